"""A flight in closed form, as the report takes it: a circle flown 5 cm beside its reference, the truth beside that."""

from __future__ import annotations

import numpy as np
from certified import certificate

from flightstack.region import Region as SafeRegion
from flightstack_logs.report.flight import (
    Barrier,
    FlightEvent,
    FlightReport,
    Learning,
    Outcome,
    Phase,
    ReportRegion,
    ReportSamples,
    Timing,
)

HOSTILE = "</script><script>window.onerror('injected')</script><img src=x onerror=alert(1)>"


def circle_flight() -> FlightReport:
    """20 s at 250 Hz, every panel filled."""
    t = np.arange(0.0, 20.0, 0.004)
    wanted = np.stack([np.sin(t), np.cos(t) - 1.0, -1.5 * np.minimum(t / 3.0, 1.0)], axis=1)
    truth = wanted + np.array([0.03, 0.04, 0.0])
    roll = 0.1 * np.sin(t)
    attitude = np.stack([np.cos(roll / 2), np.sin(roll / 2), 0.0 * t, 0.0 * t], axis=1)
    rates = np.stack([0.1 * np.cos(t), 0.2 * np.sin(t), 0.0 * t], axis=1)
    thrust = 12.0 + np.sin(3.0 * t)

    def over_time(values: np.ndarray) -> ReportSamples:
        return ReportSamples(t, values.reshape(len(t), -1))

    return FlightReport(
        Outcome("circle", True, flight_time_s=20.0, rmse_m=0.05, max_m=0.05, tracking_of="truth", lockstep=False),
        phases=(Phase("takeoff", 0.0, 3.0), Phase("track", 3.0, 17.0), Phase("landing", 17.0, 20.0)),
        events=(
            FlightEvent(0.1, "mode", "OFFBOARD"),
            FlightEvent(12.0, "vehicle says", HOSTILE, "warning"),
            FlightEvent(13.0, "learner", "learner: sudden change noticed on z (8.2 sigma)", "warning"),
        ),
        region=ReportRegion("ellipsoid", (0.0, -1.0, -1.5), (1.5, 1.5, 1.5)),
        reference_ned_m=over_time(wanted),
        estimate_ned_m=over_time(truth + 0.005),
        truth_ned_m=over_time(truth),
        estimate_error_ned_m=over_time(np.full((len(t), 3), 0.005)),
        estimate_q_ned_frd=over_time(attitude),
        truth_q_ned_frd=over_time(attitude),
        thrust_command_n=over_time(thrust),
        thrust_feedforward_n=over_time(np.full(len(t), 12.0)),
        thrust_truth_n=over_time(thrust),
        thrust_saturated=over_time((t > 5.0) & (t < 6.0)),
        thrust_limits_n=(1.0, 20.0),
        rate_command_frd_radps=over_time(rates),
        rate_measured_frd_radps=over_time(rates),
        rate_truth_frd_radps=over_time(rates),
        rate_limit_frd_radps=(0.1, 3.0, 3.0),
        motors=over_time(np.repeat(thrust / 24.0, 4)),
        learning=Learning(
            over_time(np.stack([0.1 * np.sin(t), 0.0 * t, 3.9 + 0.1 * np.cos(t)], axis=1)),
            over_time(np.full((len(t), 3), 0.3)),
            over_time(np.minimum(t // 1.0, 3.0)),
            over_time(np.stack([0.0 * t, 0.0 * t, 3.9 + 0.0 * t], axis=1)),
            over_time(np.stack([0.0 * t, 0.0 * t, 3.9 + 0.0 * t], axis=1)),
            over_time(np.full(len(t), 0.714)),
            over_time(np.full(len(t), 0.01)),
            over_time(1.0 - np.exp(-t)),
        ),
        barrier=Barrier(
            over_time(0.6 + 0.3 * np.sin(t)),
            over_time(np.where(t < 4.0, 1.0, np.where((t > 9.0) & (t < 11.0), 3.0, 2.0))),
            over_time((t > 9.0) & (t < 11.0)),
            over_time(0.62 + 0.3 * np.sin(t)),
            over_time(np.stack([2.0 + np.sin(t), 2.0 + np.cos(t), 3.0 + 0.0 * t], axis=1)),
            over_time(np.stack([np.sin(t), np.cos(t), 0.0 * t], axis=1)),
            over_time(np.stack([np.minimum(np.sin(t), 0.5), np.cos(t), 0.0 * t], axis=1)),
            over_time(np.full((len(t), 3), -2.0)),
            over_time(np.full((len(t), 3), 2.0)),
            over_time(np.concatenate([truth, 0.1 * np.cos(truth)], axis=1)),
            SafeRegion("ellipsoid", (0.0, -1.0, -1.5), (1.5, 1.5, 1.5), (1.0, 1.0, 1.0)),
            (certificate(1.2), certificate(1.4, 0.8, version=3)),
        ),
        timing=Timing(250.0, 3.0, 90.0, 5000.0, 1, np.array([3.0, 3.0, 4.0, 90.0, 5000.0])),
        settings=(("seed", "0"),),
    )
