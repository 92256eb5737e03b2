"""The gap workflow: read -> check -> compare -> locate -> name -> add -> verify -> report, on files of logs.

Every step is a file of this package; here is only their order and what passes between them.  What is not usable is
refused with a reason (`InputError`); what the flights can't show is said, not guessed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from flightstack.gap import gather, pooled
from flightstack.gap.check import check
from flightstack.gap.concluded import OnProgress, Said, concluded, held_out_gap, silent, without_bias
from flightstack.gap.decisions import CLEAR_SHARE, HALF, MOSTLY
from flightstack.gap.drifting import with_changing_gyro
from flightstack.gap.held import far_from_noise
from flightstack.gap.lift import told_by_lift
from flightstack.gap.likeness import same_flight
from flightstack.gap.mean_lift import compared_only, with_mean_lift
from flightstack.gap.name import DRIFTS, Selection
from flightstack.gap.one_heading import on_one_heading, with_one_push
from flightstack.gap.pooled import FitHoldoutSplit
from flightstack.gap.read import flight
from flightstack.gap.records import Checked, Samples
from flightstack.gap.result import GapResult
from flightstack.gap.trim import told_by_trim
from flightstack.gap.verdict import closed_power
from flightstack.types import InputError
from flightstack.vehicle import Vehicle


def analyse(
    logs: Sequence[Path],
    vehicle: Vehicle,
    *,
    vehicle_name: str = "",
    holdout: Sequence[Path] = (),
    columns: Path | str | None = None,
    ground_d_m: float = 0.0,
    kinematics_only: bool = False,
    on_progress: OnProgress = silent,
) -> GapResult:
    """Find what the vehicle's model lacks in these logs; InputError, one line, where they can't be used.

    `holdout` are logs kept for the verdict; without any, the last third of each flight is.  `kinematics_only` allows
    logs without motor commands: then only sensor effects can be named.
    """
    checked, kept = _checked(logs, holdout, vehicle, columns, ground_d_m, kinematics_only, on_progress)
    checked = _each_once(checked, kept)
    flights, held = [_usable(c) for c in checked], [_usable(c) for c in kept]
    of = pooled.split(flights, held)
    if not any(mask.any() for mask in of.fit) or not any(mask.any() for mask in of.holdout):
        raise InputError(f"log {logs[0]}: is too short to learn from and to judge by; record at least 10 s in the air")
    called = vehicle_name or vehicle.name

    def look(against: Vehicle, progress: OnProgress = silent) -> Said:
        return _looked(against, flights, held, of, called, progress)

    naming, of, gap = with_mean_lift(vehicle, look(vehicle, on_progress), look)
    for told in (with_one_push, told_by_lift, told_by_trim):
        naming, of, gap = told(vehicle, (naming, of, gap))
    if naming.unexplained.significant or far_from_noise(gap):
        naming = replace(naming, found=on_one_heading(naming.found, of.flights))
    naming = with_changing_gyro(vehicle, naming, flights)
    on_progress(0.9, "drawing")
    only = compared_only(naming, of.flights)
    report = gather.report(vehicle, naming, without_bias(naming, of), gap, (*checked, *kept), only=only)
    return GapResult(
        tuple(str(path) for path in (*logs, *holdout)),
        called,
        naming.where,
        naming.found,
        gap,
        naming.unexplained,
        naming.rejected,
        naming.vehicle,
        report,
    )


def _looked(
    vehicle: Vehicle,
    flights: Sequence[Samples],
    held: Sequence[Samples],
    of: FitHoldoutSplit,
    called: str,
    on_progress: OnProgress,
) -> Said:
    """What the flights tell against a vehicle, by one split after the other until it closes what is open."""
    naming, of, gap = concluded(vehicle, of, called, on_progress)
    if naming.left_thin and (naming.unexplained.significant or (gap.closed is not None and gap.closed < MOSTLY)):
        naming, of, gap = _with_what_is_thin(vehicle, (naming, of, gap), called)
    if naming.unexplained.significant:
        naming, of, gap = _looked_closely(vehicle, (naming, of, gap), called)
    if not held and naming.unexplained.significant:
        naming, of, gap = _turned_round(vehicle, flights, (naming, of, gap), called)
    if not (held or naming.found) and naming.unexplained.significant:
        for split in (pooled.split_by_power, pooled.split_by_passes):
            if not naming.found:
                naming, of, gap = _split_by_what_is_off(vehicle, split(vehicle, flights), (naming, of, gap), called)
    return naming, of, gap


def _with_what_is_thin(vehicle: Vehicle, said: Said, called: str) -> Said:
    """The verdict with names whose evidence pays for their coefficients only, where that closes half of what is open.

    A load of a twentieth beside a drag that is off has less than a name's evidence in the rows, and without it the drag
    is another along each axis and a fifth of the gap stays.
    """
    try:
        naming, of, gap = concluded(vehicle, said[1], called, margin=0.0)
    except InputError:
        return said
    if len(naming.found) < max(len(said[0].found), 1) or gap.closed is None or _is_drift_again(said[0], naming):
        return said
    before = said[2].closed if said[0].found else 0.0
    return (naming, of, gap) if 1.0 - gap.closed <= HALF * (1.0 - (before or 0.0)) else said


def _looked_closely(vehicle: Vehicle, said: Said, called: str) -> Said:
    """The verdict where what a good model may be off by is looked at, too, if that explains all; else what was said.

    A centre of mass off by two percent of an arm is less than vehicles differ by, and yet all that is missing here.
    Where nothing was named, most of force or of turning is enough.
    """
    try:
        naming, of, gap = concluded(vehicle, said[1], called, closely=True)
    except InputError:
        return said
    if not naming.found or gap.closed is None or _is_drift_again(said[0], naming):
        return said
    whole = gap.closed >= MOSTLY and not naming.unexplained.significant
    return (naming, of, gap) if whole or (not said[0].found and closed_power(gap) >= MOSTLY) else said


def _is_drift_again(before: Selection, now: Selection) -> bool:
    """Whether a battery's sag is named for which a thrust that drifts with time stood better by another split."""
    drifted = any(r.name == "battery_sag" and r.reason == DRIFTS for r in before.rejected)
    return drifted and any(found.name == "battery_sag" for found in now.found)


