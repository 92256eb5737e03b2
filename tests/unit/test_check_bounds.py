"""No file takes the checker's time or memory: absurd ones are refused in one line, in a process with hard limits."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from certificates import ELLIPSE, certificate, resealed

from flightstack.barrier.file import certificate_to_json
from flightstack.certificate_check import check
from flightstack.cli import checking
from flightstack.cli.main import main
from flightstack.types import InputError
from tests.thorough import THOROUGH


@cache
def honest() -> str:
    return certificate_to_json(certificate(ELLIPSE, 60, 12))


def changed(change: Callable[[dict[str, Any]], None]) -> str:
    data = json.loads(honest())
    change(data)
    return resealed(data)


def many_columns(data: dict[str, Any]) -> None:
    spec = data["knowledge"]["vertical"]["kernel"]
    while "left" in spec:
        spec = spec["right"]
    spec["columns"] = [0] * 2_000_000


def deep_kernel(data: dict[str, Any]) -> None:
    spec: dict[str, Any] = {"kernel": "constant", "variance": 1.0}
    for _ in range(12):
        spec = {"kernel": "sum", "left": spec, "right": spec}
    data["knowledge"]["vertical"]["kernel"] = spec


def many_points(data: dict[str, Any]) -> None:
    store = data["knowledge"]["vertical"]
    store["x"], store["y"] = store["x"] * 7, store["y"] * 7


ABSURD: dict[str, Callable[[dict[str, Any]], None]] = {
    "columns: 2000000": many_columns,
    "more than 16 nodes": deep_kernel,
    "420 points": many_points,
    "nodes: 1e+09": lambda data: data["knowledge"].update(nodes=10**9),
    "65 nodes": lambda data: data["axes"][0]["authority"].update(v_mps=[0.1 * i for i in range(65)]),
    "cells: 6001": lambda data: data["axes"][0].update(cells=data["axes"][0]["cells"][:1] * 6001),
    "axes: 4": lambda data: data.update(axes=data["axes"] * 4),
    "margins: 17": lambda data: data["axes"][0].update(margins=[{}] * 17),
    "queries": lambda data: data["knowledge"].update(nodes=64, axes=[0, 1, 2]),
    "characters": lambda data: data["axes"][0]["margins"][0].update(because="x" * 3_000),
    "deeper": lambda data: data.update(axes=json.loads("[" * 60 + "]" * 60)),
}


@pytest.mark.parametrize("why", ABSURD)
def test_absurd_counts_are_refused_before_anything_is_made_of_them(why: str) -> None:
    text = changed(ABSURD[why])
    began = time.process_time()
    verdict = check(text)
    assert time.process_time() - began < 5.0
    assert not verdict.valid
    assert not verdict.readable
    assert len(verdict.lines) == 1
    assert why in verdict.lines[0]


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ('{"schema": 1, "schema": 2}', "twice"),
        ('{"schema": NaN}', "no number"),
        ('{"schema": -Infinity}', "no number"),
        ('{"schema": 1e999}', "finite"),
        ("[" * 100_000, "deep"),
        ("9" * 5_000, "digits"),
        ('{"schema": "flightstack.certificate/0"}', "schema"),
        ('{"a": "' + "x" * 10_000_001 + '"}', "10 MB"),
    ],
)
def test_what_is_no_certificate_is_unreadable(text: str, why: str) -> None:
    verdict = check(text)
    assert not verdict.readable
    assert len(verdict.lines) == 1
    assert why in verdict.lines[0]


def test_what_is_no_longer_true_is_readable_and_not_valid() -> None:
    assert check(honest()).valid
    for text in (changed(lambda data: data.update(delta=0.5)), honest().replace('"delta": 0.05', '"delta": 0.06', 1)):
        verdict = check(text)
        assert verdict.readable
        assert not verdict.valid


def test_the_verb_says_valid_not_valid_and_unreadable(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for text, code, words in (
        (honest(), 0, "valid"),
        (changed(lambda data: data.update(delta=0.5)), 1, "NOT valid"),
        (changed(many_columns), 2, "at most 7"),
        ("[" + "{}," * 3_000_000 + "{}]", 2, "schema"),
    ):
        path = tmp_path / "c.json"
        path.write_text(text)
        with pytest.raises(SystemExit) as done:
            main(["certify", "--check", str(path)])
        said = capsys.readouterr()
        assert done.value.code == code, said.err
        assert words in said.out + said.err
        if code == 2:
            assert said.err.startswith("error: ")
            assert said.err.count("\n") == 1


def test_a_file_of_gigabytes_and_what_is_no_file_are_refused_unread(tmp_path: Path) -> None:
    large = tmp_path / "large.json"
    with large.open("wb") as file:
        file.truncate(5 * 10**9)  # sparse: takes no disk
    for path, why in (
        (large, "5000 MB"),
        (tmp_path, "no file"),
        (tmp_path / "none", "No such file"),
        (Path("/dev/zero"), "no file"),
    ):
        with pytest.raises(InputError, match=why):
            checking.check_file(path)


_BOXES = [[-0.6 + 1e-5 * i, 0.6 - 1e-5 * i, -1.2 + 1e-5 * i, 1.2 - 1e-5 * i, 0.0, 0.0] for i in range(6000)]
WIDE = changed(lambda data: data["axes"][0].update(cells=_BOXES))
"""As many boxes as are looked at: the dearest certificate of an ellipse."""


def test_a_child_that_takes_too_long_or_dies_is_said_to(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    path = tmp_path / "c.json"
    path.write_text(honest())
    monkeypatch.setattr(checking, "_SHARED", 0.01 / checking.CPU_LIMIT_S)
    with pytest.raises(InputError, match=r"no verdict within 0\.01 s;"):
        checking.check_file(path)
    monkeypatch.setattr(checking, "_SHARED", 100.0)
    monkeypatch.setattr(checking, "CPU_LIMIT_S", 1)
    with pytest.raises(InputError, match="no verdict within 1 s of processor time"):
        checking.check_text(WIDE, "slow.json")
    monkeypatch.setattr(checking.sys, "executable", "/bin/false")
    with pytest.raises(InputError, match="without a verdict"):
        checking.check_text("{}", "nothing")


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only Linux limits a process' data this way")
def test_the_child_keeps_below_500_mb() -> None:
    """The dearest texts of 10 MB: many small tables, and as many boxes as are looked at."""
    dear = ["[" + '{"a":0},' * 1_200_000 + "0]", *[WIDE] * THOROUGH]
    script = (
        "import sys; from flightstack.cli import checking; checking.main(sys.argv[1:]); "
        "print(next(line.split()[1] for line in open('/proc/self/status') if line.startswith('VmHWM')))"
    )
    for text in dear:
        done = subprocess.run(
            [sys.executable, "-c", script, str(checking.CPU_LIMIT_S)], input=text, capture_output=True, text=True,
            check=True, env=os.environ | checking._ONE_THREAD,
        )  # fmt: skip
        verdict, resident_kb = done.stdout.splitlines()  # not ru_maxrss: a child inherits its parent's
        assert not json.loads(verdict)["valid"]
        assert "JSON" not in verdict  # it was read
        assert int(resident_kb) < 500_000
