"""`--site`: the site of a flight, the certificate that keeps the vehicle in it, what is refused, how it is scored."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from flightstack.barrier.estimate_bounds import EstimateBounds
from flightstack.barrier.torque import GovernorTerms
from flightstack.cli import files
from flightstack.cli.barrier_score import TimedFilter
from flightstack.cli.checking import read_bounded
from flightstack.cli.site_track import AS_ASKED, SiteTrack, track_in
from flightstack.learning.stored import vehicle_hash
from flightstack.mission import peak_speed_mps, plan
from flightstack.model import Limits, Model
from flightstack.scenario import Scenario
from flightstack.site import bend as bending
from flightstack.site import decide
from flightstack.site.certificate import prior_of
from flightstack.site.clearance import CHUTE, clear_of, edge_name, packed
from flightstack.site.file import MOST_BYTES, parse_site
from flightstack.site.filter import SiteFilter, SiteState
from flightstack.site.shape import MOST_EDGES, KeepOut, Site
from flightstack.site.stopping import Prior, StoppingCertificate, stopping
from flightstack.trajectory import Trajectory
from flightstack.types import F64, Command, Filtered, FlatOutput, InputError, Learned, Measurement, TickRecord
from flightstack.vehicle import Vehicle

_CHUTE_ROOM_M = 1.0
_ENVELOPE_M = 15.0
_JOINING_S = 0.1
_DRAWN_EDGES = 24
"""The most corners of which the upright edges are drawn."""


class TimedSiteFilter(TimedFilter):
    """The site filter, timed, and what it did at the last tick."""

    def __init__(self, site_filter: SiteFilter) -> None:
        super().__init__(site_filter)
        self._of_site = site_filter
        self.numbers: F64 = np.zeros(decide.MEMORY)
        self.bent: F64 = np.zeros(bending.SIZE)
        self.reference: FlatOutput | None = None
        """As it was followed at the last tick."""
        self._state: SiteState | None = None

    def bend(self, state: object, setpoint: FlatOutput) -> FlatOutput:
        """The filter's own, kept."""
        self.reference = super().bend(state, setpoint)
        return self.reference

    def step(
        self, state: object, measurement: Measurement, command: Command, sent: Command, learned: Learned
    ) -> tuple[object, Command, Filtered]:
        """The filter's own, kept."""
        after = super().step(state, measurement, command, sent, learned)
        assert isinstance(after[0], SiteState)
        self._state, self.numbers, self.bent = after[0], after[0].numbers, after[0].bent
        return after

    @property
    def chute_m(self) -> float:
        """Radius of the chutes."""
        return self._of_site.chute_m

    @property
    def chute_room_m(self) -> float:
        """How far from its middle a vehicle at rest still is within its chute."""
        return self._of_site.chute_room_m

    @property
    def felt_mps2(self) -> float:
        """The force that the accelerometer shows beyond the model."""
        return float(np.linalg.norm(self.numbers[decide.FORCE : decide.FORCE + 3]))

    @property
    def certificate(self) -> StoppingCertificate:
        """What is in force, unless it was falsified."""
        return self._of_site.certificate

    def narrow(self, certificate: StoppingCertificate) -> None:
        """The filter's own; what falsified the one before it is in this one."""
        self._of_site.narrow(certificate)
        self.numbers[decide.BEYOND_S] = 0.0

    def passes(self, path: Trajectory) -> bool:
        """The filter's own."""
        return self._of_site.passes(path)

    def replace(self, state: SiteState, site: Site, measurement: Measurement) -> str:
        """The filter's own."""
        return self._of_site.replace(state, site, measurement)

    def way_ned_m(self) -> F64:
        """(n, 3) the way to a stop that the filter has committed itself to; none before the first."""
        count = int(self.numbers[decide.COMMITTED])
        if self._state is None or count == 0:
            return np.zeros((0, 3))
        return np.asarray(self._state.committed[:count:2, :3] + self._state.origin_ned_m)


