"""Logs whose motors say less than commands: only their mean (PX4 by default), or only what the rotors turned."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flightstack.gap import classes, pooled
from flightstack.gap.concluded import held_out_gap
from flightstack.gap.mean_lift import with_mean_lift
from flightstack.gap.name import name
from flightstack.gap.records import Estimate, Figures, Gap, IdentifiedEffect, Unexplained
from flightstack.gap.result import GapResult
from flightstack.gap.simulate import FreeParameter, sensitivities
from flightstack.gap.workflow import analyse, usable_flights
from flightstack.types import InputError
from flightstack.vehicle import Vehicle, parse_vehicle, vehicle_to_toml
from flightstack_logs.readers.csv_file import HEADER
from tests.gap_flights import Flown, fly, hidden, hover, quad, wander
from tests.thorough import ONLY_THEN, thorough

DRAG = {"d_x_kgps": 0.45, "d_y_kgps": 0.35, "d_z_kgps": 0.4}
PAYLOAD_KG = 0.2
SLOW = 13
"""Rows of 8 ms from one logged command to the next."""


@pytest.fixture(scope="module")
def flown() -> Flown:
    truth = hidden(quad(), {"linear_drag": DRAG, "payload": {"mass_kg": PAYLOAD_KG}})
    return fly(truth, quad(), wander(), seconds=30.0, seed=5)


def written(flown: Flown, motors: np.ndarray, names: str, log: Path) -> Path:
    first = [flown.t_s[:, None], flown.pos, flown.vel, flown.q, flown.rate, flown.accel]
    battery = flown.battery_v[:, None]
    rows = np.hstack([*first, motors, battery])
    header = ",".join(name.replace("motor_", names) for name in HEADER)
    text = "\n".join(",".join("" if np.isnan(x) else f"{x:.7g}" for x in row) for row in rows)
    log.write_text(f"{header}\n{text}\n", encoding="utf-8")
    return log


def found_in(flown: Flown, motors: np.ndarray, names: str, folder: Path) -> GapResult:
    return analyse([written(flown, motors, names, folder / "flight.csv")], quad())


def found_against(vehicle: Vehicle, flown: Flown, motors: np.ndarray, folder: Path) -> GapResult:
    return analyse([written(flown, motors, "motor_", folder / "flight.csv")], vehicle)


def slow(flown: Flown) -> np.ndarray:
    motors = np.full_like(flown.motor, np.nan)
    motors[::SLOW] = flown.motor[::SLOW]
    return motors


def test_slow_motors_leave_the_side_force_and_the_mean_lift_and_say_so(flown: Flown, tmp_path: Path) -> None:
    """By the side force alone no load was named, and the drag of the mass that the file has: 0.39 for 0.45."""
    result = found_in(flown, slow(flown), "motor_", tmp_path)
    named = {found.name: found for found in result.found}
    assert set(named) == {"linear_drag", "payload"}
    assert set(named["linear_drag"].indistinguishable_from) == {"rotor_drag", "parasitic_drag"}
    alike = {"thrust_scale", "thrust_curve", "constant_force", "slung_load", "battery_sag"}
    assert set(named["payload"].indistinguishable_from) == alike
    load = named["payload"].parameters["mass_kg"]
    assert load.low <= PAYLOAD_KG <= load.high
    assert load.high - load.low < 0.02 * quad().mass_kg
    for parameter in ("d_x_kgps", "d_y_kgps"):
        told = named["linear_drag"].parameters[parameter]
        assert told.low <= DRAG[parameter] <= told.high
    assert result.corrected.total_mass_kg == pytest.approx(quad().mass_kg + load.estimate)
    assert result.gap.before.one_step_radps2 is None
    assert result.gap.closed is not None
    assert result.gap.closed > 0.9
    assert "torques were not looked at, of the vertical force only the mean" in result.report.sentence
    ((_, lift),) = [check for check in result.report.checks if check[0] == "mean lift off by"]
    was, now = (float(each.split()[0]) for each in lift.split("→"))
    assert was == pytest.approx(100.0 * PAYLOAD_KG / quad().mass_kg, abs=1.5)  # and what the drag carries
    assert now < 0.2 * was  # a drag along the rotors' axis is not told, and carries 2 % of the weight here
    drawn, where = result.report.traces[0], {row.signal: row for row in result.report.where}
    for column, signal in enumerate(("specific_force_x", "specific_force_y")):  # one noise on the whole page
        assert drawn.noise[column] == pytest.approx(where[signal].expected_noise, rel=1e-9)


@ONLY_THEN
def test_a_thrust_that_slow_motors_can_only_tell_from_a_load_by_no_drag_is_in_every_class(tmp_path: Path) -> None:
    """Rotors of 0.85 on a vehicle whose file has its drag: as a load of 0.18 of the mass with as much more drag."""
    believed = hidden(quad(), {"linear_drag": DRAG})
    weak = fly(hidden(believed, {"thrust_scale": {"scale": 0.85}}), believed, wander(), seconds=30.0, seed=6)
    result = analyse([written(weak, slow(weak), "motor_", tmp_path / "weak.csv")], believed)
    assert result.found
    assert all("thrust_scale" in (f.name, *f.indistinguishable_from) for f in result.found)
    load = next(f for f in result.found if f.name == "payload").parameters["mass_kg"]
    assert load.low <= quad().mass_kg * (1.0 / 0.85 - 1.0) <= load.high


def test_a_weak_rotor_is_a_loads_twin_where_the_mean_commands_tip_as_well(tmp_path: Path) -> None:
    weak = hidden(quad(), {"rotor_fault": {"rotor": 2, "effectiveness": 0.8}})
    flight = fly(weak, quad(), wander(), seconds=30.0, seed=8)
    (load,) = analyse([written(flight, slow(flight), "motor_", tmp_path / "weak.csv")], quad()).found
    assert load.name == "payload"
    assert "rotor_fault" in load.indistinguishable_from


@ONLY_THEN
def test_a_lift_that_is_the_files_leaves_no_load_and_no_twin_and_says_how_much_it_would_have_told(
    tmp_path: Path,
) -> None:
    truth = hidden(quad(), {"linear_drag": DRAG})
    light = fly(truth, quad(), wander(), seconds=30.0, seed=7)
    logs = [written(light, slow(light), "motor_", tmp_path / "light.csv")]
    (drag,) = analyse(logs, quad()).found
    assert drag.name == "linear_drag"
    assert "payload" not in drag.indistinguishable_from
    as_flown = analyse(logs, truth)
    assert not as_flown.found
    assert "agree within the noise in side force and mean lift, all that was compared" in as_flown.report.sentence
    assert "a payload of 0.0" in as_flown.report.sentence
    assert as_flown.report.sentence.endswith("as motors were logged too slowly.")


def test_a_load_stands_beside_an_accelerometer_that_is_off_upwards_and_is_none_of_it(tmp_path: Path) -> None:
    """Of 0.2 m/s^2 by what the sensor shows 0.2 / 9.8 of the mass was a load."""
    truth = hidden(quad(), {"accelerometer_bias": {"x_mps2": 0.1, "y_mps2": -0.1, "z_mps2": 0.2}})
    flight = fly(truth, quad(), wander(), seconds=30.0, seed=9)
    found = analyse([written(flight, slow(flight), "motor_", tmp_path / "off.csv")], quad()).found
    assert {each.name for each in found} == {"accelerometer_bias"}


def test_translational_lift_is_a_loads_twin_where_it_is_flown_fast_enough(tmp_path: Path) -> None:
    lifted = hidden(quad(), {"translational_lift": {"k_h_kg_per_m": 0.02}})
    flight = fly(lifted, quad(), wander(), seconds=30.0, seed=10)
    (load,) = analyse([written(flight, slow(flight), "motor_", tmp_path / "lifted.csv")], quad()).found
    assert load.name == "payload"
    assert load.parameters["mass_kg"].estimate < 0.0
    assert "translational_lift" in load.indistinguishable_from
    assert not {"vortex_ring", "slung_load", "rotor_fault"} & set(load.indistinguishable_from)


@pytest.mark.parametrize(("share", "tells"), [(1.0, True), (0.2, False)])
def test_beside_something_unexplained_a_load_must_be_clear(
    flown: Flown, tmp_path: Path, share: float, tells: bool
) -> None:
    """Four tethers of 4, tried at 10 Hz, were a load of 0.02 to 0.16 of the mass beside a remainder."""
    (samples,) = usable_flights([written(flown, slow(flown), "motor_", tmp_path / "slow.csv")], quad())
    of = pooled.split([samples], [])
    heavier = replace(quad(), mass_kg=quad().mass_kg + (1.0 - share) * PAYLOAD_KG)
    naming = name(heavier, of.flights, of.fit, of.holdout)
    gap = held_out_gap(heavier, naming, of)
    left = replace(naming, unexplained=Unexplained(True, ("position",), 0.5))
    told, _, _ = with_mean_lift(heavier, (left, of, gap), lambda vehicle: (naming, of, gap))
    assert ("payload" in {each.name for each in told.found}) is tells
    told, _, _ = with_mean_lift(heavier, (naming, of, gap), lambda vehicle: (naming, of, gap))
    assert "payload" in {each.name for each in told.found}


@pytest.mark.parametrize("share", [0.6, thorough(1.3)])
def test_a_load_of_more_than_half_the_mass_is_a_thrust_that_leaves_the_drag_as_it_is(
    tmp_path: Path, share: float
) -> None:
    """Commands logged at 0.6 of what was sent were a load of -0.8 kg of 1.2, and a third of the drag."""
    empty = fly(hidden(quad(), {"linear_drag": DRAG}), quad(), wander(), seconds=30.0, seed=5)
    result = found_against(quad(), empty, np.clip(slow(empty) * share, 0.0, 1.0), tmp_path)
    found = {f.name: f for f in result.found}
    assert set(found) == {"thrust_scale", "linear_drag"}
    assert "payload" in found["thrust_scale"].indistinguishable_from
    for parameter in ("d_x_kgps", "d_y_kgps"):
        told = found["linear_drag"].parameters[parameter]
        assert told.low <= DRAG[parameter] <= told.high


def test_a_load_that_the_file_has_already_is_put_right(flown: Flown, tmp_path: Path) -> None:
    half = hidden(quad(), {"linear_drag": DRAG, "payload": {"mass_kg": PAYLOAD_KG / 2.0}})
    load = next(f for f in found_against(half, flown, slow(flown), tmp_path).found if f.name == "payload")
    told = load.parameters["mass_kg"]
    assert told.before == PAYLOAD_KG / 2.0
    assert told.low <= PAYLOAD_KG <= told.high
    assert told.low > PAYLOAD_KG / 2.0


def test_a_lift_that_changes_in_flight_is_no_load_and_said(flown: Flown, tmp_path: Path) -> None:
    """Of eight thrusts that fade with time, tried at 10 Hz, eight were a load beside nothing unexplained."""
    ramp = 1.0 + 0.15 * flown.t_s / flown.t_s[-1]
    truth = hidden(quad(), {"linear_drag": DRAG, "payload": {"mass_kg": PAYLOAD_KG}})
    assert "mean lift, all that was compared" in found_against(truth, flown, slow(flown), tmp_path).report.sentence
    log = written(flown, slow(flown) * ramp[:, None], "motor_", tmp_path / "fading.csv")
    result = analyse([log], truth)
    assert not result.found
    assert result.unexplained.significant
    assert result.unexplained.depends_on[0] == "time"
    assert "what the same commands carry changes by" in result.report.sentence


@pytest.mark.parametrize("lacks", ["q_ned_frd", "vel_ned_mps"])
def test_without_how_it_leaned_or_moved_no_lift_is_compared(flown: Flown, tmp_path: Path, lacks: str) -> None:
    (samples,) = usable_flights([written(flown, slow(flown), "motor_", tmp_path / "slow.csv")], quad())
    gone = {name: np.full_like(getattr(samples, name), np.nan) for name in (lacks, "pos_ned_m")}
    bare = replace(samples, **gone)
    naming = name(quad(), [bare], [bare.valid], [bare.valid])
    said = (
        naming,
        pooled.FitHoldoutSplit((bare,), (bare.valid,), (bare.valid,)),
        Gap(*3 * [Figures(None, None, None)], None),
    )
    assert with_mean_lift(quad(), said, lambda vehicle: said) is said


def test_a_log_without_motors_says_nothing_of_a_load(flown: Flown, tmp_path: Path) -> None:
    log = written(flown, np.full_like(flown.motor, np.nan), "motor_", tmp_path / "none.csv")
    result = analyse([log], quad(), kinematics_only=True)
    assert not result.found
    assert "payload" not in result.report.sentence


def test_a_guessed_mass_is_not_told_by_the_mean_lift_that_may_be_a_guessed_thrust(flown: Flown, tmp_path: Path) -> None:
    text = vehicle_to_toml(quad())
    ranged = parse_vehicle(
        re.sub(r"(?m)^mass_kg = (.*)$", r"mass_kg = {value = \1, range = [0.5, 2.0]}", text), "ranged"
    )
    result = analyse([written(flown, slow(flown), "motor_", tmp_path / "guessed.csv")], ranged)
    assert "payload" not in {found.name for found in result.found}
    assert "vertical force and torques were not looked at" in result.report.sentence


def test_without_motors_nothing_upright_is_told_of_a_force_or_a_wind(flown: Flown, tmp_path: Path) -> None:
    """By the lean alone a swinging side force looked like 2.7 weights from above, to one percent."""
    (samples,) = usable_flights([written(flown, slow(flown), "motor_", tmp_path / "slow.csv")], quad())
    columns = [FreeParameter("constant_force", f"{axis}_n") for axis in ("north", "east", "down")]
    shown = np.nan_to_num(sensitivities(quad(), samples, columns))
    assert [bool(np.any(shown[:, :, k])) for k in range(3)] == [True, True, False]


def test_without_motors_a_drag_that_the_file_has_is_not_told_from_the_mass_that_it_brakes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(classes, "without_motors", lambda flights: True)
    monkeypatch.setattr(classes, "has_gyro", lambda flights: True)
    known, fresh = (
        IdentifiedEffect("linear_drag", {"d_x_kgps": Estimate(was, 1.4, 1.3, 1.5)}, -50.0, 0.9, 1e-9)
        for was in (1.0, 0.0)
    )
    twins = [each.indistinguishable_from for each in classes.in_classes((known, fresh), ())]
    assert ["payload" in each for each in twins] == [True, False]
    assert all({"rotor_drag", "parasitic_drag"} <= set(each) for each in twins)


def test_measured_speeds_stand_for_commands(flown: Flown, tmp_path: Path) -> None:
    rotors = quad().rotors
    f = rotors.thrust_model_factor
    rpm = rotors.max_speed_radps * np.sqrt(f * flown.true_u**2 + (1.0 - f) * flown.true_u) * 30.0 / np.pi
    result = found_in(flown, rpm, "motor_rpm_", tmp_path)
    named = {found.name: found for found in result.found}
    assert set(named) == {"linear_drag", "payload"}
    told = named["payload"].parameters["mass_kg"]
    assert told.low <= PAYLOAD_KG <= told.high
    assert not {"motor_lag", "transport_delay", "thrust_curve"} & set(named)
    hidden_ = {row.effect: row.level for row in result.report.shown}
    assert hidden_["motor_lag"] == "hidden"


@ONLY_THEN
def test_a_log_with_slow_motors_beside_a_whole_one_is_no_hindrance(flown: Flown, tmp_path: Path) -> None:
    logs = [
        written(flown, motors, "motor_", tmp_path / f"{k}.csv") for k, motors in enumerate((flown.motor, slow(flown)))
    ]
    assert {found.name for found in analyse(logs, quad()).found} == {"linear_drag", "payload"}
    with pytest.raises(InputError, match="holds a flight that is learned from"):
        analyse(logs[:1], quad(), holdout=logs[1:])


@ONLY_THEN
def test_what_a_hover_shows_as_a_mean_only_is_named(tmp_path: Path) -> None:
    """Four percent of mass and a hundredth of the arm: less than vehicles differ by, and all that is missing here."""
    truth = hidden(quad(), {"payload": {"mass_kg": 0.05}, "com_offset": {"x_m": 0.0015, "y_m": -0.001}})
    still = fly(truth, quad(), hover(), seconds=24.0, seed=4, dither=0.0)
    said = found_in(still, still.motor, "motor_", tmp_path)
    assert not said.unexplained.significant
    assert said.gap.closed == pytest.approx(1.0, abs=0.05)
    shifted = next(found for found in said.found if found.name == "com_offset")
    (mass,) = (found for found in said.found if found is not shifted)
    assert {"payload", "thrust_scale"} & {mass.name, *mass.indistinguishable_from}
    assert shifted.parameters["x_m"].low <= 0.0015 <= shifted.parameters["x_m"].high
    assert shifted.parameters["y_m"].low <= -0.001 <= shifted.parameters["y_m"].high
