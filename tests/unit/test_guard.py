"""The guard: whatever comes in, what goes out is finite, within limits and named."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from measured import measured
from scipy.spatial.transform import Rotation
from shipped import load_vehicle

from flightstack.frames import quat_from_euler, quat_to_matrix
from flightstack.guard import OUTSIDE, Guard, carried_thrust, stale
from flightstack.model import Limits, Model
from flightstack.types import Command, Measurement, changed

MODEL = Model.from_vehicle(load_vehicle("quad-x"))
LIMITS = Limits(radius_m=10.0, height_m=8.0)
GUARD = Guard(MODEL, LIMITS)
LOW, HIGH = MODEL.thrust_range_n(LIMITS)
ORIGIN = np.zeros(3)
GOOD = measured(
    t_us=1000, pos_ned_m=np.array([1.0, 1.0, -2.0]), vel_ned_mps=np.zeros(3), q_ned_frd=quat_from_euler(0.1, 0.0, 0.5),
    rate_frd_radps=np.zeros(3), specific_force_frd_mps2=np.zeros(3), motor_command=np.full(4, math.nan),
    position_age_us=4000, attitude_age_us=4000, imu_age_us=4000,
)  # fmt: skip
HOVER = Command(1000, MODEL.weight_n, MODEL.hover_norm, np.array([0.1, -0.2, 0.3]))


def check(command: Command = HOVER, carried_n: float = MODEL.weight_n, **changes: object) -> tuple[Command, str]:
    measurement = changed(GOOD, **changes)  # type: ignore[arg-type]
    return GUARD.check(command, measurement, ORIGIN, carried_n, 1000)


@pytest.mark.parametrize("down_mps", [5e307, -5e307])
@pytest.mark.parametrize("pitch_rad", [0.0, 1.0, 2.0, math.pi])
def test_a_velocity_near_the_greatest_float_gives_no_thrust_that_is_no_number(
    down_mps: float, pitch_rad: float
) -> None:
    out, name = check(vel_ned_mps=np.array([0.0, 0.0, down_mps]), q_ned_frd=quat_from_euler(0.0, pitch_rad, 0.0),
                      pos_ned_m=np.array([20.0, 0.0, -2.0]))  # fmt: skip
    assert name == OUTSIDE
    assert LOW <= out.thrust_n <= HIGH


def test_a_good_command_passes_untouched() -> None:
    command, name = check()
    assert name == ""
    assert command is HOVER


ANY = st.floats(width=64)
ANY3 = arrays(np.float64, 3, elements=ANY)
QUATERNION = st.one_of(
    arrays(np.float64, 4, elements=ANY),
    st.builds(quat_from_euler, st.floats(-4, 4), st.floats(-4, 4), st.floats(-4, 4)),
)
AGES = st.integers(-(10**12), 10**12)


@settings(max_examples=500, deadline=None)
@given(
    st.builds(Command, AGES, ANY, ANY, ANY3),
    st.one_of(
        st.none(),
        st.builds(
            measured, AGES, ANY3, ANY3, QUATERNION, ANY3, ANY3, arrays(np.float64, 4, elements=ANY),
            *[st.one_of(AGES, st.integers(0, 10_000))] * 3,
        ),
    ),
    ANY3,
    ANY,
)  # fmt: skip
def test_nothing_raises_and_the_result_is_finite_and_within_limits(
    command: Command, measurement: Measurement | None, origin: np.ndarray, carried: float
) -> None:
    out, name = GUARD.check(command, measurement, origin, carried, 5)
    assert LOW <= out.thrust_n <= HIGH
    assert 0.0 <= out.thrust_norm <= 1.0
    assert np.isfinite(out.rate_frd_radps).all()
    assert (np.abs(out.rate_frd_radps) <= LIMITS.rate_max_radps).all()
    assert (out is command) == (name == "")


@pytest.mark.parametrize(
    ("age", "limit_us", "stream"),
    [("position_age_us", 34_000, "position"), ("attitude_age_us", 25_000, "attitude"), ("imu_age_us", 22_000, "imu")],
)
def test_a_stream_is_stale_beyond_three_periods_and_the_links_latency(age: str, limit_us: int, stream: str) -> None:
    """Periods of 8, 5 and 4 ms, 10 ms of latency; the limit itself is still fresh."""
    assert stale(changed(GOOD, **{age: limit_us}), LIMITS) == ""
    assert stale(changed(GOOD, **{age: limit_us + 1}), LIMITS) == stream
    assert stale(None, LIMITS) == "attitude"


def test_without_attitude_nothing_turns_and_the_thrust_that_carried_so_far_goes_on() -> None:
    for command, name in (
        GUARD.check(HOVER, None, ORIGIN, 1.4 * MODEL.weight_n, 77),
        check(attitude_age_us=10**6, carried_n=1.4 * MODEL.weight_n),
        check(q_ned_frd=np.zeros(4), carried_n=1.4 * MODEL.weight_n),
        check(rate_frd_radps=np.array([0.0, math.nan, 0.0]), carried_n=1.4 * MODEL.weight_n),
    ):
        assert name == "zero_rates: attitude lost"
        np.testing.assert_array_equal(command.rate_frd_radps, 0.0)
        assert command.thrust_n == pytest.approx(1.4 * MODEL.weight_n)
    assert GUARD.check(HOVER, None, ORIGIN, 10.0, 77)[0].t_us == 77


@pytest.mark.parametrize(
    "changes",
    [{"position_age_us": 10**6}, {"imu_age_us": 10**6}, {"pos_ned_m": np.full(3, np.nan)},
     {"vel_ned_mps": np.array([0.0, np.inf, 0.0])}],
)  # fmt: skip
def test_without_position_it_levels_and_sinks_slowly(changes: dict[str, object]) -> None:
    command, name = check(**changes)
    assert name == "level: position lost"
    assert command.thrust_n == pytest.approx(0.97 * MODEL.weight_n)
    assert command.rate_frd_radps[0] < -0.2, "rolled right by 0.1 rad: it rolls left"
    assert command.rate_frd_radps[1] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({"pos_ned_m": np.array([10.1, 0.0, -2.0])}, "brake: outside the envelope"),
        ({"pos_ned_m": np.array([0.0, 0.0, -8.1])}, "brake: outside the envelope"),
        ({"q_ned_frd": quat_from_euler(math.radians(81.0), 0.0, 0.0)}, "brake: tilt"),
    ],
)
def test_outside_the_envelope_or_tipped_over_it_brakes(changes: dict[str, object], name: str) -> None:
    assert check(**changes)[1] == name


@pytest.mark.parametrize(
    "command",
    [
        HOVER._replace(thrust_n=math.nan),
        HOVER._replace(thrust_norm=math.inf),
        HOVER._replace(rate_frd_radps=np.array([0.0, 0.0, math.nan])),
    ],
)
def test_a_command_that_is_not_finite_is_replaced_by_braking(command: Command) -> None:
    assert check(command)[1] == "brake: command not finite"


def test_commands_beyond_the_limits_are_clipped() -> None:
    wild = Command(1000, 1e3, 1.0, np.array([9.0, -9.0, 0.0]))
    command, name = check(wild)
    assert name == "clip: command beyond its limits"
    assert command.thrust_n == pytest.approx(HIGH)
    assert MODEL.thrust_of(command.thrust_norm) == pytest.approx(HIGH)
    np.testing.assert_array_equal(command.rate_frd_radps, [6.0, -6.0, 0.0])


@pytest.mark.parametrize(("norm", "passes"), [(0.0, True), (1.0, True), (-0.01, False), (1.01, False)])
def test_a_normalised_thrust_beyond_0_to_1_is_made_anew_from_the_newtons(norm: float, passes: bool) -> None:
    asked = Command(1000, MODEL.weight_n, norm, np.zeros(3))
    out, name = GUARD.check(asked, GOOD, ORIGIN, MODEL.weight_n, 1000)
    assert (out is asked) is passes
    assert (name == "") is passes
    assert passes or out.thrust_norm == pytest.approx(MODEL.hover_norm)


@pytest.mark.parametrize("start", [(0.3, -0.2, 1.0), (3.0, 0.1, 0.0), (math.pi, 0.0, 0.0), (0.0, 2.9, -2.0)])
def test_leveling_turns_any_attitude_level(start: tuple[float, float, float]) -> None:
    """SciPy integrates the attitude under the fallback's own rates; also from upside down."""
    attitude = Rotation.from_euler("ZYX", start[::-1])
    for _ in range(600):
        q = attitude.as_quat(scalar_first=True)
        command, _ = check(q_ned_frd=q, position_age_us=10**6)
        attitude = attitude * Rotation.from_rotvec(0.01 * command.rate_frd_radps)
    assert quat_to_matrix(attitude.as_quat(scalar_first=True))[2, 2] > 0.9999


