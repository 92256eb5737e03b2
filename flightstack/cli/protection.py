"""What keeps a flight inside its region: the barrier filter and the certifier that options and scenario ask for.

--no-filter       nothing filters
--as-published    the paper's filter on its h_mu (with --controller state-gp also its learner of the state alone)
--site            the site filter, under the stopping certificate from the prior, whatever the scenario
--certificate     the filter under the certificate of a file, whatever the scenario
otherwise         where the scenario has a region: certified in flight, once enough has been learned; no filter where it
                  has none or where the learner can't certify.  Of an ellipsoid, the paper's experiment up and down, the
                  vertical axis alone, in a region that grows.  The certifier works in a process of its own where it
                  may (`workshop`)
"""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path

from flightstack.barrier.certifier import OnlineCertifier
from flightstack.barrier.certifier_config import CertifierConfig, Elsewhere, Thrust
from flightstack.barrier.estimate_bounds import EstimateBounds, does_not_fit, estimate_bounds
from flightstack.barrier.flown import planned_of
from flightstack.barrier.growing import VERTICAL, GrowingCertifier, vertical_for
from flightstack.barrier.initial import require_authority
from flightstack.barrier.published_certifier import PublishedCertifier
from flightstack.barrier.published_filter import PublishedFilter
from flightstack.barrier.records import Certificate
from flightstack.barrier.torque import GovernorTerms, governor_terms
from flightstack.cli import files
from flightstack.cli.barrier_score import AS_PUBLISHED, GivenCertificate, TimedFilter, WatchedCertifier
from flightstack.cli.checking import read_bounded
from flightstack.cli.given_certificate import certificate_for, require_checked, require_premises, round_trip_max_s
from flightstack.cli.sensors import error_statistics
from flightstack.cli.site import SitePlan, given_prior, load_site, plan_site
from flightstack.cli.workshop import Appointed, Workshop
from flightstack.learning.stored import vehicle_hash
from flightstack.model import Limits, Model
from flightstack.region import Region
from flightstack.safety_filter import BarrierFilter
from flightstack.scenario import Scenario
from flightstack.seams import Certifier, NoCertifier, NoFilter, SafetyFilter
from flightstack.site.certificate import require_same
from flightstack.types import InputError
from flightstack.vehicle import Vehicle
from flightstack_sim.grade import load_grade
from mavlink_bridge.companion import Companion


@dataclass(frozen=True, slots=True, kw_only=True)
class ProtectionOptions:
    """What a flight may be asked for."""

    filtering: bool = True
    as_published: bool = False
    certificate: Path | None = None
    site: Path | None = None
    """Keep the vehicle in the site of this file."""
    unprotected_ok: bool = False
    """Protection that was asked for and not had, or left, does not fail the flight."""

    @property
    def place(self) -> tuple[float, float] | None:
        """Latitude and longitude of the place of arming, where they are known before the flight."""
        return None

    @property
    def in_real_time(self) -> bool:
        """Whether deadlines count: then a certificate, which takes many ticks' time, is made beside the flight."""
        return False

    @property
    def protection_as_written(self) -> bool:
        """As a scenario means it."""
        return self.filtering and not self.as_published and self.certificate is None and self.site is None


