"""The batched closed loop flies each vehicle as the single plant, rate loop and controller do, whatever the threads."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from measured import measured

from flightstack.control.feedback import FlatnessController
from flightstack.errors import InputError
from flightstack.model import Limiter, Limits, Model
from flightstack.trajectory import sinusoid
from flightstack.types import F64, Command, FlatOutput, Learned, Tuple3
from flightstack.vehicle import Vehicle, parse_vehicle, scaled, with_effects
from flightstack_sim.autopilot.flight_control import airframe_params
from flightstack_sim.autopilot.rate_control import RateControl
from flightstack_sim.batch import BatchClosedLoop, BatchPlant
from flightstack_sim.batch_loop import TICK_S
from flightstack_sim.plant import NativePlant

TICKS = 150
QUAD = Path(__file__).resolve().parents[2] / "flightstack/data/vehicles/quad-x.toml"


def _quad() -> Vehicle:
    return parse_vehicle(QUAD.read_text(), "quad-x")


def _truths() -> list[Vehicle]:
    quad = _quad()
    return [
        quad,
        with_effects(scaled(quad, mass_ratio=1.3), {"constant_force": {"north_n": 1.0}}),
        with_effects(quad, {"turbulence": {"sigma_mps": 1.5, "length_m": 30.0}, "linear_drag": {"d_x_kgps": 0.3}}),
        with_effects(quad, {"transport_delay": {"delay_s": 0.02}, "rotor_drag": {"k_d_kg_per_rad": 1.6e-4}}),
    ]


def _reference(ticks: int = TICKS) -> F64:
    path = sinusoid((0.0, 0.0, -1.5), (1.0, 0.8, 0.3), (1.2, 1.0, 0.7), (0.0, 0.5, 0.0), yaw_rad=0.3)
    return np.array([path.at(TICK_S * k).row for k in range(ticks)])


def _alone(truth: Vehicle, seed: int, reference: F64, begins: Tuple3 = (0.0, 0.0, 0.0)) -> tuple[NativePlant, int]:
    """The same through the single classes, a call each, from these rates; and how many commands met their limit."""
    believed, limits = _quad(), Limits()
    model = Model.from_vehicle(believed)
    plant = NativePlant(truth, seed=seed, ground=False)
    plant.motor_u[:], plant.rate_frd_radps[:], limited = model.hover_norm, begins, 0
    controller, limiter = FlatnessController(model, limits=limits), Limiter(model, limits)
    rates, state = RateControl(believed, airframe_params(believed)), controller.init(0)
    sent, nothing = Command(0, 0.0, 0.0, np.zeros(3)), Learned.nothing()
    for row in reference:
        seen = measured(
            plant.t_us, plant.pos_ned_m, plant.vel_ned_mps, plant.q_ned_frd, plant.rate_frd_radps, np.zeros(3),
            np.zeros(4), 0, 0, 0,
        )  # fmt: skip
        state, proposal = controller.step(state, seen, FlatOutput(row), nothing, sent, plant.t_us)
        command, _ = limiter.limit(proposal.thrust_n, proposal.rate_frd_radps, plant.t_us)
        rate = tuple(command.rate_frd_radps.tolist())
        rates.set_target(rate, command.thrust_norm, armed=True, hold_integral=False)  # type: ignore[arg-type]
        for _ in range(4):
            rates.step(plant.rate_frd_radps)
            plant.step(rates.motor_command)
            limited += int(np.sum((rates.motor_command <= 0.0) | (rates.motor_command >= 1.0)))
    return plant, limited


@pytest.fixture(scope="module")
def flown() -> BatchClosedLoop:
    batch = BatchClosedLoop(_quad(), _truths(), seed=7)
    batch.fly(_reference(), threads=2)
    return batch


@pytest.mark.parametrize("which", range(4))
def test_each_vehicle_flies_as_alone(flown: BatchClosedLoop, which: int) -> None:
    alone, _ = _alone(_truths()[which], 7 + which, _reference())
    for ours, single in (
        (flown.pos_ned_m, alone.pos_ned_m), (flown.vel_ned_mps, alone.vel_ned_mps), (flown.q_ned_frd, alone.q_ned_frd),
        (flown.rate_frd_radps, alone.rate_frd_radps),
    ):  # fmt: skip
        np.testing.assert_allclose(ours[which], single, rtol=0.0, atol=1e-9)


def test_what_motors_cannot_give_is_shared_out_as_alone() -> None:
    """Two vehicles of a block begin tumbling: all of it flies as each would alone."""
    begins = np.zeros((20, 3))
    begins[3], begins[17] = (9.0, -6.0, 2.0), (-3.0, 12.0, -4.0)
    batch, reference = BatchClosedLoop(_quad(), [_quad()] * 20), _reference(60)
    batch.rate_frd_radps[:] = begins
    batch.fly(reference)
    for which in (2, 3, 17, 19):
        alone, limited = _alone(_quad(), which, reference, tuple(begins[which].tolist()))
        assert limited > 0
        np.testing.assert_allclose(batch.rate_frd_radps[which], alone.rate_frd_radps, rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(batch.pos_ned_m[which], alone.pos_ned_m, rtol=0.0, atol=1e-9)


def test_threads_and_interruptions_do_not_matter(flown: BatchClosedLoop) -> None:
    other = BatchClosedLoop(_quad(), _truths(), seed=7)
    other.fly(_reference()[:97], threads=1)
    other.fly(np.repeat(_reference()[None, 97:], 4, axis=0), threads=3)
    assert np.array_equal(other.pos_ned_m, flown.pos_ned_m)
    assert np.array_equal(other.rate_frd_radps, flown.rate_frd_radps)


def test_it_follows_its_reference() -> None:
    reference = _reference(1500)
    batch = BatchClosedLoop(_quad(), [_quad()])
    batch.pos_ned_m[:] = reference[0, :3]
    distances = batch.fly(reference)
    assert distances.shape == (1, 1500)
    assert np.sqrt(np.mean(distances[0, 750:] ** 2)) < 0.1


def test_a_batch_of_plants_does_not_depend_on_its_threads() -> None:
    quad, commands = _quad(), np.random.default_rng(0).uniform(0.5, 0.9, (7, 4))
    vehicles = [with_effects(quad, {"payload": {"mass_kg": 0.05 * i}}) for i in range(7)]
    one, three = (BatchPlant(vehicles, seed=0, threads=threads) for threads in (1, 3))
    for _ in range(20):
        one.step(commands)
        three.step(commands)
    assert np.array_equal(one.vel_ned_mps, three.vel_ned_mps)


def test_what_is_no_reference_is_one_line() -> None:
    with pytest.raises(InputError, match="is not"):
        BatchClosedLoop(_quad(), [_quad()]).fly(np.zeros((3, 16)))
    with pytest.raises(InputError, match="at least one"):
        BatchClosedLoop(_quad(), [])
