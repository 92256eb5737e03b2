"""What a person sees in the terminal: progress while flying, a table at the end, one line when something is wrong."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from rich.markup import escape
from rich.table import Table

from flightstack.certificate_check import Verdict
from flightstack.cli import terminal
from flightstack.cli.estimate_score import estimate_words
from flightstack.cli.result import FlightResult
from flightstack.cli.terminal import errors, output, show
from flightstack.cli.verdict import HELD, LEFT, NONE, OFF
from flightstack.errors import one_line

if TYPE_CHECKING:
    from flightstack.cli.certify import CertifyResult

_PROTECTION_STYLES = {HELD: "[green]", LEFT: "[red]", NONE: "[red]", OFF: "[dim]"}


def say(text: str) -> None:
    """One line on stderr."""
    errors.print(text, markup=False)


def say_error(text: str) -> None:
    """One line on stderr that begins `error:`."""
    errors.print(f"error: {one_line(text)}", markup=False)


def show_result(result: FlightResult) -> None:
    """The flight's summary; of a dry run the checklist."""
    if result.completed is None:
        _show_checklist(result)
        return
    if result.passed:
        verdict = "[bold green]completed[/]" if result.completed else "[bold]nothing was to be flown[/]"
    else:
        verdict = f"[bold red]{_not_passed(result)}[/]"
    terminal.facts(_rows(result), f"{result.scenario}: {verdict}")
    for name, path in (("log", result.log), ("report", result.report)):
        if path:  # outside the table: a path must never be cut or wrapped
            terminal.say(f" {name:<8}{path}")
    for problem in filter(None, (result.log_problem, result.report_problem)):
        output.print(f" [red]{problem}[/]", soft_wrap=True)


def _show_checklist(result: FlightResult) -> None:
    """What was looked at, line by line."""
    verdict = "[bold green]ready[/]" if result.passed else "[bold red]NOT ready[/]"
    table = Table(title=f"{result.scenario}, dry run: {verdict}", title_justify="left", show_header=False, box=None)
    for _ in range(3):
        table.add_column()
    for check in result.checklist:
        mark = "[green]ok[/]" if check["ok"] else "[bold red]no[/]"
        table.add_row(mark, escape(check["check"]), escape(check["said"]))
    show(table)
    if result.log:
        terminal.say(f" log     {result.log}")


def _not_passed(result: FlightResult) -> str:
    if not result.completed:
        return "NOT completed"
    if result.unprotected:
        return "completed, but left its region" if result.protection == LEFT else "completed, but not protected"
    if result.log_problem:
        return "completed, but the log is not whole"
    return "completed, but there is no report" if result.report_problem else "completed, but a check failed"


def show_certified(result: CertifyResult) -> None:
    """An exploration's summary."""
    from flightstack.cli.certified_page import figures

    good = "[bold green]certified[/]" if not result.as_published else "[bold]done, not robustly certifiable[/]"
    rows = [("how it ended", escape(result.words))]
    for each in figures(result):
        rows.append((each.label.lower(), escape(f"{each.value} ({each.note})" if each.note else each.value)))
    terminal.facts(rows, f"{result.flight.scenario}: {good if result.passed else '[bold red]NOT certified[/]'}")
    for line in result.verdict:
        terminal.say(f" checker {line}")
    for name, path in (("certificate", result.certificate), ("log", result.flight.log), ("report", result.report)):
        if path:
            terminal.say(f" {name:<12}{path}")


def show_checked(path: str, verdict: Verdict) -> None:
    """What the independent checker said of a file; the last line is its verdict."""
    for line in verdict.lines:
        terminal.say(f" {line}")
    said = f"valid, {verdict.level}" if verdict.valid else "NOT valid"
    terminal.say(f"{path}: {said}")


