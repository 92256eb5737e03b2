"""`certify --site`: a flight in a site under the prior's certificate, and the narrower one that it gives.

What is learned: the thrust gain, with its calibrated deviation, which bounds the mass; and the greatest force that the
accelerometer showed beyond the model, from the end of the climb to the command to land, with the estimate's error and
room on top.  Both stay within the prior.  The certificate holds for that load and that wind.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from flightstack.barrier.estimate_bounds import estimate_bounds
from flightstack.cli import files
from flightstack.cli.compiled import FLIGHT, SITE, ensure_compiled
from flightstack.cli.flight import FlyOptions, fly_setup, prepare
from flightstack.cli.protection import governor_for
from flightstack.cli.result import FlightResult
from flightstack.cli.sensors import error_statistics
from flightstack.cli.site import TimedSiteFilter
from flightstack.learning.stored import vehicle_hash
from flightstack.site.certificate import SPEEDS_MPS, as_json
from flightstack.site.stopping import Prior, StoppingCertificate, stopping
from flightstack.types import STANDARD_GRAVITY_MPS2, InputError
from flightstack_sim.grade import load_grade

NAME = "stopping.json"
_K_SIGMA, _SAG = 4.3, 0.02
_ROOM, _LEAST_FORCE_G = 1.5, 0.02


@dataclass(frozen=True, slots=True)
class SiteCertified:
    """What came of it."""

    flight: FlightResult
    certificate: Path | None
    made: StoppingCertificate | None
    learned: dict[str, Any]

    @property
    def passed(self) -> bool:
        """Flown, held and certified."""
        return self.flight.passed and self.certificate is not None

    def failure(self) -> str:
        """Why not, one line."""
        return self.flight.failure() or "nothing was learned of the thrust: fly longer"

    def as_json(self) -> dict[str, Any]:
        """`flightstack.certify-site/1`."""
        made = self.made
        stops = {} if made is None else {f"{v:g} m/s": made.stopping_way_m(v) for v in SPEEDS_MPS}
        return {
            "schema": "flightstack.certify-site/1",
            "certificate": None if self.certificate is None else str(self.certificate),
            "prior": None if made is None else dict(made.prior._asdict()),
            "learned": self.learned,
            "radius_m": None if made is None else made.radius_m,
            "stops_within_m": stops,
            "log": self.flight.log,
            "barrier": self.flight.barrier,
        }


def certify_site(
    options: FlyOptions, *, stop_requested: Callable[[], str], on_progress: Callable[[float, str], None]
) -> SiteCertified:
    """Fly, learn, certify; InputError before anything moves."""
    if options.certificate is not None or not options.learning:
        raise InputError("certify --site learns from the prior on: leave out --certificate and --no-learning")
    ensure_compiled(lambda text: on_progress(0.0, text), FLIGHT, SITE)
    setup = prepare(options)
    timed = setup.flight.protection.filter
    assert isinstance(timed, TimedSiteFilter)
    flight = fly_setup(setup, options, stop_requested=stop_requested, on_progress=on_progress)
    gain, sigma = flight.gp["thrust_gain"], flight.gp["thrust_gain_sigma"]
    learned = {"gain": gain, "gain_sigma": sigma, "force_mps2": timed.force_most_mps2, "flight_s": flight.flight_time_s}
    if not flight.passed or gain is None or sigma is None:
        return SiteCertified(flight, None, None, learned)
    believed, stack, sensors = setup.flight.believed, setup.flight.stack, options.grade(setup.flight.scenario)
    estimate = estimate_bounds(error_statistics(load_grade(sensors)))
    prior = narrowed(gain, sigma, timed.force_most_mps2, max(estimate.acc_mps2))
    governor = governor_for(believed, stack.model, stack.limits, sensors)
    made = stopping(believed, stack.model, stack.limits, estimate, governor, prior)
    assert flight.log is not None
    path = Path(flight.log).parent / NAME
    files.write_text(path, as_json(made, believed.name, vehicle_hash(believed), sensors, learned))
    return SiteCertified(flight, path, made, learned)


def narrowed(gain: float, sigma: float, force_mps2: float, eps_mps2: float) -> Prior:
    """Mass and force that a flight leaves open, within the prior."""
    prior = Prior()
    low, high = (1.0 - _SAG) * (gain - _K_SIGMA * sigma), (1.0 + _SAG) * (gain + _K_SIGMA * sigma)
    least, most = prior.gain
    low, high = min(max(low, least), most), max(min(high, most), least)
    force = max(_ROOM * force_mps2 + eps_mps2, _LEAST_FORCE_G * STANDARD_GRAVITY_MPS2) / STANDARD_GRAVITY_MPS2
    return Prior(1.0 / high, 1.0 / low, min(force, prior.force_g))
