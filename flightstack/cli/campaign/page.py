"""A campaign as one HTML page: rates with intervals, what drives the failures, distributions, the worst flights."""

from __future__ import annotations

from collections import Counter
from html import escape
from typing import Any

import numpy as np

from flightstack.cli.campaign.grouped import shown
from flightstack.cli.campaign.result import CampaignResult, replay_name
from flightstack.cli.campaign.statistics import Influence, metric
from flightstack.types import F64
from flightstack_logs.report.page import figures_html
from flightstack_logs.report.plot import Plot, padded
from flightstack_logs.report.still import still_page
from flightstack_logs.report.words import KeyFigure

_SHOWN = (
    ("tracking.rmse_m", "distance from the reference, rms, m"),
    ("tracking.max_m", "distance from the reference, most, m"),
    ("barrier.min_h_truth", "least h of the true state"),
    ("estimator.velocity_error_rms_mps", "error of the velocity estimate, m/s"),
    ("flown.touchdown_mps", "speed at touchdown, m/s"),
    ("flight_time_s", "flight time, s"),
)
_BARS = 30
_FAILURES = 200
_CHARTS = 6


def render(result: CampaignResult) -> str:
    """The whole page; no network, no script."""
    good = sum(count for name, count in result.outcomes.items() if name != "completed") == 0
    verdict = "stopped" if result.stopped else "all completed" if good else "failures"
    parts = [
        _panel("What drives the failures", _drivers(result), wide=True),
        *(_panel(f"Failures by {each.factor}", _by_factor(each)) for each in result.influences[:_CHARTS]),
        *(_panel(words, svg) for words, svg in _distributions(result)),
        _panel("In figures", _grouped(result), wide=True) if result.table else "",
        _panel("Search", _search(result), wide=True) if result.search else "",
        _panel("The worst flights", _worst(result), wide=True),
        _panel("Failures", _failures(result), wide=True),
        _panel("The campaign's file", f"<pre>{escape(result.spec.text)}</pre>", wide=True),
    ]
    return still_page(
        f"Campaign {result.spec.path.name}",
        [_subtitle(result)],
        f'<dl class="figures">{_figures(result)}</dl><main><div class="grid">{"".join(parts)}</div></main>',
        state="good" if good and not result.stopped else "bad",
        verdict=verdict,
        footer="Intervals: Clopper-Pearson, 95 %. Influence: Mann-Whitney or chi-squared, corrected after Holm for the "
        f"number of factors. <code>flightstack {result.spec.verb} FILE</code> flies a file of this folder again.",
        css=("flightstack.cli.campaign", "page.css"),
    )


def _panel(title: str, body: str, *, wide: bool = False) -> str:
    style = ' style="grid-column: 1 / -1"' if wide else ""
    return f'<section class="panel"{style}><h2>{escape(title)}</h2>{body}</section>'


def _subtitle(result: CampaignResult) -> str:
    spec = result.spec
    design = spec.design if spec.search is None else f"search by {spec.search.method}"
    said = f"{len(result.entries)} flights, {design}, {len(spec.factors)} factors, {spec.seeds} seeds"
    return f"{said}; {result.stopped}" if result.stopped else said


def _figures(result: CampaignResult) -> str:
    shown = []
    for row in result.rates:
        if not row["count"] and row["of"] not in ("completed", "failed"):
            continue
        state = "good" if row["of"] == "completed" and row["count"] == row["flights"] else "plain"
        state = "bad" if row["of"] != "completed" and row["count"] else state
        low, high = row["ci95"]
        note = f"{row['count']} of {row['flights']}; {_percent(low)} to {_percent(high)}"
        shown.append(KeyFigure(row["of"], _percent(row["rate"]), note, state))
    walls = [entry["timing"]["wall_s"] for entry in result.entries]
    if walls:
        note = f"median; {sum(walls) / 3600.0:.2f} h in all"
        shown.append(KeyFigure("a flight took", f"{np.median(walls):.1f} s", note))
    return figures_html(shown)


def _percent(share: float | None) -> str:
    return "–" if share is None else f"{100.0 * share:.3g} %"


def _table(heads: tuple[str, ...], rows: list[list[str]], numbers: tuple[int, ...]) -> str:
    def cell(k: int, text: str, tag: str) -> str:
        of = ' class="number"' if k in numbers else ""
        return f"<{tag}{of}>{text}</{tag}>"

    head = "".join(cell(k, escape(text), "th") for k, text in enumerate(heads))
    body = "".join("<tr>" + "".join(cell(k, text, "td") for k, text in enumerate(row)) + "</tr>" for row in rows)
    return (
        f'<div class="wide-table"><table class="rows"><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'
    )


def _grouped(result: CampaignResult) -> str:
    rows, by = result.table, len(result.spec.table.by if result.spec.table else ())
    cells = [[escape(shown(value)) for value in row.values()] for row in rows]
    return _table(tuple(rows[0]), cells, tuple(range(by, len(rows[0]))))


