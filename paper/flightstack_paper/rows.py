"""The table: the paper's claim beside what this run measured.  Every number comes from the run's parts."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

from flightstack_paper.plan import PILOTS, inputs_name, seeds_of, tracking_name

WITH, WITHOUT = "q", "q'"
"""Inputs with position and without."""
Results = Mapping[str, dict[str, Any]]
"""Name of a part -> its result; {"failed": why} where there is none."""


@dataclass(frozen=True, slots=True)
class ResultLine:
    """One line of the table."""

    id: str
    claim: str
    paper: float | None
    """The paper's figure; None where it says it in words."""
    ours: float | None
    """Measured; None where the part failed, which the note tells."""
    unit: str
    holds: bool
    """The measured value satisfies the claim as it is worded."""
    note: str

    def as_json(self) -> dict[str, Any]:
        """The row of results.json."""
        return asdict(self)


Cell = tuple[float, bool, str]
"""What is measured, whether the claim holds, and the note."""


@dataclass(frozen=True, slots=True)
class ResultTable:
    """The rows of one run."""

    results: Results
    plants: tuple[str, ...]
    seed: int
    quick: bool

    def row(
        self, row_id: str, claim: str, paper: float | None, unit: str, parts: tuple[str, ...], make: Callable[..., Cell]
    ) -> ResultLine:
        """A row from the results of `parts`; where one of them failed, it says so."""
        found = [self.results[name] for name in parts]
        failed = [f"{name}: {each['failed']}" for name, each in zip(parts, found, strict=True) if "failed" in each]
        if failed:
            return ResultLine(row_id, claim, paper, None, unit, False, f"not measured: {'; '.join(failed)}")
        ours, holds, note = make(*found)
        known = math.isfinite(ours)
        return ResultLine(row_id, claim, paper, float(ours) if known else None, unit, bool(holds) and known, note)

    def on(self, plant: str) -> str:
        """The end of a flown row's note."""
        return f"; {plant} plant{', short flights (--quick)' if self.quick else ''}"

    def tracking(self, plant: str, pilot: str) -> tuple[str, ...]:
        """Names of a pilot's flights."""
        return tuple(
            tracking_name(plant, pilot, seed) for seed in seeds_of(plant == self.plants[0], self.seed, quick=self.quick)
        )


def table(results: Results, plants: tuple[str, ...], seed: int, *, quick: bool) -> list[ResultLine]:
    """All rows: those of the first plant under their plain ids, those of a second with its name behind."""
    from flightstack_paper import rows_barrier, rows_example

    run = ResultTable(results, plants, seed, quick)
    rows = rows_example.rows(run)
    for plant in plants:
        behind = "" if plant == plants[0] else f"-{plant}"
        rows += [*_learning(run, plant, behind), *rows_barrier.flown(run, plant, behind)]
    rows += rows_barrier.formulas(run)
    return rows


def _learning(run: ResultTable, plant: str, behind: str) -> list[ResultLine]:
    """Section V.A on one plant."""
    rows = [_ratio(run, plant, behind)]
    rows += [_against(run, plant, pilot, behind) for pilot in PILOTS if pilot not in ("learning", "none")]
    if plant == run.plants[0]:
        rows.append(_inference(run, plant))
    rows.append(_inputs(run, plant, "paper", f"inputs-without-position-ratio{behind}", ""))
    if inputs_name(plant, "air") in run.results:
        rows.append(_inputs(run, plant, "air", f"inputs-without-position-ratio-air{behind}", "drag, lift and wind: "))
        rows.append(_inputs(run, plant, "ground", f"inputs-without-position-ratio-ground{behind}", "ground effect: "))
    return rows


def _ratio(run: ResultTable, plant: str, behind: str) -> ResultLine:
    learning, none = run.tracking(plant, "learning"), run.tracking(plant, "none")

    def make(*flights: dict[str, Any]) -> Cell:
        with_it, without = flights[: len(learning)], flights[len(learning) :]
        ratio = middle(with_it) / middle(without)
        return ratio, ratio < 0.5, (
            f"settled rms error {100 * middle(with_it):.2f} cm with, {100 * middle(without):.1f} cm without the process"
            f"{_over(len(with_it))}; 'significantly' is read as less than half{run.on(plant)}"
        )  # fmt: skip

    claim = "with the Gaussian process the tracking error is significantly smaller than without (Fig. 5)"
    return run.row(f"tracking-rmse-ratio{behind}", claim, None, "1", (*learning, *none), make)


def _against(run: ResultTable, plant: str, pilot: str, behind: str) -> ResultLine:
    learning, others = run.tracking(plant, "learning"), run.tracking(plant, pilot)

    def make(*flights: dict[str, Any]) -> Cell:
        ours, theirs = middle(flights[: len(learning)]), middle(flights[len(learning) :])
        return (
            ours / theirs,
            ours < theirs,
            (
                f"settled rms error {100 * ours:.2f} cm against {100 * theirs:.2f} cm of {PILOTS[pilot]}"
                f"{_over(len(others))}; the paper flies no such baseline{run.on(plant)}"
            ),
        )

    claim = f"learning tracks better than {PILOTS[pilot]}"
    return run.row(f"tracking-rmse-over-{pilot}{behind}", claim, None, "1", (*learning, *others), make)


def middle(flights: tuple[dict[str, Any], ...]) -> float:
    """Median settled error, m."""
    errors = sorted(float(flight["rmse_settled_m"]) for flight in flights)
    count = len(errors)
    return 0.5 * (errors[(count - 1) // 2] + errors[count // 2])


def _over(count: int) -> str:
    return f" (medians of {count} seeds)" if count > 1 else ""


def _inference(run: ResultTable, plant: str) -> ResultLine:
    def make(flight: dict[str, Any]) -> Cell:
        found = flight["inference"]
        return found["max_ms"], found["max_ms"] < 20.0, (
            f"processor time of the longest of {found['iterations']} iterations with {found['points']} points over the "
            f"flown track: median {1000 * found['p50_ms']:.0f} us, 99 % {1000 * found['p99_ms']:.0f} us; by the clock, "
            f"the machine's other programs included, {found['clock_max_ms']:.1f} ms"
        )  # fmt: skip

    claim = "one iteration of the recursive process with 300 points is always below 20 ms (Fig. 6)"
    return run.row("gp-step-ms-max", claim, 20.0, "ms", run.tracking(plant, "learning")[:1], make)


def _inputs(run: ResultTable, plant: str, world: str, row_id: str, where: str) -> ResultLine:
    def make(study: dict[str, Any]) -> Cell:
        rows = study["rows"]
        far = max(row["displacement_m"] for row in rows)
        error = {row["inputs"]: row["error_mps2"] for row in rows if row["displacement_m"] == far}
        near = {row["inputs"]: row["error_mps2"] for row in rows if row["displacement_m"] == 0.0}
        ratio, without = error[WITHOUT] / error[WITH], error[WITHOUT]
        more = "".join(f", {name} {value:.3f}" for name, value in error.items() if name not in (WITH, WITHOUT))
        return ratio, ratio < 0.5, (
            f"{where}rms error of prediction {far:g} m away {without:.3f} ({WITHOUT}) against "
            f"{error[WITH]:.3f} m/s^2 ({WITH}){more}; on the learned path {near[WITHOUT]:.3f} and {near[WITH]:.3f}; "
            f"'much better' is read as half the error{run.on(plant)}"
        )  # fmt: skip

    claim = "in regions not explored before, learning without position (q') scales much better than with it (q)"
    return run.row(row_id, claim, None, "1", (inputs_name(plant, world),), make)
