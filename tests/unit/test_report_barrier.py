"""The report's section on the barrier: what it takes from a log, what it draws, what it writes into its tables."""

from __future__ import annotations

import math
import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from certified import certificate, says

from flightstack.barrier.file import certificate_to_json
from flightstack.barrier.records import MARGINS
from flightstack.barrier.shapes import Quadratic, Stopping, value
from flightstack.cli.result import NO_BARRIER, NO_QP
from flightstack.types import Filtered
from flightstack_logs.reader import Log, read
from flightstack_logs.report import barrier
from flightstack_logs.report.flight import FlightReport, Outcome
from flightstack_logs.report.log_input import from_log
from flightstack_logs.report.page import render_report
from flightstack_logs.report.phase_plane import Outline, Plane, boundary, ellipse, parted, plane_svg
from flightstack_logs.report.plot import ticks
from flightstack_logs.report.result import outcome_from_result
from flightstack_logs.topics import CERTIFICATE, FINAL_CERTIFICATE, TOPICS, Attachment
from flightstack_logs.writer import FlightLog

ROOT = Path(__file__).parents[2]
SCENARIO = (ROOT / "flightstack/data/scenarios" / "paper-tracking.toml").read_text()
START = np.array([5.0, 6.0, 7.0])


def _row(topic: str, **values: Any) -> tuple[Any, ...]:
    blank = {"string": "", "bool": False}
    zeros = {f.name: [blank.get(f.type, 0)] * f.size if f.size else blank.get(f.type, 0) for f in TOPICS[topic].fields}
    return tuple((zeros | values).values())


def attached(version: int, semi_m: float = 1.0, **changes: Any) -> bytes:
    return certificate_to_json(certificate(semi_m, version=version, **changes)).encode()


def write_circle(path: Path, *items: Attachment, truth: bool = True, settings: dict[str, str] | None = None) -> Log:
    """10 s on a circle in (east, its rate): engaged after 4 s, changed from 6 to 7 s, infeasible from 8.0 to 8.1 s."""
    files = [Attachment("scenario.toml", "", SCENARIO.encode()), *items]
    log = FlightLog.open(path, metadata={"settings": settings or {}}, attachments=files)
    log.event(0, "phase", "takeoff")
    for k in range(1000):
        t_us, t = 10_000 * k, 0.01 * k
        east, rate = 0.5 * math.sin(t), 0.5 * math.cos(t)
        place = np.add(START, (0.0, east, -1.5)) if k else START
        pose = {"pos_ned_m": place, "vel_ned_mps": [0.0, rate, 0.0], "q_ned_frd": [1.0, 0.0, 0.0, 0.0]}
        log.write("/tick", t_us, _row("/tick", **pose))
        if truth:
            log.write("/truth", t_us, _row("/truth", **pose))
        status = 1 if k < 400 else 3 if 600 <= k < 700 else 4 if 800 <= k < 810 else 2
        accelerations = {"wanted_acc_ned_mps2": (1.0, 2.0, 3.0), "safe_acc_ned_mps2": (1.0, 2.0, 2.5)}
        allowed = {"low_ned_mps2": (-2.0, -2.0, np.nan), "high_ned_mps2": (2.0, 2.0, np.nan)}
        log.write("/filter", t_us, says(status, **accelerations, **allowed))
    log.event(8_000_000, "filter", "filter: fallback: infeasible (h -0.020, at the state 0.5)", "warning")
    log.close()
    assert log.failed is None, log.failed
    return read(path)


