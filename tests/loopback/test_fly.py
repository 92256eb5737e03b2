"""Whole flights through `fly`: simulator and companion over UDP.  Each asserts that it really flew."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from flightstack.cli import files, preparation
from flightstack.cli.controllers import load_gains
from flightstack.cli.flight import FlyOptions, fly
from flightstack.cli.result import FlightResult
from flightstack.control.feedback import FlatnessController
from flightstack.control.gains import FlatnessGains
from flightstack.seams import NoLearner
from flightstack.types import Command, FlatOutput, Learned, Measurement, changed
from flightstack_logs.reader import Log, read
from mavlink_bridge import messages as m
from mavlink_bridge.link import Link
from mavlink_bridge.voice import LEVEL
from tests.thorough import THOROUGH, thorough

ROOT = Path(__file__).resolve().parents[2]
RIGHT_MODEL = ("hover", "figure8", "minimum-snap")


def _fly(tmp_path: Path, scenario: str, *, report: bool = False, **options: object) -> tuple[FlightResult, Log]:
    flown = FlyOptions(scenario=scenario, out=tmp_path, log_wire=True, **options)  # type: ignore[arg-type]
    result = fly(flown, report_wanted=lambda result: report)
    return result, read(tmp_path / "flight.mcap")


def _sent_setpoints(log: Log) -> list[m.SetAttitudeTarget]:
    link = Link(1, 1)
    for data in log.messages["/mavlink/tx"].data:
        link.receive_datagram(data, 0)
    assert link.stats.dropped == 0
    events = []
    while (received := link.next_event()) is not None:
        if isinstance(received.message, m.SetAttitudeTarget):
            events.append(received.message)
    return events


def _assert_flew(log: Log, least_height_m: float) -> None:
    """Armed by the vehicle's word, in the air by the truth, moved by rates that were on the wire; once, before PX4's
    Land, the attitude that is."""
    assert bool(np.any(log.tables["/vehicle/status"]["armed"]))
    assert -log.tables["/truth"]["pos_ned_m"][:, 2].min() > least_height_m
    masks = [point.type_mask for point in _sent_setpoints(log) if point.thrust_norm > 0.2]
    assert len(masks) > 1000
    assert sorted(set(masks)) == [LEVEL, 128]
    assert masks[:-10].count(LEVEL) == 0
    assert masks.count(LEVEL) == 1
    end = {name: column[-1] for name, column in log.tables["/truth"].columns.items()}
    assert bool(end["on_ground"])
    assert np.abs(end["vel_ned_mps"]).max() < 0.01
    assert not bool(log.tables["/vehicle/status"]["armed"][-1])


@pytest.mark.parametrize("scenario", [thorough("hover"), "figure8", thorough("minimum-snap")])
def test_with_a_right_model_the_true_error_stays_below_3_cm_rms(scenario: str, tmp_path: Path) -> None:
    result, log = _fly(tmp_path, scenario, report=True, duration_s=None if THOROUGH else 16.0)
    assert result.completed, result.reason
    assert result.passed
    assert result.tracking["of"] == "truth"
    assert 0.0 < result.tracking["rmse_m"] < 0.03
    _assert_flew(log, 1.2)


GPS_TOO = ("figure8",)
"""Flown with GPS by `make test` as well: the others' legs are of the same kinds, gps-barrier is flown elsewhere."""
RARER = (
    "excite-low-pass", "excite-rate-doublets", "excite-thrust-chirp", "excite-yaw-at-speed", "low-pass",
    "paper-barrier", "paper-tracking", "payload-drop", "steady-wind",
)  # fmt: skip
"""Left to `make thorough`: `test_excite.py` has the first four in memory, the first of them as low as the fifth,
`test_barrier_flights.py` flies the next two (12 s of the path, with its page), `test_learning_flights.py` the drop,
`rotor-drag` is of the last one's kind."""
SHIPPED = files.shipped_names("scenarios")
GPS_ONLY = "gps-barrier"
"""Its region is made for those sensors, and its climb of 20 m is the longest."""


