from __future__ import annotations

import base64
import json
import math
import random
import re
import struct
import tomllib
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from flightstack_logs.reader import Log, read
from flightstack_logs.report import words
from flightstack_logs.report.flight import (
    CheckResult,
    FlightEvent,
    FlightReport,
    Outcome,
    Phase,
    ReportRegion,
    ReportSamples,
    Timing,
    samples,
)
from flightstack_logs.report.log_input import from_log
from flightstack_logs.report.page import render_report, write_report
from flightstack_logs.report.result import outcome_from_result, timing_from_result
from flightstack_logs.topics import TOPICS, Attachment, Field
from flightstack_logs.writer import FlightLog

ROOT = Path(__file__).parents[2]
VEHICLE = (ROOT / "flightstack/data/vehicles" / "quad-x.toml").read_bytes()
SCENARIO = (ROOT / "flightstack/data/scenarios" / "paper-tracking.toml").read_bytes()
START_US = 7_000_000
TAKEOFF_S, TRACK_S, LAND_S = 3.0, 6.0, 26.0
RESULT = {
    "schema": "flightstack.flight/1",
    "scenario": "paper-tracking",
    "seed": 3,
    "completed": True,
    "flight_time_s": 26.0,
    "wall_time_s": 1.0,
    "realtime_factor": 26.0,
    "plant": "native",
    "controller": "flatness",
    "tracking": {"of": "truth", "rmse_m": 0.05, "max_m": 0.07, "rmse_settled_m": 0.05},
    "barrier": {"enabled": False, "min_h_truth": None},
    "gp": {"enabled": False, "points": None},
    "loop": {"rate_hz": None, "lateness_us": {"p50": None, "p99": None, "max": None}, "missed": None},
}


def signal(t: object, values: object) -> ReportSamples:
    made = samples(t, values)
    assert made is not None
    return made


def blank(field: Field) -> object:
    value: object = {"string": "", "bool": False, "double": 0.0, "float": 0.0}.get(field.type, 0)
    return [value] * field.size if field.size else value


def row(topic: str, **values: object) -> tuple[object, ...]:
    """A record of a topic: zeros but for what is named."""
    return tuple(values.get(field.name, blank(field)) for field in TOPICS[topic].fields)


def circle(t: float) -> np.ndarray:
    """A climb to 1.5 m, then a circle of radius 1 m at 1 rad/s, relative to the start."""
    if t < TRACK_S:
        return np.array([0.0, 0.0, -1.5 * min(max(t, 0.0) / TAKEOFF_S, 1.0)])
    angle = min(t, LAND_S) - TRACK_S
    return np.array([math.sin(angle), 1.0 - math.cos(angle), -1.5])


def write_flight(path: Path, topics: set[str]) -> Log:
    """A flight in closed form, in MCAP: from the take-off's end on the truth is (3, 4, 0) cm beside the reference.

    The estimate's frame has its origin elsewhere: the take-off is at (10, 20, 0) m there, at (0, 0, 0) in the truth's.
    """
    origin = np.array([10.0, 20.0, 0.0])
    log = FlightLog.open(
        path,
        metadata={
            "settings": {"scenario": "paper-tracking", "seed": "3", "pace": "lockstep"},
            "versions": {"numpy": "2"},
        },
        attachments=[
            Attachment("scenario.toml", "application/toml", SCENARIO),
            Attachment("vehicle.toml", "application/toml", VEHICLE),
        ],
    )

    def put(topic: str, at_us: int, /, **values: object) -> None:
        if topic in topics:
            log.write(topic, at_us, row(topic, **values))

    for name, at_s in (
        ("takeoff", 0.0),
        ("approach", TAKEOFF_S),
        ("track", TRACK_S),
        ("done", LAND_S),
        ("land", LAND_S),
    ):
        put("/events", START_US + int(at_s * 1e6), level="info", name="phase", text=name)
    put("/vehicle/statustext", START_US - 500_000, level="warning", name="warning", text="Preflight: compass")
    put("/events", START_US - 400_000, level="warning", name="statustext", text="Preflight: compass")
    for k in range(-100, int((LAND_S + 2.0) * 100)):
        t, t_us = k / 100, START_US + 10_000 * k
        wanted = circle(t)
        true = wanted + (np.array([0.03, 0.04, 0.0]) if t >= TAKEOFF_S else 0.0)
        q = Rotation.from_euler("x", 0.1).as_quat()[[3, 0, 1, 2]]
        put("/truth", t_us, pos_ned_m=true, q_ned_frd=q, rotor_thrust_n=[1.0, 2.0, 3.0, 4.0], rate_frd_radps=[0.1] * 3)
        put("/vehicle/local_position", t_us, t_boot_us=t_us, pos_ned_m=true + origin + [0.0, 0.0, 0.01])
        put("/vehicle/attitude", t_us, t_boot_us=t_us, q_ned_frd=q, rate_frd_radps=[0.1, 0.2, 0.3])
        put("/vehicle/motors", t_us, t_us=t_us, pwm_us=[1250, 1500, 1750, 2000, *[0] * 12])
        put("/vehicle/status", t_us, mode="OFFBOARD", armed=t >= -0.2, landed=False)
        if t >= 0.0:
            put("/setpoint", t_us, pos_ned_m=wanted + origin + ([0.0, 0.0, 9.0] if t > LAND_S else 0.0))
            put("/command", t_us, thrust_n=15.0, rate_frd_radps=[0.0, 0.1, 0.0])
            put("/control", t_us, thrust_ff_n=14.0)
            put("/tick", t_us, thrust_saturated=10.0 <= t < 15.0, q_ned_frd=q)
    log.close()
    assert log.failed is None, log.failed
    return read(path)