def _turned_round(vehicle: Vehicle, flights: Sequence[Samples], said: Said, called: str) -> Said:
    """The verdict with the first third of each flight held out, where that explains all; else what was said.

    What acts in the last third only (one low pass before landing) can't be named from the first two.  Learned from, it
    must close the gap there, and must leave nothing open in the first third.  Beside names (which must stay) that is
    tried where most of what they leave open comes late.
    """
    if said[0].found and pooled.split_by_power(said[0].vehicle, flights) is None:
        return said
    of = pooled.split(flights, (), first=True)
    try:
        naming, of, gap = concluded(vehicle, of, called)
    except InputError:
        return said
    before = {each.name for each in said[0].found}
    if not naming.found or naming.unexplained.significant or not before <= {each.name for each in naming.found}:
        return said
    if _is_drift_again(said[0], naming):
        return said
    closed = held_out_gap(vehicle, naming, replace(said[1], flights=of.flights)).closed
    return said if closed is None or closed < MOSTLY else (naming, of, gap)


def _split_by_what_is_off(vehicle: Vehicle, of: FitHoldoutSplit | None, said: Said, called: str) -> Said:
    """The verdict with the last third of what each flight is off by held out, where that closes most; else `said`.

    A flight that hovers for its first two thirds says nothing there of a drag, and in its first third nothing to judge
    one by.  What is then learned must close most of force or turning in the last third of the time as well.
    """
    if of is None:
        return said
    try:
        naming, of, gap = concluded(vehicle, of, called)
    except InputError:
        return said
    if not naming.found or closed_power(gap) < CLEAR_SHARE or _is_drift_again(said[0], naming):
        return said
    before = held_out_gap(vehicle, naming, replace(said[1], flights=of.flights))
    return said if closed_power(before) < CLEAR_SHARE else (naming, of, gap)


def usable_flights(
    logs: Sequence[Path], vehicle: Vehicle, *, columns: Path | str | None = None, ground_d_m: float = 0.0
) -> list[Samples]:
    """The logs read and checked; InputError, one line, for the first that can't be used."""
    checked, _ = _checked(logs, (), vehicle, columns, ground_d_m, False, silent)
    return [_usable(each) for each in checked]


def _checked(
    logs: Sequence[Path],
    holdout: Sequence[Path],
    vehicle: Vehicle,
    columns: Path | str | None,
    ground_d_m: float,
    kinematics_only: bool,
    on_progress: OnProgress,
) -> tuple[list[Checked], list[Checked]]:
    """All logs read and checked; every one must be usable."""
    done: list[Checked] = []
    count = len(logs) + len(holdout)
    for k, path in enumerate((*logs, *holdout)):
        on_progress(0.2 * k / count, f"reading {path.name}")
        read = flight(path, vehicle, columns)
        on_progress(0.2 * (k + 0.5) / count, f"checking {path.name}")
        done.append(check(read, vehicle, ground_d_m=ground_d_m, kinematics_only=kinematics_only))
        _refuse(path, done[-1])
    return done[: len(logs)], done[len(logs) :]


def _refuse(path: Path, checked: Checked) -> None:
    """InputError with the check's own reason where a log can't be used."""
    if checked.samples is None:
        reasons = [finding.text for finding in checked.findings if finding.level == "refused"]
        raise InputError(f"log {path}: {reasons[0] if reasons else 'no part of it can be used'}")


def _each_once(checked: Sequence[Checked], kept: Sequence[Checked]) -> list[Checked]:
    """The flights to learn from, each from the log that says most of it; InputError for one that is to judge, too.

    Twice the same noise passes for twice the evidence.
    """
    once: list[Checked] = []
    for each in sorted(checked, key=lambda c: len(_usable(c).derived)):
        if not any(same_flight(_usable(each), _usable(other)) for other in once):
            once.append(each)
    for each in kept:
        if any(same_flight(_usable(each), _usable(other)) for other in once):
            raise InputError(f"log {each.flight.name}: holds a flight that is learned from; the verdict needs another")
    return [each for each in checked if each in once]


def _usable(checked: Checked) -> Samples:
    assert checked.samples is not None  # `_refuse` saw to it
    return checked.samples
