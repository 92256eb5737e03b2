"""A certificate that was given for a flight: whether it may be flown with.

It must parse, be made for this vehicle, mode and no more thrust and tilt than the flight allows, and pass the
independent checker (`flightstack.certificate_check`), which shares nothing with what made it.
"""

from __future__ import annotations

from pathlib import Path

from flightstack.barrier.file import parse_certificate
from flightstack.barrier.records import Certificate
from flightstack.cli import files
from flightstack.cli.barrier_score import AS_PUBLISHED
from flightstack.cli.checking import check_text
from flightstack.learning.stored import vehicle_hash
from flightstack.model import Limits, Model
from flightstack.types import InputError
from flightstack.vehicle import Vehicle
from mavlink_bridge.decide import ROUND_TRIP_MAX_S

COMMAND_INTERVAL_S = 0.004
"""Of every loop that flies."""


def require_checked(file: files.TextFile) -> None:
    """InputError, one line, where the independent checker refuses the text or comes to no verdict."""
    verdict = check_text(file.text, str(file.path))
    if not verdict.valid:
        raise InputError(
            f"{file.path}: the independent checker refuses it: {verdict.lines[-1]}; certify anew: `flightstack certify`"
        )


def require_premises(path: Path, certificate: Certificate, sensors: str) -> None:
    """InputError, one line, where this flight is known not to keep a premise: grade of sensors, rate of commands.

    The others are watched in flight; the link is measured before take-off (`round_trip_max_s`).
    """
    premises = certificate.premises
    if premises is None:
        raise InputError(f"{path}: names no premises, so that nobody can say for which flight it holds; certify anew")
    if premises.sensors != sensors:
        raise InputError(
            f"{path}: holds with {premises.sensors} sensors, this flight has {sensors}: another --sensors, or certify "
            f"with these: `flightstack certify --sensors {sensors}`"
        )
    if premises.command_interval_s < COMMAND_INTERVAL_S - 1e-9:
        raise InputError(
            f"{path}: holds for a command every {1e3 * premises.command_interval_s:.3g} ms, this loop gives one every "
            f"{1e3 * COMMAND_INTERVAL_S:.3g} ms; certify with this one"
        )


def round_trip_max_s(certificate: Certificate | None) -> float:
    """Longest round trip with which a certificate can hold.

    Samples count as new when they arrive, so all that the link takes, there and back, is between a command and what is
    seen of it (`mavlink_bridge.command_way`); the answer itself is heard a tick later at most.
    """
    premises = None if certificate is None else certificate.premises
    if premises is None:
        return ROUND_TRIP_MAX_S
    return min(ROUND_TRIP_MAX_S, premises.delay_s[1] + premises.jitter_s + COMMAND_INTERVAL_S)


def certificate_for(file: files.TextFile, mode: str, believed: Vehicle, model: Model, limits: Limits) -> Certificate:
    """The certificate of a file, made for this vehicle, this mode and no more thrust than the flight allows."""
    certificate = parse_certificate(file.text, str(file.path))
    if certificate.mode != mode:
        need = "with" if certificate.mode == AS_PUBLISHED else "without"
        raise InputError(f"{file.path}: a certificate of mode {certificate.mode}: fly it {need} --as-published")
    if certificate.knowledge.get("vehicle_hash") != vehicle_hash(believed):
        name = certificate.knowledge.get("vehicle")
        of = f"for vehicle {name!r} with" if name else "for"
        raise InputError(
            f"{file.path}: made {of} another vehicle file than {believed.name!r}; "
            "name the one that it was made for with --vehicle, or certify this one: `flightstack certify`"
        )
    terms = certificate.governor
    if terms is not None and (differs := terms.differs_from(believed, model)):
        raise InputError(f"{file.path}: {differs}; certify with this autopilot: `flightstack certify`")
    budget, greatest_mps2 = certificate.budget, model.thrust_range_n(limits)[1] / model.mass_kg
    if budget.thrust_max_mps2 > greatest_mps2 * (1.0 + 1e-9):
        raise InputError(
            f"{file.path}: counts on {budget.thrust_max_mps2:.2f} m/s^2 of thrust, this flight allows "
            f"{greatest_mps2:.2f}; raise the scenario's limits.thrust_max_weights"
        )
    if budget.tilt_max_rad > limits.tilt_max_rad + 1e-9:
        raise InputError(
            f"{file.path}: counts on {budget.tilt_max_rad:.2f} rad of tilt, this flight allows "
            f"{limits.tilt_max_rad:.2f}; raise the scenario's limits.tilt_max_rad"
        )
    return certificate
