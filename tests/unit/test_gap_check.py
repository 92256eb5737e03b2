"""The data check on flights in closed form: whatever is wrong with a log is found, and put right or refused."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from shipped import load_vehicle

from flightstack.gap.check import check
from flightstack.gap.checks.agreement import is_better
from flightstack.gap.checks.offsets import find_offsets
from flightstack.gap.records import Checked, Flight, Samples, Signal
from flightstack.types import F64
from flightstack.vehicle import Vehicle
from flightstack_logs.turn import conjugate, multiply, rotate_inverse
from tests.flown import NOISE, flown, late, with_signal

ENU = np.array([[0.0, np.sqrt(0.5), np.sqrt(0.5), 0.0]])
FLIP = np.array([[0.0, 1.0, 0.0, 0.0]])


@cache
def vehicle() -> Vehicle:
    return load_vehicle("quad-x")


@cache
def flight(drag_ps: float = 0.0) -> Flight:
    return flown(vehicle(), seconds=30.0, seed=3, hz=100.0, drag_ps=drag_ps)


@cache
def right(drag_ps: float = 0.0) -> Checked:
    return check(flight(drag_ps), vehicle())


def usable(checked: Checked) -> Samples:
    assert checked.samples is not None, checked.findings
    return checked.samples


def texts(checked: Checked, level: str) -> str:
    return " | ".join(each.text for each in checked.findings if each.level == level)


def flu(values: F64) -> F64:
    return values * np.array([1.0, -1.0, -1.0])


def enu(values: F64) -> F64:
    return np.stack([values[:, 1], values[:, 0], -values[:, 2]], axis=1)


def test_a_good_log_passes_without_a_warning_and_its_samples_are_the_flight() -> None:
    checked = right()
    samples = usable(checked)
    assert not texts(checked, "warning")
    assert not texts(checked, "refused")
    assert samples.dt_s == pytest.approx(0.01)
    assert samples.valid.mean() > 0.99
    assert samples.derived == ()
    np.testing.assert_allclose(samples.height_m, -samples.pos_ned_m[:, 2])
    np.testing.assert_allclose(np.linalg.norm(samples.q_ned_frd, axis=1), 1.0)
    exact = flown(vehicle(), seconds=30.0, seed=3, hz=100.0, noise=0.0).signals
    rows = np.searchsorted(exact["motor"].t_s, samples.t_s + 1e-6, side="right") - 1
    for name, size in NOISE.items():
        assert np.sqrt(np.mean((getattr(samples, name) - exact[name].value[rows]) ** 2)) < 1.2 * size, name
    np.testing.assert_allclose(samples.motor, exact["motor"].value[rows], atol=1e-9)


def test_noise_is_what_was_put_on() -> None:
    noise = usable(right()).noise
    for name, size in NOISE.items():
        assert noise[name] == pytest.approx(size, rel=0.08), name


def _quaternion(turn: Callable[[F64], F64]) -> Callable[[Flight], Flight]:
    return lambda log: with_signal(log, "q_ned_frd", turn(log.signals["q_ned_frd"].value))


def _scaled(name: str, factor: float) -> Callable[[Flight], Flight]:
    return lambda log: with_signal(log, name, log.signals[name].value * factor)


def _turned(name: str, turn: Callable[[F64], F64]) -> Callable[[Flight], Flight]:
    return lambda log: with_signal(log, name, turn(log.signals[name].value))


def _all_enu_flu(log: Flight) -> Flight:
    """As ROS has it: every vector and the attitude in ENU and FLU."""
    for name, turn in (("pos_ned_m", enu), ("vel_ned_mps", enu), ("rate_frd_radps", flu), ("accel_frd_mps2", flu)):
        log = _turned(name, turn)(log)
    return _quaternion(lambda q: multiply(multiply(ENU, q), FLIP))(log)


def _signs(name: str, *signs: int) -> Callable[[Flight], Flight]:
    return _turned(name, lambda v: v * np.array(signs, dtype=float))


def _about_z(name: str, degrees: float) -> Callable[[Flight], Flight]:
    """As a sensor tells it that was built in turned by so much about z, clockwise from above."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return _turned(name, lambda v: v @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]).T)