@pytest.mark.parametrize(
    ("sensors", "scenario"),
    [
        thorough("mocap", name) if name in RARER else ("mocap", name)
        for name in SHIPPED
        if name not in (*RIGHT_MODEL, GPS_ONLY)
    ]
    + [("gps", name) if name in GPS_TOO else thorough("gps", name) for name in SHIPPED],
)
def test_every_shipped_scenario_completes_and_lands(scenario: str, sensors: str, tmp_path: Path) -> None:
    """Those with a right model are flown above.

    `rotor-drag` is as fast as 10 m/s but at the ends of its laps of 10 s: cut off there it lands while it slides.

    Lower above the ground than GPS knows the height a flight may touch it; then it has not flown what was asked.
    """
    duration_s = 10.0 if scenario == "rotor-drag" else 5.0
    report = sensors == "mocap" or scenario == GPS_ONLY  # one of each scenario
    learning = report or scenario in ("paper-tracking", "payload-drop", "steady-wind")
    asked = {"sensors": sensors, "learning": learning, "duration_s": duration_s}
    result, log = _fly(tmp_path, scenario, report=report, seed=1, **asked)
    near_ground = sensors == "gps" and scenario in ("excite-low-pass", "low-pass")
    assert result.completed or (near_ground and result.reason), result.reason
    _assert_flew(log, 0.4)


def test_the_papers_wrong_model_shows_as_a_steady_droop_that_the_gains_explain(tmp_path: Path) -> None:
    """f = 1.4 m (g - a_z): what the believed mass lacks, 0.4 g, is carried by the position error alone.

    With poles at p the nominal's stiffness is p^2 / 3, and the feedback adds K_p / m: both are read from the gains.
    """
    result, log = _fly(tmp_path, "paper-tracking", duration_s=20.0, learning=False)
    assert result.completed, result.reason
    truth, reference = log.tables["/truth"], log.tables["/setpoint"]
    t_us = reference.t_us[(reference.t_us > reference.t_us[-1] - 15_000_000)]
    down = np.interp(t_us, truth.t_us, truth["pos_ned_m"][:, 2])
    wanted = np.interp(t_us, reference.t_us, reference["pos_ned_m"][:, 2])
    droop = float(np.mean(down - wanted))
    gains = load_gains()["flatness"].groups[1]
    assert isinstance(gains, FlatnessGains)
    stiffness = gains.pole_z_radps**2 / 3.0 + gains.thrust_p_ps2
    assert droop == pytest.approx(0.4 * 9.80665 / stiffness, rel=0.1)
    assert result.tracking["rmse_m"] > 0.1  # the baseline that learning has to beat


def test_the_same_seed_gives_the_same_bytes_and_another_seed_does_not(tmp_path: Path) -> None:
    logs = []
    for name, seed in (("a", 3), ("b", 3), ("c", 4)):
        (tmp_path / name).mkdir()
        result, _ = _fly(tmp_path / name, "figure8" if THOROUGH else "hover", duration_s=2.0, seed=seed)
        assert result.completed
        logs.append((tmp_path / name / "flight.mcap").read_bytes())
    assert logs[0] == logs[1]
    assert logs[0] != logs[2]


def test_the_companion_sees_the_truth_only_through_its_sensors(tmp_path: Path) -> None:
    _, log = _fly(tmp_path, "hover", duration_s=4.0)
    truth, seen = log.tables["/truth"], log.tables["/vehicle/local_position"]
    at = np.interp(seen["t_boot_us"], truth.t_us, truth["pos_ned_m"][:, 0])
    error = seen["pos_ned_m"][:, 0] - at
    assert 0.002 < float(np.std(error)) < 0.01  # mocap grade: 5 mm


class Claims(NoLearner):
    """Says that the vehicle has 1.4 times the believed mass, and wrongly that a force of 1 N/kg pushes it forward."""

    enabled = True

    def step(
        self, state: object, measurement: Measurement, sent: Command, reference: FlatOutput
    ) -> tuple[object, Learned]:
        residual = (1.0, 0.0, sent.thrust_n / 1.2 * (1.0 - 1.0 / 1.4))
        return state, changed(
            Learned.nothing(), stage=3.0, thrust_gain=1.0 / 1.4, residual_frd_mps2=residual,
            sigma_frd_mps2=(0.1, 0.1, 0.1), target_frd_mps2=residual, fed=5.0,
        )  # fmt: skip


