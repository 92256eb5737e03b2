"""Whether the topics of a ULog went by one clock that never went back, told by the order of its messages.

PX4 writes a message milliseconds after it was stamped, so stamps go on in the file as they do in time.  Where the
stamps of most topics go back, the clock itself did; where those of one topic leave the others', that topic's did.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flightstack.types import F64, I64, Mask

_SLOWEST_US = 0.25e6
"""Usual time between two messages of a topic that tells the time."""
_LEAST_ROWS = 20
_LEAST_TOPICS = 5
_SIMILAR = 3.0
"""Of the fastest topic's period, up to which others tell as well when a clock jumped."""
_MOST_PLACES = 20_000
_BACK_US = 20e3
"""By which a clock must go back: what each topic said last never does."""
_OFF_US = 0.2e6
"""By which a topic's stamps may leave the others', beside three of its own periods: loggers write late at load."""
_ENDED = 3.0
"""Usual distances in the file after which a topic without a further message has ended."""
_SAME_JUMP = 50
"""Places within which two steps back are one jump: topics see it one after the other."""
_MOST_BACK = 50.0
"""Usual steps that a topic with a clock of its own may go back by."""
_MOST_US = 3e15
"""A century: no clock since 1970 has a later stamp."""
_APART_US = 1e6
"""Put between what was stamped before a clock went back and what came after: nobody knows how long that took."""


@dataclass(frozen=True, slots=True)
class Stamped:
    """One topic: where its messages lie in the file (N,), ascending, and their stamps (N,), us."""

    name: str
    place: I64
    t_us: F64


@dataclass(frozen=True, slots=True)
class Restamped:
    """By how much each message's time must move (N,), us, and whether its stamp can be believed (N,)."""

    added_us: F64
    keep: Mask


def on_one_clock(stamped: Sequence[Stamped]) -> tuple[list[Restamped], list[str]]:
    """What must be done to the stamps of each topic, and in words what was wrong; nothing where nothing was."""
    sane = [each.t_us < _MOST_US for each in stamped]
    topics = [Stamped(each.name, each.place[ok], each.t_us[ok]) for each, ok in zip(stamped, sane, strict=True)]
    fast = [each for each in topics if _is_fast(each.t_us)]
    place, clock = _clock(_fastest(fast)) if fast else (np.zeros(0, np.int64), np.zeros(0))
    out = []
    for each in topics:
        if len(place) < _LEAST_ROWS:
            out.append(Restamped(np.zeros(len(each.t_us)), _until_back(each.t_us)))
            continue
        near = _near(each, place, clock)
        added = _added(clock)[near]
        out.append(Restamped(added, _believed(each.t_us + added, clock[near] + added, each.place >= place[0])))
    out = [_among(done, ok) for done, ok in zip(out, sane, strict=True)]
    off = {each.name: int(np.sum(~done.keep)) for each, done in zip(topics, out, strict=True) if not np.all(done.keep)}
    return out, [*_says_back(clock), *_says_off(off)]


def _among(done: Restamped, sane: Mask) -> Restamped:
    """The same for all messages of a topic, of which those that are not sane are not believed."""
    added, keep = np.zeros(len(sane)), np.zeros(len(sane), np.bool_)
    added[sane], keep[sane] = done.added_us, done.keep
    return Restamped(added, keep)


def _usual_us(t_us: F64) -> float:
    """Nine in ten messages come no later than this after the one before: some topics come in bursts."""
    return float(np.percentile(np.abs(np.diff(t_us)), 90.0))


def _is_fast(t_us: F64) -> bool:
    return len(t_us) >= _LEAST_ROWS and 0.0 < _usual_us(t_us) <= _SLOWEST_US


def _fastest(fast: Sequence[Stamped]) -> Sequence[Stamped]:
    """Those that show when the clock jumped; at least five where there are so many, as one may have its own clock."""
    by_rate = sorted(fast, key=lambda each: _usual_us(each.t_us))
    most = _SIMILAR * _usual_us(by_rate[0].t_us)
    return [each for k, each in enumerate(by_rate) if k < _LEAST_TOPICS or _usual_us(each.t_us) <= most]


