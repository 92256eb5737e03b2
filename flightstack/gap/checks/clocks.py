"""Stamps: units of time, mixed clocks, gaps, repeated samples, rates, length."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from flightstack.gap.checks.grid import SLOWEST_MOTOR_S, period_s
from flightstack.gap.decisions import GOOD_HZ, GUARD_S, LEAST_HZ, SMALL_SHARE
from flightstack.gap.records import Finding, Signal, how_to_record, refused, warning
from flightstack.types import F64

SLOW = ("battery_v", "landed", "height_m")
"""Signals that may come as rarely as they like."""
_HELD = 0.02
_LONG_GAP_S = 10.0
_TIME_UNITS = {"ms": (0.9, 90.0, 1e-3), "us": (400.0, 90e3, 1e-6), "ns": (4e5, 90e6, 1e-9)}
"""Unit -> period that it would show as seconds, from, to; its size."""


def settle_clocks(signals: Mapping[str, Signal], kind: str) -> tuple[dict[str, Signal], list[Finding]]:
    """The signals with stamps in seconds and without repeated samples; refusals where their clocks don't meet."""
    findings: list[Finding] = []
    out = _time_unit(signals, kind, findings)
    out = {name: _fresh(name, each, kind, findings) for name, each in out.items()}
    _mixed(out, findings)
    return (out if findings and findings[-1].level == "refused" else _closed_up(out, findings)), findings


def _time_unit(signals: Mapping[str, Signal], kind: str, findings: list[Finding]) -> dict[str, Signal]:
    """A CSV whose rows are minutes apart has its time in another unit."""
    fast = [period_s(each) for name, each in signals.items() if name not in SLOW and len(each.t_s) > 8]
    if kind != "csv" or not fast:
        return dict(signals)
    for unit, (low, high, size) in _TIME_UNITS.items():
        if low < min(fast) < high:
            findings.append(warning("units", f"time: was in {unit}; turned into seconds"))
            return {name: Signal(each.t_s * size, each.value, each.source) for name, each in signals.items()}
    return dict(signals)


def _fresh(name: str, each: Signal, kind: str, findings: list[Finding]) -> Signal:
    """Without the rows that only repeat the one before: a slower topic held in the rows of a faster log.

    Commands of other logs than CSV have stamps of their own.
    """
    if name in SLOW or len(each.t_s) < 50 or (name == "motor" and kind != "csv"):
        return each
    value = each.value.reshape(len(each.t_s), -1)
    fresh = np.concatenate([[True], np.any(value[1:] != value[:-1], axis=1)])
    fresh = _of_its_clock(fresh) if name == "motor" else fresh
    share = 1.0 - float(np.mean(fresh))
    still = longest_run(~fresh) / len(fresh)
    if share - still < _HELD or fresh.sum() < 20:
        return each
    findings.append(warning("rate", f"{name}: {100 * share:.0f} % of its rows only repeat the row before; left out"))
    return Signal(each.t_s[fresh], each.value[fresh], each.source)


