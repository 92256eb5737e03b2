"""What a gap is, what of it is closed, and what is left open: one definition for the file, the sentence and the page.

A figure (rms of one step on held-out data, of force or of turning) holds a gap where it is at least `GAP_FROM` times
its noise floor.  `closed` is the share of (before - floor) that the correction removes, of the worse figure.  What the
corrected model leaves is open where a figure still holds a gap by the same rule:

    nothing named   open wherever there was a gap, whether or not a driver of it was found
    names           open where a driver was found or less than `MOSTLY` is closed

The unexplained fraction is 1 - closed, so that the two never contradict each other.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from flightstack.gap.decisions import GAP_FROM, MOSTLY
from flightstack.gap.records import Figures, Gap, Unexplained

ONE_STEP = ("one_step_mps2", "one_step_radps2")


def gap_of(before: Figures, after: Figures, floor: Figures) -> Gap:
    """The verdict in figures."""
    return Gap(before, after, floor, closed(before, after, floor))


def closed(before: Figures, after: Figures, floor: Figures) -> float | None:
    """(before - after) / (before - floor) of one step: the worse of force and torque; None without a gap in either."""
    shares = [(was - now) / (was - least) for was, now, least in _with_a_gap(before, after, floor)]
    return min(shares, default=None)


def closed_by_channel(gap: Gap) -> dict[str, float]:
    """Shares as `closed`, of force and of turning, where each has a gap."""
    out = {}
    for name, channel in zip(ONE_STEP, ("force", "turning"), strict=True):
        for was, now, least in _with_a_gap(gap.before, gap.after, gap.noise_floor, (name,)):
            out[channel] = (was - now) / (was - least)
    return out


def closed_power(gap: Gap) -> float:
    """Share of the held-out gap's mean square that is closed, of force or torque, the better; 1 without a gap."""
    rows = _with_a_gap(gap.before, gap.after, gap.noise_floor)
    return max(((was**2 - now**2) / (was**2 - least**2) for was, now, least in rows), default=1.0)


def is_open(gap: Gap) -> bool:
    """Whether what the corrected model leaves still holds a gap in force or turning."""
    return any(True for _ in _with_a_gap(gap.after, gap.after, gap.noise_floor))


def unexplained(rest: Unexplained, gap: Gap, *, named: bool) -> Unexplained:
    """What is said to be left: `rest` (its drivers) judged by the held-out figures."""
    if gap.closed is None and not named:
        return Unexplained(False)
    left = 1.0 if gap.closed is None or not named else min(max(1.0 - gap.closed, 0.0), 1.0)
    if gap.closed is None:  # names without a gap by these figures: only a driver can tell
        return rest
    if not named:
        return Unexplained(True, rest.depends_on, left)
    if is_open(gap) and (rest.significant or gap.closed < MOSTLY):
        return Unexplained(True, rest.depends_on, left)
    return Unexplained(False, (), left)


def _with_a_gap(
    tested: Figures, after: Figures, floor: Figures, names: Sequence[str] = ONE_STEP
) -> Iterator[tuple[float, float, float]]:
    """(tested, after, floor) of each one-step figure of `tested` that holds a gap."""
    for name in names:
        was, now, least = getattr(tested, name), getattr(after, name), getattr(floor, name)
        if was is not None and now is not None and least is not None and was >= GAP_FROM * least:
            yield was, now, least
