"""What `make bench` measures beside its parts: others' means for the same piece, and a floor, of what is installed."""

from __future__ import annotations

import importlib.util
import io
import itertools
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from mcap.writer import Writer
from pymavlink.dialects.v20 import common

from benchmarks import gp_peers, plant
from flightstack.gp.panel import aligned, padded, triangle, update_multiply
from flightstack.types import F64

Work = Callable[[], int]
"""Does some work; how many pieces that were."""
POINTS, INPUTS, OUTPUTS, NOISE = 300, 9, 6, 0.01
SCALES = np.linspace(1.0, 2.0, INPUTS)


def points() -> tuple[F64, F64]:
    """(2 POINTS, INPUTS) and (2 POINTS, OUTPUTS): what comes into the process, half of it held at first."""
    rng = np.random.default_rng(0)
    return rng.normal(size=(2 * POINTS, INPUTS)), rng.normal(size=(2 * POINTS, OUTPUTS))


def of_the_process() -> Iterator[tuple[str, Work]]:
    """An exchange and a prediction of the Gaussian process; the floor is its one pass over the matrix."""
    size = padded(POINTS)
    matrix, rows = aligned(1, triangle(size))[0], aligned(8, size)

    def floor() -> int:
        for _ in range(300):
            update_multiply(matrix, size, rows, rows[4], rows[5])
        return 300

    yield "floor: rank-2 update and product", floor
    peers = [("SciPy, refit", gp_peers.cholesky_refit)]
    if importlib.util.find_spec("sklearn") is not None:
        peers.append(("scikit-learn, refit", gp_peers.sklearn_refit))
    x, y = points()
    for name, make in peers:
        step = make(x[:POINTS], y[:POINTS], SCALES, NOISE)

        def steps(step: gp_peers.Step = step) -> int:
            for k in range(20):
                step(x[POINTS + k], y[POINTS + k], x[POINTS + k])
            return 20

        yield name, steps


def of_the_link() -> Iterator[tuple[str, Work]]:
    """A HIGHRES_IMU packed, and parsed at the other end."""
    ours, theirs = common.MAVLink(None, 1, 1), common.MAVLink(None, 240, 191)
    message = common.MAVLink_highres_imu_message(
        1, 0.1, 0.2, -9.8, 0.01, 0.02, 0.03, 0.2, 0.0, 0.4, 1013.0, 0.0, 488.0, 25.0, 63
    )

    def both_ends() -> int:
        for _ in range(200):
            theirs.parse_buffer(message.pack(ours))
        return 200

    yield "pymavlink", both_ends


def of_the_plant() -> Iterator[tuple[str, Work]]:
    """A step of 1 ms of a rigid body under four rotors' forces."""
    if importlib.util.find_spec("jsbsim") is not None:
        with tempfile.TemporaryDirectory() as folder:
            yield "JSBSim, a rigid body", plant.jsbsim_step(Path(folder))


def of_the_log(row: bytes) -> Iterator[tuple[str, Work]]:
    """A message as long as a row, chunks (zstd) included, into memory."""
    writer = Writer(io.BytesIO())
    writer.start()
    schema = writer.register_schema("row", "", b"")
    channel = writer.register_channel("/row", "", schema)
    stamps = itertools.count(step=4_000_000)

    def work() -> int:
        for _ in range(1000):
            now_ns = next(stamps)
            writer.add_message(channel, now_ns, row, now_ns)
        return 1000

    yield "mcap.Writer", work