def test_coverage_is_scored_on_the_truth_and_what_is_learned_is_used_and_logged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A hover with 1.4 times the mass: the claim of z is right, of y too, of x always ten sigma beside."""
    monkeypatch.setattr(preparation, "build", lambda name, model, limits, learning: (
        FlatnessController(model, limits=limits), Claims()))  # fmt: skip
    text = (ROOT / "flightstack/data/scenarios" / "hover.toml").read_text()
    (tmp_path / "heavy.toml").write_text(text + "\n[truth]\nmass_ratio = 1.4\n")
    result, log = _fly(tmp_path, str(tmp_path / "heavy.toml"), report=True, duration_s=4.0)
    assert result.passed, result.failure()
    assert result.tracking["rmse_m"] < 0.03  # without the gain it droops by 0.2 m and more
    assert result.gp["coverage_3sigma_axes"] == pytest.approx([0.0, 1.0, 1.0], abs=0.01)
    assert result.gp["coverage_3sigma"] == pytest.approx(2 / 3, abs=0.01)
    assert result.gp["coverage_simultaneous"] == 0.0
    assert result.gp["step_us"]["p50"] > 0.0
    learner = log.tables["/learner"]
    assert set(learner["fed"]) == {5.0}
    assert "step_us" not in learner.columns
    told = [text for name, text in zip(log.tables["/events"]["name"], log.tables["/events"]["text"], strict=True)
            if name == "learner"]  # fmt: skip
    assert told == ["learner: used"]
    assert 'id="learning"' in (tmp_path / "report.html").read_text()


def test_a_payload_taken_up_in_flight_is_noticed_and_said_in_the_log(tmp_path: Path) -> None:
    text = (ROOT / "flightstack/data/scenarios" / "hover.toml").read_text()
    text = text[: text.index("[[checks]]")] + (
        '[[events]]\ntime_s = 2.0\neffect = "payload"\nvalues = { mass_kg = 0.4 }\n'
    )
    (tmp_path / "load.toml").write_text(text)
    result, log = _fly(tmp_path, str(tmp_path / "load.toml"), duration_s=6.0)
    assert result.completed, result.reason
    events = log.tables["/events"]
    (at_us,) = (int(t) for t, name in zip(events.t_us, events["name"], strict=True) if name == "effect")
    told = {str(text): int(t) for t, text in zip(events.t_us, events["text"], strict=True) if "sudden" in text}
    assert told, "no change was noticed"
    first = min(told, key=lambda text: told[text])
    assert first.startswith("learner: sudden change noticed on z (")
    assert 0 < told[first] - at_us < 300_000
    assert result.gp["changes"] == len(told)


def test_ctrl_c_lands_and_closes_the_log(tmp_path: Path) -> None:
    calls = iter(range(10_000))
    options = FlyOptions(scenario="hover", out=tmp_path)
    result = fly(options, stop_requested=lambda: "stopped by the user" if next(calls) > 100 else "")
    assert not result.completed
    assert result.reason == "stopped by the user"
    log = read(tmp_path / "flight.mcap")
    assert log.complete
    assert bool(log.tables["/truth"]["on_ground"][-1])
    assert not bool(log.tables["/vehicle/status"]["armed"][-1])


def test_a_timed_event_changes_the_truth_in_flight_and_is_in_the_log(tmp_path: Path) -> None:
    """0.3 kg more from 2 s on: the true thrust that carries the vehicle grows by their weight."""
    text = (ROOT / "flightstack/data/scenarios" / "hover.toml").read_text()
    text = text[: text.index("[[checks]]")] + (
        '[[events]]\ntime_s = 2.0\neffect = "payload"\nvalues = { mass_kg = 0.3 }\n'
    )
    (tmp_path / "drop.toml").write_text(text)
    result, log = _fly(tmp_path, str(tmp_path / "drop.toml"), duration_s=10.0)
    assert result.completed, result.reason
    events = log.tables["/events"]
    (at_us,) = (int(t) for t, name in zip(events.t_us, events["name"], strict=True) if name == "effect")
    truth = log.tables["/truth"]
    total = truth["rotor_thrust_n"].sum(axis=1)
    before = float(np.mean(total[(truth.t_us > at_us - 1_000_000) & (truth.t_us < at_us)]))
    after = float(np.mean(total[(truth.t_us > at_us + 5_000_000) & (truth.t_us < at_us + 7_000_000)]))
    assert before == pytest.approx(1.2 * 9.80665, rel=0.01)
    assert after == pytest.approx(1.5 * 9.80665, rel=0.01)


def test_a_truth_file_replaces_the_scenarios_truth_and_the_controller_never_sees_it(tmp_path: Path) -> None:
    """With --truth naming the believed vehicle, the paper's flight has no wrong mass and no wind left."""
    result, log = _fly(tmp_path, "paper-tracking", truth="quad-x", duration_s=5.0)
    assert result.completed, result.reason
    assert result.tracking["rmse_m"] < 0.03
    assert b"mass_kg = 1.2" in (log.attachment("truth.toml") or b"")


