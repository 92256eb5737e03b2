"""The vehicle file's table [autopilot]: read, refused, flown by the simulated autopilot, compared with a vehicle."""

from __future__ import annotations

import pytest
from shipped import load_vehicle

from flightstack.autopilot import autopilot_of
from flightstack.autopilot_params import AUTOPILOT_PARAMS
from flightstack.types import InputError
from flightstack.vehicle import parse_vehicle, vehicle_to_toml
from flightstack_sim.autopilot.flight_control import airframe_params
from flightstack_sim.autopilot.params import PARAMS

QUAD = load_vehicle("quad-x")


def with_table(text: str) -> str:
    return vehicle_to_toml(QUAD) + f"\n[autopilot]\n{text}\n"


def test_defaults_and_ranges_are_those_of_the_simulated_px4() -> None:
    table = {spec.name: spec for spec in PARAMS}
    for key, param in AUTOPILOT_PARAMS.items():
        spec = table[param.name]
        if param.default is not None:
            assert spec.default == pytest.approx(param.default, rel=1e-6), key
        if not key.endswith("rate_max"):  # a limit of no turning at all is no flight
            assert (spec.minimum, spec.maximum) == (param.minimum, param.maximum), key


def test_what_is_stated_flies_and_the_rest_are_the_defaults() -> None:
    stated = parse_vehicle(with_table("mc_rollrate_p = 0.11\nmc_yawrate_k = 0.5\nimu_gyro_cutoff = 60.0"), "file")
    params = airframe_params(stated)
    assert params.get("MC_ROLLRATE_P") == pytest.approx(0.11)
    assert params.get("MC_YAWRATE_K") == 0.5
    assert params.get("IMU_GYRO_CUTOFF") == 60.0
    assert params.get("MC_PITCHRATE_P") == pytest.approx(0.15)
    assert all(params.get(AUTOPILOT_PARAMS[key].name) == value for key, value in autopilot_of(stated).items())


def test_the_table_is_written_and_read_bit_for_bit() -> None:
    stated = parse_vehicle(with_table("mc_rollrate_p = 0.11\nairmode = 1"), "file")
    assert parse_vehicle(vehicle_to_toml(stated), "file") == stated
    assert "[autopilot]" not in vehicle_to_toml(QUAD)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("mc_rollrate_q = 0.1", "unknown key autopilot.mc_rollrate_q"),
        ("mc_rollrate_p = 9.0", "autopilot.mc_rollrate_p = 9.0 is not allowed"),
        ("mc_rollrate_p = nan", "autopilot.mc_rollrate_p = nan is not allowed"),
        ('mc_rollrate_p = "high"', "autopilot.mc_rollrate_p = 'high' is not allowed"),
        ("airmode = 0.5", "autopilot.airmode = 0.5 is not allowed"),
        ("airmode = 3", "autopilot.airmode = 3 is not allowed"),
    ],
)
def test_a_bad_table_is_refused_in_one_line(text: str, says: str) -> None:
    with pytest.raises(InputError, match=r"^file: ") as refused:
        parse_vehicle(with_table(text), "file")
    assert says in str(refused.value)
    assert "\n" not in str(refused.value)


def test_autopilot_that_is_no_table_is_refused() -> None:
    text = "autopilot = 3\n" + vehicle_to_toml(QUAD)
    with pytest.raises(InputError, match="autopilot must be a table"):
        parse_vehicle(text, "file")
