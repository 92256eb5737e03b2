"""The gap report in a real browser: it draws everything, without an error, whatever is missing."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import pytest
from gap_result import HOSTILE, gap_result
from test_report_browser import CHROMIUM, LAYOUT, opened

from flightstack.effects import EFFECTS
from flightstack.gap.records import Across, Estimate, Figures, Gap, IdentifiedEffect, Rejected, Unexplained
from flightstack.gap.report import GapReport, write_report
from flightstack.gap.report.record import Shown

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


BROKEN = """<script>
addEventListener("load", () => setTimeout(() => {
  const say = (name, value) => (document.body.dataset[name] = JSON.stringify(value));
  const told = (e) => (e.id || e.className) + ": " + e.textContent.slice(0, 60);
  say("beyond", [...document.querySelectorAll(".panel *")].filter((e) => !e.closest(".chart")
    && e.getBoundingClientRect().right > e.closest(".panel").getBoundingClientRect().right).map(told));
  // a word that stands in more than one line was broken
  const broken = [];
  const words = [...document.querySelectorAll("td:not(#checks td:nth-child(2)), th")].flatMap((e) => [...e.childNodes]);
  for (const node of words.filter((each) => each.nodeType === 3)) {
    for (const { index, 0: word } of node.data.matchAll(/[^\\s_\u2212-]+/g)) {
      const range = new Range();
      range.setStart(node, index); range.setEnd(node, index + word.length);
      const lines = new Set([...range.getClientRects()].filter((r) => r.width > 0).map((r) => Math.round(r.top)));
      if (lines.size > 1) broken.push(word);
    }
  }
  say("broken", broken);
}, 900));
</script></body>"""


@pytest.mark.parametrize("size", ["390,844", "1440,900"])
def test_nothing_leaves_its_panel_and_no_word_is_broken(tmp_path: Path, size: str) -> None:
    result = gap_result()
    tiny = Estimate(0.0, -0.016, -0.033, 9.82e-4)
    force = IdentifiedEffect("constant_force", dict.fromkeys(("north_n", "east_n", "down_n"), tiny), -4184.0, 0.17, 0.0)
    more = tuple(Rejected(name, 10.0 * k, "explains nothing more") for k, name in enumerate(EFFECTS))
    shown = tuple(Shown(name, "shown", "thrust_model_factor from 0.048; hard to tell from drag") for name in EFFECTS)
    flown = tuple((f"a_rather_long_name_of_flight_{k}.ulg", tiny) for k in range(3))
    across = (Across("constant_force", "north_n", 1e-12, False, flown),)
    result = dataclasses.replace(result, found=(force, *result.found), rejected=more, shown=shown, across=across)
    page = write_report(result, tmp_path / "report.html")
    page.write_text(page.read_text(encoding="utf-8").replace("</body>", LAYOUT.replace("</body>", BROKEN)), "utf-8")
    _, data = opened(page, tmp_path / "profile", size)
    assert data["errors"] == ""
    assert data["wide"] == data["widest"] == data["cut"] == data["unnamed"] == "0"
    assert json.loads(data["beyond"]) == []
    assert json.loads(data["broken"]) == []
    if size.startswith("390"):
        assert 500 < int(data["tall"]) < 4500  # as long as nothing is unfolded