def _drivers(result: CampaignResult) -> str:
    if not result.influences:
        words = "nothing was varied" if not result.spec.factors else "all flights ended alike"
        return f'<p class="missing">{words}</p>'
    rows = [
        [escape(each.factor), f"{each.effect:.2f}", f"{each.p_value:.2g}", escape(each.words)]
        for each in result.influences
    ]
    note = '<p class="note">Influence: 0 none, 1 all. p: chance of as much where the factor has no influence.</p>'
    return _table(("factor", "influence", "p", "failures are"), rows, (1, 2)) + note


def _by_factor(influence: Influence) -> str:
    bins = [each for each in influence.bins if each.flights]
    most = max(max(100.0 * each.ci95[1] for each in bins), 1.0)
    numbers = all(each.ends is not None for each in bins)
    places = [each.ends or (float(k), k + 1.0) for k, each in enumerate(bins)]
    label = influence.factor if numbers else "values in the order below"
    span = (places[0][0], places[-1][1])
    plot = Plot(span, (0.0, most), (label, "failures, %"), f"Failures by {influence.factor}", height=300.0)
    for (left, right), each in zip(places, bins, strict=True):
        low, high = (100.0 * end for end in each.ci95)
        rate, edge, middle = 100.0 * each.failed / each.flights, 0.04 * (right - left), 0.5 * (left + right)
        plot.boxes(np.array([[left + edge, right - edge, 0.0, rate]]), np.array([0.75]), "failed")
        plot.line(np.array([[middle, low], [middle, high]]), "ci", label=f"{each.words}: {rate:.3g} %")
    listed = "; ".join(f"{each.words}: {each.failed} of {each.flights}" for each in bins)
    return plot.svg() + f'<p class="note">{escape(listed)}</p>'


def _distributions(result: CampaignResult) -> list[tuple[str, str]]:
    drawn = []
    target = [] if result.spec.search is None else [(result.spec.search.target, result.spec.search.target)]
    for name, words in [*target, *_SHOWN]:
        values = np.array([v for entry in result.entries if (v := metric(entry, name)) is not None])
        if len(values) > 1 and (name, words) not in drawn:
            drawn.append((words, _histogram(values, words)))
    return drawn


def _histogram(values: F64, words: str) -> str:
    low, high = padded(values, 0.0)
    counts, edges = np.histogram(values, _BARS, (low, high))
    plot = Plot(
        (low, high), (0.0, float(counts.max()) * 1.05), (words, "flights"), f"Distribution of {words}", height=300.0
    )
    rows = np.array([[edges[k], edges[k + 1], 0.0, float(n)] for k, n in enumerate(counts) if n])
    plot.boxes(rows, np.full(len(rows), 0.8), "bar")
    p5, p50, p95 = np.percentile(values, [5, 50, 95])
    return plot.svg() + f'<p class="note">{len(values)} flights; 5 %: {p5:.4g}, median {p50:.4g}, 95 %: {p95:.4g}</p>'


def _links(row: dict[str, Any]) -> str:
    named = ((row["report"], "report"), (row["log"], "log"), (row["replay"], "scenario file"))
    return " · ".join(f'<a href="{escape(str(place))}">{words}</a>' for place, words in named if place)


def _worst(result: CampaignResult) -> str:
    rows = [[escape(row["of"]), str(row["flight"]), f"{row['value']:.4g}", _links(row)] for row in result.worst]
    return _table(("by", "flight", "value", "see"), rows, (1, 2)) if rows else '<p class="missing">no figures</p>'


def _failures(result: CampaignResult) -> str:
    failed = [entry for entry in result.entries if entry["outcome"] != "completed"]
    if not failed:
        return '<p class="missing">none</p>'
    reasons = Counter((entry["outcome"], _kind(entry["reason"])) for entry in failed)
    summed = _table(
        ("outcome", "flights", "reason"),
        [[name, str(count), escape(reason)] for (name, reason), count in reasons.most_common(30)], (1,),
    )  # fmt: skip
    rows = [
        [
            str(entry["flight"]), str(entry["seed"]), entry["outcome"], escape(entry["reason"]),
            _links({"report": entry["report"], "log": entry["log"], "replay": replay_name(entry["flight"])}),
        ]
        for entry in failed[:_FAILURES]
    ]  # fmt: skip
    more = f'<p class="note">{len(failed) - _FAILURES} more in flights.parquet</p>' if len(failed) > _FAILURES else ""
    return summed + _table(("flight", "seed", "outcome", "reason", "see"), rows, (0, 1)) + more


def _kind(reason: str) -> str:
    """A reason without its figures, so that alike ones count together."""
    return "".join("#" if c.isdigit() else c for c in reason).replace("##", "#").replace("##", "#").replace("#.#", "#")


def _search(result: CampaignResult) -> str:
    assert result.search is not None
    rows = [[escape(str(name)), escape(_plain(value))] for name, value in result.search.items()]
    return _table(("", ""), rows, ())


def _plain(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
