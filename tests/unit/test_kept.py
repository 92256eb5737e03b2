"""Results of searches on disk: read as they were written, or searched anew."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from flightstack import jit, kept
from flightstack.site import radii

MODULE = "flightstack.site.radii"
NUMBERS = [0.1, 1.0 / 3.0, float("inf"), -0.0, 5e-324]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(kept, "code_folder", lambda module: tmp_path)
    return tmp_path


def _counted() -> tuple[Callable[[], list[float]], list[int]]:
    calls: list[int] = []

    def search() -> list[float]:
        calls.append(1)
        return list(NUMBERS)

    return search, calls


def test_a_search_is_made_once_and_read_to_the_last_bit(folder: Path) -> None:
    search, calls = _counted()
    for _ in range(3):
        again = kept.kept(MODULE, (1.0, 2.0), search)
        assert np.array(again).tobytes() == np.array(NUMBERS).tobytes()
    assert len(calls) == 1
    kept.kept(MODULE, (1.0, 2.0 + 2e-16 * 2), search)
    assert len(calls) == 2
    assert not list(folder.glob("new-*"))


@pytest.mark.parametrize("spoil", [b"", b"0x1p+0\n", b"\xff\xfe\x00", b"0x1p+0 0x1p+0\nnot its sum\n"])
def test_what_was_not_written_so_is_searched_anew(folder: Path, spoil: bytes) -> None:
    search, calls = _counted()
    kept.kept(MODULE, "q", search)
    (file,) = folder.glob("kept-*")
    file.write_bytes(spoil)
    assert kept.kept(MODULE, "q", search) == NUMBERS
    assert len(calls) == 2
    assert kept.kept(MODULE, "q", search) == NUMBERS
    assert len(calls) == 2


def test_a_single_changed_digit_is_noticed(folder: Path) -> None:
    search, calls = _counted()
    kept.kept(MODULE, "q", search)
    (file,) = folder.glob("kept-*")
    file.write_text(file.read_text().replace("0x1.999", "0x1.998"))
    assert kept.kept(MODULE, "q", search) == NUMBERS
    assert len(calls) == 2


def test_without_a_place_or_beyond_the_most_nothing_is_kept(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    search, calls = _counted()
    monkeypatch.setattr(kept, "_MOST", 0)
    assert kept.kept(MODULE, "q", search) == NUMBERS
    assert not list(folder.iterdir())
    monkeypatch.setattr(kept, "code_folder", lambda module: None)
    assert kept.kept(MODULE, "q", search) == NUMBERS
    assert len(calls) == 2


def test_another_source_has_another_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jit, "cache_folder", lambda: tmp_path)
    before = jit.code_folder(MODULE)
    monkeypatch.setattr(jit, "_closure_key", lambda module: "edited")
    after = jit.code_folder(MODULE)
    assert before != after
    assert before is not None
    assert before.is_dir()


def test_the_search_is_told_by_all_that_it_depends_on() -> None:
    """What a result is kept by must tell every number of it: named tuples of numbers do, arrays of many do not."""
    held = radii.Held(*(0.1 * k + 1e-16 for k in range(7)))
    assert repr(held) != repr(held._replace(eps_v_mps=np.nextafter(held.eps_v_mps, 1.0)))
