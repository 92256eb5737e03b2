"""docs/learning.md: tables and words round a campaign's results; nothing in it is written by hand."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from benchmarks import learning_words as text
from benchmarks.learning_bars import Bar, bars, inputs_ratio, spread
from benchmarks.learning_cases import CASES, FIRST_SEED, FIXED, PILOTS, SCHEDULED
from benchmarks.learning_stats import covered, of, paired, shares, values
from flightstack_paper.inputs import WORLDS

_COMPARED = ("paper-tracking", "rotor-drag", "low-pass", "steady-wind", "px4-sih", "payload-drop")
_OTHERS = ("figure8", "hover", "right-model", "paper-tracking-gps", "rotor-drag-gps")
_CAPTIONS = {
    "tracking": "Tracking error with and without the Gaussian process, and with the exact model.",
    "compared": "Settled error of every controller: a dot for each seed, a line at the median.",
    "payload-drop": "A sudden change: the payload falls off.",
    "coverage": "How often the bound holds the truth.",
    "inputs": "Inputs with position (q) against without (q'): the path displaced after training.",
    "iteration": "One iteration of the recursive process over the points that it holds.",
}


def report(results: dict[str, Any], figures: Sequence[str], command: str) -> str:
    """The whole page, markdown."""
    parts = [_head(results, command), _summary(bars(results)), _figure("tracking", figures), _controllers(results)]
    parts += [_figure("compared", figures), _excess(results), _others(results), _schedule(results)]
    parts += [_change(results)]
    parts += [_figure("payload-drop", figures), _coverage(results), _figure("coverage", figures)]
    parts += [_inputs(results), _figure("inputs", figures), _timing(results), _figure("iteration", figures)]
    parts.append(text.METHOD.format(first=FIRST_SEED))
    return "\n\n".join(part for part in parts if part) + "\n"


def _head(results: dict[str, Any], command: str) -> str:
    flights = results["flights"]
    failed = [r for r in flights if not r["completed"]]
    seeds = sorted({r["seed"] for r in flights})
    machine = f"{results['machine']}, {results['cores']}, Python {results['python']}"
    hours = sum(r["track_s"] for r in flights if r["track_s"]) / 3600.0
    fed = sum(r.get("fed", 0) for r in flights if r["pilot"] == "learning")
    fate = "all completed" if not failed else f"{len(failed)} did not complete: " + ", ".join(_name(r) for r in failed)
    return (
        "# Learning in flight: what it reaches\n"
        f"Written by `{command}` on {results['date']} (git {results['git_commit'] or 'unknown'}; {machine}; "
        f"{results['wall_s'] / 60.0:.0f} min).\n"
        f"{len(flights)} flights over UDP on loopback, seeds {seeds[0]} to {seeds[-1]}, {hours:.1f} h of tracked "
        f"flight, {fed / 1e6:.1f} million samples learned from; {fate}.\n{text.HEAD}"
    )


def _name(row: dict[str, Any]) -> str:
    return f"{row['case']}/{row['pilot']}/{row['seed']}"


def _summary(found: Iterable[Bar]) -> str:
    words = {True: "yes", False: "**no**", None: ""}
    lines = [f"| {bar.what} | {bar.bar} | {bar.measured} | {words[bar.kept]} |" for bar in found]
    return "\n".join(["## The bars", "| | bar | measured | kept |", "| --- | --- | --- | --- |", *lines])


def _figure(name: str, figures: Sequence[str]) -> str:
    return f"![{_CAPTIONS[name]}](learning/{name}.png)" if name in figures else ""


def _error(rows: Sequence[dict[str, Any]], key: str = "rmse_settled_m") -> str:
    """Median and range in centimetres; how many flights failed."""
    if not rows:
        return ""
    found = 100.0 * values(rows, key)
    whole = found[np.isfinite(found)]
    failed = len(found) - len(whole)
    lost = f", {failed} of {len(found)} lost" if failed else ""
    if not len(whole):
        return "all lost"
    middle, low, high = (_cm(float(value)) for value in (np.median(whole), whole.min(), whole.max()))
    return f"{middle} ({low} to {high}){lost}" if len(whole) > 1 else f"{middle}{lost}"


def _cm(value: float) -> str:
    return f"{value:.2f}" if value < 9.995 else f"{value:.1f}"


def _controllers(results: dict[str, Any]) -> str:
    rows = results["flights"]
    cases = [case for case in _COMPARED if any(r["case"] == case for r in rows)]
    head = ["| settled rms error, cm: median (range) | " + " | ".join(cases) + " |", "| --- |" + " --- |" * len(cases)]
    body = []
    for pilot, about in PILOTS.items():
        if pilot in SCHEDULED:
            continue
        cells = [_error(of(rows, case, pilot)) for case in cases]
        if any(cells):
            body.append(f"| **{pilot}**: {about.words} | " + " | ".join(cells) + " |")
    counts = [sorted({len(f) for pilot in PILOTS if (f := of(rows, case, pilot))}) for case in cases]
    body.append("| seeds | " + " | ".join(" or ".join(map(str, count)) for count in counts) + " |")
    tasks = [f"* `{case}`: {CASES[case].words}" for case in cases]
    return "\n".join(["## Every controller, every task", *tasks, "", *head, *body])


def _excess(results: dict[str, Any]) -> str:
    lines = []
    for case in _COMPARED:
        for among in (FIXED, ("state-gp",)):
            found = shares(results["flights"], case, among)
            if found is None:
                continue
            three = [f"{100.0 * value:.2f}" for value in (found.floor_m, found.best_m, found.learning_m)]
            share = spread(found.removed, digits=2) if found.clear else "no excess"
            lines.append(f"| {case} | {found.best} | " + " | ".join(three) + f" | {share} |")
    if not lines:
        return ""
    return "\n".join(
        [
            "## What is left over the floor",
            text.FLOOR,
            "",
            "| | baseline | floor, cm | baseline, cm | learning, cm | share removed |",
            "| --- | --- | --- | --- | --- | --- |",
            *lines,
        ]
    )


def _others(results: dict[str, Any]) -> str:
    rows = results["flights"]
    lines = []
    for case in _OTHERS:
        cells = [_error(of(rows, case, pilot)) for pilot in ("learning", "none", "exact")]
        if not any(cells):
            continue
        ratio = paired(rows, case, "learning", "none")
        share = "" if ratio is None else spread(ratio)
        lines.append(f"| {CASES[case].words} | " + " | ".join(cells) + f" | {share} |")
    if not lines:
        return ""
    head = "| settled rms error, cm | learning | without | exact model | learning / without |"
    return "\n".join(
        ["## Nothing to learn, and worse sensors", text.OTHERS, "", head, "| --- |" + " --- |" * 4, *lines]
    )


def _schedule(results: dict[str, Any]) -> str:
    rows = results["flights"]
    cases = [case for case in CASES if of(rows, case, SCHEDULED[0])]
    if not cases:
        return ""
    seeds = {case: {r["seed"] for r in of(rows, case, SCHEDULED[0])} for case in cases}
    lines = []
    for pilot in ("learning", *SCHEDULED, "none"):
        cells = [_error([r for r in of(rows, case, pilot) if r["seed"] in seeds[case]]) for case in cases]
        lines.append(f"| {PILOTS[pilot].words} | " + " | ".join(cells) + " |")
    head = "| settled rms error, cm: median (range) | " + " | ".join(cases) + " |"
    return "\n".join(
        ["## The gain schedule, apart", text.SCHEDULE, "", head, "| --- |" + " --- |" * len(cases), *lines]
    )


def _change(results: dict[str, Any]) -> str:
    changes = [r["change"] for r in of(results["flights"], "payload-drop", "learning") if r.get("change")]
    if not changes:
        return ""

    def cells(key: str, scale: float = 1.0, digits: int = 2) -> str:
        known = [scale * change[key] for change in changes if change[key] is not None]
        missing = len(changes) - len(known)
        if not known:
            return "never"
        middle = f"{np.median(known):.{digits}f} ({min(known):.{digits}f} to {max(known):.{digits}f})"
        return middle + (f", never in {missing}" if missing else "")

    table = [
        ("the residual jumps by, m/s²", cells("jump_mps2")),
        ("noticed after, ms", cells("noticed_s", 1e3, 0)),
        ("3-sigma bound before, m/s²", cells("bound_before_mps2")),
        ("3-sigma bound within 20 ms of the notice, m/s²", cells("bound_noticed_mps2")),
        ("the bound holds the truth again after, ms", cells("covered_s", 1e3, 0)),
        ("share of the 2 s from the notice on in which it holds", cells("covered_after_notice", digits=4)),
        ("learned (a tenth of the jump left, for good) after, s", cells("learned_s")),
        ("within 5 cm of the reference again, for good, after, s", cells("back_s")),
    ]
    lines = [f"| {name} | {cell} |" for name, cell in table]
    head = f"`payload-drop`, {len(changes)} seeds, body z; median (range)."
    return "\n".join(["## A sudden change", head, "", "| | |", "| --- | --- |", *lines])


def _coverage(results: dict[str, Any]) -> str:
    learning = [r for r in results["flights"] if r["pilot"] == "learning"]
    lines = []
    for case in (*CASES, None):
        seen = covered(r for r in learning if case in (r["case"], None))
        if seen is None:
            continue
        axes = " | ".join(f"{share:.4f}" for share in seen.axes)
        name = "**whole campaign**" if case is None else case
        lines.append(f"| {name} | {seen.ticks} | {axes} | {seen.pairs:.4f} | {seen.simultaneous:.4f} |")
    if not lines:
        return ""
    head = ["| | ticks | x | y | z | all pairs | all three at once |", "| --- |" + " --- |" * 6]
    return "\n".join(["## Calibration", text.COVERAGE, "", *head, *lines])


def _inputs(results: dict[str, Any]) -> str:
    rows = results["inputs"]
    if not rows:
        return ""
    parts = ["## The study of inputs", text.INPUTS]
    for world, place in WORLDS.items():
        here = [row for row in rows if row["world"] == world]
        if not here:
            continue
        far = sorted({row["displacement_m"] for row in here})
        parts += ["", f"{place.words[0].upper()}{place.words[1:]}:", ""]
        parts.append("| rms error of prediction, m/s² | " + " | ".join(f"{d:g} m" for d in far) + " |")
        parts.append("| --- |" + " --- |" * len(far))
        for name in dict.fromkeys(row["inputs"] for row in here):
            errors = [[r["error_mps2"] for r in here if r["inputs"] == name and r["displacement_m"] == d] for d in far]
            parts.append(f"| {name} | " + " | ".join(f"{np.median(e):.3f}" for e in errors) + " |")
        sizes = [np.median([r["residual_mps2"] for r in here if r["displacement_m"] == d]) for d in far]
        parts.append("| the residual itself | " + " | ".join(f"{size:.3f}" for size in sizes) + " |")
        ratios = [inputs_ratio(rows, world, d) for d in far]
        cells = [f"{np.median(r):.1f}" if r else "" for r in ratios]
        parts.append("| **q over q'** | " + " | ".join(cells) + " |")
    parts += ["", text.INPUTS_LESSON]
    return "\n".join(parts)


def _timing(results: dict[str, Any]) -> str:
    rows = results["timing"]
    if not rows:
        return ""
    last = rows[-1]
    steps = [r["step_us"]["p50"] for r in results["flights"] if r["pilot"] == "learning" and r["step_us"]["p50"]]
    said = (
        f"One iteration (one point leaves, one enters, mean and variance at one query; 9 inputs, 6 outputs) with "
        f"{last['points']} points:\nmedian {last['p50_us']:.0f} us, 99 % {last['p99_us']:.0f} us "
        "(`make bench-gp` has its peers and the machine's floor)."
    )
    if steps:
        said += (
            f"\nA whole step of the learner in flight (samples, two stores, alarm, feed-forward): median "
            f"{np.median(steps):.0f} us of the tick's 4,000."
        )
    return "## Time\n" + said
