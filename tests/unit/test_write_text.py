"""A result that is written again, on a disk that is full by then, stays what it was."""

from __future__ import annotations

import os
import resource
from pathlib import Path

import pytest

from flightstack.cli import files
from flightstack.types import InputError


def test_what_can_not_be_written_again_stays_as_it_was(tmp_path: Path) -> None:
    path = tmp_path / "r.json"
    files.write_text(path, "before")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, hard))  # as a full disk: the write begins and fails
    try:
        with pytest.raises(InputError, match=r"r\.json: File too large"):
            files.write_text(path, 5000 * "x")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert path.read_text() == "before"
    assert os.listdir(tmp_path) == ["r.json"]


def test_a_link_stays_a_link_and_a_device_a_device(tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    link = tmp_path / "r.json"
    link.symlink_to(tmp_path / "there" / "real.json")
    files.write_text(link, "told")
    assert link.is_symlink()
    assert (tmp_path / "there" / "real.json").read_text() == "told"
    files.write_text(Path("/dev/null"), "told")
    assert Path("/dev/null").is_char_device()


def test_a_pipe_is_written_to(tmp_path: Path) -> None:
    read, write = os.pipe()
    try:
        files.write_text(Path(f"/dev/fd/{write}"), "told")
        assert os.read(read, 10) == b"told"
    finally:
        os.close(read)
        os.close(write)


def test_a_file_that_is_open_is_written_to_and_not_replaced(tmp_path: Path) -> None:
    """`--json /dev/stdout > FILE`: what else is said goes to the same file."""
    with (tmp_path / "out.txt").open("w") as out:
        files.write_text(Path(f"/dev/fd/{out.fileno()}"), "told")
        assert (tmp_path / "out.txt").stat().st_ino == os.fstat(out.fileno()).st_ino
    assert (tmp_path / "out.txt").read_text() == "told"


def test_a_folder_in_the_place_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="Is a directory"):
        files.write_text(tmp_path, "told")


def test_a_file_in_memory_is_a_file(tmp_path: Path) -> None:
    """/dev/shm: the second JSON of a flight, which knows of its page, was left away there."""
    assert not files.is_stream(Path("/dev/shm") / tmp_path.name)
    assert files.is_stream(Path("/dev/stdout"))
