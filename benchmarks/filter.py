"""How fast and how exact the safety filter is: the whole step, its QP alone, and peers on the same problems.

    python benchmarks/filter.py                       timing, beside CVXPY and quadprog where they are installed
    python benchmarks/filter.py --exact               the QP against every active set, minutes: 100,000 random problems
                                                      and 10,000 that are nearly infeasible

Times are of the wall clock, and beside them of the thread's own processor clock, which leaves out what other processes
take.  The problems are those of a filtered flight against an adversary; "always" solves each tick's QP even where the
wanted command is safe.  All solvers see the same rows in one run, so that their ratios hold whatever else the machine
does.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "unit")]

from test_qp import narrow_problems, random_problems, worst_error  # noqa: E402
from test_safety_filter import closed_loop, erratic, outwards  # noqa: E402

from flightstack import safety_filter  # noqa: E402
from flightstack.barrier.qp import NearestPoint  # noqa: E402

Problem = tuple[Any, Any, Any, Any]
Spent = tuple[float, float]
"""Wall and processor time, seconds."""


def now() -> Spent:
    """Both clocks."""
    return time.perf_counter(), time.thread_time()


def since(start: Spent) -> Spent:
    """Spent since then."""
    end = now()
    return end[0] - start[0], end[1] - start[1]


def flights(always: bool) -> tuple[list[Spent], list[Problem]]:
    """Times of each engaged step of two flights and the QPs that were set up."""
    times: list[Spent] = []
    problems: list[Problem] = []
    assess, step = safety_filter._ASSESS, safety_filter.BarrierFilter.step

    def watched(*args: Any) -> int:
        status, (_, rows, low, high), out = assess.call(*args), args[6], args[7]
        if always and status == safety_filter.PASSED:
            status = safety_filter.CHANGED
        if status == safety_filter.CHANGED:
            problems.append((rows.copy(), low.copy(), high.copy(), out[8:11].copy()))
        return int(status)

    def timed(self: Any, state: Any, *args: Any) -> Any:
        start = now()
        result = step(self, state, *args)
        spent = since(start)
        if result[2].status > safety_filter.WAITING:
            times.append(spent)
        return result

    safety_filter._ASSESS = SimpleNamespace(call=watched)  # type: ignore[assignment]
    safety_filter.BarrierFilter.step = timed  # type: ignore[method-assign]
    try:
        for nominal in (outwards, erratic(1)):
            closed_loop(nominal, 4000, seconds=20.0)
    finally:
        safety_filter._ASSESS, safety_filter.BarrierFilter.step = assess, step  # type: ignore[method-assign]
    assert problems
    return times, problems


def timed_each(solve: Callable[..., object], problems: list[Problem]) -> list[Spent]:
    """Time of each problem, one after another."""
    times = []
    for problem in problems:
        start = now()
        solve(*problem)
        times.append(since(start))
    return times


def cvxpy_solver(rows: int, name: str) -> Callable[..., object]:
    """The same QP as a parametrised CVXPY problem, compiled once; only parameters change."""
    import cvxpy as cp

    x, a = cp.Variable(3), cp.Parameter((rows, 3))
    low, high, wanted = cp.Parameter(rows), cp.Parameter(rows), cp.Parameter(3)
    problem = cp.Problem(cp.Minimize(cp.sum_squares(x - wanted)), [a @ x >= low, a @ x <= high])
    options = {"eps_abs": 1e-9, "eps_rel": 1e-9} if name == "OSQP" else {}

    def solve(matrix: Any, least: Any, most: Any, nearest: Any) -> object:
        a.value, low.value, high.value = matrix, np.maximum(least, -1e6), np.minimum(most, 1e6)
        wanted.value = nearest
        problem.solve(solver=name, warm_start=True, **options)
        return x.value

    return solve


def quadprog_solver() -> Callable[..., object]:
    """Goldfarb and Idnani's dual method."""
    import quadprog

    def solve(matrix: Any, least: Any, most: Any, nearest: Any) -> object:
        normals = np.concatenate([matrix, -matrix]).T
        bounds = np.concatenate([np.maximum(least, -1e6), np.maximum(-most, -1e6)])
        return quadprog.solve_qp(np.eye(3), nearest, normals, bounds)[0]

    return solve


def line(name: str, times: list[Spent], reference: float | None = None) -> float:
    """Print p50 and p99 of both clocks and the ratio of the wall's p50 to `reference`; returns that p50, us."""
    micro = 1e6 * np.array(times[20:])
    (half, own), (most, most_own) = np.median(micro, axis=0), np.quantile(micro, 0.99, axis=0)
    ratio = f"{half / reference:8.1f}" if reference else "        "
    print(f"| {name:<46} | {half:8.1f} | {most:8.1f} | {own:8.1f} | {most_own:8.1f} | {ratio} |", flush=True)
    return float(half)


def timing(peers: int) -> None:
    """The table of times."""
    print(f"| {'microseconds':<46} | p50      | p99      | own p50  | own p99  | ratio    |")
    print("| --- | --- | --- | --- | --- | --- |")
    times, _ = flights(always=False)
    line("whole step, as flown", times)
    times, problems = flights(always=True)
    line("whole step, always solving", times)
    solver = NearestPoint(len(problems[0][1]))
    ours = line(f"QP alone ({len(problems)} problems)", timed_each(solver.solve, problems), None)
    some = problems[:: max(len(problems) // peers, 1)]
    for name, make in (
        ("CVXPY with OSQP", lambda: cvxpy_solver(len(some[0][1]), "OSQP")),
        ("CVXPY with Clarabel", lambda: cvxpy_solver(len(some[0][1]), "CLARABEL")),
        ("quadprog", quadprog_solver),
    ):
        try:
            solve = make()
        except ImportError as error:
            print(f"| {name:<46} | not installed: {error.name} |")
            continue
        worst = max(float(np.abs(np.asarray(solve(*p)) - solver.solve(*p).x).max()) for p in some[:200])
        line(f"{name} (differs by {worst:.0e} at most)", timed_each(solve, some), ours)


def exact() -> None:
    """Largest errors against every active set."""
    for name, make, count in (("random", random_problems, 100_000), ("nearly infeasible", narrow_problems, 10_000)):
        worst, failed, most, rng = 0.0, 0, 0, np.random.default_rng(2026)
        for _ in range(count // 1000):
            error, bad, iterations = worst_error(make(rng, 1000))
            worst, failed, most = max(worst, error), failed + bad, max(most, iterations)
        print(f"{count} {name} problems: largest error {worst:.1e}, {failed} not solved, {most} iterations at most")


def main() -> None:
    """Parse and run."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--exact", action="store_true", help="errors against every active set, instead of times")
    parser.add_argument("--peers", type=int, default=2000, help="problems that the slower peers solve")
    options = parser.parse_args()
    exact() if options.exact else timing(options.peers)


if __name__ == "__main__":
    main()