def _on_its_side(roll: int, yaw: int, *names: str) -> Callable[[Flight], Flight]:
    """As sensors tell it on a board that was first turned by roll and then by yaw, a quarter turn or none."""
    c, s = np.cos(np.radians([roll, yaw])), np.sin(np.radians([roll, yaw]))
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, c[0], -s[0]], [0.0, s[0], c[0]]])
    about_z = np.array([[c[1], -s[1], 0.0], [s[1], c[1], 0.0], [0.0, 0.0, 1.0]])

    def spoil(log: Flight) -> Flight:
        for name in names or ("rate_frd_radps", "accel_frd_mps2"):
            log = _turned(name, lambda v: v @ (about_z @ about_x))(log)
        return log

    return spoil


def _askew(log: Flight) -> Flight:
    return _about_z("rate_frd_radps", 135)(_about_z("accel_frd_mps2", 135)(log))


def _body_velocity(log: Flight) -> Flight:
    return with_signal(
        log, "vel_ned_mps", rotate_inverse(log.signals["q_ned_frd"].value, log.signals["vel_ned_mps"].value)
    )


def _milliseconds(log: Flight) -> Flight:
    return replace(log, signals={n: Signal(s.t_s * 1e3, s.value, s.source) for n, s in log.signals.items()})


def _microseconds(log: Flight) -> Flight:
    return replace(log, signals={n: Signal(s.t_s * 1e6, s.value, s.source) for n, s in log.signals.items()})


DEFECTS: dict[str, tuple[Callable[[Flight], Flight], str]] = {
    "accelerometer in g": (_scaled("accel_frd_mps2", 1.0 / 9.80665), "accelerometer: was in g"),
    "accelerometer in mg": (_scaled("accel_frd_mps2", 1e3 / 9.80665), "accelerometer: was in mg"),
    "accelerometer in cm/s^2": (_scaled("accel_frd_mps2", 100.0), "accelerometer: was in cm/s^2"),
    "gyro in degrees": (_scaled("rate_frd_radps", 57.29578), "gyro: was in deg/s"),
    "velocity in mm/s": (_scaled("vel_ned_mps", 1e3), "velocity: was in mm/s"),
    "velocity in km/h": (_scaled("vel_ned_mps", 3.6), "velocity: was in km/h"),
    "position in mm": (_scaled("pos_ned_m", 1e3), "position: was in mm"),
    "battery times ten": (_scaled("battery_v", 10.0), "battery: 16"),
    "battery in mV": (_scaled("battery_v", 1e3), "battery: 1.6"),
    "motors in us": (_turned("motor", lambda u: 1000.0 + 1000.0 * u), "motors: were pulse widths"),
    "motors in percent": (_scaled("motor", 100.0), "motors: were in percent"),
    "motors of 16 bits": (_scaled("motor", 65535.0), "motors: were 16-bit numbers"),
    "time in ms": (_milliseconds, "time: was in ms"),
    "time in us": (_microseconds, "time: was in us"),
    "accelerometer z up": (_turned("accel_frd_mps2", flu), "accelerometer: was in FLU"),
    "gyro FLU": (_turned("rate_frd_radps", flu), "gyro: was in FLU"),
    "velocity ENU": (_turned("vel_ned_mps", enu), "velocity: was ENU"),
    "velocity NWU": (_turned("vel_ned_mps", flu), "velocity: was NWU"),
    "velocity up positive": (_turned("vel_ned_mps", lambda v: v * np.array([1, 1, -1])), "velocity: was NEU"),
    "position ENU": (_turned("pos_ned_m", enu), "position: was ENU"),
    "velocity in the body": (_body_velocity, "velocity: was in the body frame (FRD)"),
    "quaternion scalar last": (_quaternion(lambda q: q[:, [1, 2, 3, 0]]), "attitude: was scalar last"),
    "quaternion world to body": (_quaternion(conjugate), "attitude: was world to body"),
    "quaternion both": (
        _quaternion(lambda q: conjugate(q)[:, [1, 2, 3, 0]]),
        "attitude: was scalar last, world to body",
    ),
    "quaternion of FLU": (_quaternion(lambda q: multiply(q, FLIP)), "attitude: was body FLU"),
    "quaternion to ENU": (_quaternion(lambda q: multiply(ENU, q)), "attitude: was world ENU"),
    "gyro's x turned round": (_signs("rate_frd_radps", -1, 1, 1), "gyro: x had the opposite sign"),
    "gyro's z turned round": (_signs("rate_frd_radps", 1, 1, -1), "gyro: z had the opposite sign"),
    "gyro turned round": (_signs("rate_frd_radps", -1, -1, -1), "gyro: was in FLU, x had the opposite sign"),
    "gyro built in to the right": (_about_z("rate_frd_radps", 90), "gyro: was built in turned by 90 degrees"),
    "gyro built in askew": (_about_z("rate_frd_radps", -45), "gyro: was built in turned by -45 degrees"),
    "all ENU and FLU": (_all_enu_flu, "attitude: was body FLU, world ENU"),
}


