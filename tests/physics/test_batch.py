"""Many vehicles in one call fly as each would alone."""

from __future__ import annotations

import numpy as np
import pytest
from fleet import QUAD, TYPICAL, quad, random_vehicle, set_random_state

from flightstack.effects.row import PLACES, S_FORCE
from flightstack.types import InputError
from flightstack_sim import batch
from flightstack_sim.batch import BatchPlant
from flightstack_sim.batch_step import compiled_steps
from flightstack_sim.parameters import derive, parameter_row
from flightstack_sim.plant import NativePlant, evaluate_rows

SHOWN = ("pos_ned_m", "vel_ned_mps", "q_ned_frd", "rate_frd_radps", "specific_force_frd_mps2", "motor_u")


def _same(batch: BatchPlant, singles: list[NativePlant]) -> None:
    for k, plant in enumerate(singles):
        for name in SHOWN:
            np.testing.assert_allclose(
                getattr(batch, name)[k], getattr(plant, name), rtol=1e-9, atol=1e-9, err_msg=name
            )
        np.testing.assert_allclose(batch.battery_v[k], plant.battery_v, rtol=1e-9)
        assert batch.on_ground[k] == plant.on_ground
        assert batch.t_us == plant.t_us


def test_each_of_a_batch_of_random_vehicles_flies_as_alone_gusts_ground_and_all() -> None:
    rng = np.random.default_rng(9)
    vehicles = [random_vehicle(rng) for _ in range(19)]  # more than one block, not a whole number of them
    batch = BatchPlant(vehicles, seed=5)
    singles = [NativePlant(vehicle, seed=5 + i) for i, vehicle in enumerate(vehicles)]
    for steps in (*(1,) * 300, 3, 90):
        commands = rng.uniform(0.3, 1.0, (19, 4))
        batch.run(commands, steps)
        for plant, command in zip(singles, commands, strict=True):
            plant.run(command, steps)
    _same(batch, singles)


def test_without_effects_high_above_the_ground_too() -> None:
    rng = np.random.default_rng(2)
    batch, singles = BatchPlant([QUAD] * 3, seed=0, threads=1), [NativePlant(QUAD, seed=0) for _ in range(3)]
    batch.pos_ned_m[:, 2] = -20.0
    for plant in singles:
        plant.pos_ned_m[2] = -20.0
    for _ in range(200):
        commands = rng.uniform(0.4, 0.9, (3, 4))
        batch.step(commands)
        for plant, command in zip(singles, commands, strict=True):
            plant.step(command)
    _same(batch, singles)
    assert not batch.on_ground.any()


def test_no_lane_disturbs_another_and_a_command_that_is_no_number_stops_its_motor() -> None:
    vehicles = [quad(**TYPICAL), QUAD]
    clean, broken = BatchPlant(vehicles, seed=1, ground=False), BatchPlant(vehicles, seed=1, ground=False)
    broken.vel_ned_mps[0] = np.nan
    commands = np.array([[0.8] * 4, [0.8, np.nan, 7.0, -1.0]])
    clean.run(commands, 40)
    broken.run(commands, 40)
    assert np.isnan(broken.pos_ned_m[0]).all()
    for name in SHOWN:
        assert np.array_equal(getattr(clean, name)[1], getattr(broken, name)[1])
    alone = NativePlant(QUAD, seed=2, ground=False)
    alone.run(commands[1], 40)
    np.testing.assert_allclose(clean.motor_u[1], alone.motor_u, rtol=1e-9)


def test_many_steps_in_one_call_are_the_same_flight_as_step_by_step() -> None:
    together, single = NativePlant(quad(**TYPICAL), seed=4), NativePlant(quad(**TYPICAL), seed=4)
    command = np.array([0.8, 0.82, 0.79, 0.81])
    for steps in (1, 255, 2, 700, 42):
        together.run(command, steps)
    for _ in range(1000):
        single.step(command)
    assert np.array_equal(together._state, single._state)
    assert together.truth() == single.truth()