def _of_its_clock(fresh: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(N,) rows that count, where what is new comes by a clock of its own: less than two rows beside its usual one.

    Commands that merely stay the same for a while, as rounded ones do, come at random: then all rows count.  While a
    vehicle stands rows count as often as they do in flight.
    """
    at = np.flatnonzero(fresh)
    apart = np.diff(at, append=len(fresh))
    usual = float(np.mean(apart[apart <= 3.0 * np.median(apart)]))
    if float(np.mean(np.abs(apart - usual) < 2.0)) <= 1.0 - SMALL_SHARE:
        return np.ones_like(fresh)
    since = np.arange(len(fresh)) - np.repeat(at, apart)
    stands = np.repeat(apart >= usual + 2.0, apart)
    return np.asarray(fresh | (stands & (since % round(usual) == 0)))


def longest_run(flags: NDArray[np.bool_]) -> int:
    """Rows of the longest stretch of (N,) flags that are set."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(np.int8), [0]])))
    return int(np.max(edges[1::2] - edges[::2], initial=0))


def _mixed(signals: Mapping[str, Signal], findings: list[Finding]) -> None:
    """Topics that share no time, or one topic whose stamps jump by more than all the rest of it lasts."""
    fast = {name: each for name, each in signals.items() if name not in SLOW and len(each.t_s) > 3}
    if signals and not fast:
        findings.append(refused("clock", "holds three rows or fewer that have a time of their own: too short, or its "
                                "clock stands still. Record 30 s in the air"))  # fmt: skip
    for name, each in fast.items():
        steps = np.diff(each.t_s)
        usual = float(np.median(steps)) * len(steps)
        if float(steps.max()) > max(60.0, 3.0 * usual):
            findings.append(refused("clock", f"{name}: its stamps jump by {steps.max():.3g} s; the log mixes clocks. "
                                    "Stamp every row by one clock"))  # fmt: skip
            return
    if len(fast) > 1:
        begin = max(fast, key=lambda name: fast[name].t_s[0])
        end = min(fast, key=lambda name: fast[name].t_s[-1])
        if fast[begin].t_s[0] >= fast[end].t_s[-1]:
            findings.append(refused("clock", f"{begin} begins after {end} has ended: they are stamped by different "
                                    "clocks. Stamp all topics by one clock"))  # fmt: skip


def _closed_up(signals: Mapping[str, Signal], findings: list[Finding]) -> dict[str, Signal]:
    """Long gaps that all fast topics share (a log that stopped, a clock that jumped) last no longer than it takes to
    forget: else a minute that nobody flew would be a third of the flight."""
    fast = [each.t_s for name, each in signals.items() if name not in SLOW and len(each.t_s) > 3]
    if not fast:
        return dict(signals)
    said = np.unique(np.concatenate(fast))
    at = np.flatnonzero(np.diff(said) > _LONG_GAP_S)
    if not len(at):
        return dict(signals)
    begin, lost = said[at], np.diff(said)[at] - GUARD_S
    total = np.concatenate([[0.0], np.cumsum(lost)])
    findings.append(warning("gaps", f"no topic says anything for {np.max(lost) + GUARD_S:.3g} s after {begin[0]:.1f} s"
                            f"{f', and {len(at) - 1} times more' if len(at) > 1 else ''}: its parts were put "
                            f"{GUARD_S:.0f} s apart"))  # fmt: skip
    # what a slow topic said in a gap counts as said at its end
    out = {}
    for name, each in signals.items():
        after = np.searchsorted(begin, each.t_s, side="left")
        gone = np.where(
            after > 0, np.minimum(lost[after - 1], np.maximum(0.0, each.t_s - begin[after - 1] - GUARD_S)), 0
        )
        earlier = total[np.maximum(after - 1, 0)]
        out[name] = Signal(each.t_s - earlier - gone, each.value, each.source)
    return out


def judge_rates(signals: Mapping[str, Signal], span_s: tuple[float, float], kind: str) -> list[Finding]:
    """Whether topics are fast and whole enough."""
    findings: list[Finding] = []
    better = how_to_record(kind)
    for name in ("motor", "rate_frd_radps", "q_ned_frd", "accel_frd_mps2", "vel_ned_mps"):
        if name not in signals or len(signals[name].t_s) < 4:
            continue
        rate = 1.0 / period_s(signals[name])
        if rate * SLOWEST_MOTOR_S < 1.0 and name == "motor":
            text = f"""motor: {rate:.3g} Hz shows their mean only: of the vertical force that is all that is compared \
(mass and thrust are one), of torques nothing (inertia, lag and centre of mass can't be told), the side force as ever. \
For the rest: {better}"""
            findings.append(warning("rate", text))
        elif rate < LEAST_HZ:
            findings.append(refused("rate", f"{name}: {rate:.3g} Hz is too slow; it takes at least {LEAST_HZ:.0f}, "
                                    f"better 100 to 250 Hz: {better}"))  # fmt: skip
        elif rate < GOOD_HZ and name in ("motor", "rate_frd_radps", "accel_frd_mps2"):
            what = "the samples may be aliased" if name != "motor" else "lag and delay can hardly be told"
            findings.append(warning("rate", f"{name}: {rate:.3g} Hz; {what}. At 100 to 250 Hz they aren't: {better}"))
        _gaps(name, signals[name], span_s, findings)
    return findings


def _gaps(name: str, each: Signal, span_s: tuple[float, float], findings: list[Finding]) -> None:
    inside: F64 = each.t_s[(each.t_s >= span_s[0]) & (each.t_s <= span_s[1])]
    steps = np.diff(inside)
    if not len(steps):
        return
    lost = steps[steps > 3.5 * period_s(each)]
    if len(lost):
        findings.append(
            Finding(
                "gaps",
                "warning",
                f"{name}: {len(lost)} gaps, {lost.sum():.3g} s in all, the longest {lost.max():.3g} s",
            )
        )
