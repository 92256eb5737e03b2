"""The paper's page in a real browser: no wider than a phone, and no tick where a claim does not hold."""

from __future__ import annotations

from html import escape
from pathlib import Path

import pytest
from test_report_browser import CHROMIUM, opened

from flightstack_paper.page import page
from flightstack_paper.rows import Row

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
  document.body.dataset.wide = seen.documentElement.scrollWidth - 390;
  document.body.dataset.mark = seen.defaultView.getComputedStyle(seen.querySelector(".verdict"), "::before").content;
  }, 200));</script>"""


def row(holds: bool) -> Row:
    return Row("adaptive-vs-uniform-samples-sound", "adaptive sampling needs far fewer samples " * 3, 2.4335,
               0.029340123, "m^2/s", holds, "24 samples of the strict form against 818 " * 5)  # fmt: skip


@pytest.mark.parametrize(("holds", "ticked"), [((True, True), True), ((True, False), False)])
def test_the_page_fits_a_phone_and_ticks_only_what_holds(tmp_path: Path, holds: tuple[bool, ...], ticked: bool) -> None:
    text = page([row(each) for each in holds], [], HEAD, {}, tmp_path)
    outer = tmp_path / "outer.html"
    frame = f'<iframe style="width: 390px; height: 800px; border: 0" srcdoc="{escape(text)}"></iframe>'
    outer.write_text(f'<!doctype html><html><body style="margin: 0">{frame}{LOOK}</body></html>')
    _, data = opened(outer, tmp_path / "profile")
    assert int(data["wide"]) <= 0
    assert ("✓" in data["mark"]) is ticked