@dataclass(frozen=True, slots=True)
class Protection:
    """Filter and certifier of a flight, and the region that it is judged by."""

    words: str
    """What protects the flight, or why nothing does; one line."""
    asked: bool = False
    """Whether protection is wanted: then a flight without it has failed."""
    region: Region | None = None
    """The scenario's, where the flight is judged by it."""
    filter: SafetyFilter = field(default_factory=NoFilter)
    certifier: Certifier = field(default_factory=NoCertifier)
    certificate: str | None = None
    """Text of the certificate that it begins with."""
    certificate_from: str = ""
    """Where that came from."""
    given: Certificate | None = None
    """The same, where there is a filter that keeps to it."""
    workshop: Workshop | Appointed | None = None
    """Where certificates are made, if not in the ticks."""
    estimate: EstimateBounds | None = None
    """How far the estimate may be off for what is certified; None where nothing is."""
    site: SitePlan | None = None
    """The site that the vehicle is kept in."""

    @property
    def round_trip_max_s(self) -> float:
        """Longest round trip of the link with which the flight may begin."""
        most_s = round_trip_max_s(self.given)
        return most_s if self.site is None else min(most_s, SITE_ROUND_TRIP_MAX_S)

    def link_too_slow(self, companion: Companion) -> bool:
        """Whether the flight was refused because its link is slower than the certificate that was given holds for."""
        slow = 1e-6 * companion.view.round_trip_us > self.round_trip_max_s
        return self.given is not None and slow and companion.flight_start_us < 0

    @property
    def unattainable(self) -> str:
        """Why protection that was asked for can't be had, known before anything moves; empty where it may be had."""
        return self.words.removeprefix("off: ") if self.asked and not self.filter.enabled else ""

    def not_taken(self, engaged_ticks: int) -> str:
        """Why a certificate that was given protected nothing; empty where it did, or none was given."""
        if self.given is None or engaged_ticks:
            return ""
        return (
            f"the vehicle was never within region, speeds and leans of the certificate for half a second ({self.words})"
        )

    def beside(self) -> AbstractContextManager[object]:
        """What works beside the flight, to be entered for as long as that lasts."""
        return self.workshop or nullcontext()

    @property
    def watched(self) -> WatchedCertifier | None:
        """The certifier whose certificates are kept; None where there is none."""
        return self.certifier if isinstance(self.certifier, WatchedCertifier) else None


SITE_ROUND_TRIP_MAX_S = 0.04
"""A site without a certificate of its own counts on the vehicle file's delay: with more than this none was flown."""


def protect(
    options: ProtectionOptions, scenario: Scenario, believed: Vehicle, model: Model, learner: str, sensors: str
) -> Protection:
    """Filter and certifier of a flight; InputError, one line, where the options contradict each other or the file.

    `learner` is one of the LEARNERS below, `sensors` a grade.
    """
    if options.as_published and not options.filtering:
        raise InputError("--as-published flies the published filter: leave out --no-filter")
    if options.site is not None:
        return _in_site(options, scenario, believed, model, sensors)
    mode = AS_PUBLISHED if options.as_published else SOUND
    path = options.certificate
    file = None if path is None else files.TextFile(path, read_bounded(path))
    if file is not None and mode == SOUND:  # what is published proves nothing that could be checked
        require_checked(file)
    given = None if file is None else certificate_for(file, mode, believed, model, scenario.limits)
    if file is not None and given is not None and mode == SOUND:
        require_premises(file.path, given, sensors)
    region = scenario.region if given is None else None
    if not options.filtering and given is None:
        return Protection(_NO_FILTER, region=region)
    workshop: Workshop | Appointed | None = None
    if given is not None:
        certifier: Certifier | str = GivenCertificate(given, model)
    elif options.in_real_time and options.as_published and region is not None:
        certifier = "what the paper publishes is certified within a tick, for which real time does not wait"
    else:
        why_not = _not_online(mode, scenario, learner, sensors)
        if not why_not and mode == SOUND:
            workshop = Workshop() if options.in_real_time else Appointed()
        certifier = why_not or _online(mode, scenario, believed, model, sensors, workshop)
    if isinstance(certifier, str):
        return Protection(f"off: {certifier}", asked=region is not None and learner != NONE, region=region)
    stamp = {"vehicle": believed.name, "vehicle_hash": vehicle_hash(believed)}
    watched = WatchedCertifier(certifier, stamp, workshop)
    text, source = ("", "") if file is None else (file.text, str(file.path))
    if not options.filtering:  # the certificate still says by which region the flight is judged
        return Protection(
            _NO_FILTER, region=region, certifier=watched, certificate=text or None, certificate_from=source
        )
    made = PublishedFilter(model, scenario.limits) if options.as_published else BarrierFilter(model, scenario.limits)
    origin = f"certificate {source}" if source else "certified in flight"
    doubt = ", which can't be certified robustly" if options.as_published else ""
    words = f"{mode}{doubt}, {origin}"
    counted = None if options.as_published else estimate_bounds(error_statistics(load_grade(sensors)))
    return Protection(words, True, region, TimedFilter(made), watched, text or None, source, given, workshop, counted)


