"""What tests call compiled and no verb does, compiled before they begin: each of their processes would compile it.

`make test` runs it after the linting, while another process still compiles what the verbs call.
"""

from __future__ import annotations

import numpy as np
from numba.core import sigutils

from benchmarks import gap_flights
from benchmarks.oracle import Oracle
from flightstack.cli.controllers import CONTROLLERS
from flightstack.cli.flight import FlyOptions, prepare
from flightstack.gp import (
    Kernel,
    Linear,
    Matern,
    RecursiveGP,
    SquaredExponential,
    affine_in,
    least_relevant,
    log_marginal_likelihood,
    program,
)
from flightstack.imu_bias import ImuBias
from flightstack.model import Model
from flightstack.quick_compiling import quick_compiling
from flightstack.trajectory import hover
from flightstack.types import Command
from flightstack.vehicle import with_effects
from flightstack_sim.batch import BatchClosedLoop, BatchPlant
from flightstack_sim.plant import NativePlant
from tests.gap_flights import quad
from tests.unit.measured import measured


def batches() -> None:
    """Fleets with and without effects in the loop, gusts among them; one vehicle, by a step and by many."""
    windy = with_effects(quad(), {"turbulence": {"sigma_mps": 1.0, "length_m": 10.0}, "payload": {"mass_kg": 0.1}})
    path = np.array([hover((0.0, 0.0, -2.0)).at(0.0).row] * 2)
    alone = NativePlant(quad(), seed=0)
    alone.run(np.full(4, 0.6), 1)
    alone.step(np.full(4, 0.6))
    for vehicle in (quad(), windy):
        BatchPlant([vehicle], seed=0).step(np.full((1, 4), 0.6))
        BatchClosedLoop(quad(), [vehicle]).fly(path)


def processes() -> None:
    """Gaussian processes of every kind of kernel, as Python calls them."""
    x, y = np.linspace(0.0, 1.0, 12).reshape(6, 2), np.ones((6, 1))
    kernels: tuple[Kernel, ...] = (
        SquaredExponential(1.0, (1.0, 2.0)) + Linear(0.2, 0),
        affine_in(1, SquaredExponential(0.5, 1.0, columns=(0,)), Matern(2.5, 1.0, 0.7)),
    )
    for kernel in kernels:
        process = RecursiveGP(kernel, 0.01, input_dim=2, output_dim=1, capacity=5)
        process.add(x, y)
        process.predict(x[0])
        process.rebuild()
        process.remove(least_relevant(process, x[1]))
        process.remove(0)
        log_marginal_likelihood(kernel, 0.01, x, y)
        flat, lines = kernel.program(2), np.empty((2, len(x)))
        program.gradient(flat, x, np.eye(len(x)))
        work = np.empty((program.WORK_ROWS, len(x)))
        program.row(
            (flat.ints, flat.floats), np.ascontiguousarray(x.T), len(x), (x[0], x[1]), work, (lines[0], lines[1]), True
        )


def small_ones() -> None:
    """Every controller, the exact model, and the watch over the bias that a filter takes out."""
    for controller in CONTROLLERS:
        prepare(FlyOptions(scenario="hover", controller=controller)).flight.warm_up()
    oracle, rest = Oracle(Model.from_vehicle(quad()), quad()), hover((0.0, 0.0, -2.0)).at(0.0)
    still, level = np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])
    seen = measured(0, still, still, level, still, still, np.full(4, np.nan), 0, 0, 0)
    oracle.step(oracle.init(), seen, Command(0, 0.0, 0.0, still), rest)
    bias = ImuBias()
    for k in range(600):
        bias.reported((0.0, 0.0, -9.8))
        bias.raw(4000 * k, (0.0, 0.0, -9.8))
        _ = bias.bias_frd_mps2


def drawn_flights() -> None:
    """The loop that flies the gap workflow's drawn cases."""
    kinds = "(f8[::1], f8[::1], f8[::1], i8, f8[:,::1], f8[::1], f8[::1], f8[::1], f8[:,::1], f8[:,::1], f8[:,::1])"
    gap_flights._fly.compile(sigutils.normalize_signature(kinds)[0])  # numba keeps a text's code under the text


if __name__ == "__main__":
    with quick_compiling():
        for work in (batches, drawn_flights, small_ones, processes):
            work()