@dataclass(slots=True)
class SiteScore:
    """What became of a site in a flight, tick by tick from take-off to the command to land."""

    site: Site
    packed: F64
    filter: TimedSiteFilter
    exits: int = 0
    outside_first: str = ""
    ticks: int = 0
    changed: int = 0
    governed: int = 0
    kept: int = 0
    broken: int = 0
    bent: list[dict[str, Any]] = field(default_factory=list)
    is_narrow: bool = False
    """The certificate is narrower than the prior, and may be falsified."""
    track: SiteTrack = AS_ASKED
    """How the whole flight is flown otherwise than asked for."""
    _last_s: float = 0.0
    clearance_m: float = math.inf
    """Of the vehicle at the last tick."""
    _bending: bool = False
    _disc: F64 = field(default_factory=lambda: np.zeros((1, 5)))

    def add(self, flight_s: float, record: TickRecord) -> None:
        """One tick of the stack."""
        if not record.filtered.status >= decide.PASSED:
            return
        numbers = self.filter.numbers
        self.ticks += 1
        self._last_s = flight_s
        kept = bool(numbers[decide.KEPT] > 0.0)
        self.changed += record.filtered.intervened == 1.0
        self.governed += record.governed
        self.kept += kept
        falsified = bool(numbers[decide.BEYOND_S] >= decide.BROKEN_S)
        self.broken += (kept and bool(numbers[decide.OFF] > 0.0)) or (falsified and self.is_narrow)
        bent = self.filter.bent[bending.BENT] > 0.0
        if bent and self._bending:
            self.bent[-1]["to_s"] = flight_s
        elif bent:
            edge = edge_name(self.site, int(self.filter.bent[bending.EDGE]))
            self.bent.append({"from_s": flight_s, "to_s": flight_s, "edge": edge})
        self._bending = bent

    def place(self, flight_s: float, record: TickRecord, place_ned_m: Sequence[float]) -> None:
        """Where the vehicle was at a tick, relative to its start, (3,): the truth where there is one."""
        if not record.filtered.status >= decide.PASSED:
            return
        if self.filter.numbers[decide.LEFT] > 0.0:
            self.packed[CHUTE] = -1.0
        self._disc[0, :3] = place_ned_m[0], place_ned_m[1], -place_ned_m[2]
        clearance, edge = clear_of(self.packed, self._disc, 1, 1.0)
        self.clearance_m = clearance
        if clearance < 0.0:
            if not self.exits:
                self.outside_first = f"{edge_name(self.site, edge)} {flight_s:.2f} s after take-off"
            self.exits += 1

    @property
    def stopped_share(self) -> float:
        """Of the ticks: those in which the way out was followed."""
        return self.kept / self.ticks if self.ticks else 0.0

    def summary(self) -> dict[str, Any]:
        """What the JSON's `barrier` gains."""
        share = 1.0 / self.ticks if self.ticks else 0.0
        whole = [{"from_s": 0.0, "to_s": self._last_s, **bent} for bent in self.track.bent]
        return {
            "site": self.site.source,
            "exits": self.exits,
            "changed_share": self.changed * share,
            "governor_share": self.governed * share,
            "stopped_share": self.stopped_share,
            "premises_broken": self.broken,
            "bent": [*whole, *self.bent],
        }


