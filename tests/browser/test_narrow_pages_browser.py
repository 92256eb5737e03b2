"""Pages of the paper and of certify in a real browser: no wider than a phone, and no tick where a claim fails."""

from __future__ import annotations

from dataclasses import replace
from html import escape
from pathlib import Path

import numpy as np
import pytest
from certified import certificate
from test_report_browser import CHROMIUM, opened

from flightstack.explore import Round
from flightstack_logs.report.certified import Exploration, render
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
  const seen = document.querySelector("iframe").contentDocument;
  document.body.dataset.tall = seen.documentElement.scrollHeight;
  document.body.dataset.wide = seen.documentElement.scrollWidth - 390;
  document.body.dataset.mark = seen.defaultView.getComputedStyle(seen.querySelector(".verdict"), "::before").content;
  }, 200));</script>"""


def row(holds: bool) -> ResultLine:
    return ResultLine("adaptive-vs-uniform-samples-sound", "adaptive sampling needs far fewer samples " * 3, 2.4335,
               0.029340123, "m^2/s", holds, "24 samples of the strict form against 818 " * 5)  # fmt: skip


def on_a_phone(text: str, folder: Path) -> dict[str, str]:
    """The page's extent in a frame of 390 x 800 pixels, and the mark before its verdict."""
    outer = folder / "outer.html"
    frame = f'<iframe style="width: 390px; height: 800px; border: 0" srcdoc="{escape(text)}"></iframe>'
    outer.write_text(f'<!doctype html><html><body style="margin: 0">{frame}{LOOK}</body></html>')
    return opened(outer, folder / "profile")[1]


@pytest.mark.parametrize(("holds", "ticked"), [((True, True), True), ((True, False), False)])
def test_the_papers_page_fits_and_ticks_only_what_holds(tmp_path: Path, holds: tuple[bool, ...], ticked: bool) -> None:
    data = on_a_phone(page([row(each) for each in holds], [], HEAD, {}, tmp_path), tmp_path)
    assert int(data["wide"]) <= 0
    assert ("✓" in data["mark"]) is ticked


def test_certifys_page_fits_and_breaks_no_words(tmp_path: Path) -> None:
    """Margins that are broken letter by letter made it 8,700 pixels high."""
    figures = tuple((name, "3.007 m²/s", "58 % of the kernel of the vehicle's own limits, 5.23") for name in "abcdef")
    rounds = tuple(Round(2, 5.0 * k, 1, 1.6, 0.4, (0.1, 0.3), (0.2, 0.5)) for k in range(1, 25))
    vertical = certificate()
    vertical = replace(vertical, axes=vertical.axes[2:])
    made = Exploration(
        "paper-barrier: certified in flight", True, "24 rounds were flown", figures, (vertical,), rounds,
        np.zeros((50, 6)), (0.6, -2.0, 8.0), ("down: 1179 cells meet the condition " * 3,) * 6,
    )  # fmt: skip
    data = on_a_phone(render(made), tmp_path)
    assert int(data["wide"]) <= 0
    assert int(data["tall"]) < 3000