class Tables(HTMLParser):
    """Rows of the page's ledger as lists of their cells' words."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.rows: list[list[str]] = []
        self.feed(page[page.index('class="ledger"') :].split("</table>")[0])

    def handle_starttag(self, tag: str, attrs: Any) -> None:
        if tag == "tr":
            self.rows.append([])
        elif tag in ("td", "th"):
            self.rows[-1].append("")
        elif tag == "p":
            self.rows[-1][-1] += "|"

    def handle_data(self, data: str) -> None:
        if self.rows and self.rows[-1]:
            self.rows[-1][-1] += data


# ---------------------------------------------------------------- from a log


def test_a_log_gives_what_the_filter_said_and_the_state_relative_to_the_start(tmp_path: Path) -> None:
    seen = from_log(write_circle(tmp_path / "f.mcap")).barrier
    assert seen is not None
    assert seen.state is not None
    np.testing.assert_allclose(
        seen.state.values[314], [0.0, 0.5 * math.sin(3.14), -1.5, 0.0, 0.5 * math.cos(3.14), 0.0]
    )
    assert seen.status.values[[0, 399, 400, 650, 805], 0].tolist() == [1, 1, 2, 3, 4]
    assert seen.region is not None
    h = barrier.region_h(seen)
    assert h is not None
    # the scenario's region: 1.5 m and 1.8 m/s along east, the centre 1.5 m up
    expected = 1.0 - (0.5 * math.sin(5.0) / 1.5) ** 2 - (0.5 * math.cos(5.0) / 1.8) ** 2
    assert h.values[500, 0] == pytest.approx(expected)
    blind = from_log(write_circle(tmp_path / "g.mcap", truth=False)).barrier
    assert blind is not None
    assert blind.state is not None
    np.testing.assert_allclose(blind.state.values, seen.state.values)


def test_the_certificates_are_the_first_and_the_last_and_what_is_damaged_is_left_out(tmp_path: Path) -> None:
    first, last = Attachment(CERTIFICATE, "", attached(1)), Attachment(FINAL_CERTIFICATE, "", attached(4))
    torn = Attachment(FINAL_CERTIFICATE, "", attached(4)[:-50])
    for items, versions in (((first, last), [1, 4]), ((first,), [1]), ((last,), [4]), ((first, torn), [1]), ((), [])):
        flight = from_log(write_circle(tmp_path / "f.mcap", *items))
        assert flight.barrier is not None
        assert [one.version for one in flight.barrier.certificates] == versions
        (tmp_path / "f.mcap").unlink()
    same = from_log(write_circle(tmp_path / "s.mcap", first, Attachment(FINAL_CERTIFICATE, "", attached(1))))
    assert same.barrier is not None
    assert len(same.barrier.certificates) == 1


def test_a_flight_under_a_given_certificate_is_not_shown_in_the_scenarios_region(tmp_path: Path) -> None:
    seen = from_log(write_circle(tmp_path / "f.mcap", settings={"certificate": "mine.json"})).barrier
    assert seen is not None
    assert seen.region is None
    assert barrier.region_h(seen) is None


# ---------------------------------------------------------------- the page


def test_a_flight_without_a_filter_has_no_such_section() -> None:
    assert 'id="barrier"' not in render_report(FlightReport(Outcome()))


def test_the_section_has_its_charts_planes_ledger_and_histogram(tmp_path: Path) -> None:
    items = Attachment(CERTIFICATE, "", attached(1, 0.8)), Attachment(FINAL_CERTIFICATE, "", attached(4))
    qp = {
        "solve_us": {"p50": 35.0, "p99": 90.0, "max": 200.0}, "infeasible": 10,
        "histogram": {"edges_us": [1.0, 10.0, 100.0, 1000.0], "counts": [0, 995, 5]},
    }  # fmt: skip
    kept = {"enabled": True, "min_h_truth": 0.61, "min_h_estimate": 0.6, "violations": 0, "interventions": 110}
    kept |= {"protected": [{"from_s": 4.0, "to_s": 8.0}, {"from_s": 8.1, "to_s": 10.0}], "engaged_share": 0.59}
    region = {"engaged_s": 2.4}  # when h was first large: nobody kept to it then
    flight = from_log(
        write_circle(tmp_path / "f.mcap", *items), {"barrier": kept, "region": region, "qp": qp, "completed": True}
    )
    page = render_report(flight)
    drawn = {panel.key: panel for panel in barrier.panels(flight)}
    h = drawn["barrier-h"]
    np.testing.assert_allclose(h.shaded_s, [(6.0, 7.0), (8.0, 8.1)], atol=0.011)
    assert [(span.label, round(span.start_s, 2)) for span in h.strip] == [
        ("not engaged", 0.0), ("engaged", 4.0), ("infeasible", 8.0), ("engaged", 8.1),
    ]  # fmt: skip
    assert [mark.label for mark in h.marks] == ["infeasible"]
    assert [curve.label for curve in drawn["barrier-east"].curves] == ["allowed", "allowed", "wanted", "sent"]
    assert [curve.label for curve in drawn["barrier-down"].curves] == ["wanted", "sent"]  # nothing is known of limits
    for key in drawn:
        assert f'data-panel="{key}"' in page
    assert page.count('<svg class="plane"') == 3
    for role, count in (("certified", 3), ("before", 3), ("region", 3)):
        assert page.count(f'<path class="{role}"') == count
    assert "995 ticks" in page
    figures = {figure.label: (figure.value, figure.state) for figure in barrier.figures(flight)}
    assert figures["Least h, truth"] == ("0.610", "good")
    assert figures["Infeasible"] == ("10", "bad")
    assert figures["Engaged"] == ("4.0 s", "plain")  # where the strip of the chart turns as well
    assert figures["One step"] == ("35 µs", "plain")
    assert figures["Certified area"][0] == "version 4"


def test_the_ledger_has_every_margin_of_every_axis_with_its_reason(tmp_path: Path) -> None:
    flight = from_log(write_circle(tmp_path / "f.mcap", Attachment(FINAL_CERTIFICATE, "", attached(4))))
    page = render_report(flight)
    rows = Tables(page).rows
    assert rows[0] == ["Margin", "north", "east", "down"]
    assert [row[0].replace(" ", "_") for row in rows[1 : 1 + len(MARGINS)]] == list(MARGINS)
    assert rows[3][2] == "0.030"  # the third margin of east
    assert "figure 2 &lt;of 1&gt;" in page  # its reason, escaped
    assert "<of 1>" not in page
    assert rows[1 + len(MARGINS)] == ["together", *["0.550"] * 3]


def test_a_flight_that_left_its_region_says_so_at_the_top(tmp_path: Path) -> None:
    result = {"completed": True, "barrier": {"enabled": True, "violations": 3, "min_h_truth": -0.1}}
    page = render_report(from_log(write_circle(tmp_path / "f.mcap"), result))
    assert re.search(r'<header class="bad">\s*<span class="verdict">Left its region', page)


@pytest.mark.parametrize(
    "result",
    [
        {}, {"barrier": 3, "qp": [], "region": "x"}, {"qp": {"histogram": {"edges_us": [1, 2], "counts": [1, 2]}}},
        {"qp": {"histogram": {"edges_us": ["a", 2.0], "counts": [1]}}}, {"barrier": NO_BARRIER, "qp": NO_QP},
        {"qp": {"histogram": {"edges_us": [0.0, 0.5], "counts": [4]}}},
    ],
)  # fmt: skip
def test_a_result_that_says_little_or_nonsense_is_no_error(tmp_path: Path, result: dict[str, object]) -> None:
    assert outcome_from_result(result).filter.solve_counts == ()
    page = render_report(from_log(write_circle(tmp_path / "f.mcap"), result))
    assert 'id="barrier-solve"' not in page


def test_a_filter_that_had_nothing_certified_is_drawn_too(tmp_path: Path) -> None:
    log = FlightLog.open(tmp_path / "f.mcap", metadata={})
    for k in range(50):
        log.write("/filter", 4000 * k, Filtered(np.where(np.arange(len(says(0).row)) == 2, 0.0, says(0, h=np.nan).row)))
    log.close()
    page = render_report(from_log(read(tmp_path / "f.mcap")))
    assert 'id="barrier"' in page


# ---------------------------------------------------------------- the planes


@pytest.mark.parametrize("barrier_of", [Quadratic(0.1, -0.2, 3.0, 0.4, 0.4), Stopping(-0.6, 0.6, 0.2, 2.0, 6.0)])
def test_the_boundary_is_where_h_is_nought(barrier_of: Quadratic | Stopping) -> None:
    points = boundary(barrier_of, 1.0)
    assert np.abs([value(barrier_of, e - 1.0, v) for e, v in points]).max() < 1e-6
    around = np.concatenate([points, points[:1]])
    area = 0.5 * abs(np.sum(around[:-1, 0] * around[1:, 1] - around[1:, 0] * around[:-1, 1]))  # the shoelace formula
    assert area == pytest.approx(barrier_of.area_m2ps, rel=2e-3)


def test_an_ellipse_has_its_axes() -> None:
    points = ellipse(2.0, 0.5, 0.25)
    np.testing.assert_allclose(((points[:, 0] - 2.0) / 0.5) ** 2 + (points[:, 1] / 0.25) ** 2, 1.0)


def test_what_is_left_out_parts_the_path() -> None:
    points = np.arange(12.0).reshape(6, 2)
    seen = parted(points, [True, True, False, False, True, True])
    assert np.isnan(seen[2]).all()
    np.testing.assert_array_equal(np.delete(seen, 2, axis=0), points[[0, 1, 4, 5]])


def test_the_plane_shows_the_region_whole_and_the_way_up_from_the_ground_cut_off() -> None:
    outline = Outline("certified", ellipse(-1.5, 0.5, 0.5))
    nothing = np.empty((0, 2))
    far = np.array([[0.0, 0.0], [-40.0, 9.0]])
    one = plane_svg(Plane("down", nothing, nothing, nothing, (outline,)))
    other = plane_svg(Plane("down", far, nothing, nothing, (outline,)))
    polygon = re.compile(r'<path class="certified" d="M([^"]*)Z"')
    shown, same = polygon.search(one), polygon.search(other)
    assert shown is not None
    assert same is not None
    assert shown.group(1) == same.group(1)
    numbers = np.array([pair.split() for pair in shown.group(1).split("L")], dtype=float)
    assert numbers.min() > 0.0
    assert numbers[:, 0].max() < 420.0
    assert numbers[:, 1].max() < 320.0
    assert '<path class="idle"' in other
    assert plane_svg(Plane("down", nothing, nothing, nothing)) == ""


@pytest.mark.parametrize(("low", "high"), [(-0.6, 0.6), (-41.3, 2.0), (0.1234, 0.1235)])
def test_ticks_are_a_few_round_numbers_inside(low: float, high: float) -> None:
    found = ticks(low, high)
    assert 2 <= len(found) <= 8
    assert low <= found[0] <= found[-1] <= high
    assert len(set(np.round(np.diff(found), 9))) == 1


def test_the_path_is_that_of_the_flight(tmp_path: Path) -> None:
    north, east, down = barrier.planes(from_log(write_circle(tmp_path / "f.mcap")))
    engaged = east.engaged[np.isfinite(east.engaged).all(axis=1)]
    np.testing.assert_allclose(np.linalg.norm(engaged, axis=1), 0.5)
    assert len(east.changed) == 110
    assert (north.name, down.name) == ("north", "down")
    np.testing.assert_allclose(down.changed, [[-1.5, 0.0]] * 110)