def test_braking_leans_against_the_velocity_and_counters_a_fall() -> None:
    """Moving north at 2 m/s and level: the nose must come up, which slows a vehicle that flies north."""
    level = quat_from_euler(0.0, 0.0, 0.0)
    out = np.array([20.0, 0.0, -2.0])
    command, _ = check(q_ned_frd=level, pos_ned_m=out, vel_ned_mps=np.array([2.0, 0.0, 0.5]))
    assert command.rate_frd_radps[1] > 0.1
    assert command.thrust_n == pytest.approx(MODEL.weight_n), "sinking as fast as it should"
    falling, _ = check(q_ned_frd=level, pos_ned_m=out, vel_ned_mps=np.array([0.0, 0.0, 1.0]))
    assert falling.thrust_n == pytest.approx(MODEL.weight_n + 1.2 * 3.0 * 0.5)


@pytest.mark.parametrize("lost_us", [0, 10**6])
@pytest.mark.parametrize("roll_deg", [81.0, 95.0, 120.0, 150.0, 180.0, -140.0])
def test_tipped_over_its_thrust_does_not_drive_it_to_the_ground(roll_deg: float, lost_us: int) -> None:
    """Falling at 6 m/s, by Newton: beyond 90 degrees it gains no more on a stone than the least thrust that steers
    gives; a real PX4, tipped over 5 m up, met the ground at 7.8 m/s: nine tenths of its thrust, upside down."""
    q = quat_from_euler(math.radians(roll_deg), 0.0, 0.0)
    command, name = check(q_ned_frd=q, vel_ned_mps=np.array([0.0, 0.0, 6.0]), position_age_us=lost_us)
    assert name in ("brake: tilt", "level: position lost")
    upwards_n = command.thrust_n * math.cos(math.radians(roll_deg))
    assert upwards_n >= -LOW
    assert command.thrust_n >= LOW, "it still steers"