@dataclass(frozen=True, slots=True, eq=False)
class SitePlan:
    """A site, ready to be flown in: the certificate and where the floor does not bind."""

    site: Site
    certificate: StoppingCertificate
    chutes: F64
    chute_m: float
    estimate: EstimateBounds
    """How far the vehicle's estimate may be off."""
    prior: StoppingCertificate | None = None
    """What is kept to once the certificate was falsified; None: the certificate is the prior's."""
    track: SiteTrack = AS_ASKED
    """How the scenario is flown otherwise than asked for."""

    def filter(self, model: Model, limits: Limits) -> TimedSiteFilter:
        """The filter."""
        return TimedSiteFilter(
            SiteFilter(model, limits, self.certificate, self.site, self.chutes, self.chute_m, self.prior)
        )

    @property
    def flat(self) -> F64:
        """The site, packed."""
        return packed(self.site, self.chutes, self.chute_m)

    def score(self, timed: TimedSiteFilter) -> SiteScore:
        """A score; without a margin, but for the ground under the chutes."""
        return SiteScore(self.site, self.flat, timed, is_narrow=self.prior is not None, track=self.track)

    @property
    def outlines(self) -> str:
        """JSON of what is drawn of it: lines of (north, east) in metres; the first is the one to stay in."""
        lines = [self.site.inside]
        lines += [_ring(each) if each.polygon is None else each.polygon for each in self.site.keep_outs]
        return json.dumps({"lines": [np.round(line, 3).tolist() for line in lines]})

    @property
    def lines_ned_m(self) -> tuple[F64, ...]:
        """Lines (n, 3) from the place of arming that draw it: below, above and at the corners of each part."""
        site, parts = self.site, [(self.site.inside, self.site.floor_m, self.site.ceiling_m)]
        for each in site.keep_outs:
            ball = each.height_m - each.radius_m, each.height_m + each.radius_m
            low, high = (each.floor_m, each.ceiling_m) if math.isnan(each.height_m) else ball
            low, high = max(low, site.floor_m), min(high, site.ceiling_m)
            parts.append((_ring(each) if each.polygon is None else each.polygon, low, high))
        return tuple(line for outline, low, high in parts for line in _prism(outline, low, high))

    @property
    def words(self) -> str:
        """One line."""
        made, prior = self.certificate, self.certificate.prior
        return (
            f"site {self.site.source}, stopping certificate (mass {prior.mass_low:g} to "
            f"{prior.mass_high:g}, {prior.force_g:g} g): {made.radius_m:.2f} m at rest, "
            f"{made.stopping_way_m(3.0):.1f} m from 3 m/s{self.track.words}"
        )


def _prism(outline: F64, low_m: float, high_m: float) -> list[F64]:
    """Rings below and above and, where they are few, the edges between."""
    ring = np.vstack([outline, outline[:1]])
    rings = [np.column_stack([ring, np.full(len(ring), -height)]) for height in (low_m, high_m)]
    return rings if len(outline) > _DRAWN_EDGES else [*rings, *np.stack([end[:-1] for end in rings], axis=1)]


def _ring(each: KeepOut) -> F64:
    """(n, 2) a circle's outline."""
    angle = np.linspace(0.0, 2.0 * math.pi, 36, endpoint=False)
    ring: F64 = np.array(each.centre) + each.radius_m * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return ring


def read_site(path: Path) -> Site:
    """The site of a file; InputError, one line."""
    try:
        if path.stat().st_size > MOST_BYTES:
            raise InputError(
                f"{path}: {path.stat().st_size} bytes hold more than {MOST_EDGES} edges, the most that are taken"
            )
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}") from None
    return parse_site(files.read_text(path).text, str(path))


def load_site(path: Path, place: tuple[float, float] | None) -> Site:
    """The site of a file in metres round a place (latitude, longitude; None: not known); InputError, one line."""
    site = read_site(path)
    if not site.is_global:
        return site
    if place is None:
        raise InputError(f"{path}: the site is on the globe, and where the vehicle is on it is not known (no GPS?)")
    return site.local(*place)


def envelope(limits: Limits, site: Site) -> Limits:
    """The limits of a flight whose site is larger than its envelope."""
    reach = float(np.hypot(*site.inside.T).max()) + _ENVELOPE_M
    return replace(
        limits, radius_m=max(limits.radius_m, reach), height_m=max(limits.height_m, site.ceiling_m + _ENVELOPE_M)
    )


def given_prior(path: Path | None, believed: Vehicle, sensors: str) -> tuple[Prior | None, str]:
    """What a certificate's file says of mass and force, and its text; the prior's where no file was given."""
    if path is None:
        return None, ""
    text = read_bounded(path)
    return prior_of(text, str(path), vehicle_hash(believed), sensors), text


