"""The governor of rate commands against the simulated autopilot and plant, which share no code with its model."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from measured import measured
from shipped import load_vehicle

from flightstack.barrier import torque
from flightstack.barrier.torque import governor_terms
from flightstack.governor import Governor, GovernorLimits
from flightstack.guard import Guard
from flightstack.model import Limits, Model
from flightstack.seams import NoFilter
from flightstack.stack import Stack
from flightstack.types import F64, Command, FlatOutput
from flightstack.vehicle import Vehicle, parse_vehicle, with_effects
from flightstack_sim.autopilot.setpoint import ControlKind, ControlSetpoint
from flightstack_sim.grade import load_grade
from flightstack_sim.simulated_vehicle import simulated_vehicle

QUAD, SIH = load_vehicle("quad-x"), load_vehicle("px4-sihsim-quadx")
NOISE = load_grade("mocap").imu.gyro_noise_radps_rthz
TICK_US = 4000


def terms(which: Vehicle) -> Any:
    return governor_terms(which, Model.from_vehicle(which), Limits(), NOISE)


def test_a_doubt_that_is_kept_is_another_ones_where_any_number_of_the_loop_is(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []
    monkeypatch.setattr(torque, "kept", lambda module, question, search: asked.append(repr(question)) or [1.0, 1.0])
    rotors = replace(QUAD.rotors, position_m=1.25 * QUAD.rotors.position_m)
    effects: tuple[dict[str, dict[str, float]], ...] = (
        {"thrust_curve": {"thrust_model_factor": 0.25}},
        {"motor_lag": {"time_constant_s": 0.05}},
        {"inertia": {"scale_x": 1.1, "scale_y": 1.0, "scale_z": 1.0}},
        {"angular_damping": {"k_x_nms": 0.0, "k_y_nms": 0.0, "k_z_nms": 0.01}},
    )
    others = [with_effects(QUAD, each) for each in effects]
    others += [replace(QUAD, rotors=rotors), replace(QUAD, autopilot={"mc_yawrate_k": 1.5}), QUAD]
    for which in others:
        torque._Loop(which).doubt(0.1)
    torque._Loop(QUAD).doubt(0.125)
    assert len(set(asked)) == len(asked) == len(others) + 1
    torque._Loop(QUAD).doubt(0.125)
    assert asked[-1] == asked[-2]


def flown(believed: Vehicle, truth: Vehicle, commands: list[tuple[F64, float]], limits: GovernorLimits | None) -> F64:
    """(n, 7) each millisecond: true torque (3), the model's (3), greatest difference of a rotor's command."""
    flies = simulated_vehicle(believed, truth, load_grade("mocap"), seed=1)
    flies.plant.pos_ned_m[2] = -500.0
    flies.plant.motor_u[:] = commands[0][1]
    governor, rows = Governor(believed), []
    state = governor.init()
    for tick, (wanted, norm) in enumerate(commands):
        state, sent, rate = governor.step(state, Command(tick * TICK_US, 0.0, norm, wanted), limits)
        p, q, r = (wanted if rate is None else rate).tolist()
        model = Governor.torque(state)[:, 0]
        for _ in range(4):
            flies.advance(ControlSetpoint(ControlKind.RATE, (p, q, r), sent), 1)
            rows.append([*flies.torque, *model, np.abs(flies.motor_command - sent).max()])
    return np.array(rows)


def dither(hz: float, amplitude: float, norm: float = 0.7, seconds: float = 2.0) -> list[tuple[F64, float]]:
    t = np.arange(0.0, seconds, 0.004)
    wave = amplitude * np.sin(2.0 * math.pi * hz * t)
    return [(np.array([x, 0.7 * x, 0.1 * x]), norm) for x in wave]


@pytest.mark.parametrize("which", [QUAD, SIH])
@pytest.mark.parametrize("hz", [1.0, 5.0, 10.8])
def test_the_model_asks_for_the_torque_that_the_simulated_autopilot_asks_for(which: Vehicle, hz: float) -> None:
    rows = flown(which, which, dither(hz, 0.15), None)[400:]
    first = rows[4::4]  # the model's torque is that of the last step before a command is sent
    off = first[:-1, 0:2] - first[1:, 3:5]
    late = rows[3::4][1:, 0:2] - rows[4::4][: len(rows[3::4]) - 1, 3:5]
    assert min(np.abs(off).max(), np.abs(late).max()) < 0.012 + 0.05 * np.abs(rows[:, :2]).max()


@pytest.mark.parametrize("which", [QUAD, SIH])
def test_dithered_rates_saturate_without_the_governor_and_keep_within_its_margin_with_it(which: Vehicle) -> None:
    found = terms(which)
    truth = with_effects(which, {"inertia": {"scale_x": 0.85, "scale_y": 1.2, "scale_z": 1.0}})
    loose, kept = (flown(which, truth, dither(10.8, 1.6), limits)[500:] for limits in (None, found.limits))
    assert loose[:, 6].max() > 0.2
    assert kept[:, 6].max() <= found.margin
    assert np.hypot(kept[:, 0], kept[:, 1]).max() <= found.chi * found.roll_pitch_max + found.noise


def test_a_held_command_stays_within_the_bound_for_as_long_as_it_is_held() -> None:
    found = terms(QUAD)
    step = [(np.array([3.0, -2.0, 0.5]), 0.75)] + [(np.zeros(3), 0.75)] * 3
    governor = Governor(QUAD)
    _, norm, rate = governor.step(governor.init(), Command(0, 0.0, 0.75, step[0][0]), found.limits)
    assert rate is not None
    rows = flown(QUAD, QUAD, [(rate, norm)] * 60, None)  # 240 ms of it
    assert np.hypot(rows[:, 0], rows[:, 1]).max() <= found.chi * found.roll_pitch_max + found.noise


def test_commands_pass_bit_for_bit_where_nothing_is_in_force_and_where_they_are_calm() -> None:
    governor = Governor(QUAD)
    state = governor.init()
    for tick, (rate, _) in enumerate(dither(3.0, 6.0)):
        state, norm, changed = governor.step(state, Command(tick * TICK_US, 0.0, 0.01, rate), None)
        assert (norm, changed) == (0.01, None)
    state = governor.init()
    for tick, (rate, u) in enumerate(dither(1.0, 0.2)):
        state, norm, changed = governor.step(state, Command(tick * TICK_US, 0.0, u, rate), GovernorLimits())
        assert (norm, changed) == (u, None)


def test_thrust_stays_off_both_ends_by_the_margin() -> None:
    governor, limits = Governor(QUAD), GovernorLimits(0.05, 0.02, 0.1)
    for wanted, sent in ((0.0, 0.1), (0.05, 0.1), (0.5, 0.5), (0.9, 0.9), (1.0, 0.9)):
        assert governor.step(governor.init(), Command(0, 0.0, wanted, np.zeros(3)), limits)[1] == sent


def test_what_is_no_number_passes_and_leaves_the_model_alone() -> None:
    governor = Governor(QUAD)
    state = governor.init()
    before = state.memory.copy()
    for rate, norm in ((np.array([math.nan, 0.0, 0.0]), 0.5), (np.zeros(3), math.inf)):
        state, sent, changed = governor.step(state, Command(0, 0.0, norm, rate), GovernorLimits())
        assert changed is None
        assert sent == norm or math.isnan(sent)
    np.testing.assert_array_equal(state.memory, before)


def test_who_shakes_pitch_does_not_take_rolls_torque() -> None:
    """Roll's answer to a step beside pitch dithered at 6 rad/s is no slower than with half of the torque's square."""
    found = terms(QUAD).limits
    governor = Governor(QUAD)

    def roll_after(pitch: float) -> float:
        state = governor.init()
        sent = 0.0
        for tick in range(40):
            wanted = np.array([2.0, pitch * (-1.0) ** (tick // 10), 0.0])
            state, _, rate = governor.step(state, Command(tick * TICK_US, 0.0, 0.75, wanted), found)
            sent = float((wanted if rate is None else rate)[0])
        return sent

    assert roll_after(6.0) > 0.6 * roll_after(0.0) > 0.5


def test_a_pause_and_a_clock_that_goes_back_are_survived() -> None:
    governor = Governor(QUAD)
    state = governor.init()
    for t_us in (0, 4000, 5_000_000, 10, 2**40):
        state, norm, _ = governor.step(state, Command(t_us, 0.0, 0.6, np.full(3, 5.0)), GovernorLimits())
        assert norm == 0.6
        assert np.isfinite(state.memory).all()


class InForce(NoFilter):
    """A filter that changes nothing, under a certificate that counts on the governor."""

    def governed(self, state: object) -> GovernorLimits:
        return GovernorLimits(0.05, 0.02, 0.1)


def test_the_guards_brake_is_governed_too() -> None:
    model, limits = Model.from_vehicle(QUAD), Limits()
    tilt = math.radians(150.0)
    q = np.array([math.cos(0.5 * tilt), math.sin(0.5 * tilt), 0.0, 0.0])
    seen = measured(4000, np.zeros(3), np.zeros(3), q, np.zeros(3), np.zeros(3), np.full(4, np.nan), 0, 0, 0)
    rest = FlatOutput.of(*([np.zeros(3)] * 5))
    brake, name = Guard(model, limits).check(Command(4000, 10.0, 0.6, np.zeros(3)), seen, np.zeros(3), 10.0, 4000)
    assert name == "brake: tilt"
    for governed in (False, True):
        stack = Stack(model, limits, safety_filter=InForce(), governor=Governor(QUAD) if governed else None)
        state, command, record = stack.tick(stack.init(seen), seen, rest, 4000)
        assert record.guard == "brake: tilt"
        assert record.governed is governed
        slower = np.abs(command.rate_frd_radps).max() < 0.5 * np.abs(brake.rate_frd_radps).max()
        assert bool(slower) is governed
        assert state.sent is command


def test_the_limits_leave_the_scenarios_thrust_and_the_ledgers_line() -> None:
    for which in (QUAD, SIH):
        model, found = Model.from_vehicle(which), terms(which)
        assert model.norm_of(1.8 * model.weight_n) <= 1.0 - found.margin + 1e-3
        assert found.lift_mps2 <= 0.12
        assert found.loss_mps2 == 0.0
        assert found.roll_pitch_max >= 0.04


@pytest.mark.parametrize("heading_rad", [0.0, 0.6, math.pi / 4.0, -2.0])
def test_what_is_cut_is_the_most_that_may_be_and_leans_north_and_east_alike(heading_rad: float) -> None:
    """From rest: the change that turns the lean to north and to east is cut at one size, which is the greatest: a
    little less passes as it is, a little more is cut again."""
    governor, limits = Governor(QUAD), GovernorLimits(0.06, 0.03, 0.1)
    sine, cosine = math.sin(heading_rad), math.cos(heading_rad)

    def sent(wanted: F64) -> F64 | None:
        return governor.step(governor.init(), Command(0, 0.0, 0.6, wanted), limits, heading_rad)[2]

    wanted = np.array([3.0, -2.0, 0.0])
    found = sent(wanted)
    assert found is not None

    def lean(rate: F64) -> F64:
        """Roll turns it right, pitch back: rates of the lean to north and to east, by hand."""
        return np.array([rate[1] * cosine + rate[0] * sine, rate[1] * sine - rate[0] * cosine])

    most = np.abs(lean(found)).max()
    assert 0.1 < most < np.abs(lean(wanted)).max()
    np.testing.assert_allclose(lean(found), np.clip(lean(wanted), -most, most), atol=0.02 * most + 0.005)
    assert found[2] == 0.0
    assert sent(0.97 * found) is None
    assert sent(1.03 * found) is not None


def test_ticks_that_are_no_whole_steps_leave_nothing_out_and_count_nothing_twice() -> None:
    """340 ms of one command, in ticks of 4.25 ms and of 4 ms: 340 steps of the model, the same bits."""
    rate, memories = np.array([0.3, -0.2, 0.1]), []
    for tick_us, ticks in ((4250, 80), (4000, 85)):
        governor = Governor(QUAD)
        state = governor.init()
        for tick in range(ticks + 1):
            state, _, _ = governor.step(state, Command(tick * tick_us, 0.0, 0.6, rate), None)
        assert state.t_us == 340_000
        memories.append(state.memory.copy())
    np.testing.assert_array_equal(*memories)


@pytest.mark.parametrize(
    ("wanted", "yaws"), [((3.0, -2.0, 0.0), False), ((0.0, 3.0, 0.0), False), ((0.0, 0.0, 2.0), True)]
)
def test_what_is_cut_takes_all_of_the_torque_that_is_allowed(wanted: tuple[float, float, float], yaws: bool) -> None:
    """The greatest torque of the simulated autopilot in the 240 ms after it, from rest: the limit within 5 %."""
    governor, limits = Governor(QUAD), GovernorLimits(0.06, 0.03, 0.1)
    _, norm, rate = governor.step(governor.init(), Command(0, 0.0, 0.6, np.array(wanted)), limits)
    assert rate is not None
    rows = flown(QUAD, QUAD, [(rate, norm)] * 60, None)
    found, most = (np.abs(rows[:, 2]).max(), 0.03) if yaws else (np.hypot(rows[:, 0], rows[:, 1]).max(), 0.06)
    assert found == pytest.approx(most, rel=0.05)


NIMBLE = """schema = "flightstack.vehicle/1"
name = "nimble"
[body]
mass_kg = 0.18
inertia_kgm2 = [0.00053, 0.00055, 0.0009]
[rotors]
position_m = [[0.076, 0.076, 0.0], [-0.076, -0.076, 0.0], [0.076, -0.076, 0.0], [-0.076, 0.076, 0.0]]
torque_ratio_m = [0.0086, 0.0086, -0.0086, -0.0086]
max_thrust_n = 0.886
max_speed_radps = 1500.0
thrust_model_factor = 0.891
time_constant_s = 0.0052
radius_m = 0.06
"""


def test_a_loop_that_rings_near_full_command_is_kept_away_from_there() -> None:
    """Steady at hover, at 0.93 of full command it is not with 15 % less inertia: rotors swung from 0.5 to 1."""
    which = parse_vehicle(NIMBLE, "nimble.toml")
    found = terms(which)
    truth = with_effects(which, {"inertia": {"scale_x": 0.85, "scale_y": 0.85, "scale_z": 0.85}})
    low, high = found.limits.command_range(0.0)
    for norm in (low, high):
        kept = flown(which, truth, dither(10.8, 1.6, norm, seconds=4.0), found.limits)
        assert kept[500:, 6].max() <= found.margin
    loose = flown(which, truth, dither(10.8, 0.05, 0.93), None)
    assert loose[1500:, 6].max() > 0.3  # what it does up there by itself
