"""Windows of a flight for output error: where they start, what sensors and simulations gather in their pieces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flightstack.gap.naming.inputs import with_sharp_commands, with_smooth_commands
from flightstack.gap.records import Samples
from flightstack.gap.rollouts import Rollout
from flightstack.gap.track import Track, track
from flightstack.types import F64
from flightstack.vehicle import Vehicle

WINDOW_S = 0.5
PIECE_S = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Windows:
    """One flight's windows and what its sensors gathered in their pieces."""

    flight: Track
    starts: NDArray[np.int64]
    edges: NDArray[np.int64]
    """(n + 1,) samples after a start, where pieces begin and end."""
    gathered: F64
    """(S, n, 6) integrals of specific force (m/s) and changes of rate (rad/s)."""
    sharp: Samples
    """The flight with its commands curved between their stamps."""
    smooth: Samples
    """The flight without the noise on its commands."""


def windows_of(vehicle: Vehicle, samples: Samples, mask: NDArray[np.bool_], most: int) -> Windows:
    """Windows one after another over the masked samples (N,), at most so many, spread evenly."""
    flight = track(samples)
    good = mask & flight.usable
    piece = max(1, round(PIECE_S / samples.dt_s))
    steps = piece * max(2, round(WINDOW_S / samples.dt_s / piece))
    starts, k = [], 0
    bad = np.concatenate([[0], np.cumsum(~good)])
    while k + steps + 1 < len(good):
        if bad[k + steps + 1] == bad[k]:
            starts.append(k)
            k += steps
        else:
            k += 1
    chosen = np.array(starts, dtype=np.int64)
    if len(chosen) > most:
        chosen = chosen[np.linspace(0, len(chosen) - 1, most).astype(np.int64)]
    edges = np.arange(0, steps + 1, piece)
    force = flight.measured[:, 0:3]
    sums = np.zeros_like(force)
    sums[1:] = np.cumsum(0.5 * samples.dt_s * (force[1:] + force[:-1]), axis=0)
    # The gyro as it is: a smoothed one's residuals are so alike from piece to piece that they would count too much.
    derived = "rate_frd_radps" in flight.missing
    rate = flight.turn_frd_radps if derived else np.nan_to_num(samples.rate_frd_radps)
    at = chosen[:, None] + edges[None, :]
    gathered = np.concatenate([np.diff(sums[at], axis=1), np.diff(rate[at], axis=1)], axis=2)
    smooth = with_smooth_commands(samples, vehicle)
    return Windows(flight, chosen, edges, gathered, with_sharp_commands(samples), smooth)


def gathered_by(run: Rollout, windows: Windows) -> F64:
    """(S, n, 6) of a simulation, as `Windows.gathered` has it."""
    sums = np.cumsum(run.force_frd_mps2 * windows.flight.samples.dt_s, axis=1)[:, windows.edges]
    rate = run.rate_frd_radps[:, windows.edges]
    return np.concatenate([np.diff(sums, axis=1), np.diff(rate, axis=1)], axis=2)
