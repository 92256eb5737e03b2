"""The vertical slice's largest safe set on a grid, by hj_reachability: what a certificate's region is held against.

The states from which a braking command keeps |e| <= limit: the viability kernel of a double integrator, whose area is
known exactly (`viability.area`).  A grid's value is no proof: nothing is said of what lies between its nodes.
"""

from __future__ import annotations

import time

import numpy as np

from flightstack.barrier import viability

_NODES = (51, 101)
_HORIZON_S = 1.2
"""Longer than any stop of the slice takes: the value changes no more."""
_RUNS = 5


def grids(limit_m: float, u_low_mps2: float, u_high_mps2: float) -> str:
    """A table of times and areas; one line that says so where hj_reachability is not installed."""
    try:
        import hj_reachability as hj
        import jax.numpy as jnp
    except ImportError:
        return "hj_reachability is not installed: no grid"

    class Slice(hj.ControlAndDisturbanceAffineDynamics):  # type: ignore[misc]
        def __init__(self) -> None:
            none = hj.sets.Box(jnp.zeros(1), jnp.zeros(1))
            super().__init__("max", "min", hj.sets.Box(jnp.array([u_low_mps2]), jnp.array([u_high_mps2])), none)

        def open_loop_dynamics(self, state: object, time: float) -> object:
            return jnp.array([state[1], 0.0])  # type: ignore[index]

        def control_jacobian(self, state: object, time: float) -> object:
            return jnp.array([[0.0], [1.0]])

        def disturbance_jacobian(self, state: object, time: float) -> object:
            return jnp.zeros((2, 1))

    half = np.array([1.3 * limit_m, 1.3 * np.sqrt(2.0 * 2.0 * limit_m * max(u_high_mps2, -u_low_mps2))])
    settings = hj.SolverSettings.with_accuracy("very_high", hamiltonian_postprocessor=lambda x: jnp.minimum(x, 0.0))
    kernel = viability.area(-limit_m, limit_m, u_low_mps2, u_high_mps2)
    rows = ["| grid of hj_reachability | ms p50 (compiled before) | area | of the kernel |", "|---|---|---|---|"]
    for nodes in _NODES:
        grid = hj.Grid.from_lattice_parameters_and_boundary_conditions(hj.sets.Box(-half, half), (nodes, nodes))
        kept, took = limit_m - jnp.abs(grid.states[..., 0]), []
        for _ in range(_RUNS + 1):
            begin = time.perf_counter()
            value = hj.step(settings, Slice(), grid, 0.0, kept, -_HORIZON_S, progress_bar=False).block_until_ready()
            took.append(1e3 * (time.perf_counter() - begin))
        area = float((value >= 0.0).sum()) * float(np.prod(2.0 * half / (nodes - 1)))
        rows.append(f"| {nodes} x {nodes} | {np.median(took[1:]):.0f} | {area:.3f} | {area / kernel:.3f} |")
    return "\n".join(rows)
