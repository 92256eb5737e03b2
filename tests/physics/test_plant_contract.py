"""What every plant keeps to, whatever its physics: `sim.plant.Plant`, over both."""

from __future__ import annotations

import math

import numpy as np
import pytest
from fleet import QUAD, TYPICAL, quad

from flightstack.effects import EFFECTS
from flightstack.types import InputError
from flightstack_sim.jsbsim.aircraft import REFUSED
from flightstack_sim.plant import PLANTS, Plant, make_plant

ARRAYS = (
    "pos_ned_m", "vel_ned_mps", "q_ned_frd", "rate_frd_radps", "specific_force_frd_mps2", "accel_bias_frd_mps2",
    "gyro_bias_frd_radps", "misalignment_q",
)  # fmt: skip
HOVER = np.full(4, 0.67)
MODERATE = {**TYPICAL, "blade_flapping": {"k_flap_nms2_per_rad_m": 1e-6}}


@pytest.fixture(params=[pytest.param(name, marks=[pytest.mark.jsbsim] if name == "jsbsim" else []) for name in PLANTS])
def name(request: pytest.FixtureRequest) -> str:
    if request.param == "jsbsim":
        pytest.importorskip("jsbsim", reason="no JSBSim here (wheels exist for x86-64 only)")
    return str(request.param)


def flown(plant: Plant, steps: int = 400, u: float = 0.8) -> list[float]:
    for k in range(steps):
        plant.step(np.full(4, u) + 0.005 * np.sin(0.1 * k + np.arange(4)))
    truth = plant.truth()
    return [*truth.pos_ned_m, *truth.vel_ned_mps, *truth.q_ned_frd, *truth.rate_frd_radps, *truth.wind_ned_mps]


def test_it_starts_at_rest_on_the_ground_at_the_origin_facing_north(name: str) -> None:
    plant = make_plant(name, QUAD, seed=0)
    truth = plant.truth()
    assert truth.t_us == plant.t_us == 0
    assert truth.pos_ned_m == pytest.approx((0, 0, 0), abs=1e-6)
    assert truth.q_ned_frd == pytest.approx((1, 0, 0, 0), abs=1e-9)
    assert truth.vel_ned_mps == pytest.approx((0, 0, 0), abs=1e-9)
    assert truth.specific_force_frd_mps2 == pytest.approx((0, 0, -9.807), abs=2e-3)
    assert truth.motor_u == (0, 0, 0, 0)
    assert truth.on_ground
    assert plant.on_ground
    assert plant.battery_v == pytest.approx(16.8)


def test_its_arrays_are_the_same_objects_for_life_through_steps_and_changed_effects(name: str) -> None:
    plant = make_plant(name, QUAD, seed=0)
    before = [getattr(plant, field) for field in ARRAYS]
    plant.step(HOVER)
    plant.set_effect("payload", {"mass_kg": 0.2})
    plant.step(HOVER)
    assert all(getattr(plant, field) is array for field, array in zip(ARRAYS, before, strict=True))
    assert plant.t_us == 2 * plant.dt_us == 2000
    assert plant.truth().pos_ned_m == tuple(plant.pos_ned_m.tolist())


def test_same_seed_same_flight_another_seed_other_gusts(name: str) -> None:
    gusty = quad(turbulence={"sigma_mps": 2.0, "length_m": 5.0}, linear_drag={"d_x_kgps": 0.5, "d_y_kgps": 0.5})
    first, again, other = (flown(make_plant(name, gusty, seed=seed)) for seed in (7, 7, 8))
    assert first == again
    assert first != other


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -math.inf, 1.5, -0.2])
def test_commands_are_held_to_what_a_motor_can_do(name: str, wrong: float) -> None:
    """Above 1 is full, below 0 and no number is off."""
    odd, plain = make_plant(name, QUAD, seed=0), make_plant(name, QUAD, seed=0)
    means = 1.0 if wrong > 1.0 else 0.0
    for _ in range(50):
        odd.step(np.array([0.7, wrong, 0.7, 0.7]))
        plain.step(np.array([0.7, means, 0.7, 0.7]))
    assert odd.truth() == plain.truth()
    assert np.isfinite(odd.pos_ned_m).all()


def test_the_quaternion_stays_one_and_never_jumps_through_a_roll(name: str) -> None:
    plant = make_plant(name, QUAD, seed=0)
    for _ in range(1500):
        plant.step(np.full(4, 0.9))
    last = plant.q_ned_frd.copy()
    for k in range(900):
        plant.step(np.array([0.4, 0.6, 0.6, 0.4]) if k < 300 else np.full(4, 0.5))
        assert plant.q_ned_frd @ last > 0.99
        last = plant.q_ned_frd.copy()
    assert np.linalg.norm(plant.q_ned_frd) == pytest.approx(1.0, abs=1e-12)
    assert abs(plant.rate_frd_radps[0]) > 2.0


def test_sensor_effects_leave_the_motion_alone_and_show_as_their_values(name: str) -> None:
    sensed = ("accelerometer_bias", "gyro_bias", "attitude_misalignment")
    plant = make_plant(name, quad(**{effect: TYPICAL[effect] for effect in sensed}), seed=0)
    assert flown(plant) == flown(make_plant(name, QUAD, seed=0))
    assert plant.accel_bias_frd_mps2.tolist() == [0.1, -0.2, 0.3]
    assert plant.gyro_bias_frd_radps.tolist() == [0.01, 0.02, -0.03]
    assert plant.misalignment_q[1] == pytest.approx(math.sin(0.01), rel=0.05)


@pytest.mark.parametrize("effect", EFFECTS)
def test_every_effect_flies_and_acts_or_is_refused_by_its_name(name: str, effect: str) -> None:
    spec = EFFECTS[effect]
    drag = {"linear_drag": {"d_x_kgps": 0.1, "d_y_kgps": 0.2, "d_z_kgps": 0.1}}
    vehicle = quad(**{**drag, effect: MODERATE[effect]})
    if name == "jsbsim" and effect in REFUSED:
        with pytest.raises(InputError, match=rf"effects\.{effect} .*--plant native"):
            make_plant(name, vehicle, seed=0)
        return
    plain = flown(make_plant(name, quad(**drag), seed=0))
    with_it = flown(make_plant(name, vehicle, seed=0))
    assert np.isfinite(with_it).all()
    assert (with_it == plain) == (spec.kind == "sensor")


@pytest.mark.parametrize("effect", [name for name in EFFECTS if name not in REFUSED])
def test_an_effect_at_its_null_value_flies_like_none(name: str, effect: str) -> None:
    nulls = {p.name: p.null for p in EFFECTS[effect].params if p.null is not None}
    assert flown(make_plant(name, quad(**{effect: nulls}), seed=3)) == flown(make_plant(name, QUAD, seed=3))


def test_a_time_step_or_a_plant_that_is_not_known_is_refused(name: str) -> None:
    with pytest.raises(InputError, match="100 to 10000 us"):
        make_plant(name, QUAD, seed=0, dt_us=20)
    with pytest.raises(InputError, match="native, jsbsim"):
        make_plant("gazebo", QUAD, seed=0)


def test_the_command_line_offers_the_plants_that_there_are() -> None:
    from flightstack.cli.options import PlantName

    assert [plant.value for plant in PlantName] == list(PLANTS)
