"""What is computed and flown: one list of independent parts for a full and for a quick run."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

PILOTS: dict[str, str] = {
    "learning": "flatness control, Gaussian process learning in flight",
    "none": "the same without learning",
    "pd": "PD control",
    "pid": "PID control: PD with integral action",
    "indi": "incremental nonlinear dynamic inversion",
    "dob": "flatness control with a disturbance observer",
    "px4": "PX4's own position control",
    "state-gp": "the paper's learner: a Gaussian process of the state alone",
}
"""Who flies the tracking flight: name -> words."""
SOUND, PUBLISHED = "sound", "as-published"
MODES = (SOUND, PUBLISHED)


@dataclass(frozen=True, slots=True)
class PaperPart:
    """One part of the run."""

    name: str
    kind: str
    """A row of `work.KINDS`."""
    cost_s: float
    """About so long: the longest begin first, and progress is counted in it."""
    given: dict[str, Any] = field(default_factory=dict)
    """Arguments of its kind."""


def tracking_name(plant: str, pilot: str, seed: int) -> str:
    """Name of a tracking flight's part."""
    return f"tracking-{plant}-{pilot}-{seed}"


def certify_name(plant: str, mode: str) -> str:
    """Name of an exploration's part."""
    return f"certify-{plant}-{mode}"


def inputs_name(plant: str, world: str) -> str:
    """Name of a study's part."""
    return f"inputs-{plant}-{world}"


def seeds_of(first_plant: bool, seed: int, *, quick: bool) -> tuple[int, ...]:
    """Every pilot flies three seeds on the first plant, one on another and in a quick run."""
    return (seed, seed + 1, seed + 2) if first_plant and not quick else (seed,)


def parts_of(plants: tuple[str, ...], seed: int, *, quick: bool) -> list[PaperPart]:
    """All parts, the longest first."""
    parts = [
        PaperPart("example1", "example1", 3.0, {"starts": 300 if quick else 1000}),
        PaperPart("theory", "theory", 6.0),
    ]
    for plant in plants:
        slow = 1.0 if plant == "native" else 2.0
        parts += [_certify(plant, mode, seed, quick, slow) for mode in MODES]
        parts += [_study(plant, world, seed, quick, slow) for world in _worlds(plant == plants[0], quick)]
        for pilot in PILOTS:
            for one in seeds_of(plant == plants[0], seed, quick=quick):
                given = {"plant": plant, "pilot": pilot, "seed": one, "duration_s": 16.0 if quick else 60.0}
                given["timed"] = (plant, pilot, one) == (plants[0], "learning", seed)
                cost_s = slow * (4.0 if quick else 10.0)
                parts.append(PaperPart(tracking_name(plant, pilot, one), "tracking", cost_s, given))
    return sorted(parts, key=lambda part: -part.cost_s)


def _worlds(first: bool, quick: bool) -> tuple[str, ...]:
    """Ground effect and air drag are flown on one plant."""
    return ("paper",) if quick or not first else ("paper", "air", "ground")


def _study(plant: str, world: str, seed: int, quick: bool, slow: float) -> PaperPart:
    given: dict[str, Any] = {"world": world, "plant": plant, "seed": seed}
    if quick:
        given |= {"displacements_m": [0.0, 4.0], "train_s": 15.0, "test_s": 8.0}
    return PaperPart(inputs_name(plant, world), "inputs", slow * (10.0 if quick else 25.0), given)


def _certify(plant: str, mode: str, seed: int, quick: bool, slow: float) -> PaperPart:
    given: dict[str, Any] = {"plant": plant, "mode": mode, "seed": seed}
    if quick:  # rounds and seconds of exploration
        given |= {"rounds_max": 2, "duration_s": 60.0 if mode == SOUND else 30.0}
    cost_s = (25.0 if mode == SOUND else 20.0) if quick else (140.0 if mode == SOUND else 50.0)
    return PaperPart(certify_name(plant, mode), "certify", slow * cost_s, given)
