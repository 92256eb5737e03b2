"""The result in words: the one sentence, the verdict, parameters with their intervals."""

from __future__ import annotations

import math
from collections.abc import Mapping

from flightstack.effects import EFFECTS
from flightstack.gap.decisions import TENTH
from flightstack.gap.records import Estimate, Figures, Gap, IdentifiedEffect, Unexplained
from flightstack.gap.report.record import GapReport
from flightstack.gap.verdict import closed_by_channel

_IN_FULL = 2
"""Effects that the sentence gives with intervals and classes."""


def effect(name: str) -> str:
    """An effect as one says it."""
    return EFFECTS[name].words


def number(value: float, like: float | None = None) -> str:
    """Four digits, or as many decimals as an interval of width `like` deserves."""
    if 0.0 < abs(value) < 1e-3:
        return f"{value:.2e}".replace("e-0", "e-").replace("-", "−")
    if like is not None and like > 0.0 and math.isfinite(like):
        decimals = max(0, min(5, 1 - math.floor(math.log10(like))))
        return f"{value:.{decimals}f}".replace("-", "−")
    return f"{value:.4g}".replace("-", "−")


def parameter(found: IdentifiedEffect, name: str) -> str:
    """`mass_kg 0.216 kg (0.210 to 0.222)`, the unit from the effect's table."""
    value = found.parameters[name]
    if not value.told:
        return f"{name} not told"
    spec = next((p for p in EFFECTS[found.name].params if p.name == name), None)
    shown = f" {unit(spec.unit)}" if spec is not None and spec.unit else ""
    if spec is not None and spec.integer:
        return f"{name} {value.estimate:.0f}"
    return f"{name} {number(value.estimate, _width(value))}{shown} ({interval(value)})"


def interval(value: Estimate) -> str:
    """`0.210 to 0.222`."""
    if not value.told:
        return "not told by these logs"
    if not (math.isfinite(value.low) and math.isfinite(value.high)):
        return "interval unknown"
    return f"{number(value.low, _width(value))} to {number(value.high, _width(value))}"


def _width(value: Estimate) -> float:
    return value.high - value.low


SIDE_FORCE, SIDE_AND_LIFT = "side force", "side force and mean lift"
"""What is compared of logs whose motors were logged too slowly for more."""
_UNSEEN = {
    SIDE_FORCE: "vertical force and torques were not looked at, as motors were logged too slowly",
    SIDE_AND_LIFT: "torques were not looked at, of the vertical force only the mean, as motors were logged too slowly",
}


def sentence(
    found: tuple[IdentifiedEffect, ...],
    gap: Gap,
    unexplained: Unexplained,
    *,
    only: str = "",
    limits: str = "",
    untold: str = "",
) -> str:
    """What was found, how sure, and what would settle the rest; `only`: what was compared, where motors told too
    little for more.

    `limits` says what would have been named, for where nothing is; `untold` what no log of this kind can tell.
    """
    if found:
        parts = [_found(found), _closed(gap, len(found)), *_rest(unexplained, gap), *_doubt(found)]
    elif unexplained.significant:
        parts = ["Something is missing that no effect of the table explains", *_depends(unexplained)]
        parts += ["it shows in the part that was learned from only"] * is_elsewhere(gap, unexplained)
    elif gap.before.one_step_mps2 is None and gap.before.one_step_radps2 is None:
        parts = ["The logs can't be compared with the simulation: only the data check was made"]
    else:
        part = compared(gap, only=only)
        parts = [
            f"Model and measurement agree within the noise{f' in {part}, all that was compared' * bool(part)}",
            limits,
        ]
    parts.append(untold)
    if only:
        parts.append(_UNSEEN[only])
    return "; ".join(part for part in parts if part) + "."


def headline(report: GapReport) -> str:
    """The sentence by names alone, where something is named: the page has the numbers in a table below it."""
    if not report.found:
        return report.sentence
    named = [" or ".join(effect(name) for name in (f.name, *f.indistinguishable_from)) for f in report.found]
    text = named[0] if len(named) == 1 else f"{', '.join(named[:-1])} and {named[-1]}"
    parts = [f"The model lacks {text}", _closed(report.gap, len(named)), *_rest(report.unexplained, report.gap)]
    if only := compared_only(report):
        parts.append(_UNSEEN[only])
    return "; ".join(part for part in parts if part) + "."


def is_elsewhere(gap: Gap, unexplained: Unexplained) -> bool:
    """Whether held-out data show no gap, so that what is unexplained shows where was learned from."""
    return unexplained.significant and gap.closed is None and not unexplained.shown


def compared_only(report: GapReport) -> str:
    """What was compared, where these logs' motors told too little for more; else ""."""
    return next((only for only, unseen in _UNSEEN.items() if report.sentence.endswith(f"{unseen}.")), "")


def compared(gap: Gap, *, only: str = "") -> str:
    """What was compared, where that is not all: of the rest no log says that there is no gap."""
    if only:
        return only
    if gap.before.one_step_radps2 is None:
        return "force"
    return "turning" if gap.before.one_step_mps2 is None else ""


def _found(found: tuple[IdentifiedEffect, ...]) -> str:
    """One or two effects with all that is known of them, more by their sizes alone: the page has the rest below."""
    named = [_in_full(each) if len(found) <= _IN_FULL else _in_short(each) for each in found]
    text = named[0] if len(named) == 1 else f"{', '.join(named[:-1])} and {named[-1]}"
    twins = any(each.indistinguishable_from for each in found) and len(found) > _IN_FULL
    return f"The model lacks {text}" + (" (what stands after an or these logs can't tell apart)" if twins else "")