FLOWN = {
    "/truth", "/events", "/vehicle/statustext", "/vehicle/local_position", "/vehicle/attitude", "/vehicle/motors",
    "/vehicle/status", "/setpoint", "/command", "/tick", "/control",
}  # fmt: skip


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Log:
    return write_flight(tmp_path_factory.mktemp("report") / "flight.mcap", FLOWN)


class Page(HTMLParser):
    """What of a page can load, and its texts."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.loads: list[str] = []
        self.scripts: list[str] = []
        self.text = ""
        self._inside = ""
        self.feed(html)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self._inside = tag
        loading = {"src", "href", "data", "action", "srcset"}
        self.loads += [str(v) for name, v in attrs if name in loading and not str(v).startswith("#")]
        if tag == "script":
            self.scripts.append("")

    def handle_endtag(self, tag: str) -> None:
        self._inside = ""

    def handle_data(self, data: str) -> None:
        if self._inside == "script":
            self.scripts[-1] += data
        elif self._inside != "style":
            self.text += data + "\n"

    @property
    def data(self) -> dict[str, object]:
        found: dict[str, object] = json.loads(self.scripts[0])
        return found


def unpack(text: object) -> np.ndarray:
    raw = base64.b64decode(str(text))
    return np.array(struct.unpack(f"<{len(raw) // 4}f", raw))


# ---------------------------------------------------------------- from a log


def test_a_log_gives_positions_relative_to_the_start_and_the_error_of_closed_form(log: Log) -> None:
    flight = words.with_measured_figures(from_log(log))
    assert flight.outcome.rmse_m == pytest.approx(0.05, abs=1e-9)
    assert flight.outcome.max_m == pytest.approx(0.05, abs=1e-9)
    assert flight.outcome.tracking_of == "truth"
    assert flight.reference_ned_m is not None
    assert flight.estimate_ned_m is not None
    assert flight.estimate_error_ned_m is not None
    np.testing.assert_allclose(flight.reference_ned_m.values[0], [0.0, 0.0, 0.0], atol=1e-9)
    assert flight.reference_ned_m.t_s[-1] == pytest.approx(LAND_S)
    # The frames' origins differ by (10, 20, 0) m: that is the estimate's error, but not the path's.
    error = np.nanmean(flight.estimate_error_ned_m.values, axis=0)
    np.testing.assert_allclose(error, [10.0, 20.0, 0.01], atol=1e-5)


def test_a_log_gives_phases_events_and_what_was_commanded_and_delivered(log: Log) -> None:
    flight = from_log(log, RESULT)
    assert [(p.name, round(p.start_s, 6)) for p in flight.phases] == [
        ("takeoff", 0.0), ("approach", 3.0), ("track", 6.0), ("landing", 26.0),
    ]  # fmt: skip
    assert [(e.kind, e.text, e.severity) for e in flight.events] == [
        ("vehicle says", "Preflight: compass", "warning"),
        ("arming", "reported armed", "info"),
    ]
    assert flight.thrust_truth_n is not None
    assert set(flight.thrust_truth_n.values[:, 0]) == {10.0}
    assert flight.motors is not None
    np.testing.assert_allclose(flight.motors.values[0], [0.25, 0.5, 0.75, 1.0])
    assert flight.outcome.lockstep is True
    assert ("numpy", "2") in flight.settings
    saturated = next(f for f in words.figures(flight) if f.label == "Thrust at its limit")
    assert saturated.value == "22 %"  # 5 s of the 23 s from the end of take-off to the landing


def test_limits_and_region_come_from_the_logs_own_scenario_and_vehicle(log: Log) -> None:
    flight = from_log(log)
    mass_kg = tomllib.loads(VEHICLE.decode())["body"]["mass_kg"]
    assert flight.thrust_limits_n is not None
    assert flight.thrust_limits_n[1] == pytest.approx(1.8 * mass_kg * 9.80665)
    region = tomllib.loads(SCENARIO.decode())["region"]
    assert flight.region == ReportRegion("box", tuple(region["centre_m"]), tuple(region["semi_axes_m"]))


@pytest.mark.parametrize("missing", [*sorted(FLOWN), "all", "half"])
def test_any_topic_may_be_missing_and_its_panel_says_so(tmp_path: Path, missing: str) -> None:
    topics = FLOWN - {missing}
    if missing in {"all", "half"}:
        kept = {"all": set(), "half": set(random.Random(5).sample(sorted(FLOWN), 4))}
        topics = kept[missing]
    page = Page(render_report(from_log(write_flight(tmp_path / "flight.mcap", topics), RESULT)))
    if missing == "all":
        assert page.data["path"] is None
        assert page.data["panels"] == []
    if missing in {"/truth", "all"}:
        assert "not recorded" in page.text
    panels = page.data["panels"]
    assert isinstance(panels, list)
    shown = {panel["key"] for panel in panels}
    estimate = topics & {"/vehicle/local_position", "/tick"}
    assert ("estimate-position" in shown) == ("/truth" in topics and bool(estimate))
    assert ("motors" in shown) == bool(topics & {"/vehicle/motors", "/tick", "/truth"})
    assert ("error-distance" in shown) == ("/setpoint" in topics and bool(estimate or "/truth" in topics))


def test_a_broken_scenario_in_the_log_costs_the_limits_only(log: Log) -> None:
    broken = Log(
        **{f: getattr(log, f) for f in log.__slots__} | {"attachments": (Attachment("scenario.toml", "", b"\xff["),)}
    )  # type: ignore[arg-type]
    flight = from_log(broken, RESULT)
    assert flight.region is None
    assert flight.reference_ned_m is not None


@pytest.mark.parametrize("kept", [b"", b"\xff{", b"[1]", b'{"completed": 3}', b'{"completed": true', b"[" * 200_000])
def test_a_broken_result_in_the_log_costs_the_verdict_only(log: Log, kept: bytes) -> None:
    broken = Log(
        **{f: getattr(log, f) for f in log.__slots__} | {"attachments": (Attachment("result.json", "", kept),)}
    )  # type: ignore[arg-type]
    flight = from_log(broken)
    assert flight.outcome.completed is None
    assert flight.reference_ned_m is not None


@pytest.mark.parametrize(
    "result",
    [{}, {"tracking": None, "loop": 3, "completed": "yes", "seed": math.nan}, {"checks": [1, {"passed": "no"}]}, None],
)
def test_a_strange_result_is_unknown_never_an_error(result: dict[str, object] | None) -> None:
    outcome = outcome_from_result(result)
    assert outcome.completed is None
    assert outcome.rmse_m is None
    assert timing_from_result(result) is None


# ---------------------------------------------------------------- the page


def test_the_page_loads_nothing_and_is_small_enough(log: Log) -> None:
    html = render_report(from_log(log, RESULT))
    page = Page(html)
    assert page.loads == []
    code = re.sub(r"/\*!.*?\*/", "", html, flags=re.DOTALL)  # the library's own notice names its home page
    assert not re.search(r"https?://|@import|url\(", code)
    assert not {"link", "iframe", "img", "object", "embed", "base"} & set(page.tags)
    assert "default-src 'none'" in html
    assert len(html.encode()) < 1_500_000


def test_a_ten_minute_flight_is_no_bigger_than_a_short_one() -> None:
    def size(seconds: float) -> int:
        t = np.arange(0.0, seconds, 0.004)
        path = signal(t, np.stack([np.sin(t), np.cos(t), -t / seconds], axis=1))
        rates = {"rate_command_frd_radps": path, "rate_measured_frd_radps": path, "rate_truth_frd_radps": path}
        motors = signal(t, np.full((len(t), 4), 0.5))
        positions = {"reference_ned_m": path, "truth_ned_m": path, "estimate_ned_m": path, "estimate_error_ned_m": path}
        return len(render_report(FlightReport(Outcome(), motors=motors, **positions, **rates)))  # type: ignore[arg-type]

    assert size(600.0) < 1.05 * size(60.0) < 1_500_000


def test_the_same_flight_gives_the_same_bytes(log: Log, tmp_path: Path) -> None:
    first = write_report(from_log(log, RESULT), tmp_path / "a.html")
    second = write_report(from_log(read(log.path), dict(reversed(RESULT.items()))), tmp_path / "b.html")
    assert first.read_bytes() == second.read_bytes()


def test_what_is_drawn_is_what_was_logged(log: Log) -> None:
    panels = Page(render_report(from_log(log, RESULT))).data["panels"]
    assert isinstance(panels, list)
    by_key = {panel["key"]: panel for panel in panels}
    distance = by_key["error-distance"]
    assert distance["unit"] == "cm"
    t, y = unpack(distance["t"]), unpack(distance["curves"][0]["y"])
    np.testing.assert_allclose(y[(t > TAKEOFF_S + 0.1) & (t < LAND_S)], 5.0, atol=1e-4)
    assert t[-1] <= LAND_S + 1e-6
    tilt = unpack(by_key["tilt"]["curves"][0]["y"])
    np.testing.assert_allclose(tilt, math.degrees(0.1), atol=1e-4)
    rate = {curve["label"]: unpack(curve["y"]) for curve in by_key["rate-pitch"]["curves"]}
    np.testing.assert_allclose(rate["measured"], math.degrees(0.2), rtol=1e-5)
    assert by_key["thrust"]["shaded"] == [[pytest.approx(10.0), pytest.approx(15.0)]]


HOSTILE = "</script><script>alert(1)</script><img src=x onerror=alert(2)> & \"q\" 'a' <!-- \u2028 put data"


def test_hostile_strings_stay_text_everywhere() -> None:
    flight = FlightReport(
        Outcome(scenario=HOSTILE, completed=False, reason=HOSTILE, plant=HOSTILE, controller=HOSTILE,
                checks=(CheckResult(HOSTILE, 1.0, False),)),
        phases=(Phase(HOSTILE, 0.0, 1.0),),
        events=(FlightEvent(0.5, HOSTILE, HOSTILE, '"><script>'),),
        region=ReportRegion(HOSTILE, (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)),
        truth_ned_m=signal([0.0, 1.0], np.zeros((2, 3))),
        settings=((HOSTILE, HOSTILE),),
    )  # fmt: skip
    page = Page(render_report(flight))
    harmless = Page(render_report(FlightReport(Outcome())))
    assert page.tags.count("script") == harmless.tags.count("script") == 3
    assert "img" not in page.tags
    assert page.scripts[1:] == harmless.scripts[1:]
    assert page.data["events"] == [[0.5, '"><script>', HOSTILE]]
    assert page.text.count(HOSTILE) >= 5


def test_an_empty_flight_is_a_page_that_says_not_recorded() -> None:
    page = Page(render_report(FlightReport(Outcome())))
    assert page.text.count("not recorded") >= 14
    assert page.data["panels"] == []


# ---------------------------------------------------------------- words


@pytest.mark.parametrize(
    ("outcome", "expected"),
    [
        (Outcome("hover", True, flight_time_s=30.0, rmse_m=0.012, max_m=1.5),
         "hover completed, 30.0 s flown, tracking error 1.2 cm rms (at most 1.50 m)."),
        (Outcome("hover", False, "stopped by the user", flight_time_s=0.0),
         "hover failed before take-off: stopped by the user."),
        (Outcome("hover", False, "left its region.", flight_time_s=12.34),
         "hover failed after 12.3 s: left its region."),
        (Outcome("hover", False, rmse_m=2.0), "hover failed. Tracking error 2.00 m rms."),
        (Outcome("waypoints", flight_time_s=150.0), "waypoints recorded, 2 min 30 s flown."),
    ],
)  # fmt: skip
def test_the_headline_says_what_happened_and_why(outcome: Outcome, expected: str) -> None:
    assert words.headline(FlightReport(outcome)) == expected


@pytest.mark.parametrize(("command", "note"), [(0.0, "not recorded"), (1.0, "a motor at its limit: 100 %")])
def test_motors_that_never_turned_are_not_at_their_limit(command: float, note: str) -> None:
    """A flight that Ctrl-C ended as the vehicle armed."""
    flight = FlightReport(Outcome(), motors=signal([0.0, 0.5, 1.0], np.full((3, 4), command)))
    saturated = next(f for f in words.figures(flight) if f.label == "Thrust at its limit")
    assert (saturated.value, saturated.note) == ("–", note)


def test_a_failed_check_shows_in_the_verdict() -> None:
    passed, failed = CheckResult("rmse below 3 cm", 0.02, True), CheckResult("rmse below 1 cm", 0.02, False)
    assert words.verdict(FlightReport(Outcome(completed=True, checks=(passed,)))) == ("good", "Completed")
    flight = FlightReport(Outcome(completed=True, checks=(passed, failed)))
    assert words.verdict(flight) == ("bad", "Check failed")
    assert "rmse below 1 cm: measured 0.02" in Page(render_report(flight)).text


def test_barrier_and_learner_say_off_or_what_they_did() -> None:
    off = {f.label: f for f in words.figures(FlightReport(outcome_from_result(RESULT)))}
    assert off["Barrier filter"].value == off["Learner"].value == "off"
    assert off["Speed"].value == "26.0 ×"
    on = RESULT | {
        "barrier": {"enabled": True, "min_h_truth": -0.01, "violations": 2, "interventions": 120},
        "gp": {"enabled": True, "points": 300, "coverage_3sigma": 0.997},
    }
    shown = {f.label: f for f in words.figures(FlightReport(outcome_from_result(on)))}
    assert shown["Barrier filter"].state == "bad"
    assert shown["Barrier filter"].value == "2 violations"
    assert (shown["Learner"].value, shown["Learner"].note) == ("300 points", "99.7 % within 3 sigma")


# ---------------------------------------------------------------- timing


def test_real_time_shows_lateness_and_lockstep_says_that_there_is_none() -> None:
    timing = Timing(250.0, 3.0, 120.0, 4500.0, 2, np.array([3.0, 3.0, 120.0, 4500.0]))
    text = Page(render_report(FlightReport(Outcome(lockstep=False), timing=timing))).text
    assert "4.50 ms" in text
    assert "120 µs" in text
    assert "Lockstep" in Page(render_report(FlightReport(Outcome(lockstep=True)))).text


def test_a_log_of_others_shows_what_it_holds_and_says_once_what_it_does_not(tmp_path: Path) -> None:
    """The circle of the DataFlash log is known in closed form: 1 m, one turn in 2 pi s."""
    from flightstack_logs.readers.dataflash import read_dataflash
    from flightstack_logs.report.log_input import from_log
    from flightstack_logs.report.page import render_report
    from flightstack_logs.standard import with_vehicle_topics
    from tests.unit.test_log_formats import circle, dataflash

    log = with_vehicle_topics(read_dataflash(tmp_path / "<i>flown.BIN", dataflash()))
    page = render_report(from_log(log))
    speed = np.linalg.norm(circle(0.0)[1])
    assert f"<dt>Fastest</dt><dd>{speed:.1f} m/s</dd>" in page
    assert page.count("not recorded") == 0
    assert page.count("not in this log: tracking error, 3-D distance; ") == 1
    assert "&lt;i&gt;flown.BIN recorded." in page
    assert 'id="velocity"' in page
    assert 'id="timing"' not in page
