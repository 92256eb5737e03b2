"""Many short simulations at once, each from a measured state, all driven by the logged commands.

Output error takes them in windows: what sensors and simulations gather in their pieces.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flightstack.effects import accelerometer_bias, attitude_misalignment, gyro_bias
from flightstack.effects.row import (
    D_DELAY_STEPS,
    P_RESISTANCE,
    S_CHARGE,
    S_CURSOR,
    S_LOAD_DIR,
    S_POS,
    S_Q,
    S_RATE,
    S_RING,
    S_VEL,
)
from flightstack.gap.evaluated import run_windows
from flightstack.gap.naming.inputs import with_sharp_commands, with_smooth_commands
from flightstack.gap.records import Samples
from flightstack.gap.run import ModelEvaluation, first_command, params_row, true_attitude, with_added_delay
from flightstack.gap.track import ProcessedFlight, track
from flightstack.types import F64
from flightstack.vehicle import Vehicle
from flightstack_logs.turn import multiply, rotate_inverse


@dataclass(frozen=True, slots=True, eq=False)
class Rollout:
    """S simulations over n samples: (S, n + 1, ...).

    Positions and velocities over ground; attitude, rates and specific force as the sensors would show them.
    """

    starts: NDArray[np.int64]
    """(S,) index of the sample where each begins."""
    pos_ned_m: F64
    vel_ned_mps: F64
    q_ned_frd: F64
    rate_frd_radps: F64
    force_frd_mps2: F64
    """Mean since the sample before; 0 at the start."""


def rollout(vehicle: Vehicle, samples: Samples, starts: Sequence[int] | NDArray[np.int64], horizon_s: float) -> Rollout:
    """Simulate from the measured state at each of these samples for `horizon_s` (rounded to samples)."""
    return rollouts([(vehicle, 0.0)], samples, starts, horizon_s)[0]


def rollouts(
    variants: Sequence[tuple[Vehicle, float]],
    samples: Samples,
    starts: Sequence[int] | NDArray[np.int64],
    horizon_s: float,
) -> list[Rollout]:
    """`rollout` of several vehicles, each with its commands acting so much later (s), over the same starts at once."""
    flight = track(samples)
    at = np.asarray(starts, dtype=np.int64)
    steps = max(1, round(horizon_s / samples.dt_s))
    at = at[at + steps < len(samples.t_s)]
    batch = _Batch(variants, flight, at)
    shown, force = batch.run(steps)
    return [
        _as_shown(batch.params[i * len(at)], at, shown[own], force[own])
        for i in range(len(variants))
        if len(at) > 0
        for own in (slice(i * len(at), (i + 1) * len(at)),)
    ]


def _as_shown(p: F64, at: NDArray[np.int64], state: F64, force: F64) -> Rollout:
    misalignment = attitude_misalignment.rotation(p)
    q = multiply(state[:, :, S_Q : S_Q + 4], misalignment)
    turned = rotate_inverse(misalignment, force)
    return Rollout(
        at,
        state[:, :, S_POS : S_POS + 3],
        state[:, :, S_VEL : S_VEL + 3],
        q,
        state[:, :, S_RATE:S_LOAD_DIR] + gyro_bias.bias(p),
        turned + accelerometer_bias.bias(p),
    )


class _Batch:
    """State and parameter rows of V variants times S starts, variant by variant."""

    __slots__ = ("_at", "_commands", "_driven", "_voltage", "params", "state")

    def __init__(
        self, variants: Sequence[tuple[Vehicle, float]], flight: ProcessedFlight, at: NDArray[np.int64]
    ) -> None:
        self._at = at
        rows = [params_row(vehicle, flight.step_s) for vehicle, _ in variants]
        entries = int(np.ceil(max(p[D_DELAY_STEPS] for p in rows))) + 2
        self.params = np.repeat(np.stack(rows), len(at), axis=0)
        self.params[:, P_RESISTANCE] = 0.0  # the voltage is the log's
        self.state = np.zeros((len(self.params), S_RING + 4 * entries))
        shifted = {0.0: flight}
        driven: dict[tuple[int, int], int] = {}
        self._driven: list[int] = []
        self._voltage: list[F64] = []
        self._commands: list[F64] = []
        for i, ((_, late_s), p) in enumerate(zip(variants, rows, strict=True)):
            if late_s not in shifted:
                shifted[late_s] = with_added_delay(flight, late_s)
            moved = shifted[late_s]
            own = self.state[i * len(at) : (i + 1) * len(at)]
            run = ModelEvaluation(p, moved)
            own[:, :S_RING] = run.states(at)
            own[:, S_Q : S_Q + 4] = true_attitude(p, flight)[at]
            own[:, S_RATE : S_RATE + 3] = (flight.rate_frd_radps - gyro_bias.bias(p))[at]
            own[:, S_RING:] = _ring(moved, at, entries)
            key = (id(moved.commands), id(run.voltage))
            if key not in driven:
                driven[key] = len(self._commands)
                self._voltage.append(run.voltage)
                self._commands.append(moved.commands)
            self._driven.append(driven[key])
        self.state[:, S_CURSOR] = entries - 1
        self.state[:, S_CHARGE] = 1.0

    def run(self, steps: int) -> tuple[F64, F64]:
        """What the rows show (V S, steps + 1, S_LOAD_DIR), and their mean specific forces (V S, steps + 1, 3)."""
        shown = np.empty((len(self.state), steps + 1, S_LOAD_DIR))
        force = np.zeros((len(self.state), steps + 1, 3))
        start = np.tile(self._at, len(self._driven))
        driven = np.repeat(np.array(self._driven, dtype=np.int64), len(self._at))
        commands, voltage = np.stack(self._commands), np.stack(self._voltage)
        run_windows(self.state, self.params, start, driven, commands, voltage, shown, force)
        return shown, force


def _ring(flight: ProcessedFlight, at: NDArray[np.int64], entries: int) -> F64:
    """(S, 4 * entries) the commands before each start, the newest last."""
    before = at[:, None] * flight.every - np.arange(entries, 0, -1)[None, :]
    commands = flight.commands[np.maximum(before, 0)]
    commands[before < 0] = first_command(flight)
    return np.asarray(commands.reshape(len(at), -1))


WINDOW_S = 0.5
PIECE_S = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Windows:
    """One flight's windows and what its sensors gathered in their pieces."""

    flight: ProcessedFlight
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
