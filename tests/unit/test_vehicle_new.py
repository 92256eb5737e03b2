"""Vehicle files from PX4's parameters, and ranges: shipped vehicles with published numbers are the oracle."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pymavlink import mavutil

from flightstack.cli.main import main
from flightstack.model import Model
from flightstack.plausibility import implausible
from flightstack.types import InputError
from flightstack.vehicle import Vehicle, parse_vehicle, vehicle_to_toml
from flightstack.vehicle_new import vehicle_text
from mavlink_bridge.param_file import listed_params
from tests.wrong_vehicles import WRONG

FOLDER = Path(__file__).resolve().parents[2] / "flightstack/data/vehicles"


def shipped(name: str) -> Vehicle:
    return parse_vehicle((FOLDER / f"{name}.toml").read_text(), name)


def parameters(vehicle: Vehicle, scale: float = 1.0) -> dict[str, float]:
    """What PX4 would be set up with for this vehicle; its geometry is free of scale."""
    values = {"CA_ROTOR_COUNT": 4.0, "THR_MDL_FAC": 0.0, "MPC_THR_HOVER": 0.5}
    for i, (place, ratio) in enumerate(
        zip(vehicle.rotors.position_m.tolist(), vehicle.rotors.torque_ratio_m.tolist(), strict=True)
    ):
        values |= {f"CA_ROTOR{i}_PX": scale * place[0], f"CA_ROTOR{i}_PY": scale * place[1]}
        values[f"CA_ROTOR{i}_KM"] = float(np.copysign(0.05, ratio))
    return values


def as_file(values: dict[str, float]) -> str:
    rows = [f"1\t1\t{name}\t{value:.9g}\t9" for name, value in values.items()]
    return "# Vehicle-Id 1 Component-Id 1\n" + "\n".join(rows) + "\n"


@pytest.mark.parametrize("name", ["quad-x", "iris", "f450"])
@pytest.mark.parametrize("with_arm", [True, False])
def test_the_ranges_hold_what_is_published_of_a_vehicle(name: str, with_arm: bool) -> None:
    truth = shipped(name)
    arm = float(np.linalg.norm(truth.rotors.position_m[:, :2], axis=1).mean()) if with_arm else None
    text = vehicle_text(
        parameters(truth, 1.0 / 0.37), name="made", mass_kg=truth.mass_kg, arm_m=arm, source="parameters"
    )
    made = parse_vehicle(text, "made")
    for key, value in {
        "body.inertia_kgm2": truth.inertia_kgm2,
        "rotors.torque_ratio_m": truth.rotors.torque_ratio_m,
        "rotors.time_constant_s": truth.rotors.time_constant_s,
        "rotors.radius_m": truth.rotors.radius_m,
        "rotors.max_speed_radps": truth.rotors.max_speed_radps,
        "rotors.thrust_model_factor": truth.rotors.thrust_model_factor,
    }.items():
        pairs = made.ranges[key]
        assert np.all((pairs[..., 0] <= value) & (value <= pairs[..., 1])), key
    if with_arm:
        assert made.rotors.position_m[:, :2] == pytest.approx(truth.rotors.position_m[:, :2], abs=2e-5)
    assert np.sign(made.rotors.torque_ratio_m).tolist() == np.sign(truth.rotors.torque_ratio_m).tolist()
    assert not implausible(made)


@pytest.mark.parametrize(("hover", "curve"), [(0.35, 0.0), (0.62, 0.3), (0.5, 0.0)])
def test_the_made_vehicle_hovers_where_px4_says(hover: float, curve: float) -> None:
    """PX4's thrust setpoint is the share of the greatest thrust: 4 T_max hover = m g."""
    values = parameters(shipped("quad-x")) | {"MPC_THR_HOVER": hover, "THR_MDL_FAC": curve}
    made = parse_vehicle(vehicle_text(values, name="made", mass_kg=1.3, arm_m=0.2, source="p"), "made")
    assert 4.0 * made.rotors.max_thrust_n * hover == pytest.approx(1.3 * 9.80665, rel=1e-4)
    u = Model.from_vehicle(made).hover_norm
    assert curve * u * u + (1.0 - curve) * u == pytest.approx(hover, rel=1e-4)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"CA_ROTOR_COUNT": 6.0}, "4 rotors"),
        ({"CA_ROTOR2_KM": 0.0}, "rotor 3 is unknown"),
        ({"CA_ROTOR0_PX": 0.0, "CA_ROTOR0_PY": 0.0}, "at the centre"),
        ({"CA_ROTOR1_PY": float("nan")}, "CA_ROTOR1_PY is not told"),
    ],
)
def test_parameters_that_describe_no_quadrotor_are_one_line(change: dict[str, float], words: str) -> None:
    with pytest.raises(InputError, match=words) as error:
        vehicle_text(parameters(shipped("quad-x")) | change, name="x", mass_kg=1.0, arm_m=None, source="p")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("wrong", WRONG)
