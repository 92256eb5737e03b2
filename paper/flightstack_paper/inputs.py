"""The paper's study of inputs: q = (position, velocity, thrust direction) against q' = q without position.

A flight with no learner gives samples; a process is trained on its windows and then asked for the residual of another
flight: the same path, displaced.  Hyper-parameters are those of greatest marginal likelihood on the training flight,
for either set of inputs, axis by axis; errors are against the simulator's truth, of a window's mean.

Three worlds: the paper's (a wrong mass and a constant force, on the paper's own path), forces of the air, which do not
depend on position either, and ground effect, which does depend on height.  There q' lacks something, and the learner's
own seventh input, nearness of the ground, is the third set.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from flightstack.cli.flight import FlyOptions, prepare
from flightstack.cli.track import TickTrace, fly_track
from flightstack.gp import RecursiveGP, SquaredExponential
from flightstack.gp.likelihood import fit
from flightstack.learning import sampler as s
from flightstack.learning.learned_row import fits
from flightstack.learning.learner import LearnerConfig
from flightstack.learning.sampler import Sampler
from flightstack.model import Model
from flightstack.types import F64

POINTS = 300
_POSITION = (0, 1, 2)
_STATE = tuple(3 + column for column in (s.V_X, s.V_Y, s.V_Z, s.AXIS_N, s.AXIS_E))
SETS: dict[str, tuple[int, ...]] = {
    "q'": _STATE,
    "q": (*_POSITION, *_STATE),
    "q' and nearness of the ground": (*_STATE, 3 + s.GROUND),
}
"""Name -> columns of (position, the sampler's inputs)."""
_SCENARIO = """schema = "flightstack.scenario/1"
name = "displaced"
description = "a path, displaced"
duration_s = {duration_s}
[trajectory]
kind = "sinusoid"
centre_m = {centre}
amplitude_m = {amplitude}
rate_radps = {rate}
phase_rad = {phase}
{limits}
{truth}
"""


@dataclass(frozen=True, slots=True)
class World:
    """A path, what acts on it, and how far it is displaced (north-east-down for each metre)."""

    words: str
    centre_m: tuple[float, float, float]
    amplitude_m: tuple[float, float, float]
    rate_radps: tuple[float, float, float]
    phase_rad: tuple[float, float, float]
    truth: str
    """The scenario's tables of the truth."""
    towards: tuple[float, float, float]
    displacements_m: tuple[float, ...]
    limits: str = ""

    def scenario(self, displacement_m: float, duration_s: float) -> str:
        """The text of the scenario file."""
        centre = np.asarray(self.centre_m) + displacement_m * np.asarray(self.towards)
        parts = {"centre": centre, "amplitude": self.amplitude_m, "rate": self.rate_radps, "phase": self.phase_rad}
        lists = {name: np.asarray(part, dtype=np.float64).tolist() for name, part in parts.items()}
        return _SCENARIO.format(duration_s=duration_s, truth=self.truth, limits=self.limits, **lists)


_W = 2.0 * np.pi / 8.0
WORLDS: dict[str, World] = {
    "paper": World(
        "the paper's path, mass and force, displaced to the north-east",
        (0.0, 0.0, -1.5),
        (1.5, 1.0, 0.5),
        (0.6, 0.9, 0.6),
        (0.0, 0.0, 0.0),
        "[truth]\nmass_ratio = 1.4\nconstant_force_weights = [0.1, 0.0, 0.0]",
        (np.sqrt(0.5), np.sqrt(0.5), 0.0),
        (0.0, 0.5, 1.0, 2.0, 4.0),
        limits="[limits]\nthrust_max_weights = 1.8",
    ),
    "air": World(
        "drag, lift and 6 m/s of wind on a figure of eight of 3 m x 1.5 m, displaced to the north-east",
        (0.0, 0.0, -2.0),
        (3.0, 1.5, 0.0),
        (_W, 2.0 * _W, 0.0),
        (0.0, 0.0, 0.0),
        "[truth.effects]\n"
        "rotor_drag = { k_d_kg_per_rad = 1.6e-4 }\n"
        "translational_lift = { k_h_kg_per_m = 4.0e-3 }\n"
        "steady_wind = { north_mps = 4.24, east_mps = 4.24 }",
        (np.sqrt(0.5), np.sqrt(0.5), 0.0),
        (0.0, 0.5, 1.0, 2.0, 4.0, 8.0),
    ),
    "ground": World(
        "ground effect on low passes, raised",
        (0.0, 0.0, -0.35),
        (2.0, 0.0, -0.2),
        (np.pi / 2.0, 0.0, np.pi),
        (0.75 * np.pi, 0.0, np.pi),
        "[truth.effects]\nground_effect = { strength = 3.0 }",
        (0.0, 0.0, -1.0),
        (0.0, 0.05, 0.1, 0.2, 0.4),
    ),
}
TRAIN_S, TEST_S = 20.0, 16.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Study:
    """One study: where, from which seed, how far displaced, how long the flights are, on which plant."""

    world: str
    seed: int
    displacements_m: tuple[float, ...] = ()
    """None named: the world's own."""
    train_s: float = TRAIN_S
    test_s: float = TEST_S
    plant: str = "native"


def study(
    asked: Study,
    *,
    stop_requested: Callable[[], str] = lambda: "",
    on_progress: Callable[[float, str], None] = lambda share, phase: None,
) -> list[dict[str, Any]]:
    """Errors of prediction of each set of inputs at each displacement: rows for the results.

    Raises RuntimeError where a flight did not complete.
    """
    place = WORLDS[asked.world]
    displacements = asked.displacements_m or place.displacements_m
    flights = [(0.0, asked.train_s, asked.seed), *((far, asked.test_s, asked.seed + 500) for far in displacements)]
    flown = []
    for number, (far, duration_s, seed) in enumerate(flights):
        on_progress(number / (len(flights) + 1), f"displaced by {far:g} m")
        flown.append(samples(place, far, duration_s, seed, asked.plant, stop_requested))
    (train_x, train_y, _), *tests = flown
    sets = [name for name in SETS if asked.world == "ground" or s.GROUND + 3 not in SETS[name]]
    rows: list[dict[str, Any]] = []
    for name in sets:
        columns = list(SETS[name])
        processes = [trained(train_x[:, columns], train_y[:, axis]) for axis in range(3)]
        for displacement, (x, _, truth) in zip(displacements, tests, strict=True):
            mean = np.stack([process.predict(x[:, columns])[0][:, 0] for process in processes], axis=1)
            rows.append({
                "world": asked.world, "inputs": name, "seed": asked.seed, "displacement_m": displacement,
                "error_mps2": _rms(truth - mean), "residual_mps2": _rms(truth),
            })  # fmt: skip
    return rows


def trained(x: F64, y: F64) -> RecursiveGP:
    """A process of greatest marginal likelihood on these windows, holding at most POINTS of them."""
    keep = np.unique(np.linspace(0, len(x) - 1, min(len(x), POINTS)).astype(int))
    x, y = x[keep], y[keep]
    spread = np.maximum(x.std(axis=0), 1e-3)
    start = SquaredExponential(float(max(y.var(), 1e-4)), tuple((2.0 * spread).tolist()))
    found = fit(start, 1e-3, x, y, restarts=0)
    process = RecursiveGP(found.kernel, max(found.noise_var, 1e-6), input_dim=x.shape[1], output_dim=1, capacity=POINTS)
    process.add(x, y[:, None])
    return process


def samples(
    world: World,
    displacement_m: float,
    duration_s: float,
    seed: int,
    plant: str = "native",
    stop_requested: Callable[[], str] = lambda: "",
) -> tuple[F64, F64, F64]:
    """Windows of a flight over UDP: (n, 3 + D) position and inputs, (n, 3) measured residual, (n, 3) the true one."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "displaced.toml"
        path.write_text(world.scenario(displacement_m, duration_s))
        options = FlyOptions(scenario=str(path), seed=seed, learning=False, plant=plant, out=Path(folder))
        setup = prepare(options)
        flown, track = fly_track(setup, options, stop_requested=stop_requested)
    if not flown.companion.completed:
        raise RuntimeError(f"a flight of the study did not complete: {flown.companion.reason}")
    return windows(setup.flight.stack.model, track)


def windows(model: Model, track: TickTrace) -> tuple[F64, F64, F64]:
    """The track's windows, as the learner would make them."""
    config = LearnerConfig()
    sampler = Sampler(model)
    memory, sample = sampler.init(), np.zeros(s.SAMPLE)
    records = [*track.before, *track.records]
    truth = np.concatenate([np.zeros((len(track.before), 3)), track.true_residual(model)])
    kept: list[F64] = []
    gathered: list[F64] = []
    for i in range(1, len(records)):
        now = records[i].measurement
        sampler.step(memory, now, records[i - 1].command, sample)
        if i < len(track.before) or not fits(sample, config.residual_max_mps2):
            gathered.clear()
            continue
        gathered.append(np.concatenate([now.pos_ned_m, sample[s.S_INPUT : s.S_TARGET + 3], truth[i]]))
        if len(gathered) == config.window_ticks:
            kept.append(np.mean(gathered, axis=0))
            gathered.clear()
    rows = np.array(kept)
    return rows[:, : 3 + s.D], rows[:, 3 + s.D : 6 + s.D], rows[:, 6 + s.D :]


def _rms(values: F64) -> float:
    """Of the vectors' lengths."""
    return float(np.sqrt((values**2).sum(axis=1).mean()))
