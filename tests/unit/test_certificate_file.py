"""The certificate file: exact there and back, strict on the way in."""

from __future__ import annotations

import json
import re
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from certificates import ELLIPSE, STOPPING, certificate, resealed
from hypothesis import given, settings
from hypothesis import strategies as st

from flightstack.barrier.condition import Setting
from flightstack.barrier.file import certificate_to_json, parse_certificate
from flightstack.barrier.records import Authority, AxisCertificate, Certificate
from flightstack.types import InputError

EXACT = st.floats(-1e11, 1e11, allow_nan=False).filter(lambda x: x == 0.0 or abs(x) > 1e-300)


def small() -> Certificate:
    return certificate(ELLIPSE, 12, 8)


def same(one: Certificate, other: Certificate) -> bool:
    """Equal in every number, bit by bit."""

    def plain(value: Any) -> Any:
        if isinstance(value, np.ndarray):
            return value.tolist()
        if isinstance(value, tuple | list) and not isinstance(value, Setting):
            return [plain(part) for part in value]
        if isinstance(value, Certificate | AxisCertificate | Authority):
            return {part.name: plain(getattr(value, part.name)) for part in fields(value)}
        return value

    return bool(plain(one) == plain(other))


@pytest.mark.parametrize("barrier", [ELLIPSE, STOPPING])
def test_a_certificate_comes_back_as_it_was(barrier: Any) -> None:
    made = certificate(barrier, 12, 8)
    text = certificate_to_json(made)
    assert same(parse_certificate(text, "file"), made)
    assert certificate_to_json(parse_certificate(text, "file")) == text


@settings(max_examples=40, deadline=None)
@given(st.lists(st.lists(EXACT, min_size=6, max_size=6), min_size=1, max_size=4), EXACT)
def test_every_number_is_exact(cells: list[list[float]], north: float) -> None:
    made = small()
    made = replace(
        made, axes=(replace(made.axes[0], cells=np.array(cells)),), centre_ned_m=(north * 1e-6, 0.1 + 0.2, -0.8)
    )
    back = parse_certificate(certificate_to_json(made), "file")
    assert back.axes[0].cells.tobytes() == made.axes[0].cells.tobytes()
    assert back.centre_ned_m == made.centre_ned_m


def test_the_text_is_plain_json_with_one_row_a_line() -> None:
    text = certificate_to_json(small())
    data = json.loads(text)
    assert next(iter(data)) == "schema"
    assert data["schema"] == "flightstack.certificate/6"
    assert list(data)[-1] == "seal"
    row = data["axes"][0]["cells"][3]
    assert any(line.strip().rstrip(",") == json.dumps(row) for line in text.splitlines())
    assert json.loads(resealed(data)) == data  # the seal is what its docstring says


def one_line(error: InputError) -> str:
    text = str(error)
    assert text.startswith("file: ")
    assert "\n" not in text
    assert len(text) < 300
    return text


def set_at(data: Any, path: list[Any], value: object) -> None:
    for key in path[:-1]:
        data = data[key]
    data[path[-1]] = value


