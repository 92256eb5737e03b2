"""`certify --site`: a flight in a site under the prior's certificate, and the narrower one that it gives.

Faster and faster in all directions (`site.faster`), or along a scenario.  What is learned: the thrust gain, with its
calibrated deviation, which bounds the mass; the greatest force that the accelerometer showed beyond the model, from the
end of the climb to the command to land, with the estimate's error and room on top; and up to which speed.  Mass and
force stay within the prior.  The certificate holds for that load, that wind and that speed.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from flightstack.cli import files
from flightstack.cli.certify import EXPLORE_S
from flightstack.cli.compiled import compiled_first
from flightstack.cli.flight import FlyOptions, Setup, fly_setup, prepare
from flightstack.cli.result import FlightResult
from flightstack.cli.site import TimedSiteFilter
from flightstack.cli.site_track import height_to_fly_m
from flightstack.learning.stored import vehicle_hash
from flightstack.mission import Mission
from flightstack.site import faster
from flightstack.site.certificate import SPEEDS_MPS, as_json
from flightstack.site.decide import PASSED
from flightstack.site.stopping import Prior, StoppingCertificate, stopping
from flightstack.trajectory import Polynomial, Trajectory, hover
from flightstack.types import F64, STANDARD_GRAVITY_MPS2, InputError, TickRecord

NAME = "stopping.json"
EXPLORED = "hover"
"""The scenario whose place the exploration takes, and at least its height."""
_EXPLORE_S = 150.0
"""The most that it may take."""
_K_SIGMA, _SAG = 4.3, 0.02
_LEAST_FORCE_G = 0.02
_STILL_MPS, _SETTLE_S = 0.15, 0.3


@dataclass(frozen=True, slots=True)
class SiteCertified:
    """What came of it."""

    flight: FlightResult
    certificate: Path | None
    made: StoppingCertificate | None
    learned: dict[str, Any]
    rounds: list[faster.StarRound] = field(default_factory=list)
    ended: str = ""
    """Why no faster round was flown; empty where a scenario was."""

    @property
    def passed(self) -> bool:
        """Flown, held and certified."""
        return self.flight.passed and self.certificate is not None

    def failure(self) -> str:
        """Why not, one line."""
        felt_g = self.learned["force_mps2"] / STANDARD_GRAVITY_MPS2
        if not self.flight.failure() and felt_g > Prior().force_g:
            return f"{felt_g:.2f} g were felt beyond the model, more than any certificate holds for: less wind or load"
        return self.flight.failure() or "nothing was learned of the thrust: fly longer"

    @property
    def words(self) -> str:
        """What was flown and what holds, a line each."""
        rounds = [f"{each.flown_mps:.2f} m/s ({each.force_mps2:.3f} m/s^2 felt)" for each in self.rounds]
        lines = [f"flown in all directions: {', '.join(rounds)}; {self.ended}"] if rounds else []
        if (made := self.made) is not None:
            prior = made.prior
            speeds = [v for v in SPEEDS_MPS if v <= prior.speed_mps]
            stops = ", ".join(f"{made.stopping_way_m(v):.2f} m from {v:g} m/s" for v in speeds)
            lines.append(
                f"certificate {self.certificate}: mass {prior.mass_low:.3f} to {prior.mass_high:.3f}, "
                f"{prior.force_g:.3f} g, up to {prior.speed_mps:.1f} m/s: {made.radius_m:.2f} m at rest, "
                f"stops within {stops or 'that'}"
            )
        return "\n".join(lines)

    def as_json(self) -> dict[str, Any]:
        """`flightstack.certify-site/1`."""
        made = self.made
        stops = {} if made is None else {f"{v:g} m/s": made.stopping_way_m(v) for v in SPEEDS_MPS}
        rounds = [each._asdict() | {"prior": each.prior and each.prior._asdict()} for each in self.rounds]
        return {
            "schema": "flightstack.certify-site/1",
            "certificate": None if self.certificate is None else str(self.certificate),
            "prior": None if made is None else dict(made.prior._asdict()),
            "learned": self.learned,
            "rounds": rounds,
            "ended": self.ended,
            "radius_m": None if made is None else made.radius_m,
            "stops_within_m": stops,
            "log": self.flight.log,
            "barrier": self.flight.barrier,
        }


class FlownSpeeds:
    """How fast was flown in each direction from the climb's end to the landing, and what was felt; changes no mission.

    In the climb the thrust gain is still being read, and what it is off by shows as a force.
    """

    def __init__(self, timed: TimedSiteFilter) -> None:
        self.reach_mps: F64 = np.zeros(faster.RUNS)
        self.force_mps2 = 0.0
        """The greatest."""
        self.timed = timed

    @property
    def flown_mps(self) -> float:
        """The least over the directions."""
        return float(self.reach_mps.min())

    def step(self, mission: Mission, t_s: float, record: TickRecord) -> Mission:
        """One tick."""
        if mission.track_start_s <= t_s < mission.track_end_s and record.filtered.status >= PASSED:
            vel = record.measurement.vel_ned_mps
            self.force_mps2 = max(self.force_mps2, self.timed.felt_mps2)
            np.maximum(self.reach_mps, faster.DIRECTIONS @ vel[:2], out=self.reach_mps)
        return mission


class FasterPlanner(FlownSpeeds):
    """Star after star, each certified before the next."""

    def __init__(self, certify: _Certify, flat: F64) -> None:
        """`certify` makes a certificate of what is known by now; `flat`: the site."""
        super().__init__(certify.timed)
        self.rounds: list[faster.StarRound] = []
        self.ended = ""
        self._certify, self._flat = certify, flat
        self._middle: F64 | None = None
        self._yaw_rad = self._asked_mps = self._free_s = 0.0
        self._paths: list[Polynomial] = []

    @property
    def told(self) -> tuple[list[faster.StarRound], str]:
        """The rounds, and why there is no further one."""
        return self.rounds, self.ended or "its time was up"

    def step(self, mission: Mission, t_s: float, record: TickRecord) -> Mission:
        """One tick: the next run, once the last is flown and the vehicle at rest."""
        super().step(mission, t_s, record)
        if t_s < max(mission.track_start_s, self._free_s) or self.ended or t_s >= mission.track_end_s:
            return mission
        if float(np.linalg.norm(record.measurement.vel_ned_mps)) > _STILL_MPS:
            return mission
        if self._middle is None:
            reference = mission.reference(t_s)
            self._middle, self._yaw_rad = reference.pos_ned_m.copy(), reference.yaw_rad
            self._next(faster.FIRST_MPS)
        elif not self._paths:
            self._end_round(record)
        if not self._paths:
            return mission.stop(t_s)
        path = self._paths.pop(0)
        self._free_s = t_s + path.duration_s + _SETTLE_S
        return mission.then(t_s, path)

    def _end_round(self, record: TickRecord) -> None:
        flown, made = self.flown_mps, self._learned(record)
        if made is not None:
            self.timed.narrow(made)
        prior = None if made is None else made.prior
        before = self.rounds[-1].flown_mps if self.rounds else 0.0
        self.rounds.append(faster.StarRound(self._asked_mps, flown, self.force_mps2, prior))
        if not faster.is_worth(flown, before):
            self.ended = f"{self._asked_mps:.2f} m/s was asked for, and no more was flown than {flown:.2f}"
            return
        self._next(faster.allowed_mps(flown, self.force_mps2, self.timed.certificate.prior))

    def _learned(self, record: TickRecord) -> StoppingCertificate | None:
        """What is known by now; None: nothing of the thrust, or nothing that the vehicle can hold against."""
        learned = record.learned
        if not math.isfinite(learned.thrust_gain_sigma):
            return None
        try:
            return self._certify.made(self, learned.thrust_gain, learned.thrust_gain_sigma, faster.GROWTH)
        except InputError:
            return None

    def _fits(self, path: Trajectory) -> bool:
        return faster.leads_clear(path, self.timed.certificate, self._flat) and self.timed.passes(path)

    def _next(self, speed_mps: float) -> None:
        assert self._middle is not None
        least = self.flown_mps
        if least > 0.0 and not faster.is_worth(speed_mps, least):
            self.ended = f"what was felt allows {speed_mps:.2f} m/s after {least:.2f}"
            return
        fits, paths = faster.fastest_star(self._middle, self._yaw_rad, speed_mps, self._fits)
        if fits == 0.0 or (least > 0.0 and not faster.is_worth(fits, least)):
            self.ended = f"the site has room for {fits:.2f} m/s in all directions"
            return
        self._asked_mps, self._paths = fits, paths


def certify_site(
    options: FlyOptions, *, explores: bool = False, stop_requested: Callable[[], str],
    on_progress: Callable[[float, str], None],
) -> SiteCertified:  # fmt: skip
    """Fly, learn, certify; InputError before anything moves.  `explores`: not along the scenario, but faster and
    faster."""
    if options.certificate is not None or not options.learning:
        raise InputError("certify --site learns from the prior on: leave out --certificate and --no-learning")
    setup = prepare(options, compiled_first(on_progress, options.site, options.plant))
    certify = _Certify(setup, options)
    planner = FlownSpeeds(certify.timed)
    if explores:
        setup, planner = certify.explored()
    flight = fly_setup(setup, options, planner=planner, stop_requested=stop_requested, on_progress=on_progress)
    gain, sigma = flight.gp["thrust_gain"], flight.gp["thrust_gain_sigma"]
    learned = {
        "gain": gain, "gain_sigma": sigma, "force_mps2": planner.force_mps2,
        "flight_s": flight.flight_time_s, "speed_mps": planner.flown_mps,
    }  # fmt: skip
    told = planner.told if isinstance(planner, FasterPlanner) else ()
    is_known = gain is not None and sigma is not None
    if not (flight.passed and is_known) or planner.force_mps2 > Prior().force_g * STANDARD_GRAVITY_MPS2:
        return SiteCertified(flight, None, None, learned, *told)
    made = certify.made(planner, gain, sigma)
    assert flight.log is not None
    path = Path(flight.log).parent / NAME
    believed, sensors = setup.flight.believed, options.grade(setup.flight.scenario)
    files.write_text(path, as_json(made, believed.name, vehicle_hash(believed), sensors, learned))
    return SiteCertified(flight, path, made, learned, *told)


def prepare_explored(options: FlyOptions) -> tuple[Setup, FasterPlanner]:
    """The flight that goes faster and faster, and what plans it; InputError where it must not be flown."""
    return _Certify(prepare(options), options).explored()


class _Certify:
    """Certificates of one flight's vehicle."""

    def __init__(self, setup: Setup, options: FlyOptions) -> None:
        timed, plan = setup.flight.protection.filter, setup.flight.protection.site
        assert isinstance(timed, TimedSiteFilter)
        assert plan is not None
        self.timed = timed
        self._setup, self._options, self._plan = setup, options, plan

    def made(
        self, flown: FlownSpeeds, gain: float, sigma: float, times: float = faster.EXTRAPOLATED
    ) -> StoppingCertificate:
        """What is left open by a gain, its deviation and what was felt so far, up to so many times the speed."""
        flight, estimate, governor = self._setup.flight, self._plan.estimate, self._plan.certificate.governor
        prior = narrowed(gain, sigma, flown.force_mps2, max(estimate.acc_mps2), flown.flown_mps, times)
        return stopping(flight.believed, flight.stack.model, flight.stack.limits, estimate, governor, prior)

    def explored(self) -> tuple[Setup, FasterPlanner]:
        """The flight that goes faster and faster where the scenario begins, at rest."""
        flight, plan = self._setup.flight, self._plan
        north, east, down = flight.scenario.trajectory.at(0.0).pos_ned_m.tolist()
        middle = north, east, min(down, -height_to_fly_m(plan.site, plan.certificate, plan.estimate))
        still = replace(
            flight.scenario, trajectory=hover(middle), duration_s=self._options.duration_s or _EXPLORE_S, checks=()
        )
        told = replace(flight, scenario=still).with_more({EXPLORE_S: f"{still.duration_s:.12g}"})
        return replace(self._setup, flight=told), FasterPlanner(self, plan.flat)


def narrowed(
    gain: float, sigma: float, force_mps2: float, eps_mps2: float, flown_mps: float,
    times: float = faster.EXTRAPOLATED,
) -> Prior:  # fmt: skip
    """Mass and force that a flight leaves open, within the prior, up to so many times the speed that was flown: what
    was felt grows with its square."""
    prior = Prior()
    low, high = (1.0 - _SAG) * (gain - _K_SIGMA * sigma), (1.0 + _SAG) * (gain + _K_SIGMA * sigma)
    least, most = prior.gain
    low, high = min(max(low, least), most), max(min(high, most), least)
    force = max(times**2 * force_mps2 + eps_mps2, _LEAST_FORCE_G * STANDARD_GRAVITY_MPS2) / STANDARD_GRAVITY_MPS2
    return Prior(1.0 / high, 1.0 / low, min(force, prior.force_g), times * flown_mps)
