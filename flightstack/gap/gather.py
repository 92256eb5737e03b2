"""What the page shows beside the result itself: the waterfall's steps, regimes, curves over time, data quality."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from flightstack.effects import EFFECTS
from flightstack.gap import estimator_bias, pooled
from flightstack.gap.add import companion
from flightstack.gap.compare import residual
from flightstack.gap.decisions import GAP_FROM, MATTERS_MPS2
from flightstack.gap.identify import IN_PROPORTION, Identifiable
from flightstack.gap.locate import regimes
from flightstack.gap.mean_lift import held_out_share
from flightstack.gap.name import Selection
from flightstack.gap.pooled import FitHoldoutSplit, Mask
from flightstack.gap.records import REGIMES, SIGNALS, Checked, Gap, Samples
from flightstack.gap.report import words
from flightstack.gap.report.record import GapReport, LogQuality, RegimeRow, Shown, Step, Trace
from flightstack.gap.simulate import predict
from flightstack.gap.track import track
from flightstack.gap.verify import reflight, whiteness
from flightstack.types import F64, InputError
from flightstack.vehicle import Vehicle, with_effects

_LEAST_REGIME_S = 0.5
_COLUMNS = len(SIGNALS)


def report(
    vehicle: Vehicle, naming: Selection, of: FitHoldoutSplit, gap: Gap, logs: Sequence[Checked], *, only: str
) -> GapReport:
    """Everything the page shows; `logs` in the order of the split's flights; `only`: of `words.sentence`."""
    drawn = _drawn_first(of)
    takes, learner = _companion(vehicle, naming)
    untold = untold_force(of.flights, gap.noise_floor.one_step_mps2)
    told = {"limits": limits(naming.identifiable), "untold": untold}
    return GapReport(
        sentence=words.sentence(naming.found, gap, naming.unexplained, only=only, **told),
        vehicle=vehicle.name,
        gap=gap,
        found=naming.found,
        rejected=naming.rejected,
        unexplained=naming.unexplained,
        where=naming.where,
        steps=_steps(vehicle, naming, of, gap),
        regimes=_regimes(vehicle, naming.vehicle, of),
        shown=_shown(naming.identifiable),
        traces=tuple(_trace(vehicle, naming.vehicle, of, k) for k in drawn),
        logs=tuple(_quality(checked) for checked in logs),
        checks=(
            *_whiteness(naming.vehicle, of, drawn[0]),
            *_flown_again(vehicle, naming, of, drawn[0]),
            *(_carried(vehicle, naming.vehicle, of) if only == words.SIDE_AND_LIFT else ()),
        ),
        takes=takes,
        learner=learner,
        across=tuple(a for a in naming.across if not a.same or a.effect in {f.name for f in naming.found}),
        untold=untold,
    )


def _drawn_first(of: FitHoldoutSplit) -> list[int]:
    """The flight that holds most of what is held out."""
    return [int(np.argmax([int(mask.sum()) for mask in of.holdout]))]


def _steps(vehicle: Vehicle, naming: Selection, of: FitHoldoutSplit, gap: Gap) -> tuple[Step, ...]:
    """The held-out figures with one effect after the other, each at its final values."""
    steps = [Step("", gap.before)]
    now = vehicle
    for found in naming.found:
        now = with_effects(now, {found.name: naming.vehicle.effects[found.name]})
        last = found is naming.found[-1]
        steps.append(Step(found.name, gap.after if last else pooled.figures(now, of)))
    return tuple(steps)


def _regimes(before: Vehicle, after: Vehicle, of: FitHoldoutSplit) -> tuple[RegimeRow, ...]:
    """Rms by regime and channel over all that was flown."""
    was = [residual(before, samples).y[:, :_COLUMNS] for samples in of.flights]
    now = [residual(after, samples).y[:, :_COLUMNS] for samples in of.flights]
    masks = [regimes(samples) for samples in of.flights]
    rows = []
    for regime in REGIMES:
        chosen = [m[regime] & s.valid for m, s in zip(masks, of.flights, strict=True)]
        seconds = sum(float(m.sum()) * s.dt_s for m, s in zip(chosen, of.flights, strict=True))
        if seconds >= _LEAST_REGIME_S:
            rows.append(RegimeRow(regime, seconds, _rms(was, chosen), _rms(now, chosen)))
    return tuple(rows)