PUSHED: dict[str, tuple[Callable[[Flight], Flight], str]] = {
    "gravity for force": (_signs("accel_frd_mps2", -1, -1, -1), "accelerometer: x had the opposite sign"),
    "accelerometer built in backwards": (_signs("accel_frd_mps2", -1, -1, 1), "accelerometer: x and y had the opp"),
    "accelerometer built in to the left": (
        _about_z("accel_frd_mps2", -90),
        "accelerometer: was built in turned by -90",
    ),
    "IMU built in askew": (_askew, "accelerometer: was built in turned by 135 degrees"),
    "IMU on its side": (_on_its_side(90, 0), "accelerometer: was built in tipped by 90 degrees about x; turned"),
    "IMU on its other side": (_on_its_side(-90, 180), "gyro: was built in tipped by -90 degrees about x, was built in"),
    "IMU on its nose": (_on_its_side(90, 90), "accelerometer: was built in tipped by"),
    "accelerometer on its side": (_on_its_side(90, 0, "accel_frd_mps2"), "accelerometer: was built in tipped by 90"),
}
"""Of the side that is felt; in a flight without drag there is none."""


@pytest.mark.parametrize("defect", [*DEFECTS, *PUSHED])
def test_a_defect_is_named_and_put_right(defect: str) -> None:
    """Whatever unit or frame is wrong: said once, and the samples are those of the sound log."""
    spoil, said = (DEFECTS | PUSHED)[defect]
    drag_ps = 0.3 if defect in PUSHED else 0.0
    checked = check(spoil(flight(drag_ps)), vehicle())
    samples, sound = usable(checked), usable(right(drag_ps))
    assert said in texts(checked, "warning")
    assert len(samples.t_s) == pytest.approx(len(sound.t_s), abs=3)
    middle = slice(100, 2800)
    for name in (*NOISE, "battery_v", "motor"):
        a, b = getattr(samples, name)[middle], getattr(sound, name)[middle]
        if name == "q_ned_frd":
            a = a * np.sign(np.sum(a * b, axis=1, keepdims=True))
        assert np.sqrt(np.mean((a - b) ** 2)) < 3.0 * NOISE.get(name, 0.01), name


@pytest.mark.parametrize("seed", range(12))
def test_a_gyro_of_another_moment_is_not_taken_for_one_that_lies_otherwise(seed: int) -> None:
    """Stamps beyond what is searched, or another flight's rates: two that have nothing to do with one another agree
    somewhat in one of 28 readings."""
    log = flown(vehicle(), seconds=8.0, seed=seed, hz=100.0)
    other = flown(vehicle(), seconds=8.0, seed=seed + 100, hz=100.0).signals["rate_frd_radps"].value
    checked = check(with_signal(log, "rate_frd_radps", other), vehicle())
    assert "built in" not in texts(checked, "warning")
    assert "opposite sign" not in texts(checked, "warning")


