"""Single samples that no flight makes are left out and said; what a flight does make stays.

The oracle is the flight without them: the samples that were spoilt, the noise that was put on.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from shipped import load_vehicle

from benchmarks.gap_cases import as_csv, make
from flightstack.gap.check import check
from flightstack.gap.checks.conventions import settle
from flightstack.gap.checks.quality import settle_motors
from flightstack.gap.checks.spikes import without_spikes
from flightstack.gap.records import Checked, Flight, Samples, Signal
from flightstack.gap.workflow import analyse
from flightstack.types import F64
from flightstack.vehicle import Vehicle
from tests.flown import NOISE, flown, with_signal

ALWAYS = (-np.inf, np.inf)


@cache
def vehicle() -> Vehicle:
    return load_vehicle("quad-x")


@cache
def flight() -> Flight:
    return flown(vehicle(), seconds=30.0, seed=3, hz=100.0)


def usable(checked: Checked) -> Samples:
    assert checked.samples is not None, checked.findings
    return checked.samples


def spikes(checked: Checked) -> list[str]:
    return [each.text for each in checked.findings if each.name == "spikes"]


def spoilt(name: str, size: float, share: float) -> tuple[Flight, NDArray[np.int64]]:
    """One column of a signal off by `size` or half of it in a share of the samples, none of them beside another."""
    value = flight().signals[name].value.copy()
    rng = np.random.default_rng(5)
    at = np.sort(200 + 8 * rng.choice((len(value) - 400) // 8, round(share * len(value)), replace=False))
    value[at, 1] += size * rng.choice([-1.0, -0.5, 0.5, 1.0], len(at))
    return with_signal(flight(), name, value), at


@pytest.mark.parametrize("share", [0.002, 0.02])
@pytest.mark.parametrize(
    ("name", "size"),
    [
        ("accel_frd_mps2", 5.0),
        ("accel_frd_mps2", 500.0),
        ("rate_frd_radps", 2.0),
        ("rate_frd_radps", 1e3),
        ("vel_ned_mps", 3.0),
        ("vel_ned_mps", 1e6),
        ("pos_ned_m", 1.0),
        ("pos_ned_m", 1e6),
        ("q_ned_frd", 0.09),
    ],
)
def test_single_samples_that_no_flight_makes_are_left_out_and_no_others(name: str, size: float, share: float) -> None:
    log, at = spoilt(name, size, share)
    left, findings = without_spikes(log.signals, ALWAYS)
    stamps = flight().signals[name].t_s
    assert np.array_equal(left[name].t_s, np.delete(stamps, at))
    assert [each.text for each in findings] == [
        f"{name}: {len(at)} of {len(stamps)} samples are such as no flight makes; left out"
    ]
    assert all(left[other] is each for other, each in log.signals.items() if other != name)


@pytest.mark.parametrize(("name", "size"), [("accel_frd_mps2", 500.0), ("vel_ned_mps", 1e6), ("rate_frd_radps", 1e3)])
def test_the_data_check_says_so_and_the_rest_is_as_good_as_before(name: str, size: float) -> None:
    checked = check(spoilt(name, size, 0.01)[0], vehicle())
    assert len(spikes(checked)) == 1
    assert usable(checked).noise[name] == pytest.approx(NOISE[name], rel=0.08)
    assert spikes(check(flight(), vehicle())) == []


def _with(shape: F64, size: float) -> Flight:
    """The accelerometer with this shape added to its z axis, ten times over the flight."""
    value = flight().signals["accel_frd_mps2"].value.copy()
    for begin in range(300, 2800, 250):
        value[begin : begin + len(shape), 2] += size * shape
    return with_signal(flight(), "accel_frd_mps2", value)


@pytest.mark.parametrize(
    "shape",
    [
        np.ones(60),
        np.sin(np.linspace(0.0, np.pi, 12)),
        np.linspace(0.0, 1.0, 40),
        np.array([1.0, 0.9, 0.5, -0.2, 0.1]),  # a knock, as a recorded landing has it
        np.exp(-np.arange(20) / 4.0) * np.cos(np.arange(20)),
    ],
    ids=["step", "peak", "ramp", "knock", "ringing"],
)
@pytest.mark.parametrize("size", [3.0, 60.0])
def test_what_a_flight_makes_stays(shape: F64, size: float) -> None:
    assert without_spikes(_with(shape, size).signals, ALWAYS)[1] == []


def test_samples_off_before_take_off_and_after_landing_stay() -> None:
    log, at = spoilt("accel_frd_mps2", 500.0, 0.02)
    stamps = log.signals["accel_frd_mps2"].t_s
    left, _ = without_spikes(log.signals, (float(stamps[1000]), float(stamps[2000])))
    inside = at[(at > 1000) & (at < 2000)]
    assert np.array_equal(left["accel_frd_mps2"].t_s, np.delete(stamps, inside))


def test_a_signal_of_which_every_tenth_sample_is_off_is_like_that() -> None:
    value = flight().signals["accel_frd_mps2"].value.copy()
    value[::10, 0] += 50.0
    assert without_spikes(with_signal(flight(), "accel_frd_mps2", value).signals, ALWAYS)[1] == []


@pytest.mark.parametrize("rarer", [5, 20])
def test_a_rare_gyro_may_show_a_turn_for_one_sample_and_a_rare_position_no_jump(rarer: int) -> None:
    signals = {
        name: Signal(each.t_s[::rarer], each.value[::rarer].copy(), each.source)
        for name, each in flight().signals.items()
    }
    for name in ("rate_frd_radps", "pos_ned_m"):
        signals[name].value[70, 0] += 20.0
    assert [each.text.split(":")[0] for each in without_spikes(signals, ALWAYS)[1]] == ["pos_ned_m"]


def _motor(change: F64) -> tuple[dict[str, Signal], list[str]]:
    motor = flight().signals["motor"]
    out, findings = settle_motors({"motor": Signal(motor.t_s, change, "motor")})
    return out, [each.text for each in findings]


@pytest.mark.parametrize("wrong", [1.5, -0.6, 1e6])
def test_a_few_numbers_that_are_no_commands_do_not_make_the_others_percent(wrong: float) -> None:
    value = flight().signals["motor"].value.copy()
    at = np.arange(100, 2900, 50)
    value[at, 1] = wrong
    out, said = _motor(value)
    assert said == [f"motor: {len(at)} of {len(value)} samples are no commands; left out"]
    assert np.array_equal(out["motor"].value, np.delete(flight().signals["motor"].value, at, axis=0))


def test_a_pulse_width_of_0_is_no_thrust_and_a_flight_in_percent_is_no_row_of_wrong_numbers() -> None:
    command = flight().signals["motor"].value.copy()
    command[:300] = 0.0
    pulses = 1000.0 + 1000.0 * command
    pulses[:300] = 0.0
    out, said = _motor(pulses)
    assert said == ["motors: were pulse widths of 1000 to 2000 us; turned into commands 0 to 1"]
    assert out["motor"].value == pytest.approx(command)
    command[: len(command) - 140] = 0.0  # a flight of 1.4 s in half a minute
    out, said = _motor(100.0 * command)
    assert said == ["motors: were in percent; turned into commands 0 to 1"]
    assert out["motor"].value == pytest.approx(command)


@pytest.mark.parametrize("decimals", [3, 15])
@pytest.mark.parametrize("share", [0.3, 0.75])
@pytest.mark.parametrize("ends", [1.7, 29.0, -12.0])
def test_a_stream_that_ends_early_and_is_drawn_on_straight_is_no_flight_in_percent(
    ends: float, share: float, decimals: int
) -> None:
    """A published log's motors end 11 s before it and go on straight, to 29 times full command: taken for percent, the
    whole was "landed, or motors too weak"."""
    value = flight().signals["motor"].value.copy()
    stops = round(share * len(value))
    value[stops:] = np.linspace(value[stops], ends, len(value) - stops)
    out, said = _motor(value.round(decimals))
    left = len(out["motor"].value)
    assert stops - 3 <= left <= stops + 2
    assert out["motor"].value[: stops - 3] == pytest.approx(
        flight().signals["motor"].value[: stops - 3], abs=10.0**-decimals
    )
    assert said == [
        f"motor: the last {len(value) - left} of {len(value)} samples are one straight line beyond 0 to 1: "
        "the stream ended before them; left out"
    ]


@pytest.mark.parametrize("unit", [1.0, 0.3048])
@pytest.mark.parametrize("factor", [6.2, 6.8, 7.4])
def test_one_axis_that_is_off_makes_no_feet_of_metres(unit: float, factor: float) -> None:
    """Of a published log ahead and to the side agree with what is felt (1.03 and 1.06), the height moves far more: all
    three together say 0.33, which was a foot, and its drag came out three times too great."""
    signals = flight().signals
    stretched = np.array([1.0, 1.0, factor]) / unit
    values = {name: signals[name].value * stretched for name in ("pos_ned_m", "vel_ned_mps")}
    spoiled = {**signals, **{n: Signal(signals[n].t_s, value, n) for n, value in values.items()}}
    t_s = signals["pos_ned_m"].t_s
    out, findings = settle(spoiled, (float(t_s[0]), float(t_s[-1])))
    said = [each.text for each in findings if each.name == "units"]
    feet = ["velocity: was in ft/s; turned into m/s", "position: was in ft; turned into m"]
    assert said == ([] if unit == 1.0 else feet)
    assert out["vel_ned_mps"].value == pytest.approx(unit * values["vel_ned_mps"])


def test_sixty_lost_bits_of_the_accelerometer_change_nothing_of_what_a_flight_says(tmp_path: Path) -> None:
    """A drag of 1.33, 1.71 and 2.04 kg/s is hidden; by its mean of 1.72 g such a log was no flight before."""
    case = make("one:linear_drag", 4_730_000)
    rng = np.random.default_rng(1)
    table = {name: column.copy() for name, column in case.table.items()}
    at = rng.choice(len(table["time_s"]), 60, replace=False)
    for axis in "xyz":
        table[f"accel_{axis}_mps2"][at] += 640.0 * rng.choice([-1.0, 1.0], 60)
    log = tmp_path / "log.csv"
    log.write_text(as_csv(table), encoding="utf-8")
    result = analyse([log], case.believed)
    assert [found.name for found in result.found] == ["linear_drag"]
    for name, estimate in result.found[0].parameters.items():
        assert estimate.low <= case.answer.effects["linear_drag"][name] <= estimate.high
    assert not result.unexplained.significant
    assert [finding.name for finding in result.report.logs[0].findings].count("spikes") == 1
