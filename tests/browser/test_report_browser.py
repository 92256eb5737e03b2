"""The report in a real browser: it draws everything, without an error, and its charts act as one."""

from __future__ import annotations

import html
import json
import re
import subprocess
from pathlib import Path

import pytest
from report_flight import circle_flight

from flightstack_logs.report.flight import FlightReport, Outcome, ReportSamples
from flightstack_logs.report.page import write_report

CHROMIUM = Path("/usr/bin/chromium")
PANELS = 24

pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(not CHROMIUM.exists(), reason="no browser: /usr/bin/chromium is not installed"),
]

PROBE = """
<script>
addEventListener("load", () => {
  const say = (name, value) => (document.body.dataset[name] = JSON.stringify(value));
  const charts = [...document.querySelectorAll(".chart")].map((holder) => holder.chart);
  const round = (v) => Math.round(v * 100) / 100;
  const spans = () => charts.map(({ scales: { x } }) => [round(x.min), round(x.max)]);
  const canvas = document.getElementById("path3d");
  const inked = () => {
    const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
    let sum = 0;
    for (let i = 3; i < data.length; i += 4) sum += data[i] > 0 ? i % 9973 : 0;
    return sum;
  };
  const later = (steps) => steps.length && setTimeout(() => { steps[0](); later(steps.slice(1)); }, 30);
  const over = charts[0].over, box = over.getBoundingClientRect();
  const mouse = (type, share) => over.dispatchEvent(new MouseEvent(type, {
    bubbles: true, view: window, clientX: box.left + share * box.width, clientY: box.top + 20, movementX: 9,
    button: 0 }));
  let still;
  later([
    () => { say("whole", spans()); still = inked(); say("ink", still); },
    () => { mouse("mouseenter", 0.5); mouse("mousemove", 0.5); },
    () => {
      say("cursors", charts.map((chart) => Math.round(chart.posToVal(chart.cursor.left, "x") * 10) / 10));
      say("readout", document.getElementById("readout").textContent);
      say("pathfollows", inked() !== still);
    },
    () => document.querySelector('[data-phase="track"]').click(),
    () => say("zoomed", spans()),
    () => over.dispatchEvent(new MouseEvent("dblclick", { bubbles: true, view: window })),
    () => say("again", spans()),
    () => { mouse("mousemove", 0.25); mouse("mousedown", 0.25); },
    () => mouse("mousemove", 0.75),
    () => mouse("mouseup", 0.75),
    () => say("dragged", spans()),
    () => { still = inked(); document.querySelector('[data-view="top"]').click(); },
    () => { say("turned", inked() !== still); say("done", true); },
  ]);
});
</script></body>"""


LAYOUT = """
<script>
addEventListener("load", () => setTimeout(() => {
  const say = (name, value) => (document.body.dataset[name] = JSON.stringify(value));
  say("wide", document.documentElement.scrollWidth - document.documentElement.clientWidth);
  say("tall", document.documentElement.scrollHeight);
  say("unnamed", [...document.querySelectorAll("canvas")].filter((c) => !c.getAttribute("aria-label")).length);
  for (const part of document.querySelectorAll("details")) part.open = true;
  setTimeout(() => {
    say("widest", document.documentElement.scrollWidth - document.documentElement.clientWidth);
    say("drawn", [...document.querySelectorAll(".chart canvas")].filter((c) => c.width > 100).length);
    say("cut", [...document.querySelectorAll("section *")].filter((e) => e.scrollHeight > e.clientHeight + 4
      && ["auto", "scroll"].includes(getComputedStyle(e).overflowY)).length);
  }, 300);
}, 300));
</script></body>"""


def opened(page: Path, profile: Path, size: str = "1400,1200") -> tuple[str, dict[str, str]]:
    """The page's DOM once its scripts have run, and its body's data attributes."""
    options = (
        "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking "
        "--disable-component-update --disable-sync --virtual-time-budget=4000 "
        f"--window-size={size}"
    )
    command = [str(CHROMIUM), *options.split(), f"--user-data-dir={profile}", "--dump-dom", page.as_uri()]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    body = re.search(r"<body([^>]*)>", done.stdout)
    assert body is not None, done.stderr
    return done.stdout, {
        name: html.unescape(value) for name, value in re.findall(r'data-(\w+)="([^"]*)"', body.group(1))
    }


def test_every_chart_is_drawn_they_share_cursor_and_zoom_and_the_path_follows(tmp_path: Path) -> None:
    page = write_report(circle_flight(), tmp_path / "report.html")
    page.write_text(page.read_text(encoding="utf-8").replace("</body>", PROBE), encoding="utf-8")
    dom, data = opened(page, tmp_path / "profile")
    assert (data["errors"], data["rendered"], data["path"]) == ("", f"{PANELS} charts", "3 tracks")
    assert dom.count('class="u-wrap"') == PANELS
    assert "<img" not in dom.split("flight-data")[0]
    seen = {name: json.loads(value) for name, value in data.items() if name not in {"errors", "rendered", "path"}}
    assert seen["done"]
    assert seen["ink"] > 0
    assert len({tuple(span) for span in seen["whole"]}) == 1
    start, end = seen["whole"][0]
    assert (start, end) == pytest.approx((0.0, 20.0), abs=0.05)
    assert len(set(seen["cursors"])) == 1
    assert seen["cursors"][0] == pytest.approx(10.0, abs=0.2)
    assert seen["readout"].startswith("10.0")
    assert seen["readout"].endswith("track")
    assert seen["pathfollows"]
    assert seen["turned"]
    assert seen["zoomed"] == [[3.0, 17.0]] * PANELS
    assert seen["again"] == seen["whole"]
    assert len({tuple(span) for span in seen["dragged"]}) == 1
    assert seen["dragged"][0] == pytest.approx([5.0, 15.0], abs=0.2)


@pytest.mark.parametrize(("size", "most_px"), [("390,844", 13_400 // 3), ("1440,900", 10_000)])
def test_nothing_overflows_and_a_narrow_page_is_short_until_it_is_unfolded(
    tmp_path: Path, size: str, most_px: int
) -> None:
    page = write_report(circle_flight(), tmp_path / "report.html")
    page.write_text(page.read_text(encoding="utf-8").replace("</body>", LAYOUT), encoding="utf-8")
    _, data = opened(page, tmp_path / "profile", size)
    assert data["errors"] == ""
    assert data["wide"] == data["widest"] == "0"
    assert 500 < int(data["tall"]) < most_px
    assert data["unnamed"] == "0"
    assert data["drawn"] == str(PANELS)
    assert data["cut"] == "0"  # no table in a box that scrolls by itself


@pytest.mark.parametrize("position", [False, True])
def test_a_page_with_nothing_or_little_recorded_opens_without_an_error(tmp_path: Path, position: bool) -> None:
    flight = circle_flight()
    point = ReportSamples(flight.truth_ned_m.t_s[:1], flight.truth_ned_m.values[:1]) if flight.truth_ned_m else None
    bare = FlightReport(Outcome(), truth_ned_m=point if position else None)
    dom, data = opened(write_report(bare, tmp_path / "report.html"), tmp_path / "profile")
    assert data["errors"] == ""
    assert data["rendered"] == "0 charts"
    assert dom.count('class="missing"') >= 12