WRONG: list[tuple[list[Any], object, str]] = [
    (["schema"], "flightstack.certificate/1", "schema"),
    (["mode"], "loud", "mode"),
    (["version"], 1.5, "version"),
    (["version"], True, "version"),
    (["centre_ned_m"], [0.0, 1.0], "centre_ned_m"),
    (["delta"], 1.5, "delta"),
    (["k_sigma"], "4", "k_sigma"),
    (["budget", "low_mps2"], None, "budget.low_mps2"),
    (["budget", "weight"], 1.0, "unknown key weight"),
    (["axes"], [], "axes"),
    (["axes"], {}, "axes"),
    (["axes", 0, "axis"], "up", r"axes\[0\].axis"),
    (["axes", 0, "barrier", "kind"], "cubic", "barrier.kind"),
    (["axes", 0, "barrier", "kind"], ["quadratic"], "barrier.kind"),
    (["axes", 0, "barrier", "p12"], 100.0, "barrier"),
    (["axes", 0, "setting", "eta"], [0.1], "setting.eta"),
    (["axes", 0, "response", "c1_s"], "x", "response.c1_s"),
    (["axes", 0, "authority", "gain"], [1.0], "authority.gain"),
    (["axes", 0, "authority", "v_mps", 0], 9.0, "authority.v_mps"),
    (["axes", 0, "margins", 0, "name"], "luck", r"margins\[0\].name"),
    (["axes", 0, "margins", 0, "mps2"], -0.1, r"margins\[0\].mps2"),
    (["axes", 0, "cells", 2], [1.0, 2.0], r"cells\[2\]"),
    (["axes", 0, "cells", 2, 1], None, r"cells\[2\]\[1\]"),
    (["axes", 0, "cells"], 7, "cells"),
    (["knowledge"], [], "knowledge"),
    (["more"], 1, "unknown key more"),
]  # fmt: skip


@pytest.mark.parametrize(("path", "value", "names"), WRONG)
def test_what_is_wrong_is_named(path: list[Any], value: object, names: str) -> None:
    data = json.loads(certificate_to_json(small()))
    set_at(data, path, value)
    with pytest.raises(InputError) as caught:
        parse_certificate(resealed(data), "file")
    assert re.search(names, one_line(caught.value))


@pytest.mark.parametrize("path", [["mode"], ["seal"], ["axes", 0, "cells"], ["budget", "tilt_max_rad"]])
def test_what_is_missing_is_named(path: list[Any]) -> None:
    data = json.loads(certificate_to_json(small()))
    inner = data
    for key in path[:-1]:
        inner = inner[key]
    del inner[path[-1]]
    with pytest.raises(InputError, match=f"{path[-1]} is missing"):
        parse_certificate(json.dumps(data) if path == ["seal"] else resealed(data), "file")


def test_a_change_without_the_seal_is_found() -> None:
    text = certificate_to_json(small())
    data = json.loads(text)
    first = repr(data["axes"][0]["cells"][0][0])
    with pytest.raises(InputError, match="seal"):
        parse_certificate(text.replace(first, first[:-1] + ("1" if first[-1] != "1" else "2"), 1), "file")


NOT_FILES = [
    "", "7", "null", "[]", "{", '"x"', "NaN", '{"schema": NaN}', '{"schema": Infinity}', '{"a": 1e999}',
    "[" * 100_000, '{"a":' * 100_000, '{"a": ' + "9" * 5000 + "}", '{"a": 1, "a": 2}', "\x00", "\ud800", "{}",
    '{"schema": "flightstack.certificate/6"}', '{"x": ' + "[" * 60 + "]" * 60 + "}",
]  # fmt: skip


@pytest.mark.parametrize("text", NOT_FILES, ids=range(len(NOT_FILES)))
def test_what_is_no_certificate_is_refused_in_one_line(text: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_certificate(text, "file")
    one_line(caught.value)


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_damage_is_refused_in_one_line(data: st.DataObject) -> None:
    text = certificate_to_json(small())
    start = data.draw(st.integers(0, len(text) - 2))
    damaged = data.draw(
        st.sampled_from(
            [text[:start], text[start:], text[:start] + "," + text[start:], text[:start] + text[start + 7 :]]
        )
    )
    try:
        json_same = json.loads(damaged) == json.loads(text)
    except ValueError:
        json_same = False
    if json_same:
        return
    with pytest.raises(InputError) as caught:
        parse_certificate(damaged, "file")
    one_line(caught.value)


def test_what_is_not_plain_json_is_not_written() -> None:
    with pytest.raises(InputError, match="not to be written"):
        certificate_to_json(replace(small(), knowledge={"x": float("nan")}))
    with pytest.raises(InputError, match="not to be written"):
        certificate_to_json(replace(small(), knowledge={"x": object()}))
