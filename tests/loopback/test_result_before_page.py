"""The result is written before the page: an hour's page takes gigabytes, which may end the process."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from flightstack.cli import main as cli


@pytest.mark.parametrize(
    ("error", "code", "says"),
    [(KeyboardInterrupt, 130, ""), (MemoryError, 1, "error: no report: not enough memory for it")],
)
def test_what_ends_the_making_of_the_page_does_not_cost_the_result(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    error: type[BaseException],
    code: int,
    says: str,
) -> None:
    result_file = tmp_path / "r.json"
    seen: list[dict[str, object]] = []

    def made(*_: object) -> None:
        seen.append(json.loads(result_file.read_text()))
        raise error

    monkeypatch.setattr("flightstack_logs.report.page.write_report", made)
    with pytest.raises(SystemExit) as stop:
        cli.main(["fly", "hover", "--duration", "1", "--out", str(tmp_path), "--json", str(result_file)])
    assert stop.value.code == code
    assert says in capsys.readouterr().err
    (before,) = seen
    assert before["completed"]
    assert before["log_complete"]
    assert before["report"] is None
    assert {**json.loads(result_file.read_text()), "passed": True} == before  # without its page it has not passed


def test_a_pipe_hears_the_result_once(tmp_path: Path) -> None:
    read, write = os.pipe()
    try:
        with pytest.raises(SystemExit) as stop:
            cli.main(["fly", "hover", "--duration", "1", "--out", str(tmp_path), "--json", f"/dev/fd/{write}"])
        assert not stop.value.code
        result = json.loads(os.read(read, 1 << 16))
    finally:
        os.close(read)
        os.close(write)
    assert result["report"] == str(tmp_path / "report.html")