def _clock(fast: Sequence[Stamped]) -> tuple[I64, F64]:
    """Places in the file (P,) and the time there (P,), us: by the middle one of the topics.

    They begin where more than half of the topics have said one.
    """
    place = np.unique(np.concatenate([each.place for each in fast]))
    place = place[:: max(1, len(place) // _MOST_PLACES)]
    said = np.stack([_time_at(each, place) for each in fast])
    said.sort(axis=0)
    known = np.sum(np.isfinite(said), axis=0)
    whole = (np.maximum.accumulate(known) * 2 > len(fast)) & (known > 0)
    middle: F64 = said[(known[whole] - 1) // 2, np.flatnonzero(whole)]
    return place[whole], middle


def _time_at(each: Stamped, place: I64) -> F64:
    """(P,) a topic's time between its messages, held where it jumps; infinite before the first, long after the last."""
    steps = np.diff(each.t_us)
    jumps = np.flatnonzero((steps < 0.0) | (steps > 3.0 * _usual_us(each.t_us)))
    at = np.insert(each.place.astype(np.float64), jumps + 1, each.place[jumps + 1] - 0.5)
    time = np.interp(place, at, np.insert(each.t_us, jumps + 1, each.t_us[jumps]), np.inf)
    beyond = np.maximum(0.0, place - each.place[-1])
    time = time + beyond * float(np.median(steps / np.diff(each.place)))
    ended = max(0.01 * place[-1], _ENDED * np.percentile(np.diff(each.place), 90.0))
    return np.asarray(np.where(beyond > ended, np.inf, time))


def _backs(clock: F64) -> list[tuple[int, int]]:
    """Where the clock goes back: rows before and after each jump, which may take some messages to be seen."""
    backs: list[tuple[int, int]] = []
    for row in np.flatnonzero(np.diff(clock) < -_BACK_US).tolist():
        if backs and row - backs[-1][1] < _SAME_JUMP:
            backs[-1] = (backs[-1][0], row + 1)
        else:
            backs.append((row, row + 1))
    return backs


def _added(clock: F64) -> F64:
    """(P,) by how much each place's time moves so that the clock never goes back."""
    steps = np.zeros(len(clock))
    for before, after in _backs(clock):
        steps[after] = _APART_US + clock[before] - clock[after]
    return np.cumsum(steps)


def _near(each: Stamped, place: I64, clock: F64) -> I64:
    """(N,) the place of each message, or where its time is far from its own the best close by: topics jump in turn."""
    at = np.searchsorted(place, each.place, side="right") - 1
    near = np.clip(at + np.array([[0], [-20], [-5], [-1], [1], [5], [20]]), 0, len(place) - 1)
    off = np.abs(clock[near] - each.t_us)
    best = np.where(off[0] < 0.5 * _OFF_US, 0, np.argmin(off, axis=0))
    return np.asarray(near[best, np.arange(len(at))])


def _believed(t_us: F64, clock: F64, after: Mask) -> Mask:
    """(N,) messages whose stamps are the file's time; all of a topic that is slow.

    One stamp that is behind, but not behind its topic's own, was only written late.  A topic that keeps to a clock of
    its own from its beginning (or lies in the file behind the others) counts until its stamps go back.
    """
    if not _is_fast(t_us):
        return np.ones(len(t_us), np.bool_)
    off = np.where(after, t_us - clock, 0.0)
    most = _OFF_US + 3.0 * _usual_us(t_us)
    behind = off < -most
    lasts = np.convolve(behind, np.ones(3), "same") > 2.5
    lasts = np.convolve(lasts, np.ones(3), "same") > 0.5
    good = ~((off > most) | (behind & (lasts | (t_us < np.maximum.accumulate(t_us)))))
    usual = good[after][: max(_LEAST_ROWS, int(0.1 * np.sum(after)))]
    return good if len(usual) and usual.mean() > 0.5 else _until_back(t_us)


def _until_back(t_us: F64) -> Mask:
    if not _is_fast(t_us):
        return np.ones(len(t_us), np.bool_)
    return np.asarray(np.cumsum(np.diff(t_us, prepend=t_us[0]) < -_MOST_BACK * _usual_us(t_us)) == 0)


def _says_back(clock: F64) -> list[str]:
    back = [(clock[before] - clock[after]) * 1e-6 for before, after in _backs(clock)]
    if not back:
        return []
    times = f"by {back[0]:.3g} s" if len(back) == 1 else f"{len(back)} times, by up to {max(back):.3g} s"
    return [f"its clock goes back {times}: what follows was put 1 s after what came before"]


def _says_off(off: dict[str, int]) -> list[str]:
    if not off:
        return []
    most = sorted(off, key=lambda name: -off[name])
    more = f" and {len(off) - 3} more" if len(off) > 3 else ""
    return [f"messages stamped by another clock than the rest of the log, left out: {sum(off.values())} "
            f"({', '.join(most[:3])}{more})"]  # fmt: skip