def plan_site(
    site: Site,
    scenario: Scenario | None,
    believed: Vehicle,
    model: Model,
    estimate: EstimateBounds,
    governor: GovernorTerms,
    prior: Prior | None = None,
) -> SitePlan:
    """The certificate for a site in local metres; InputError where start, landing or the way between lie outside.

    `scenario` None: what is flown is not known, and only the start is looked at.
    """
    limits = Limits() if scenario is None else scenario.limits
    certificate = stopping(believed, model, limits, estimate, governor, prior)
    wider = None if prior is None else _wider(certificate, estimate, believed, model, limits)
    kept, half = certificate.kept_m, certificate.half_m
    chute_m = kept + max(_CHUTE_ROOM_M, 2.0 * kept) if site.chute_m is None else site.chute_m
    if chute_m < kept:
        raise InputError(
            f"{site.source}: chute.radius_m = {chute_m:g} is less than the {kept:.2f} m that the vehicle needs at rest"
        )
    room = site.ceiling_m - site.floor_m - 2.0 * half
    if not room > 0.0:
        raise InputError(
            f"{site.source}: {site.ceiling_m - site.floor_m:.2f} m between floor and ceiling; the vehicle at rest is "
            f"known to within {half:.2f} m up and down"
        )
    if scenario is None:
        start = np.zeros((1, 2))
        _require_clear(site, packed(site, start, chute_m), np.zeros(3), (kept, 0.0), "the start")
        return SitePlan(site, certificate, start, chute_m, estimate, wider)
    track = track_in(site, scenario, certificate, estimate)
    fastest_mps = peak_speed_mps(track.of(scenario))
    if fastest_mps > certificate.prior.speed_mps:
        raise InputError(
            f"scenario {scenario.name}: flown at up to {fastest_mps:.1f} m/s, and the certificate holds up to "
            f"{certificate.prior.speed_mps:.1f} m/s: fly it slower, or certify where there is room to be faster"
        )
    mission = plan(track.of(scenario), np.zeros(3))
    landing = mission.reference(mission.track_end_s + 60.0).pos_ned_m
    chutes = np.array([[0.0, 0.0], landing[:2]])
    flat = packed(site, chutes, chute_m)
    joining = np.arange(0.0, mission.track_start_s + _JOINING_S, _JOINING_S)
    _require_clear(site, flat, np.zeros(3), (kept, 0.0), "the start")
    for t_s in joining.tolist():
        place = mission.reference(t_s).pos_ned_m
        _require_clear(site, flat, place, (kept, half), f"the way to the track, {t_s:.1f} s after take-off,")
    _require_clear(site, flat, landing, (kept, half), "the landing place")
    return SitePlan(site, certificate, chutes, chute_m, estimate, wider, track)


def _wider(
    made: StoppingCertificate, estimate: EstimateBounds, believed: Vehicle, model: Model, limits: Limits
) -> StoppingCertificate:
    """The prior's certificate, to be kept to once a narrower one is falsified; itself where thrust can't hold that."""
    try:
        return stopping(believed, model, limits, estimate, made.governor)
    except InputError:
        return made


def _require_clear(site: Site, flat: F64, place: F64, size: tuple[float, float], what: str) -> None:
    north, east, height = float(place[0]), float(place[1]), -float(place[2])
    clearance, edge = clear_of(flat, np.array([[north, east, height, *size]]), 1, 1.0)
    if clearance < 0.0:
        where = f"{north:.2f} m north, {east:.2f} m east, {height:.2f} m up"
        raise InputError(
            f"{site.source}: {what} ({where}) lies outside the site or nearer than {size[0]:.2f} m (height "
            f"{size[1]:.2f} m) to its {edge_name(site, edge)}: that much the vehicle needs at rest"
        )


__all__ = ["SitePlan", "SiteScore", "TimedSiteFilter", "envelope", "load_site", "plan_site"]
