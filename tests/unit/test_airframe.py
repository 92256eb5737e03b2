"""Vehicle files against PX4's geometry and hover thrust; the oracle is the parameter reference and a recorded PX4."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from shipped import load_vehicle
from tlog import recording
from wrong_vehicles import WRONG

from flightstack.airframe import GEOMETRY, contradictions, unsettled_hover
from flightstack.model import Model
from flightstack.vehicle import Vehicle
from flightstack_sim.autopilot.flight_control import airframe_params
from mavlink_bridge.vehicle_params import ParamReader

SIHSIM = {
    "CA_ROTOR_COUNT": 4.0, "MPC_THR_HOVER": 0.5, "THR_MDL_FAC": 0.0,
    "CA_ROTOR0_PX": 1.0, "CA_ROTOR0_PY": 1.0, "CA_ROTOR0_KM": 0.05,
    "CA_ROTOR1_PX": -1.0, "CA_ROTOR1_PY": -1.0, "CA_ROTOR1_KM": 0.05,
    "CA_ROTOR2_PX": 1.0, "CA_ROTOR2_PY": -1.0, "CA_ROTOR2_KM": -0.05,
    "CA_ROTOR3_PX": -1.0, "CA_ROTOR3_PY": 1.0, "CA_ROTOR3_KM": -0.05,
}  # fmt: skip
"""As a PX4 with its internal simulator (airframe 10040) tells them."""
IRIS = SIHSIM | {
    "CA_ROTOR0_PX": 0.1515, "CA_ROTOR0_PY": 0.245, "CA_ROTOR1_PX": -0.1515, "CA_ROTOR1_PY": -0.1875,
    "CA_ROTOR2_PX": 0.1515, "CA_ROTOR2_PY": -0.245, "CA_ROTOR3_PX": -0.1515, "CA_ROTOR3_PY": 0.1875,
}  # fmt: skip
"""As airframe 10016 (none_iris) tells them."""


def judged(values: dict[str, float], vehicle: Vehicle) -> list[str]:
    return contradictions(values, vehicle, Model.from_vehicle(vehicle).hover_norm)


@pytest.mark.parametrize(("name", "values"), [("px4-sihsim-quadx", SIHSIM), ("quad-x", SIHSIM), ("iris", IRIS)])
def test_a_right_file_is_not_contradicted_whatever_the_scale(name: str, values: dict[str, float]) -> None:
    assert judged(values, load_vehicle(name)) == []
    larger = {key: 7.0 * value if "_P" in key and "ROTOR" in key else value for key, value in values.items()}
    assert judged(larger, load_vehicle(name)) == []


@pytest.mark.parametrize("words", WRONG)
@pytest.mark.parametrize("name", ["quad-x", "f450", "iris"])
def test_every_wrong_file_is_contradicted_by_the_autopilot_of_the_right_one(name: str, words: str) -> None:
    """The simulated autopilot is set up for the vehicle that flies, hover thrust included."""
    right = load_vehicle(name)
    params = airframe_params(right)
    values = {key: params.get(key) for key in (*GEOMETRY, "MPC_THR_HOVER", "THR_MDL_FAC")}
    assert judged(values, right) == []
    lines = judged(values, WRONG[words](right))
    assert lines
    assert all("\n" not in line for line in lines)


def test_the_lines_name_the_rotor_and_the_parameter() -> None:
    quad = load_vehicle("quad-x")
    lines = judged(SIHSIM, WRONG["two rotors swapped"](quad))
    assert lines == [
        "rotor 3: rear right in the vehicle file, front left by CA_ROTOR2_PX and _PY",
        "rotor 4: front left in the vehicle file, rear right by CA_ROTOR3_PX and _PY",
    ]
    (line,) = judged(SIHSIM, WRONG["one turns the other way"](quad))
    assert line.startswith("rotor 3: turns counter-clockwise")
    assert "CA_ROTOR2_KM = -0.05" in line
    (line,) = judged(SIHSIM | {"CA_ROTOR_COUNT": 6.0}, quad)
    assert line == "rotors: 4 in the vehicle file, 6 by CA_ROTOR_COUNT"


@pytest.mark.parametrize(
    ("told", "refused"), [(0.36, True), (0.395, False), (0.49, False), (0.64, False), (0.66, True), (0.5, False)]
)
def test_hover_thrust_may_differ_by_a_quarter_of_what_px4_was_told(told: float, refused: bool) -> None:
    """By hand: 1 kg of 4 x 5 N hover at 0.4903; 0.4903 / 1.25 = 0.392 and 0.4903 / 0.75 = 0.654 are the bounds."""
    lines = judged(SIHSIM | {"MPC_THR_HOVER": told}, load_vehicle("px4-sihsim-quadx"))
    assert bool(lines) is refused


def test_at_its_default_hover_thrust_is_left_to_the_first_hover() -> None:
    sih = load_vehicle("px4-sihsim-quadx")
    heavy = replace(sih, mass_kg=1.37)  # 0.67: 34 % off
    assert judged(SIHSIM, heavy) == []
    assert "the first hover decides" in unsettled_hover(SIHSIM, Model.from_vehicle(heavy).hover_norm)
    assert unsettled_hover(SIHSIM, Model.from_vehicle(sih).hover_norm) == ""
    assert unsettled_hover(SIHSIM | {"MPC_THR_HOVER": 0.66}, Model.from_vehicle(heavy).hover_norm) == ""


def test_hover_thrust_is_compared_before_px4_undoes_its_thrust_curve() -> None:
    """THR_MDL_FAC 1: PX4 takes the root of the setpoint, so a motor command of 0.7 is a setpoint of 0.49."""
    values = SIHSIM | {"THR_MDL_FAC": 1.0, "MPC_THR_HOVER": 0.49}
    quad = load_vehicle("quad-x")
    assert contradictions(values, quad, 0.7) == []
    assert contradictions(values, quad, 0.49)


def test_what_px4_does_not_tell_contradicts_nothing() -> None:
    quad = load_vehicle("quad-x")
    for missing in GEOMETRY:
        values = {key: value for key, value in SIHSIM.items() if key != missing}
        assert judged(values, quad) == []
    assert judged({}, quad) == []
    assert judged(dict.fromkeys(SIHSIM, 0.0) | {"CA_ROTOR_COUNT": 4.0, "MPC_THR_HOVER": 0.5}, quad) == []
    assert judged(SIHSIM | {"CA_ROTOR0_PX": np.inf}, quad) == []


def test_a_recorded_px4_agrees_with_the_file_of_its_airframe(recorded: Path) -> None:
    reader, values = ParamReader(), {}
    for heard in recording(recorded / "px4_sih_offboard.tlog"):
        if heard.system == 1:
            reader.take(heard.message)
            values = reader.values
    assert "CA_ROTOR0_PX" in values
    assert judged(values, load_vehicle("px4-sihsim-quadx")) == []
    assert judged(values, WRONG["Betaflight's order"](load_vehicle("px4-sihsim-quadx")))