def test_a_wrong_file_is_told_line_by_line(wrong: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    right = shipped("px4-sihsim-quadx")
    (tmp_path / "px4.params").write_text(as_file(parameters(right) | {"MPC_THR_HOVER": 0.49}))
    (tmp_path / "wrong.toml").write_text(vehicle_to_toml(WRONG[wrong](right)))
    (tmp_path / "right.toml").write_text(vehicle_to_toml(right))
    assert _run("vehicle", "check", tmp_path / "right.toml", "--against", tmp_path / "px4.params") == 0
    capsys.readouterr()
    assert _run("vehicle", "check", tmp_path / "wrong.toml", "--against", tmp_path / "px4.params") == 1
    lines = capsys.readouterr().out.strip().splitlines()
    assert lines
    assert all(line.startswith(("rotor", "hover thrust", "body")) for line in lines)


def test_from_a_file_of_parameters_to_a_vehicle_that_passes_its_check(tmp_path: Path) -> None:
    (tmp_path / "px4.params").write_text(as_file(parameters(shipped("iris"))))
    made = tmp_path / "made.toml"
    assert _run("vehicle", "new", "--from", tmp_path / "px4.params", "--mass", "1.5", "--out", made) == 0
    assert _run("vehicle", "check", made, "--against", tmp_path / "px4.params") == 0


@pytest.mark.parametrize(
    "text", ["", "# nothing\n", "1\t1\tMPC_THR_HOVER\n", "root:x:0:0\n", "MPC_THR_HOVER nan\n", "\x00\x01\x02"]
)
def test_other_files_are_one_line(tmp_path: Path, text: str, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "x.params").write_text(text)
    assert _run("vehicle", "new", "--from", tmp_path / "x.params", "--mass", "1", "--out", tmp_path / "o.toml") == 2
    assert capsys.readouterr().err.startswith("error: ")
    assert not (tmp_path / "o.toml").exists()


@pytest.mark.parametrize("text", ["MPC_THR_HOVER 0.5\n", "MPC_THR_HOVER,0.5\n", "1\t1\tMPC_THR_HOVER\t0.5\t9\n"])
def test_lists_as_ground_stations_save_them(text: str) -> None:
    assert listed_params(text, "x") == {"MPC_THR_HOVER": 0.5}


RANGED = """schema = "flightstack.vehicle/1"
name = "ranged"
[body]
mass_kg = {value = 1.2, range = [1.1, 1.3]}
inertia_kgm2 = {value = [0.012, 0.013, 0.022], range = [[0.01, 0.014], [0.01, 0.016], [0.02, 0.03]]}
[rotors]
position_m = [[0.13, 0.16, 0.0], [-0.13, -0.16, 0.0], [0.13, -0.16, 0.0], [-0.13, 0.16, 0.0]]
torque_ratio_m = [0.015, 0.015, -0.015, -0.015]
max_thrust_n = 6.6
max_speed_radps = 1000.0
thrust_model_factor = {value = 1.0, range = [0.0, 1.0]}
time_constant_s = 0.02
radius_m = 0.12
[effects.rotor_drag]
k_d_kg_per_rad = {value = 1.6e-4, range = [0.0, 3e-4]}
"""


def test_a_file_with_ranges_flies_its_values_and_is_written_back_whole() -> None:
    vehicle = parse_vehicle(RANGED, "x")
    assert vehicle.mass_kg == 1.2
    assert vehicle.ranges["body.mass_kg"].tolist() == [1.1, 1.3]
    assert vehicle.ranges["effects.rotor_drag.k_d_kg_per_rad"].tolist() == [0.0, 3e-4]
    again = parse_vehicle(vehicle_to_toml(vehicle), "again")
    assert again == vehicle
    assert {key: pairs.tolist() for key, pairs in again.ranges.items()} == {
        key: pairs.tolist() for key, pairs in vehicle.ranges.items()
    }


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ("{value = 1.2, range = [1.3, 1.4]}", "must hold the value"),
        ("{value = 1.2, range = [1.1]}", "one \\[low, high\\]"),
        ("{value = 1.2}", "value = ..., range"),
        ("{value = 1.2, range = [1.1, nan]}", "one \\[low, high\\]"),
        ("{value = 1.2, range = [-5.0, 1.3]}", "body.mass_kg.range"),
        ("{value = 1.2, range = ['a', 'b']}", "one \\[low, high\\]"),
        ("{value = 1.2, range = [1.1, 1.3], sigma = 0.1}", "value = ..., range"),
    ],
)
def test_a_wrong_range_is_refused_in_one_line_that_names_the_key(wrong: str, words: str) -> None:
    with pytest.raises(InputError, match=words) as error:
        parse_vehicle(RANGED.replace("{value = 1.2, range = [1.1, 1.3]}", wrong), "x")
    assert "body.mass_kg" in str(error.value)
    assert "\n" not in str(error.value)


def _run(*arguments: object) -> int:
    with pytest.raises(SystemExit) as ended:
        main([str(argument) for argument in arguments])
    return int(ended.value.code or 0)


def test_from_a_telemetry_log_of_a_px4(recorded: Path, tmp_path: Path) -> None:
    """The hover thrust that pymavlink reads from the same recording is where the made vehicle hovers."""
    source = recorded / "px4_sih_offboard.tlog"
    out = tmp_path / "mine.toml"
    with pytest.raises(SystemExit) as ended:
        main(["vehicle", "new", "--from", str(source), "--mass", "1.0", "--out", str(out)])
    assert ended.value.code == 0
    log = mavutil.mavlink_connection(str(source))
    hover = 0.0
    while (message := log.recv_match(type="PARAM_VALUE")) is not None:
        if message.param_id == "MPC_THR_HOVER":
            hover = message.param_value
    log.close()
    made = parse_vehicle(out.read_text(), "mine")
    assert hover > 0.0
    assert 4.0 * made.rotors.max_thrust_n * hover == pytest.approx(9.80665, rel=1e-4)