def _in_full(found: IdentifiedEffect) -> str:
    shown = [parameter(found, name) for name in found.parameters]
    others = [effect(name) for name in found.indistinguishable_from]
    alternative = f" or {' or '.join(others)}, which these logs can't tell apart" if others else ""
    return f"{effect(found.name)} ({', '.join(shown)}){alternative}"


def _in_short(found: IdentifiedEffect) -> str:
    specs = {p.name: p for p in EFFECTS[found.name].params}
    units = list(dict.fromkeys(unit(specs[name].unit) for name in found.parameters if name in specs))
    values = ", ".join(
        f"{e.estimate:.0f}" if name in specs and specs[name].integer else number(e.estimate, _width(e))
        for name, e in found.parameters.items()
        if e.told
    )
    hidden = [name for name, e in found.parameters.items() if not e.told]
    untold = f" ({', '.join(hidden)} not told)" if hidden else ""
    others = found.indistinguishable_from
    more = f" or {effect(others[0])}" + (f" or {len(others) - 1} more" if len(others) > 1 else "") if others else ""
    return f"{effect(found.name)} {values} {units[0] if len(units) == 1 else ''}".rstrip() + untold + more


def _closed(gap: Gap, count: int) -> str:
    if gap.closed is None:
        return ""
    shares, them = closed_by_channel(gap), "it" if count == 1 else "them"
    if _differ(shares):
        parts = [f"{percent(share)} of the gap in {channel}" for channel, share in shares.items()]
        return f"with {them} {' and '.join(parts)} are closed on data not used before"
    return f"with {them} {percent(gap.closed)} of the gap on data not used before is closed"


def _differ(shares: Mapping[str, float]) -> bool:
    """Whether one share would not tell of both."""
    return max(shares.values(), default=0.0) - min(shares.values(), default=0.0) > 2.0 * TENTH


def _rest(unexplained: Unexplained, gap: Gap) -> list[str]:
    if not unexplained.significant:
        return []
    return [f"{left_over(unexplained, gap)} is left that no effect explains", *_depends(unexplained)]


def left_over(unexplained: Unexplained, gap: Gap) -> str:
    """How much is left; of no gap there is no share."""
    if gap.closed is None:
        return "something"
    shares = closed_by_channel(gap)
    where = f" in {min(shares, key=shares.__getitem__)}" if _differ(shares) else ""
    return f"{percent(unexplained.fraction)} of the gap{where}"


def _depends(unexplained: Unexplained) -> list[str]:
    if not unexplained.depends_on:
        return ["it depends on nothing that these logs show"]
    return [f"it depends on {' and '.join(unexplained.depends_on)}", *[unexplained.shown] * bool(unexplained.shown)]


def _doubt(found: tuple[IdentifiedEffect, ...]) -> list[str]:
    return [f"to settle which: {each.manoeuvre}" for each in found if each.indistinguishable_from and each.manoeuvre][
        :1
    ]


def percent(share: float) -> str:
    """A share in per cent; never 100 where something is left, never more: less than the noise is no better than it."""
    value = 100.0 * min(share, 1.0)
    if value < 99.5 or share >= 1.0:
        return f"{value:.0f} %".replace("-", "−")
    return f"{min(value, 99.9):.1f} %"


def held_out(found: IdentifiedEffect) -> str:
    """What data not used before say of an effect."""
    if math.isnan(found.holdout_gain):
        return "held-out data hardly hold it and say nothing for or against"
    return (
        f"without it {percent(found.holdout_gain)} of what can be explained of held-out data (noise-weighted) is lost"
    )


def verdict(
    found: tuple[IdentifiedEffect, ...],
    gap: Gap,
    unexplained: Unexplained,
    *,
    only: str = "",
    untold: str = "",
) -> tuple[str, str]:
    """The page's state (good, plain, bad) and word; of `untold` (of `sentence`) nobody knows whether it is a gap."""
    if unexplained.significant:
        return "bad", "partly explained" if found else "not explained"
    if not found:
        if gap.before.one_step_mps2 is None and gap.before.one_step_radps2 is None:
            return "plain", "data check only"
        part = compared(gap, only=only)
        if untold:
            return "plain", f"no gap{f' in {part}' * bool(part)} but a force untold"
        return ("plain", f"no gap in {part}") if part else ("good", "no gap")
    if any(each.indistinguishable_from for each in found):
        return "plain", "found, with a twin"
    return "good", "found"


def figure(value: float | None, unit: str) -> str:
    """A figure with its unit, or a dash."""
    return "–" if value is None else f"{value:.3g} {unit}"


def ratio(before: Figures, after: Figures) -> str:
    """How many times smaller (or larger) the rollout's error is."""
    if not before.rollout_1s_m or not after.rollout_1s_m:
        return ""
    share = before.rollout_1s_m / after.rollout_1s_m
    times = f"{max(share, 1.0 / share):.1f}"
    return "as it was" if times == "1.0" else f"{times} times {'smaller' if share > 1.0 else 'larger'}"


def unit(text: str) -> str:
    """A unit as printed: m/s^2 as m/s²."""
    return text.replace("^2", "²")
