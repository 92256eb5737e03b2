"""The battery's voltage: its sensor's noise is taken out where it is noise, and a sag is told from a drift."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.gap_cases import make, write
from flightstack.gap.records import Signal
from flightstack.gap.voltage import on_grid, quiet
from flightstack.gap.workflow import analyse
from tests.thorough import thorough

DT_S, STD_V = 0.008, 0.02


def flight(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """(N,) a battery's true voltage in a minute, and the commands (N, 4) that drew on it."""
    rng = np.random.default_rng(seed)
    t_s = np.arange(7500) * DT_S
    command = 0.5 + 0.1 * np.sin(2.0 * np.pi * 1.7 * t_s) + 0.05 * np.sin(2.0 * np.pi * 4.1 * t_s)
    motor = np.repeat(command[:, None], 4, axis=1) + 0.01 * rng.standard_normal((len(t_s), 4))
    volts = 16.6 - 0.02 * t_s - 1.5 * np.mean(motor**3, axis=1)
    return volts, motor


def test_a_sensors_noise_goes_and_the_fall_under_load_stays() -> None:
    true_v, motor = flight()
    noisy = true_v + STD_V * np.random.default_rng(1).standard_normal(len(true_v))
    off = (quiet(noisy, motor, DT_S) - true_v)[200:-200]
    assert float(np.std(off)) < 0.2 * STD_V
    swing = (true_v - np.convolve(true_v, np.ones(250) / 250, "same"))[200:-200]
    assert float(np.std(swing)) > 2.0 * STD_V  # which plain smoothing would have lost


def test_another_load_on_the_battery_is_no_noise() -> None:
    true_v, motor = flight()
    heater = 0.3 * (np.sin(2.0 * np.pi * 2.3 * DT_S * np.arange(len(true_v))) > 0.0)
    measured = true_v - heater + STD_V * np.random.default_rng(1).standard_normal(len(true_v))
    assert quiet(measured, motor, DT_S) is measured


def rare(volts: np.ndarray, every: int, seed: int = 1) -> tuple[Signal, np.ndarray]:
    """Every so many of these rows as a sensor measures them, and the times of all."""
    t_s = DT_S * np.arange(len(volts))
    noise = STD_V * np.random.default_rng(seed).standard_normal(len(volts[::every]))
    return Signal(t_s[::every], volts[::every] + noise, "battery_v"), t_s


@pytest.mark.parametrize("every", [25, 125])
def test_between_rare_samples_the_voltage_falls_with_the_power(every: int) -> None:
    """5 and 1 Hz, as MAVLink sends it: a straight line keeps the noise and is off by all of the fall besides."""
    true_v, motor = flight()
    measured, t_s = rare(true_v, every)
    off = on_grid(measured, t_s, motor, DT_S) - true_v
    assert float(np.std(off)) < 0.4 * STD_V
    assert float(np.std(np.interp(t_s, measured.t_s, measured.value) - true_v)) > 3.0 * STD_V


@pytest.mark.parametrize("kept", [slice(3750, None), slice(0, 3750), [*range(2500), *range(5000, 7500)]])
def test_a_stream_that_is_not_there_all_the_time_is_drawn_on_by_no_parabola(kept: slice | list[int]) -> None:
    true_v, motor = flight()
    t_s = DT_S * np.arange(len(true_v))
    noisy = true_v + STD_V * np.random.default_rng(1).standard_normal(len(true_v))
    part = Signal(t_s[kept][::125], noisy[kept][::125], "battery_v")
    assert np.array_equal(on_grid(part, t_s, motor, DT_S), np.interp(t_s, part.t_s, part.value))


def test_what_goes_its_own_way_between_rare_samples_is_left_as_it_was_measured() -> None:
    true_v, motor = flight()
    heater = 0.3 * (np.sin(2.0 * np.pi * 0.04 * DT_S * np.arange(len(true_v))) > 0.0)
    measured, t_s = rare(true_v - heater, 125)
    assert np.array_equal(on_grid(measured, t_s, motor, DT_S), np.interp(t_s, measured.t_s, measured.value))


@pytest.mark.parametrize("spoilt", ["steps", "nan", "short", "none"])
def test_what_is_not_known_to_be_noise_is_left(spoilt: str) -> None:
    volts, motor = flight()
    if spoilt == "steps":
        volts = np.round(volts)
    elif spoilt == "nan":
        volts[100] = np.nan
    elif spoilt == "short":
        volts, motor = volts[:8], motor[:8]
    else:
        volts = np.zeros_like(volts)
    assert quiet(volts, motor, DT_S) is volts


@pytest.mark.parametrize(
    ("kind", "seed", "named"),
    [
        ("one:battery_sag", 110001, ["battery_sag"]),
        # a curve and a payload beside bend the voltage's way into the drift's
        thorough("outside:fading_thrust", 4620124, []),
        thorough("outside:fading_thrust", 5060905, []),  # by its first third a sag was as good
    ],
)
def test_a_sag_is_named_though_the_voltage_falls_steadily_and_a_fading_thrust_is_not(
    kind: str, seed: int, named: list[str], tmp_path: Path
) -> None:
    case = make(kind, seed)
    log, _, _ = write(case, tmp_path, "case")
    said = analyse([log], case.believed)
    assert [found.name for found in said.found] == named
    if named:
        loss = said.found[0].parameters["thrust_loss_per_v"].estimate
        assert loss == pytest.approx(case.answer.effects["battery_sag"]["thrust_loss_per_v"], rel=0.05)
    else:
        assert "time" in said.unexplained.depends_on
