"""A gap analysis in closed form, as its report takes it: a payload, a drag that has a twin, a remainder, a log."""

from __future__ import annotations

import numpy as np

from flightstack.gap.records import (
    REGIMES,
    SIGNALS,
    ChannelResidual,
    Estimate,
    Figures,
    Finding,
    Gap,
    IdentifiedEffect,
    Offset,
    Rejected,
    Unexplained,
)
from flightstack.gap.report import GapReport, LogQuality, RegimeRow, Shown, Step, Trace

HOSTILE = "</script><script>window.onerror('injected')</script><img src=x onerror=alert(1)>"


def gap_result() -> GapReport:
    """Every part of the page filled."""
    t = np.arange(0.0, 40.0, 0.008)
    measured = np.stack([np.sin((k + 1) * 0.4 * t) * (1.0 + k) for k in range(6)], axis=1)
    measured[:, 2] -= 9.8
    rng = np.random.default_rng(0)
    noise = np.array([0.1, 0.1, 0.15, 0.4, 0.4, 0.2])
    after = measured + noise * rng.standard_normal(measured.shape)
    before = after + np.array([0.5, 0.4, 1.6, 0.1, 0.0, 0.0]) * (1.0 + 0.5 * np.sin(0.3 * t))[:, None]
    measured[:200] = np.nan
    was = Figures(1.92, 0.71, 0.62)
    return GapReport(
        sentence="The model lacks a payload (mass_kg 0.216 kg (0.210 to 0.222)) and rotor drag or linear drag.",
        vehicle="quad-x",
        gap=Gap(was, Figures(0.21, 0.62, 0.04), Figures(0.19, 0.6, 0.02), 0.98),
        found=(
            IdentifiedEffect("payload", {"mass_kg": Estimate(0.0, 0.216, 0.21, 0.222)}, -4200.0, 0.91, 0.0),
            IdentifiedEffect(
                "rotor_drag", {"k_d_kg_per_rad": Estimate(0.0, 1.6e-4, 1.4e-4, 1.8e-4)}, -310.0, 0.07, 1e-12,
                ("linear_drag",), "fly excite-yaw-at-speed with turns of 2 g",
            ),
            IdentifiedEffect(
                "rotor_fault", {"rotor": Estimate(2, 2, 2, 2), "effectiveness": Estimate(1.0, 0.9, 0.89, 0.91)},
               -90.0, 0.02, 1e-5),
        ),
        rejected=(Rejected("induced_inflow", 6.1, "no more than its parameters cost"), Rejected("inertia", 3.0)),
        unexplained=Unexplained(True, ("position", "height"), 0.06),
        where=tuple(
            ChannelResidual(signal, 1.9 / (k + 1), "m/s^2" if k < 3 else "rad/s^2", 0.15, "fast_forward", "airspeed")
            for k, signal in enumerate(SIGNALS)
        ),
        steps=(
            Step("", was), Step("payload", Figures(0.42, 0.70, 0.11)), Step("rotor_drag", Figures(0.25, 0.66, 0.05)),
            Step("rotor_fault", Figures(0.21, 0.62, 0.04)),
        ),
        regimes=tuple(
            RegimeRow(regime, 4.0 + k, noise * (1.0 + k), noise * 1.1 if k else noise * np.nan)
            for k, regime in enumerate(REGIMES)
        ),
        shown=(
            Shown("payload", "shown", "known to 0.006 kg"),
            Shown("ground_effect", "hidden", "never below 8 rotor radii", "excite-low-pass"),
            Shown("motor_lag", "weak", "known to 12 ms", "excite-rate-doublets"),
        ),
        traces=(Trace("flight.csv", t, measured, before, after, noise, ((27.0, 40.0),)),),
        logs=(
            LogQuality(
                HOSTILE, "csv", 40.0,
                (Finding("rates", "ok", "125 Hz"), Finding("gaps", "warning", "one of 0.4 s")),
                (Offset("pos_ned_m", 0.021, 0.019, 0.023), Offset("battery_v", np.nan, np.nan, np.nan)),
                ("columns as in the contract",),
            ),
        ),
        checks=(("whiteness", "white to 12 Hz"), ("flown again", "0.11 m from the logged path, was 0.9 m")),
        takes=("mass_kg 1.2 → 1.416 kg",),
        learner=("rotor_drag",),
    )  # fmt: skip
