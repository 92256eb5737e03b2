"""How a scenario's track is flown in a site: higher where the vehicle could not stop above the floor, slower where it
turns faster than the vehicle could stop from, the run-up as well.  It is worked out before take-off and told."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from flightstack.barrier.estimate_bounds import EstimateBounds
from flightstack.mission import RUN_UPS_S, run_up_of
from flightstack.rows import JERK_E, JERK_N
from flightstack.scenario import Scenario
from flightstack.site import backup, slide
from flightstack.site.shape import Site
from flightstack.site.stopping import StoppingCertificate
from flightstack.trajectory import Trajectory

_EVERY_S = 0.1
_ACROSS_M = 0.5
"""A track that strays no farther from its start stays in the chute."""
_NOISE_MPS2 = 2.0
"""How hard a controller pushes down for what the estimate is off by, at most (measured with px4-sih-ekf)."""
_FASTER = 1.05
"""So much faster than a path is flown it still has to have its ways out: who follows it turns at times by more than it
does.  Without, px4-sihsim-quadx of 0.7 kg swings 4.9 m off where it just has them; 1.1 is no better."""
_SHARES = tuple(0.95**k for k in range(1, 28))
"""Of the speed asked for, tried from the fastest; a quarter at least."""


@dataclass(frozen=True, slots=True)
class SiteTrack:
    """What a site changes of a track, all along it."""

    raised_m: float = 0.0
    """By so much higher than asked for it is flown: it lies lower than the vehicle can stop above the floor."""
    speed_share: float = 1.0
    """Of the speed asked for: faster, there would be no way to a stop, whatever the site, from some of its points."""
    run_up_s: float = 0.0
    """So long its run-up takes at least; a shorter one would turn too fast in the same way."""
    too_fast: float = 0.0
    """The share of its points from which there is none, though it was slowed as far as that goes."""

    def of(self, scenario: Scenario) -> Scenario:
        """The scenario as it is flown."""
        if self.speed_share < 1.0:
            scenario = scenario.slowed(self.speed_share)
        scenario = replace(scenario, run_up_s=self.run_up_s)
        if not self.raised_m:
            return scenario
        climb_to_m = None if scenario.climb_to_m is None else scenario.climb_to_m + self.raised_m
        trajectory = scenario.trajectory.moved(np.array([0.0, 0.0, -self.raised_m]))
        return replace(scenario, trajectory=trajectory, climb_to_m=climb_to_m)

    @property
    def words(self) -> str:
        """What is to be told of it; empty where nothing is changed."""
        said = f", flown {self.raised_m:.2f} m higher to stop above the floor" if self.raised_m else ""
        if self.speed_share < 1.0:
            said += f", flown at {100.0 * self.speed_share:.0f} % of its speed, from which the vehicle can stop"
        if self.run_up_s:
            said += f", its run-up in no less than {self.run_up_s:.1f} s"
        if self.too_fast:
            said += f"; {100.0 * self.too_fast:.0f} % of the track turn too fast for it to stop from: fly it slower"
        return said

    @property
    def bent(self) -> list[dict[str, Any]]:
        """The rows of the JSON's `bent`, without their times."""
        rows: list[dict[str, Any]] = [{"edge": "floor", "raised_m": self.raised_m}] if self.raised_m else []
        return rows + ([{"edge": "speed", "speed_share": self.speed_share}] if self.speed_share < 1.0 else [])


AS_ASKED = SiteTrack()


def track_in(site: Site, scenario: Scenario, certificate: StoppingCertificate, estimate: EstimateBounds) -> SiteTrack:
    """How a track is to be flown in a site by a vehicle of that certificate, its estimate off by up to `estimate`."""
    raised_m = _raised_m(scenario, site, _low_m(certificate, estimate.vel_mps[2]))
    too_fast = _too_fast(scenario.trajectory, scenario.duration_s, certificate)
    if not too_fast:
        return _run_up(SiteTrack(raised_m), scenario, certificate)
    slow = (k for k in _SHARES if not _too_fast(scenario.trajectory.slowed(k), scenario.duration_s / k, certificate))
    share = next(slow, None)
    slowed = SiteTrack(raised_m, too_fast=too_fast) if share is None else SiteTrack(raised_m, share)
    return _run_up(slowed, scenario, certificate)


def _run_up(track: SiteTrack, scenario: Scenario, certificate: StoppingCertificate) -> SiteTrack:
    """The same with the shortest run-up that nowhere turns too fast; as it is where there is none."""
    for least_s in (0.0, *sorted(RUN_UPS_S)):
        slower = replace(track, run_up_s=least_s)
        path, is_comfortable = run_up_of(slower.of(scenario))
        if path is None or (is_comfortable and not _too_fast(path, path.duration_s, certificate)):
            return slower
    return track


def height_to_fly_m(site: Site, certificate: StoppingCertificate, estimate: EstimateBounds) -> float:
    """The lowest height at which nothing that a controller asks for is slid along the floor; half way up to the ceiling
    where that is lower."""
    low_m = site.floor_m + _low_m(certificate, estimate.vel_mps[2])
    return float(min(low_m, 0.5 * (site.floor_m + site.ceiling_m)))


def _low_m(certificate: StoppingCertificate, vel_mps: float) -> float:
    """How far above the floor nothing that a controller asks for is slid along it, where the estimate's vertical
    velocity is off by `vel_mps`: the bound of `slide` for a push down."""
    s = certificate.soft[certificate.row_of(1.0)]
    lag_s = s[slide.SLOW_S] + vel_mps / s[slide.UP]
    slid_m = (lag_s * _NOISE_MPS2 - vel_mps) / s[slide.GAMMA]
    return float(s[slide.HALF] + s[slide.SLOW_S] * vel_mps + 0.5 * vel_mps**2 / s[slide.UP] + max(slid_m, 0.0))


def _too_fast(path: Trajectory, duration_s: float, certificate: StoppingCertificate) -> float:
    """The share of a path's points from which no way comes to rest in time and within the vehicle's lean, were it flown
    by so much faster as a vehicle that follows it may turn."""
    path, duration_s = path.slowed(_FASTER), duration_s / _FASTER
    row, half = certificate.rows[certificate.row_of(1.0)], certificate.halves()[1]
    points, way = np.zeros((backup.STEPS, backup.ROW)), np.zeros((backup.STEPS, 5))
    start, times_s, missing = np.zeros(backup.ROW), np.arange(0.0, duration_s, _EVERY_S), 0
    for t_s in times_s.tolist():
        start[: backup.ASKED_N] = path.at(t_s).row[: backup.ASKED_N]
        start[backup.ASKED_N : backup.SNAP_N] = start[JERK_N : JERK_E + 1]
        missing += backup.roll(start, row, half, points, way) == 0
    return missing / len(times_s)


def _raised_m(scenario: Scenario, site: Site, room_m: float) -> float:
    """By how much higher a track is to be flown so that it begins above the chute and keeps as far from the ceiling; in
    the middle where there is no room for both.

    In the chute the floor does not bind: a track that never left it would be flown with nothing kept clear below.
    """
    times_s = np.arange(0.0, scenario.duration_s, _EVERY_S)
    track = np.stack([scenario.trajectory.at(t_s).pos_ned_m for t_s in times_s.tolist()])
    if np.hypot(track[:, 0], track[:, 1]).max() <= _ACROSS_M:
        return 0.0
    above_m, below_m = site.floor_m + room_m + track[0, 2], site.ceiling_m - room_m + track[:, 2].min()
    return float(max(above_m if above_m <= below_m else 0.5 * (above_m + below_m), 0.0))