def test_the_thrust_that_carries_is_learned_within_a_few_seconds() -> None:
    """Held at 1.4 weights and level, a first-order lag of 1 s: 1 - exp(-3) of the way after 3 s."""
    carried = MODEL.weight_n
    heavy = Command(0, 1.4 * MODEL.weight_n, 0.8, np.zeros(3))
    level = changed(GOOD, q_ned_frd=quat_from_euler(0.0, 0.0, 1.0))
    for _ in range(750):
        carried = carried_thrust(carried, heavy, level, 4000)
    share = (carried / MODEL.weight_n - 1.0) / 0.4
    assert share == pytest.approx(1.0 - math.exp(-3.0), abs=2e-3)
    tilted = changed(GOOD, q_ned_frd=quat_from_euler(math.pi / 3, 0.0, 0.0))
    assert carried_thrust(0.0, heavy, tilted, 1_000_000) == pytest.approx(0.7 * MODEL.weight_n)


@pytest.mark.parametrize("towards_deg", range(0, 360, 45))
def test_the_envelope_is_a_cylinder_about_the_place_of_arming(towards_deg: int) -> None:
    origin = np.array([40.0, -30.0, 5.0])
    away = np.array([math.cos(math.radians(towards_deg)), math.sin(math.radians(towards_deg)), 0.0])
    for distance_m, name in ((LIMITS.radius_m - 0.01, ""), (LIMITS.radius_m + 0.01, "brake: outside the envelope")):
        measurement = changed(GOOD, pos_ned_m=origin + distance_m * away)
        assert GUARD.check(HOVER, measurement, origin, MODEL.weight_n, 1000)[1] == name
    for up_m, name in ((LIMITS.height_m - 0.01, ""), (LIMITS.height_m + 0.01, "brake: outside the envelope")):
        measurement = changed(GOOD, pos_ned_m=origin - np.array([0.0, 0.0, up_m]))
        assert GUARD.check(HOVER, measurement, origin, MODEL.weight_n, 1000)[1] == name


@settings(max_examples=200, deadline=None)
@given(
    st.floats(-0.4, 0.4), st.floats(-0.4, 0.4), st.floats(-3.0, 3.0), st.floats(-8.0, 8.0), st.floats(-8.0, 8.0)
)  # fmt: skip
def test_the_brake_turns_thrust_the_short_way_to_an_acceleration_against_the_velocity(
    roll: float, pitch: float, yaw: float, north_mps: float, east_mps: float
) -> None:
    """At 1 /s of the velocity, 3 m/s^2 at most; the turn is 4 /s of the cross product of both thrust directions."""
    speed = math.hypot(north_mps, east_mps)
    per_s = min(1.0, 3.0 / speed) if speed else 1.0
    wanted = np.array([-per_s * north_mps, -per_s * east_mps, -9.80665])
    q = quat_from_euler(roll, pitch, yaw)
    body = Rotation.from_quat(q, scalar_first=True).inv().apply(wanted / np.linalg.norm(wanted))
    expected = 4.0 * np.cross([0.0, 0.0, -1.0], body)  # about the thrust axis it has no part
    out, name = check(
        Command(1000, math.nan, 0.5, np.zeros(3)), q_ned_frd=q, vel_ned_mps=np.array([north_mps, east_mps, 0.0])
    )
    assert name == "brake: command not finite"
    most = np.array(LIMITS.rate_max_radps)
    assert out.rate_frd_radps == pytest.approx(np.clip(expected, -most, most), abs=1e-9)


def test_a_brake_that_a_filter_made_passes_outside_the_envelope_and_only_that() -> None:
    outside = changed(GOOD, pos_ned_m=np.array([LIMITS.radius_m + 1.0, 0.0, -2.0]))
    turned, name = GUARD.check(HOVER, outside, ORIGIN, MODEL.weight_n, 1000, turned=True)
    assert turned is HOVER
    assert name == "brake: outside the envelope"
    own, name = GUARD.check(HOVER, outside, ORIGIN, MODEL.weight_n, 1000)
    assert own is not HOVER
    assert name == "brake: outside the envelope"
