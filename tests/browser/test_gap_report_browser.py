"""The gap report in a real browser: it draws everything, without an error, whatever is missing."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest
from gap_result import HOSTILE, gap_result
from test_report_browser import CHROMIUM, opened

from flightstack.gap.records import Figures, Gap, Unexplained
from flightstack.gap.report import GapReport, write_report

pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(not CHROMIUM.exists(), reason="no browser: /usr/bin/chromium is not installed"),
]


def test_the_page_draws_its_charts_and_says_what_was_found(tmp_path: Path) -> None:
    dom, data = opened(write_report(gap_result(), tmp_path / "report.html"), tmp_path / "profile")
    assert data == {"errors": "", "rendered": "6 charts"}
    assert dom.count('class="u-wrap"') == 6
    assert dom.count('class="waterfall"') == 3
    assert dom.count('data-effect="') == 3
    assert HOSTILE not in dom
    assert "<img" not in dom.split("flight-data")[0]
    for words in ("0.216 kg", "0.210 to 0.222", "Can't be told from linear drag", "98 %", "excite-low-pass"):
        assert words in dom


def test_a_page_with_nothing_found_and_nothing_drawn_opens_without_an_error(tmp_path: Path) -> None:
    nothing = Figures(None, None, None)
    gap = Gap(nothing, nothing, nothing, None)
    bare = GapReport("The data check only.", "quad-x", gap, (), (), Unexplained(False), ())
    dom, data = opened(write_report(bare, tmp_path / "report.html"), tmp_path / "profile")
    assert data == {"errors": "", "rendered": "0 charts"}
    assert "within the noise" in dom


def test_channels_that_were_not_measured_have_no_chart(tmp_path: Path) -> None:
    whole = gap_result()
    measured = whole.traces[0].measured.copy()
    measured[:, 3:] = float("nan")
    part = dataclasses.replace(whole, traces=(dataclasses.replace(whole.traces[0], measured=measured),))
    _, data = opened(write_report(part, tmp_path / "report.html"), tmp_path / "profile")
    assert data == {"errors": "", "rendered": "3 charts"}