def test_a_batch_in_gusts_is_the_same_however_its_steps_are_cut() -> None:
    """Normals are drawn for many steps at once; calls that end within, at and beyond a draw use the same ones."""
    vehicles = [quad(**(TYPICAL | {"turbulence": {"sigma_mps": 2.0, "length_m": 20.0}}))] * 20
    cut, single = BatchPlant(vehicles, seed=5), BatchPlant(vehicles, seed=5, threads=2)
    for steps in (1, 63, 1, 64, 65, 130, 0, 3):
        cut.run(np.full(4, 0.72), steps)
    for _ in range(327):
        single.step(np.full(4, 0.72))
    assert np.array_equal(cut.pos_ned_m, single.pos_ned_m)
    assert np.abs(cut.vel_ned_mps[0] - cut.vel_ned_mps[1]).max() > 1e-3  # each has gusts of its own


def test_same_seed_same_flight_other_seed_other_gusts() -> None:
    flights = []
    for seed in (1, 1, 2):
        plant = NativePlant(quad(**TYPICAL), seed=seed)
        plant.run(np.full(4, 0.8), 1000)
        flights.append(plant._state.copy())
    assert np.array_equal(flights[0], flights[1])
    assert not np.array_equal(flights[0], flights[2])


def test_a_snapshot_is_plain_numbers_and_does_not_change_with_the_plant() -> None:
    plant = NativePlant(QUAD, seed=0)
    before = plant.truth()
    plant.run(np.full(4, 0.9), 500)
    after = plant.truth()
    assert before.pos_ned_m == (0.0, 0.0, 0.0)
    assert after.pos_ned_m == tuple(plant.pos_ned_m)
    assert all(type(x) is float for x in (*after.pos_ned_m, *after.motor_u, after.battery_v))
    assert type(after.on_ground) is bool
    assert after.t_us == 500_000


def test_commands_of_any_kind_of_numbers_fly_the_same() -> None:
    """A list, float32 or a read-only array must neither fail nor compile anew."""
    flights = []
    read_only = np.full(4, 0.75)
    read_only.setflags(write=False)
    for command in ([0.75] * 4, np.full(4, 0.75, dtype=np.float32), read_only, np.full((4, 2), 0.75)[:, 0]):
        plant = NativePlant(QUAD, seed=0)
        for _ in range(50):
            plant.step(command)  # type: ignore[arg-type]
        flights.append(plant._state.copy())
    assert all(np.array_equal(flight, flights[0]) for flight in flights)


def test_rows_whose_raw_numbers_are_changed_and_derived_anew_are_the_changed_vehicles() -> None:
    """What sensitivities need: vary a number in a row, derive, evaluate; the same as building the vehicle so."""
    changed = {name: TYPICAL[name] for name in ("payload", "com_offset", "inertia", "thrust_scale", "rotor_drag")}
    params = np.stack([parameter_row(QUAD, dt_us=1000), parameter_row(quad(**changed), dt_us=1000)])
    varied = np.stack([params[0], params[0]])
    for name, table in changed.items():
        for key, value in table.items():
            varied[1, PLACES[name, key]] = value
    derive(varied[1])
    assert np.array_equal(varied, params, equal_nan=True)
    rng = np.random.default_rng(3)
    plant = NativePlant(QUAD, seed=0, ground=False)
    set_random_state(plant, rng)
    state = np.concatenate([plant._state, plant._state])
    evaluate_rows(state, varied)
    for row, vehicle in zip(state, (QUAD, quad(**changed)), strict=True):
        alone = NativePlant(vehicle, seed=0, ground=False)
        alone._state[:, :S_FORCE] = plant._state[:, :S_FORCE]
        alone.evaluate()
        assert np.array_equal(row[S_FORCE : S_FORCE + 6], alone._state[0, S_FORCE : S_FORCE + 6])


def test_a_numpy_that_hides_what_draws_gusts_flies_all_but_gusts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(batch, "compiled_steps", lambda effects: (*compiled_steps(effects)[:2], 0))
    with pytest.raises(InputError, match="NumPy"):
        BatchPlant([quad(turbulence={"sigma_mps": 1.0, "length_m": 20.0})], seed=0)
    plant = BatchPlant([QUAD], seed=0)
    plant.run(np.full(4, 1.0), 100)
    assert plant.vel_ned_mps[0, 2] < -0.1