def _rows(result: FlightResult) -> Iterator[tuple[str, str]]:
    if why := result.why:
        yield "why", why
    pace = f"{result.wall_time_s:.1f} s, {result.clock_time_s / max(result.wall_time_s, 1e-9):.1f} times real time"
    if result.flight_time_s:
        yield "flight", f"{result.flight_time_s:.1f} s from take-off to disarmed (in {pace})"
    else:
        yield "flight", f"none: refused or ended before it (after {result.wall_time_s:.1f} s)"
    tracking = result.tracking
    if tracking["rmse_m"] is not None:
        yield (
            f"distance from the reference ({'true' if tracking['of'] == 'truth' else 'estimated'} position)",
            f"rms {_length(tracking['rmse_m'])}, settled half {_length(tracking['rmse_settled_m'])}, "
            f"most {_length(tracking['max_m'])}",
        )
    if result.estimator["disagreement_rms_mps"] is not None:
        yield "estimate", estimate_words(result.estimator)
    yield "protection", f"{_PROTECTION_STYLES[result.protection]}{escape(result.protection_words)}[/]"
    yield "learning", _learning(result.gp)
    yield "barrier filter", _filter(result)
    lateness = result.loop["lateness_us"]
    if lateness["p50"] is not None:
        yield (
            "loop",
            f"{result.loop['rate_hz']} Hz, late by {lateness['p50']:.0f} us (p50), {lateness['p99']:.0f} us (p99), "
            f"{lateness['max']:.0f} us at most; {result.loop['missed']} ticks missed; "
            + ("real-time priority" if result.loop.get("real_time_priority") else "no real-time priority"),
        )
        if result.loop.get("stalls"):
            yield "longest stall", escape(result.loop["stalls"][0]["cause"])
        if (dead_man := result.loop.get("dead_man")) is not None:
            running = "ran" if dead_man["running"] else "did not run"
            yield "dead-man", f"{running}, acted {dead_man['acted']} times, {dead_man['taken_back']} taken back"
        trip = result.link["round_trip_us"]
        if trip["p50"] is not None:
            dropped = sum(result.link["dropped"].values())
            latency_s = result.link["command_latency_s"]
            told = "age not evident" if latency_s is None else f"{1e3 * latency_s:.1f} ms old"
            yield (
                "link",
                f"round trip {trip['p50'] / 1e3:.1f} ms (p50), {trip['p99'] / 1e3:.1f} ms (p99); "
                f"commands at the motors: {told}; "
                f"{result.link['lost']} messages lost, {dropped} dropped, {result.link['received']} taken",
            )
    for check in result.checks:
        yield "check", f"{'[green]kept[/]' if check['passed'] else '[red]FAILED[/]'}: {check['words']}"


def _learning(gp: dict[str, Any]) -> str:
    """Points, thrust gain, coverage and step time, as far as they are known."""
    if not gp["enabled"]:
        return "off"
    parts = []
    if gp["points"] is not None:
        parts.append(f"{gp['points']} points of {gp['fed']} samples")
    if gp["thrust_gain"] is not None and gp["points"] != 0:
        parts.append(f"thrust {gp['thrust_gain']:.3f} of the believed")
    if gp["coverage_3sigma"] is not None:
        parts.append(f"truth within 3 sigma {100 * gp['coverage_3sigma']:.2f} %")
    if gp["step_us"]["p50"] is not None:
        parts.append(f"step {gp['step_us']['p50']:.0f} us (p99 {gp['step_us']['p99']:.0f} us)")
    return ", ".join(parts) or "nothing learned"


def _filter(result: FlightResult) -> str:
    """What the filter was, what it kept to and what it took; or why there was none."""
    barrier, solve_us = result.barrier, result.qp["solve_us"]
    if not barrier["enabled"]:
        return result.filter_words or "off"
    parts = [result.filter_words] if result.filter_words else []
    for of, violations in (("truth", barrier["violations"]), ("estimate", None)):
        least = barrier[f"min_h_{of}"]
        if least is not None:
            outside = "" if violations is None else f" ({violations} ticks outside)"
            parts.append(f"least h of the {of} {least:.3f}{outside}")
    if not result.region.get("filtered_ticks"):
        parts.append(
            "it never engaged" if result.unprotected_because else "nothing was certified in time: it never engaged"
        )
    parts.append(f"{barrier['interventions']} interventions, {result.qp['infeasible']} infeasible")
    if solve_us["p50"] is not None:
        parts.append(f"step {solve_us['p50']:.0f} us (p99 {solve_us['p99']:.0f} us)")
    return ", ".join(parts)


def _length(metres: float | None) -> str:
    if metres is None:
        return "-"
    return f"{metres * 100:.1f} cm" if metres < 1.0 else f"{metres:.2f} m"


def show_table(title: str, columns: tuple[str, ...], rows: list[tuple[Any, ...]]) -> None:
    """A plain table."""
    table = Table(title=title, title_justify="left", box=None)
    for column in columns:
        table.add_column(column)
    for row in rows:
        table.add_row(*(str(value) for value in row))
    show(table)