@pytest.mark.parametrize("std_mps", [0.2, 0.3, 0.4, 0.5])
def test_a_noisy_velocity_is_in_no_other_unit(std_mps: float) -> None:
    """Of one that half agrees with what is felt, half is felt: it was said to be in knots."""
    log = flight()
    rng, velocity = np.random.default_rng(0), log.signals["vel_ned_mps"].value
    slow = np.stack(
        [np.convolve(each, np.ones(40) / np.sqrt(40.0), "same") for each in rng.normal(size=(3, len(velocity)))]
    )
    checked = check(with_signal(log, "vel_ned_mps", velocity + std_mps * slow.T), vehicle())
    assert "velocity: was in" not in texts(checked, "warning")


@pytest.mark.parametrize("stuck_mps2", [0.3, 12.0, 25.0])
def test_an_accelerometer_with_dead_and_stuck_axes_does_not_lie_on_its_side(stuck_mps2: float) -> None:
    """x stuck at some 9.8 beside a dead z was turned into what carries the vehicle, and the log was used."""
    felt = flight().signals["accel_frd_mps2"].value.copy()
    felt[:, 0], felt[:, 2] = stuck_mps2, 0.0
    checked = check(with_signal(flight(), "accel_frd_mps2", felt), vehicle())
    assert checked.samples is None
    assert "tipped" not in texts(checked, "warning")


def test_a_refusal_says_what_was_read_otherwise() -> None:
    """A circle's velocity that is late by a quarter of it is another frame's: who is refused has to know."""
    checked = check(late(flight(), "vel_ned_mps", 1.0), vehicle())
    assert checked.samples is None
    assert "was not read as it says: attitude: was body FLU, world ENU" in texts(checked, "refused")


