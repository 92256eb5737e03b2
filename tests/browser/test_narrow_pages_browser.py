"""Pages of the paper and of certify in a real browser: no wider than a phone, and no tick where a claim fails."""

from __future__ import annotations

import json
from dataclasses import replace
from html import escape
from typing import Any

import numpy as np
import pytest
from certified import certificate
from test_report_browser import CHROMIUM, opened

from flightstack.explore import Round
from flightstack_logs.report.certified import ExplorationPage, render
from flightstack_logs.report.words import KeyFigure
from flightstack_paper.page import page
from flightstack_paper.rows import ResultLine

pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(not CHROMIUM.exists(), reason="no browser: /usr/bin/chromium is not installed"),
]
HEAD = {
    "date": "2026-11-23", "version": "0.1.0", "git_commit": "0" * 40, "command": "flightstack reproduce --out DIR",
    "plants": ["native", "jsbsim"], "wall_time_s": 900.0, "taken_up": 0, "parts": 13,
}  # fmt: skip
LOOK = """<script>addEventListener("load", () => setTimeout(() => {
  document.body.dataset.seen = JSON.stringify([...document.querySelectorAll("iframe")].map((frame) => {
    const seen = frame.contentDocument, verdict = seen.querySelector(".verdict");
    const mark = verdict && seen.defaultView.getComputedStyle(verdict, "::before").content;
    return { tall: seen.documentElement.scrollHeight, wide: seen.documentElement.scrollWidth - 390, mark };
  }));
}, 200));</script>"""


def row(holds: bool) -> ResultLine:
    return ResultLine("adaptive-vs-uniform-samples-sound", "adaptive sampling needs far fewer samples " * 3, 2.4335,
               0.029340123, "m^2/s", holds, "24 samples of the strict form against 818 " * 5)  # fmt: skip


@pytest.fixture(scope="module")
def on_a_phone(tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, Any]]:
    """Extent of three pages in frames of 390 x 800 pixels, and the mark before their verdicts, all in one browser."""
    folder = tmp_path_factory.mktemp("narrow")
    pages = [page([row(each) for each in holds], [], HEAD, {}, folder) for holds in ((True, True), (True, False))]
    frames = "".join(
        f'<iframe style="width: 390px; height: 800px; border: 0" srcdoc="{escape(text)}"></iframe>'
        for text in (*pages, certified_page())
    )
    outer = folder / "outer.html"
    outer.write_text(f'<!doctype html><html><body style="margin: 0">{frames}{LOOK}</body></html>')
    seen: list[dict[str, Any]] = json.loads(opened(outer, folder / "profile")[1]["seen"])
    return seen


def certified_page() -> str:
    """Of certify, with as many rounds and words as it may have."""
    figures = tuple(
        KeyFigure(name, "3.007 m²/s", "58 % of the kernel of the vehicle's own limits, 5.23") for name in "abcdef"
    )
    rounds = tuple(Round(2, 5.0 * k, 1, 1.6, 0.4, (0.1, 0.3), (0.2, 0.5)) for k in range(1, 25))
    vertical = certificate()
    vertical = replace(vertical, axes=vertical.axes[2:])
    made = ExplorationPage(
        "paper-barrier: certified in flight", True, "24 rounds were flown", figures, (vertical,), rounds,
        np.zeros((50, 6)), (0.6, -2.0, 8.0), ("down: 1179 cells meet the condition " * 3,) * 6,
    )  # fmt: skip
    return render(made)


def test_the_papers_page_fits_and_ticks_only_what_holds(on_a_phone: list[dict[str, Any]]) -> None:
    for seen, ticked in zip(on_a_phone[:2], (True, False), strict=True):
        assert seen["wide"] <= 0
        assert ("✓" in seen["mark"]) is ticked


def test_certifys_page_fits_and_breaks_no_words(on_a_phone: list[dict[str, Any]]) -> None:
    """Margins that are broken letter by letter made it 8,700 pixels high."""
    seen = on_a_phone[2]
    assert seen["wide"] <= 0
    assert 500 < seen["tall"] < 3000