def _in_site(
    options: ProtectionOptions, scenario: Scenario, believed: Vehicle, model: Model, sensors: str
) -> Protection:
    """Kept in a site: no region counts then."""
    assert options.site is not None
    for name, is_given in (("--no-filter", not options.filtering), ("--as-published", options.as_published)):
        if is_given:
            raise InputError(f"--site is kept by a filter of its own: leave out {name}")
    estimate = estimate_bounds(error_statistics(load_grade(sensors)))
    governor = governor_for(believed, model, scenario.limits, sensors)
    prior, text = given_prior(options.certificate, believed, sensors)
    made = plan_site(load_site(options.site, options.place), scenario, believed, model, estimate, governor, prior)
    if options.certificate is not None:
        require_checked(files.TextFile(options.certificate, text))
        require_same(text, str(options.certificate), made.certificate)
    return Protection(made.words, True, filter=made.filter(model, scenario.limits), site=made)


SOUND = "sound"
_SPARED_H = 0.02
"""Where a path keeps so much h whatever its speed may be off by, few of its commands are changed."""
_THRUSTS = (
    Thrust(most_hovers=1.2, lateral_mps2=2.0), Thrust(most_hovers=1.2, lateral_mps2=2.25), Thrust(),
    Thrust(most_hovers=1.2), Thrust(0.75, 1.3),
)  # fmt: skip
"""No more than 1.2 hovers, or all thrust that there is: for a light vehicle lag and delay of all of it cost more
than it gives, and nothing would ever close.  More to either side bends a path less; where bounds are wide upwards only
less of it closes.  Of 0.75 to 1.3 hovers both ways have as much: with long delays or holds, 0.85 leaves too little
down."""
FULL, STATE_ONLY, NONE = "full", "state-only", "none"
"""What a flight's learner knows: state and thrust, the state alone, nothing that can be certified with."""
_NO_FILTER = "off: --no-filter"


def _not_online(mode: str, scenario: Scenario, learner: str, sensors: str) -> str:
    """Why nothing can be certified in flight; empty where it can."""
    if scenario.region is None:
        return "the scenario has no region, and no --certificate was given"
    if mode == AS_PUBLISHED:
        return ""
    if learner == STATE_ONLY:
        return "a learner of the state alone can't certify (--as-published flies it), and no --certificate was given"
    if learner == NONE:
        return "nothing is certified without the learner, and no --certificate was given"
    axes = VERTICAL.axes if scenario.region.kind == "ellipsoid" else CertifierConfig().axes
    unfit = does_not_fit(estimate_bounds(error_statistics(load_grade(sensors))), scenario.region, axes)
    return f"with {sensors} sensors nothing can be certified: {unfit}" if unfit else ""


def _online(
    mode: str, scenario: Scenario, believed: Vehicle, model: Model, sensors: str, elsewhere: Elsewhere | None
) -> Certifier:
    """What certifies in flight."""
    region, limits = scenario.region, scenario.limits
    assert region is not None
    if mode == AS_PUBLISHED:
        return PublishedCertifier(model, limits, region)
    if scenario.knowledge is not None:
        require_authority(scenario.knowledge, model, limits, f"scenario {scenario.name}: knowledge")
    governor = governor_for(believed, model, limits, sensors)
    estimate = estimate_bounds(error_statistics(load_grade(sensors)))
    if region.kind == "ellipsoid":
        vertical = replace(vertical_for(estimate), sensors=sensors, governor=governor)
        return GrowingCertifier(
            model, limits, region, initial=scenario.knowledge, certifier=vertical, elsewhere=elsewhere
        )
    config = CertifierConfig(
        sensors=sensors, estimate=estimate, governor=governor, spared_h=_SPARED_H,
        planned=planned_of(scenario.trajectory, scenario.duration_s, region), thrusts=_THRUSTS,
    )  # fmt: skip
    return OnlineCertifier(model, limits, region, initial=scenario.knowledge, config=config, elsewhere=elsewhere)


def governor_for(believed: Vehicle, model: Model, limits: Limits, sensors: str) -> GovernorTerms:
    """What bounds torque in a flight with sensors of a grade."""
    return governor_terms(believed, model, limits, load_grade(sensors).imu.gyro_noise_radps_rthz)