def _rms(values: list[F64], masks: list[Mask]) -> F64:
    rows = np.concatenate([y[m] for y, m in zip(values, masks, strict=True)])
    known = np.isfinite(rows)
    count = known.sum(axis=0)
    total = np.where(known, rows, 0.0) ** 2
    return np.where(count > 0, np.sqrt(total.sum(axis=0) / np.maximum(count, 1)), np.nan)


def _trace(before: Vehicle, after: Vehicle, of: FitHoldoutSplit, k: int) -> Trace:
    """One flight's channels as the figures see them."""
    samples = of.flights[k]
    flight = track(samples)
    measured, was, now = (
        flight.lowpass(x)[:, :_COLUMNS] for x in (flight.measured, predict(before, samples), predict(after, samples))
    )
    measured = np.where(flight.usable[:, None], measured, np.nan)
    t_s = samples.t_s - samples.t_s[0]
    noise = residual(before, samples).noise[:_COLUMNS]  # as in every table of the page
    return Trace(samples.name, t_s, measured, was, now, noise, _spans(t_s, of.holdout[k]))


def _spans(t_s: F64, mask: Mask) -> tuple[tuple[float, float], ...]:
    """First and last time of each stretch of a mask; stretches less than a second apart are one."""
    edges = np.diff(np.concatenate([[0], mask.astype(int), [0]]))
    spans: list[list[float]] = []
    for start, end in zip(np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1, strict=True):
        if spans and t_s[start] - spans[-1][1] < 1.0:
            spans[-1][1] = float(t_s[end])
        else:
            spans.append([float(t_s[start]), float(t_s[end])])
    return tuple((start, end) for start, end in spans)


def _quality(checked: Checked) -> LogQuality:
    samples = checked.samples
    seconds = 0.0 if samples is None else float(samples.valid.sum()) * samples.dt_s
    flight = checked.flight
    return LogQuality(flight.name, flight.kind, seconds, checked.findings, checked.offsets, flight.notes)


def _shown(rows: Sequence[Identifiable]) -> tuple[Shown, ...]:
    """One line an effect: the worst seen of its parameters decides."""
    lines = []
    for effect in dict.fromkeys(row.effect for row in rows):
        mine = [row for row in rows if row.effect == effect and row.parameter != IN_PROPORTION]
        whole = next((row for row in rows if row.effect == effect and row.parameter == IN_PROPORTION), None)
        in_all = whole is not None and whole.shown
        worst = max(mine, key=lambda row: row.smallest / row.matters if row.matters > 0.0 else np.inf)
        units = {p.name: p.unit for p in EFFECTS[effect].params}
        level = "weak" if in_all or any(row.shown for row in mine) else "hidden"
        level = "shown" if all(row.shown for row in mine) else level
        if np.isfinite(worst.smallest):
            text = f"{worst.parameter} from {worst.smallest:.2g} {units[worst.parameter]}".strip()
        else:
            text = f"nothing of {worst.parameter}"
        text += f"; all of the file's from {_off(whole)}" if whole is not None and in_all else ""
        alike = next((row.like for row in mine if row.like), "")
        text += f"; hard to tell from {alike.replace('_', ' ')}" if alike else ""
        manoeuvre = "" if level == "shown" else worst.manoeuvre
        sizes = {row.parameter: row.smallest for row in mine}
        lines.append(Shown(effect, level, text, manoeuvre, sizes, None if whole is None else whole.smallest))
    order = {"shown": 0, "weak": 1, "hidden": 2}
    return tuple(sorted(lines, key=lambda line: order[line.level]))