COMPILED_IN_FLIGHT = """
import gc, json, sys
from pathlib import Path
from numba.core.dispatcher import Dispatcher
from flightstack.cli import flight

def known():
    ours = [item for item in gc.get_objects() if isinstance(item, Dispatcher)]
    return {(f"{item.py_func.__module__}.{item.py_func.__name__}", id(item)): len(item.signatures) for item in ours}

prepared, before = flight.warm_up_all, {}
flight.warm_up_all = lambda setup: (prepared(setup), before.update(known()))
more = json.loads(sys.argv[4])
more |= {"site": Path(more["site"])} if "site" in more else {}
options = flight.FlyOptions(scenario=sys.argv[1], duration_s=float(sys.argv[3]), out=Path(sys.argv[2]), **more)
assert flight.fly(options, stop_requested=lambda: "").flight_time_s > options.duration_s
assert before
changed = [name[0] for name, count in known().items() if count != before.get(name, 0)]
print([name for name in changed if name.startswith(("flightstack", "mavlink_bridge"))])
"""


WALLED = """schema = "flightstack.site/1"
floor_m = 0.3
ceiling_m = 3.3
inside = [[-6.0, -5.0], [2.2, -5.0], [2.2, 5.0], [-6.0, 5.0]]
"""


@pytest.mark.parametrize(
    ("scenario", "duration_s", "more"),
    [
        ("paper-tracking", 9.0, {}),
        thorough("paper-tracking", 6.0, {"as_published": True, "fault": "link-jitter@3"}),
        thorough("payload-drop", 25.0, {}),
        ("gps-barrier", 8.0, {}),
        thorough("minimum-snap", 2.0, {}),
        ("figure8", 5.0, {"site": WALLED}),
    ],
)
def test_nothing_is_compiled_in_flight(
    scenario: str, duration_s: float, more: dict[str, object], tmp_path: Path
) -> None:
    """In a fresh process: every compiled function that the flight calls was called before its clock ran.

    The paper's flight is long enough for the filter to engage under a certificate made in flight, the one by GPS to
    ask what it has flown; the one in a site is bent along a wall, and by a link that jitters messages come alone.
    """
    if "site" in more:
        (tmp_path / "site.toml").write_text(str(more["site"]))
        more = {**more, "site": str(tmp_path / "site.toml")}
    command = [sys.executable, "-c", COMPILED_IN_FLIGHT, scenario, str(tmp_path), str(duration_s), json.dumps(more)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_a_believed_racer_that_never_left_the_ground_has_not_flown(tmp_path: Path) -> None:
    """Four times the believed thrust: the thrust that is sent can't lift the true vehicle."""
    text = (ROOT / "flightstack" / "data" / "vehicles" / "quad-x.toml").read_text()
    racer = tmp_path / "racer.toml"
    racer.write_text(text.replace("max_thrust_n = 6.6", "max_thrust_n = 26.4"))
    options = FlyOptions(scenario="hover", vehicle=str(racer), truth="quad-x", duration_s=4.0, out=tmp_path)
    result = fly(options, stop_requested=lambda: "")
    assert result.completed is False
    assert not result.passed
    assert "never flew: it rose 0.0" in result.failure()
    assert result.flown["first_height_m"] == pytest.approx(1.5)
    page = (tmp_path / "report.html").read_text()
    assert '<header class="bad">' in page
    assert '<header class="good">' not in page
