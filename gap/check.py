"""The data check: what a log is worth, before any physics is fitted to it.

It refuses what can't be used, mends what can be mended and says so, finds by how much each topic's stamps are late,
and hands on the flying part on one grid.
"""

from __future__ import annotations

from flightstack.vehicle import Vehicle
from gap.checks.samples import make_samples
from gap.records import Checked, Finding, Flight


def check(flight: Flight, vehicle: Vehicle, *, ground_d_m: float = 0.0) -> Checked:
    """Check one flight against the vehicle file; `ground_d_m` is where the ground lies (down, m)."""
    findings: list[Finding] = []
    samples = make_samples(flight.name, flight.signals, vehicle, ground_d_m)
    if samples is None:
        findings.append(
            Finding("flight", "refused", "no part of the log is a flight; record one with at least 10 s in the air")
        )
    return Checked(flight, samples, tuple(findings), ())