def limits(rows: Sequence[Identifiable]) -> str:
    """Where nothing is named, in words: how large a payload, or an error of what the file has, would have been."""
    whole = [row for row in rows if row.parameter == IN_PROPORTION]
    named = [f"{_words(row)} off by {_off(row)}" for row in whole if row.shown]
    named += [
        f"{_words(row)} of {row.smallest:.2g} kg" for row in rows if row.effect == "payload" and row.smallest < np.inf
    ]
    hidden = " and ".join(_words(row) for row in whole if not row.shown)
    told = [f"{' and '.join(named)} or more would have been named"] if named else []
    return "; ".join([*told, *([f"nothing can be told of the file's {hidden}"] if hidden else [])])


def untold_force(flights: Sequence[Samples], floor_mps2: float | None = None) -> str:
    """In words: the level force that an autopilot's own idea of its accelerometer's bias stands for, and its class.

    One that moves is said where it would make a gap by itself above this noise floor.
    """
    most = max((estimator_bias.mean_level_mps2(samples) for samples in flights), default=0.0)
    if most >= MATTERS_MPS2:
        return (
            f"a level force of {most:.2f} m/s² is the autopilot's own estimate of its accelerometer's bias or a "
            "constant force, a steady wind, an accelerometer bias or a misaligned attitude, which this log can't tell "
            "apart (raw accelerometer data would, as in a ULog)"
        )
    moving = max((estimator_bias.moving_level_mps2(samples) for samples in flights), default=0.0)
    if moving >= (MATTERS_MPS2 if floor_mps2 is None else floor_mps2 * math.sqrt(GAP_FROM**2 - 1.0)):
        return (
            f"a level force that moves by {moving:.2f} m/s² was taken for the autopilot's own estimate of its "
            "accelerometer's bias; what swings or comes and goes as slowly can't be told from it (raw accelerometer "
            "data would tell it, as in a ULog)"
        )
    return ""


def _off(row: Identifiable) -> str:
    return f"{100.0 * row.smallest:.2g} %"


def _words(row: Identifiable) -> str:
    return EFFECTS[row.effect].words


def _whiteness(corrected: Vehicle, of: FitHoldoutSplit, k: int) -> tuple[tuple[str, str], ...]:
    """Whether what is left on held-out data is noise."""
    tested = whiteness(corrected, of.flights[k], of.holdout[k])
    if not tested:
        return ()
    coloured = [each.signal.replace("_", " ") for each in tested if not each.white]
    text = f"white in {len(tested) - len(coloured)} of {len(tested)} channels"
    return (("what is left", f"{text}; not in {', '.join(coloured)}" if coloured else text),)


def _flown_again(vehicle: Vehicle, naming: Selection, of: FitHoldoutSplit, k: int) -> tuple[tuple[str, str], ...]:
    """The logged path flown once more in the simulator, with the model as it was and with the corrected one."""
    if not naming.found:
        return ()
    runs = reflight(vehicle, [vehicle, naming.vehicle], of.flights[k], of.holdout[k])
    if not runs:
        return ()
    was, now = runs
    return (
        ("flown again", f"{now.seconds:.0f} s of the logged path, closed loop, by the simulated autopilot"),
        ("leans off by", f"{np.degrees(was.lean_rad):.2f}° → {np.degrees(now.lean_rad):.2f}°"),
        ("mean command off by", f"{100.0 * was.collective:.2f} % → {100.0 * now.collective:.2f} %"),
    )


def _carried(before: Vehicle, after: Vehicle, of: FitHoldoutSplit) -> tuple[tuple[str, str], ...]:
    was, now = (100.0 * abs(held_out_share(each, of)) for each in (before, after))
    return (("mean lift off by", f"{was:.1f} % → {now:.1f} % of the weight, held out"),) if math.isfinite(was) else ()


def _companion(vehicle: Vehicle, naming: Selection) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """What the companion's model takes of the correction, and which found effects it leaves to its learner."""
    try:
        made = companion(vehicle, naming.vehicle)
    except InputError as error:
        return (f"nothing: {error}",), ()
    names = {found.name for found in naming.found}
    takes = tuple(f"{t.name} {t.before:.4g} → {t.after:.4g} {t.unit}".strip() for t in made.takes)
    return takes, tuple(name for name in made.left_to_learner if name in names)
