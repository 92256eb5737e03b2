"""`flightstack gap`: the workflow on files: reads logs and vehicle, writes gap.json, vehicle.toml and report.html."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from rich.markup import escape

from flightstack.cli import files, terminal
from flightstack.cli.terminal import output
from flightstack.gap.add import vehicle_file
from flightstack.gap.report import words, write_report
from flightstack.gap.result import GapResult, as_json
from flightstack.types import InputError


@dataclass(frozen=True, slots=True, kw_only=True)
class GapOptions:
    """What `gap` was asked for."""

    logs: tuple[Path, ...]
    vehicle: str
    out: Path
    holdout: tuple[Path, ...] = ()
    columns: Path | str | None = None
    ground_d_m: float = 0.0
    kinematics_only: bool = False


def find_gap(
    options: GapOptions, *, on_progress: Callable[[float, str], None] = lambda share, phase: None
) -> GapResult:
    """Run the workflow and write its three files into `options.out`; InputError, one line, where that can't be done."""
    from flightstack.gap.workflow import analyse
    from flightstack.jit import has_code

    vehicle, file = files.load_vehicle(options.vehicle)
    for path in (*options.logs, *options.holdout):
        if not path.is_file():
            raise InputError(f"log {path}: there is no such file; check the path")
    _make_folder(options.out)
    if not has_code("flightstack.gap.evaluated"):  # asked like this it costs nothing: the folder has to be found anyway
        from flightstack.cli.compiled import GAP, ensure_compiled

        ensure_compiled(lambda text: on_progress(0.0, text), GAP)
    result = analyse(
        options.logs,
        vehicle,
        vehicle_name=str(file.path),
        holdout=options.holdout,
        columns=options.columns,
        ground_d_m=options.ground_d_m,
        kinematics_only=options.kinematics_only,
        on_progress=on_progress,
    )
    on_progress(0.98, "writing")
    files.write_text(options.out / "vehicle.toml", _vehicle_file(result))
    try:
        write_report(result.report, options.out / "report.html")
    except OSError as error:
        raise InputError(f"{options.out}: {error.strerror}; choose another folder with --out") from None
    files.write_json(options.out / "gap.json", as_json(result))  # last: it says that all is there
    return result


def show_gap(result: GapResult, out: Path) -> None:
    """The sentence, what was named, and where the files lie."""
    output.print(escape(result.sentence), style="bold", soft_wrap=True)
    rows = []
    for log in result.report.logs:
        for finding in log.findings:
            if finding.level != "ok":
                rows.append(("data", escape(f"{log.name}: {finding.text}")))
        for note in log.notes:
            rows.append(("data", escape(f"{log.name}: {note}")))
    for found in result.found:
        shown = ", ".join(words.parameter(found, name) for name in found.parameters)
        rows.append(("effect", escape(f"{found.name}: {shown}")))
        if found.indistinguishable_from:
            rows.append(("", escape(f"or {', '.join(found.indistinguishable_from)}; to split: {found.manoeuvre}")))
    for label, name, unit in (
        ("force, one step", "one_step_mps2", "m/s²"),
        ("turning, one step", "one_step_radps2", "rad/s²"),
        ("path after 1 s", "rollout_1s_m", "m"),
    ):
        before, after, floor = (
            words.figure(getattr(part, name), unit)
            for part in (result.gap.before, result.gap.after, result.gap.noise_floor)
        )
        rows.append((label, f"{before} before, {after} after, {floor} of noise"))
    terminal.facts(rows)
    for name in ("gap.json", "vehicle.toml", "report.html"):
        terminal.say(f" {name:<14}{out / name}")


def _vehicle_file(result: GapResult) -> str:
    """The corrected vehicle's text, checked to say what was found."""
    values = {f.name: {name: value.estimate for name, value in f.parameters.items()} for f in result.found}
    return vehicle_file(result.corrected, values)


def _make_folder(out: Path) -> None:
    """The folder, without what an earlier run says it found."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        (out / "gap.json").unlink(missing_ok=True)
    except OSError as error:
        raise InputError(f"{out}: {error.strerror}; choose another folder with --out") from None
    if not os.access(out, os.W_OK):
        raise InputError(f"{out}: can't be written to; choose another folder with --out")
