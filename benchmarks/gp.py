"""How fast is the recursive Gaussian process, and how exact does it stay?  Peers in the same run.

    python benchmarks/gp.py [--json FILE] [--seconds S] [--steps N]

One step: the oldest of N = 300 points leaves, one enters, mean and variance are asked at one query; 9 inputs, 6
outputs, squared exponential with a length-scale for each input, float64, one thread, called from Python.  The path is
smooth, sampled at 250 Hz; unless a row says otherwise the query is the point that enters next.  Contenders take turns
of many steps, so that a busy neighbour is everybody's and yet each finds its own data in the cache, as in a loop of its
own; "alone in a turn" shows the step that doesn't.  Peers that are not installed are skipped, saying so
(`pip install .[bench]`).

Then `--steps` exchanges at three levels of noise, compared with scikit-learn's exact process on the points held.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import platform
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path

os.environ["OMP_NUM_THREADS"] = "1"  # before NumPy is imported
os.environ["OPENBLAS_NUM_THREADS"] = "1"
os.environ["MKL_NUM_THREADS"] = "1"
os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"

import numpy as np
from gp_peers import CholeskyFactor, cholesky_refit, gpytorch_refit, jax_recursion, numpy_block_inverse, sklearn_refit

from flightstack.gp import RecursiveGP, SquaredExponential, least_relevant
from flightstack.gp.panel import aligned, multiply, padded, triangle, update_multiply
from flightstack.jit import njit
from flightstack.types import F64

COUNT, INPUTS, OUTPUTS = 300, 9, 6
RATE_HZ = 250.0
LENGTHSCALES = np.linspace(1.0, 2.0, INPUTS)
Step = Callable[[F64, F64, F64], tuple[F64, F64]]
"""Takes the point that enters, its values and the query; gives mean and variance."""


@dataclass(slots=True)
class Row:
    """One contender: microseconds of each of its steps."""

    system: str
    what: str
    turn: int = 200
    """Steps in a turn."""
    micros: list[float] = field(default_factory=list)

    def percentiles(self) -> tuple[float, float, float]:
        """Least, median and 99th percentile."""
        low, middle, high = np.percentile(self.micros, [0, 50, 99])
        return float(low), float(middle), float(high)


def path(count: int) -> tuple[F64, F64]:
    """(count, 9) inputs and (count, 6) values of a smooth flight."""
    t = np.arange(count)[:, None] / RATE_HZ
    pace = np.array([0.6, 0.9, 0.6, 0.7, 0.45, 1.1, 0.8, 0.33, 0.5])
    x = 1.5 * np.sin(pace * t + np.arange(INPUTS)) + 0.5 * np.sin(2.3 * pace * t)
    y = np.sin(x[:, :OUTPUTS]) + 0.3 * np.roll(x, -1, axis=1)[:, :OUTPUTS]
    return x, y


def ours(noise_var: float, outputs: int = OUTPUTS) -> RecursiveGP:
    """Our process for so many outputs."""
    kernel = SquaredExponential(1.0, tuple(LENGTHSCALES))
    return RecursiveGP(kernel, noise_var, input_dim=INPUTS, output_dim=outputs, capacity=COUNT)


def shared(noise_var: float, x: F64, y: F64, paper_rule: bool = False) -> Step:
    """One factorisation for six outputs; the oldest leaves, or the paper's least relevant."""
    gp = ours(noise_var)
    gp.add(x, y)
    count = 0

    def step(point: F64, value: F64, query: F64) -> tuple[F64, F64]:
        nonlocal count
        gp.remove(least_relevant(gp, point) if paper_rule else gp.oldest())
        gp.add(point, value)
        count += 1
        return gp.predict(query)

    return step


def separate(noise_var: float, x: F64, y: F64) -> Step:
    """Six processes of one output each, as if each had hyper-parameters of its own."""
    gps = [ours(noise_var, 1) for _ in range(OUTPUTS)]
    for i, gp in enumerate(gps):
        gp.add(x, y[:, i : i + 1])

    def step(point: F64, value: F64, query: F64) -> tuple[F64, F64]:
        mean, variance = np.empty(OUTPUTS), np.empty(OUTPUTS)
        for i, gp in enumerate(gps):
            gp.add(point, value[i : i + 1])  # full: the oldest leaves
            mean[i : i + 1], variance[i : i + 1] = gp.predict(query)
        return mean, variance

    return step


