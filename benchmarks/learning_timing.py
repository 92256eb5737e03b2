"""Time of one iteration over the number of points held: the paper's figure, on this machine.

An iteration: the oldest of N points leaves, one enters, mean and variance are asked at one query; 9 inputs, 6 outputs
of one factorisation, called from Python; the query is the point that enters next.  (`make bench-gp` has peers and the
machine's floor beside it.)
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from flightstack.gp import RecursiveGP, SquaredExponential

COUNTS = (10, 25, 50, 75, 100, 150, 200, 250, 300)
INPUTS, OUTPUTS = 9, 6
PAPER_S = 0.02
"""The paper: below 20 ms, MATLAB, 2017."""
_NOISE_VAR = 1e-4


def timing(steps: int = 3000) -> list[dict[str, Any]]:
    """Median and 99th percentile for each number of points, microseconds."""
    t = np.arange(steps + max(COUNTS) + 1)[:, None] / 250.0
    x = 1.5 * np.sin(t * np.linspace(0.4, 1.2, INPUTS) + np.arange(INPUTS))
    y = np.sin(x[:, :OUTPUTS])
    rows = []
    for count in COUNTS:
        gp = RecursiveGP(
            SquaredExponential(1.0, tuple(np.linspace(1.0, 2.0, INPUTS).tolist())),
            _NOISE_VAR,
            input_dim=INPUTS,
            output_dim=OUTPUTS,
            capacity=count,
        )
        gp.add(x[:count], y[:count])
        micros = np.empty(steps)
        for i in range(steps):
            began = time.perf_counter_ns()
            gp.remove(gp.oldest())
            gp.add(x[count + i], y[count + i])
            gp.predict(x[count + i + 1])
            micros[i] = 1e-3 * (time.perf_counter_ns() - began)
        p50, p99 = np.percentile(micros[steps // 10 :], [50, 99])
        rows.append({"points": count, "p50_us": float(p50), "p99_us": float(p99)})
    return rows