def test_a_handful_of_samples_in_mg_is_no_traceback() -> None:
    """Too few for the checks of motion, enough for a unit."""
    log = _scaled("accel_frd_mps2", 1e3 / 9.80665)(flight())
    signal = log.signals["accel_frd_mps2"]
    few = slice(600, None, max(1, (len(signal.t_s) - 600) // 6))
    sparse = Signal(signal.t_s[few][:7], signal.value[few][:7], signal.source)
    checked = check(replace(log, signals={**log.signals, "accel_frd_mps2": sparse}), vehicle())
    assert "accelerometer: was in mg" in texts(checked, "warning")


def test_a_sound_log_is_left_as_it_is_even_in_hover_or_in_slow_flight() -> None:
    still = flown(vehicle(), seconds=20.0, seed=1)
    signals = dict(still.signals)
    rng = np.random.default_rng(0)
    rows = len(signals["motor"].t_s)
    constant = {"pos_ned_m": (0, 0, -2), "vel_ned_mps": (0, 0, 0), "q_ned_frd": (1, 0, 0, 0)}
    constant |= {"rate_frd_radps": (0, 0, 0), "accel_frd_mps2": (0, 0, -9.80665)}
    for name, value in constant.items():
        noisy = np.array(value) + NOISE[name] * rng.normal(size=(rows, len(value)))
        signals[name] = Signal(signals[name].t_s, noisy, name)
    signals["motor"] = Signal(signals["motor"].t_s, 0.67 + 0.01 * rng.normal(size=(rows, 4)), "motor")
    checked = check(replace(still, signals=signals), vehicle())
    assert usable(checked)
    assert not [each for each in checked.findings if each.name in ("units", "frames", "quaternion", "offset")]


@pytest.mark.parametrize("late_s", [-0.06, 0.004, 0.03, 0.12])
@pytest.mark.parametrize("name", ["rate_frd_radps", "accel_frd_mps2", "vel_ned_mps", "pos_ned_m"])
def test_late_stamps_are_found_within_a_millisecond_and_put_right(name: str, late_s: float) -> None:
    checked = check(late(flight(), name, late_s), vehicle())
    samples = usable(checked)
    found = {each.signal: each for each in checked.offsets}
    assert found[name].offset_s == pytest.approx(late_s, abs=1.5e-3)
    assert found[name].high_s - found[name].low_s < 5e-3
    for other in {"rate_frd_radps", "vel_ned_mps"} - {name}:
        assert abs(found[other].offset_s) < 1e-3
    assert f"{name}: stamps" in texts(checked, "warning")
    sound = usable(right())
    exact = np.stack([np.interp(samples.t_s[200:2800], sound.t_s, column) for column in getattr(sound, name).T], axis=1)
    assert np.sqrt(np.mean((getattr(samples, name)[200:2800] - exact) ** 2)) < 2.0 * NOISE[name] + 2e-3


@pytest.mark.parametrize("late_s", [-0.03, 0.0, 0.035])
def test_without_an_accelerometer_leaning_tells_the_velocitys_stamps(late_s: float) -> None:
    """Rotors push along one axis of the body: a late velocity is no force."""
    log = _without("accel_frd_mps2")(late(late(flight(), "vel_ned_mps", late_s), "pos_ned_m", late_s))
    found = {each.signal: each for each in check(log, vehicle()).offsets}
    for name in ("vel_ned_mps", "pos_ned_m"):
        assert found[name].low_s <= late_s <= found[name].high_s
        assert found[name].high_s - found[name].low_s < 0.01


def test_the_intervals_of_offsets_cover_the_truth_as_often_as_they_say() -> None:
    """12 flights of 30 s with 3 known offsets each: 95 % intervals cover 34 of 36; below 30 in one of 2000 runs."""
    covered = count = 0
    for seed in range(12):
        rng = np.random.default_rng(seed)
        truth = {name: rng.uniform(-0.03, 0.03) for name in ("rate_frd_radps", "accel_frd_mps2", "vel_ned_mps")}
        log = flown(vehicle(), seconds=30.0, seed=seed, hz=100.0)
        for name, by_s in truth.items():
            log = late(log, name, by_s)
        for each in find_offsets(log.signals, (0.1, 29.9)):
            if each.signal in truth:
                assert np.isfinite(each.low_s)
                covered += each.low_s <= truth[each.signal] <= each.high_s
                count += 1
    assert count == 36
    assert covered >= 30


def test_in_a_hover_whose_attitude_is_noisier_than_its_turning_the_gyros_stamps_are_not_told_wrongly() -> None:
    """Least squares on a noisy attitude's rate believed its first guess to 0.2 ms, 24 ms off: a transport delay.

    Twelve flights, turning by 9 mrad/s rms, attitude good to 1 mrad: what 95 % intervals claim, and nothing is put
    right that is not late.
    """
    wrong = 0
    for seed in range(12):
        rng = np.random.default_rng([77, seed])
        t_s = np.arange(0.0, 30.0, 0.005)
        late_s = 0.0 if seed % 2 else 0.015
        wave = [(rng.uniform(0.2, 3.0), rng.uniform(0.0, 6.0), axis) for axis in (0, 1, 2) * 6]
        rate, angle = np.zeros((len(t_s), 3)), np.zeros((len(t_s), 3))
        for hz, phase, axis in wave:
            size = 0.009 * np.sqrt(2.0 / 6.0)
            rate[:, axis] += size * np.cos(2.0 * np.pi * hz * (t_s - late_s) + phase)
            angle[:, axis] += size / (2.0 * np.pi * hz) * np.sin(2.0 * np.pi * hz * t_s + phase)
        q = np.hstack([np.ones((len(t_s), 1)), 0.5 * (angle + 1e-3 * rng.standard_normal(angle.shape))])
        q /= np.linalg.norm(q, axis=1, keepdims=True)
        gyro = rate + 2e-3 * rng.standard_normal(rate.shape)
        signals = {"q_ned_frd": Signal(t_s, q, "q"), "rate_frd_radps": Signal(t_s, gyro, "gyro")}
        (found,) = find_offsets(signals, (0.1, 29.9))
        wrong += bool(np.isfinite(found.low_s)) and not found.low_s <= late_s <= found.high_s
    assert wrong <= 2  # of twelve 95 % intervals more than two miss in one of fifty


def test_an_offset_that_the_motion_can_not_tell_is_unknown_not_zero() -> None:
    """Motors: their lateness is lag and delay. And in hover nothing tells the accelerometer's."""
    found = {each.signal: each for each in right().offsets}
    assert np.isnan(found["motor"].low_s)
    without = {name: each for name, each in flight().signals.items() if name != "q_ned_frd"}
    assert all(np.isnan(each.low_s) for each in find_offsets(without, (0.0, 30.0)))


@pytest.mark.parametrize("order", [(1, 0, 2, 3), (2, 3, 0, 1), (0, 2, 3, 1), (3, 2, 1, 0)])
def test_motors_in_another_order_than_the_files_rotors_are_refused_with_the_order_that_fits(
    order: tuple[int, ...],
) -> None:
    motor = flight().signals["motor"].value
    checked = check(with_signal(flight(), "motor", motor[:, order]), vehicle())
    assert checked.samples is None
    inverse = np.argsort(order)
    assert "another order" in texts(checked, "refused")
    assert f"are the log's motors {', '.join(str(place + 1) for place in inverse)}" in texts(checked, "refused")


def test_another_vehicles_file_is_refused() -> None:
    heavy = replace(vehicle(), rotors=replace(vehicle().rotors, max_thrust_n=60.0))
    checked = check(flight(), heavy)
    assert checked.samples is None
    assert "name the file of this vehicle" in texts(checked, "refused")


def _standing(log: Flight) -> Flight:
    signals = dict(log.signals)
    for name, value in (("motor", 0.05), ("vel_ned_mps", 0.0), ("pos_ned_m", 0.0)):
        signals[name] = Signal(signals[name].t_s, np.zeros_like(signals[name].value) + value, name)
    return replace(log, signals=signals)


def _constant_motors(log: Flight) -> Flight:
    return with_signal(log, "motor", np.full_like(log.signals["motor"].value, 0.6))


def _without(*names: str) -> Callable[[Flight], Flight]:
    return lambda log: replace(log, signals={n: s for n, s in log.signals.items() if n not in names})


def _every(name: str, rows: int) -> Callable[[Flight], Flight]:
    def spoil(log: Flight) -> Flight:
        old = log.signals[name]
        return with_signal(log, name, old.value[::rows], t_s=old.t_s[::rows])

    return spoil


def _short(log: Flight) -> Flight:
    return replace(log, signals={n: Signal(s.t_s[:200], s.value[:200], n) for n, s in log.signals.items()})


def _other_clock(log: Flight) -> Flight:
    return with_signal(log, "vel_ned_mps", t_s=log.signals["vel_ned_mps"].t_s + 1.7e9)


def _jump(log: Flight) -> Flight:
    t_s = log.signals["motor"].t_s
    later = np.where(t_s > 20.0, t_s + 5e6, t_s)
    return replace(log, signals={n: Signal(later, s.value, n) for n, s in log.signals.items()})


def _half_gravity(log: Flight) -> Flight:
    return with_signal(log, "accel_frd_mps2", 0.45 * log.signals["accel_frd_mps2"].value)


REFUSALS: dict[str, tuple[Callable[[Flight], Flight], str]] = {
    "standing": (_standing, "no part of the log is a flight"),
    "motors that never move": (_constant_motors, "motors never move"),
    "no motors": (_without("motor"), "no motor commands"),
    "neither velocity nor acceleration": (
        _without("vel_ned_mps", "pos_ned_m", "accel_frd_mps2"),
        "neither velocity nor",
    ),
    "neither attitude nor IMU": (
        _without("q_ned_frd", "rate_frd_radps", "accel_frd_mps2"),
        "record roll, pitch and yaw",
    ),
    "two seconds": (_short, "s in the air"),
    "another clock": (_other_clock, "different clocks"),
    "a jump": (_jump, "mixes clocks"),
    "motors in rad/s, both ways": (_turned("motor", lambda u: 800.0 * u - 400.0), "no commands 0 to 1"),
    "half of gravity": (_half_gravity, "accelerometer's mean"),
}


@pytest.mark.parametrize("case", REFUSALS)
def test_what_can_not_be_used_is_refused_with_a_reason(case: str) -> None:
    spoil, said = REFUSALS[case]
    checked = check(spoil(flight()), vehicle())
    assert checked.samples is None
    assert said in texts(checked, "refused")


def test_without_motors_the_kinematics_can_still_be_had() -> None:
    samples = usable(check(_without("motor")(flight()), vehicle(), kinematics_only=True))
    assert np.isnan(samples.motor).all()
    assert np.isfinite(samples.accel_frd_mps2).all()


def test_slow_px4_logs_are_told_which_profile_to_record() -> None:
    checked = check(_every("motor", 10)(flight()), vehicle())
    assert "SDLOG_PROFILE 25" in texts(checked, "warning")
    assert "motor" in usable(checked).derived


def test_gaps_are_not_valid_and_are_counted() -> None:
    log = flight()
    keep = (log.signals["vel_ned_mps"].t_s < 10.0) | (log.signals["vel_ned_mps"].t_s > 11.0)
    old = log.signals["vel_ned_mps"]
    checked = check(with_signal(log, "vel_ned_mps", old.value[keep], t_s=old.t_s[keep]), vehicle())
    samples = usable(checked)
    inside = (samples.t_s > 10.02) & (samples.t_s < 10.98)
    assert not samples.valid[inside].any()
    assert samples.valid[~inside].mean() > 0.99
    assert "vel_ned_mps: 1 gaps" in texts(checked, "warning")


def test_rows_that_repeat_a_slower_topic_are_left_out() -> None:
    log = flight()
    old = log.signals["vel_ned_mps"]
    rows = np.arange(len(old.t_s))
    checked = check(with_signal(log, "vel_ned_mps", old.value[rows - rows % 3]), vehicle())
    assert "67 % of its rows only repeat" in texts(checked, "warning")
    assert len(checked.flight.signals["vel_ned_mps"].t_s) == pytest.approx(len(rows) / 3, abs=2)


def test_saturation_and_a_clipped_sensor_are_said() -> None:
    log = flight()
    motor = np.clip(log.signals["motor"].value * 1.35, 0.0, 1.0)
    checked = check(with_signal(log, "motor", motor), vehicle())
    assert "motors are at full command" in texts(checked, "warning")
    rate = log.signals["rate_frd_radps"].value
    limit = 0.7 * np.abs(rate[:, 0]).max()
    checked = check(with_signal(log, "rate_frd_radps", np.clip(rate, -limit, limit)), vehicle())
    assert "sensor is at its limit" in texts(checked, "warning")


def test_what_a_log_lacks_is_derived_and_said() -> None:
    checked = check(_without("accel_frd_mps2", "rate_frd_radps", "pos_ned_m")(flight()), vehicle())
    samples = usable(checked)
    sound = usable(right())
    assert set(samples.derived) == {"pos_ned_m", "rate_frd_radps", "accel_frd_mps2"}
    assert np.isnan(samples.height_m).all()
    smooth = np.ones(13) / 13
    for name, most in (("accel_frd_mps2", 0.35), ("rate_frd_radps", 0.1)):
        difference = getattr(samples, name)[100:2900, :] - getattr(sound, name)[100:2900, :]
        slow = np.stack([np.convolve(column, smooth, "valid") for column in difference.T], axis=1)
        assert np.sqrt(np.mean(slow**2)) < most, name


def test_an_attitude_turned_against_the_gyro_does_not_pass_for_late_stamps() -> None:
    """Five degrees of roll and eight of yaw between them: a sensor effect, and none of the clock."""
    from flightstack_logs.turn import euler_to_quaternion

    turn = euler_to_quaternion(np.radians([[5.0, 0.0, 8.0]]))
    checked = check(_quaternion(lambda q: multiply(q, turn))(flight()), vehicle())
    found = {each.signal: each for each in checked.offsets}
    assert abs(found["rate_frd_radps"].offset_s) < 5e-4
    assert not {"units", "frames", "quaternion"} & {each.name for each in checked.findings}


def test_a_vehicle_that_stands_with_its_motors_running_does_not_fly_yet() -> None:
    """Ten seconds on the ground with half of the weight commanded, then the flight."""
    log = flight()
    signals = {}
    for name, each in log.signals.items():
        before = np.arange(0.0, 10.0, 0.01)
        first = {"motor": np.full(4, 0.5), "q_ned_frd": np.array([1.0, 0.0, 0.0, 0.0])}.get(name)
        stood = np.zeros_like(each.value[: len(before)]) + (0.0 if first is None else first)
        if name == "accel_frd_mps2":
            stood[:, 2] = -9.80665
        if name == "battery_v":
            stood += 16.6
        signals[name] = Signal(np.concatenate([before, each.t_s + 10.0]), np.concatenate([stood, each.value]), name)
    samples = usable(check(replace(log, signals=signals), vehicle()))
    assert samples.t_s[0] == pytest.approx(10.5, abs=0.05)


@pytest.mark.parametrize(("kept", "new", "better"), [(2.45, 2.58, False), (2.45, 2.9, True), (1.2, 2.3, True)])
def test_noise_that_agrees_a_little_better_with_other_noise_is_no_other_convention(
    kept: float, new: float, better: bool
) -> None:
    """2.45 and 2.58 of 3: an iris that spins over its place (its file's frames; read as FLU, ENU and km/h before)."""
    assert is_better(new, kept, 3.0) is better


@pytest.mark.parametrize("offset_m", [-1.5, 30.0])
def test_an_autopilots_heights_count_from_where_it_stood(offset_m: float) -> None:
    """Its frame begins anywhere: at the barometer's first word, or where GPS first said so."""
    log = replace(_stood_before(flight(), 10.0), kind="ulog")
    place = log.signals["pos_ned_m"]
    moved = replace(place, value=place.value + np.array([0.0, 0.0, offset_m]))
    samples = usable(check(replace(log, signals={**log.signals, "pos_ned_m": moved}), vehicle()))
    plain = usable(check(log, vehicle()))
    np.testing.assert_allclose(samples.height_m, plain.height_m, atol=0.05)
    assert samples.valid.sum() == pytest.approx(plain.valid.sum(), rel=0.02)


def test_a_height_below_the_ground_for_most_of_a_flight_is_not_believed() -> None:
    """A barometer that drifts by metres: the vehicle's own detector says that it flies."""
    log = replace(_stood_before(flight(), 10.0), kind="dataflash")
    place = log.signals["pos_ned_m"]
    sunk = place.value + np.where(place.t_s > 10.0, 20.0, 0.0)[:, None] * np.array([0.0, 0.0, 1.0])
    checked = check(replace(log, signals={**log.signals, "pos_ned_m": replace(place, value=sunk)}), vehicle())
    samples = usable(checked)
    assert "at or below the ground in 100 % of its flight" in texts(checked, "warning")
    assert np.isnan(samples.height_m).all()
    assert samples.valid.sum() * samples.dt_s > 25.0


def _stood_before(log: Flight, seconds: float) -> Flight:
    """The flight, for so long before it on the ground with motors at rest, and its own word of both."""
    signals = {}
    for name, each in log.signals.items():
        before = np.arange(0.0, seconds, 0.01)
        first = {"q_ned_frd": np.array([1.0, 0.0, 0.0, 0.0])}.get(name)
        stood = np.zeros_like(each.value[:1].repeat(len(before), axis=0)) + (0.0 if first is None else first)
        if name == "accel_frd_mps2":
            stood[:, 2] = -9.80665
        if name == "battery_v":
            stood += 16.6
        signals[name] = Signal(np.concatenate([before, each.t_s + seconds]), np.concatenate([stood, each.value]), name)
    signals["landed"] = Signal(np.array([0.0, seconds]), np.array([1.0, 0.0]), "landed")
    return replace(log, signals=signals)