def floors() -> Iterator[tuple[Row, Callable[[], object]]]:
    """What the machine can do at best: the pass alone, and merely reading and writing the triangle."""
    size = padded(COUNT)
    matrix, rows = aligned(1, triangle(size))[0], aligned(8, size)
    plain = aligned(1, COUNT * (COUNT + 1) // 2)[0]
    yield (
        Row("floor", "rank-2 update and product, one pass"),
        lambda: update_multiply(matrix, 304, rows, rows[4], rows[5]),
    )
    yield Row("floor", "product, one pass"), lambda: multiply(matrix, 304, rows[4], rows[5])
    yield Row("floor", "triangle read and written once"), lambda: _touch(plain)
    yield Row("floor", "a call of compiled code that does nothing"), lambda: _nothing(matrix, rows)


@njit
def _touch(values: F64) -> None:
    for i in range(len(values)):
        values[i] = values[i] * 0.5 + 1.0


@njit
def _nothing(matrix: F64, rows: F64) -> None:
    rows[0, 0] = 0.0


def contenders(x: F64, y: F64) -> Iterator[tuple[Row, Step, bool]]:
    """Everybody, filled with the first points, and whether the query lies off the path."""
    own = "flightstack"
    yield Row(own, "shared, noise 1e-2"), shared(1e-2, x, y), False
    yield Row(own, "shared, noise 1e-4"), shared(1e-4, x, y), False
    yield Row(own, "shared, noise 1e-2, query off the path"), shared(1e-2, x, y), True
    yield Row(own, "shared, noise 1e-2, the paper's relevance"), shared(1e-2, x, y, paper_rule=True), False
    yield Row(own, "shared, noise 1e-2, alone in a turn", 1), shared(1e-2, x, y), False
    yield Row(own, "six separate, noise 1e-2"), separate(1e-2, x, y), False
    peers: list[tuple[str, str, str, Callable[..., Step], int]] = [
        ("numba", "Cholesky factor up- and down-dated", "numba", CholeskyFactor, 50),
        ("NumPy", "block inverse, the paper's, corrected", "numpy", numpy_block_inverse, 20),
        ("SciPy", "Cholesky refit", "scipy", cholesky_refit, 20),
        ("JAX", "block inverse, compiled", "jax", jax_recursion, 40),
        ("scikit-learn", "refit", "sklearn", sklearn_refit, 8),
        ("GPyTorch", "refit, outputs as a batch", "gpytorch", gpytorch_refit, 2),
    ]
    for name, what, module, make, turn in peers:
        if importlib.util.find_spec(module) is None:
            print(f"{name}: skipped, not installed")
            continue
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield Row(name, what, turn), make(x, y, LENGTHSCALES, 1e-2), False


def measure(seconds: float) -> list[Row]:
    """All contenders in turn for so many seconds; their answers must agree."""
    x, y = path(1_000_000)
    entrants = list(contenders(x[:COUNT], y[:COUNT]))
    runs = [_stepper(row, step, off, x, y) for row, step, off in entrants]
    answers = [[run(timed=False) for _ in range(3)][-1] for run in runs]
    for (row, _, off), (mean, variance) in zip(entrants, answers, strict=True):
        exact = answers[0]
        agree = np.allclose(mean, exact[0], rtol=1e-5, atol=1e-6) and np.allclose(variance, exact[1], rtol=1e-3)
        if not agree and not off and "1e-4" not in row.what and "relevance" not in row.what:
            print(f"{row.system}, {row.what}: does another computation")
    bases = list(floors())
    began = time.perf_counter()
    while time.perf_counter() - began < seconds:
        for (row, _, _), run in zip(entrants, runs, strict=True):
            if row.turn > 1:
                run(timed=False)
            for _ in range(row.turn):
                run(timed=True)
        for row, base in bases:
            base()
            for _ in range(row.turn):
                start = time.perf_counter()
                base()
                row.micros.append(1e6 * (time.perf_counter() - start))
    return [row for row, _, _ in entrants] + [row for row, _ in bases]


def _stepper(row: Row, step: Step, off: bool, x: F64, y: F64) -> Callable[..., tuple[F64, F64]]:
    """One step along the path, and its time into the row."""
    now = COUNT

    def run(timed: bool) -> tuple[F64, F64]:
        nonlocal now
        query = x[now + 1] + 0.3 if off else x[now + 1]
        start = time.perf_counter()
        answer = step(x[now], y[now], query)
        if timed:
            row.micros.append(1e6 * (time.perf_counter() - start))
        now += 1
        return answer

    return run


def show(rows: list[Row]) -> None:
    """The table, with each median over ours (shared, noise 1e-2)."""
    print(
        f"\none step, microseconds; {platform.platform()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    )
    print(f"| {'system':<12} | {'what':<44} | {'min':>8} | {'median':>8} | {'p99':>8} | {'x ours':>7} | steps |")
    print(f"| {'-' * 12} | {'-' * 44} | {'-' * 8} | {'-' * 8} | {'-' * 8} | {'-' * 7} | --- |")
    base = rows[0].percentiles()[1]
    for row in rows:
        low, middle, high = row.percentiles()
        print(
            f"| {row.system:<12} | {row.what:<44} | {low:8.1f} | {middle:8.1f} | {high:8.1f} | {middle / base:7.2f} "
            f"| {len(row.micros)} |"
        )


def drift(steps: int) -> list[dict[str, float]]:
    """After many exchanges, the largest differences from scikit-learn's exact process on the points held."""
    if importlib.util.find_spec("sklearn") is None:
        print("drift: skipped, scikit-learn is not installed")
        return []
    x, y = path(steps + COUNT + 2)
    return [_drift(noise_var, x, y, steps) for noise_var in (1e-2, 1e-4, 1e-6)]


def _drift(noise_var: float, x: F64, y: F64, steps: int) -> dict[str, float]:
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF

    gp, least = ours(noise_var), np.inf
    gp.add(x[:COUNT], y[:COUNT])
    worst = np.zeros(4)
    for i in range(COUNT, COUNT + steps):
        gp.add(x[i], y[i])  # full: the oldest leaves
        mean, variance = gp.predict(x[i + 1])
        least = min(least, float(variance[0]))
        if (i - COUNT) % max(1, steps // 50) == 0 or i == COUNT + steps - 1:
            exact = GaussianProcessRegressor(RBF(LENGTHSCALES), alpha=noise_var, optimizer=None).fit(gp.x, gp.y)
            for place, query in enumerate((x[i + 1], x[i + 1] + 0.3)):
                mean, variance = gp.predict(query)
                true_mean, true_sigma = exact.predict(query[None], return_std=True)
                worst[place] = max(worst[place], np.abs(mean - true_mean[0]).max() / np.abs(true_mean).max())
                worst[2 + place] = max(worst[2 + place], np.abs(variance / np.ravel(true_sigma)[0] ** 2 - 1.0).max())
    health = gp.health
    result = {
        "noise_var": noise_var, "steps": float(steps), "mean": worst[0], "mean_off_path": worst[1],
        "variance": worst[2], "variance_off_path": worst[3], "least_variance": least,
        "worst_drift": health.worst_drift, "rebuilt": float(health.rebuilt), "clipped": float(health.clipped),
    }  # fmt: skip
    print("  ".join(f"{name} {value:.2g}" for name, value in result.items()), flush=True)
    return result


def main() -> None:
    """Measure, print, and write the rows as JSON where asked."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--json", metavar="FILE", help="write the rows there")
    parser.add_argument("--seconds", type=float, default=30.0, help="time spent on the steps (default 30)")
    parser.add_argument("--steps", type=int, default=100_000, help="exchanges at each noise (default 100000)")
    arguments = parser.parse_args()
    rows = measure(arguments.seconds)
    show(rows)
    print("\nlargest relative differences from scikit-learn on the points held")
    drifts = drift(arguments.steps)
    if arguments.json:
        machine = {"platform": platform.platform(), "cores": os.cpu_count(), "python": platform.python_version()}
        table = [{**asdict(row), "micros": None, "percentiles": row.percentiles()} for row in rows]
        result = {"schema": "flightstack.benchmark/1", "machine": machine, "rows": table, "drift": drifts}
        Path(arguments.json).write_text(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
