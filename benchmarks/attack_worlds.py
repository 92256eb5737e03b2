"""The worlds of the attacks: truths inside what a flight declares as its doubts, and links inside what it declares.

Every figure comes from the seed.  Declared: the scenario's knowledge before take-off (mass ratio, force in any
direction), rotors' lag to a fifth, delay to 4 ms (`barrier.margins.Doubts`); what governs rates allows for inertia.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from flightstack.barrier.initial import LEAST_AUTHORITY_WEIGHTS, vertical_authority_weights
from flightstack.types import Tuple3
from flightstack.vehicle import Vehicle, scaled, with_effects

TICK_MS = 4
_LEAST_KNOWN_MASS, _MOST_KNOWN_MASS = 0.8, 1.5
_FORCE_WEIGHTS = 0.15


@dataclass(frozen=True, slots=True)
class World:
    """One truth and one link."""

    seed: int
    scenario: str = "paper-tracking"
    vehicle: str = "quad-x"
    grade: str = "mocap"
    plant: str = "native"
    mass_ratio: float = 1.4
    """True over believed mass."""
    wind_g: Tuple3 = (0.1, 0.0, 0.0)
    """Force north, east, down, in true weights."""
    lag_ratio: float = 1.0
    """True over believed lag of the rotors."""
    inertia_ratio: float = 1.0
    """True over believed inertia, all axes."""
    down_ms: float = 2.0
    """Delay of the link from the vehicle, and to it; a tick of the simulator takes part in both."""
    up_ms: float = 2.0
    jitter_ms: float = 0.0
    """Besides, 0 to so much more, drawn for each message."""
    delay_error_ms: float = 0.0
    """Believed less true delay of the commands."""
    period_ticks: int = 1
    """Ticks of 4 ms from one command to the next."""

    @property
    def held_s(self) -> float:
        """Longest time between two commands that arrive."""
        return 1e-3 * (TICK_MS * self.period_ticks + self.jitter_ms)

    def authority_weights(self, thrust_weights: float) -> float:
        """Upward acceleration that is left, in g."""
        return vertical_authority_weights(thrust_weights, self.mass_ratio, self.wind_g)

    def refused(self, thrust_weights: float) -> bool:
        """Too little to fly with."""
        return self.authority_weights(thrust_weights) < LEAST_AUTHORITY_WEIGHTS - 1e-9

    def believed(self, vehicle: Vehicle) -> Vehicle:
        """The vehicle file that the stack is given."""
        late_s = 1e-3 * max(self.up_ms + 0.5 * self.jitter_ms + self.delay_error_ms, 0.0)
        return with_effects(vehicle, {"transport_delay": {"delay_s": late_s}}) if late_s > 0.0 else vehicle

    def truth(self, vehicle: Vehicle) -> Vehicle:
        """The vehicle that flies."""
        true = replace(
            scaled(vehicle, mass_ratio=self.mass_ratio), inertia_kgm2=vehicle.inertia_kgm2 * self.inertia_ratio
        )
        north, east, down = (share * true.weight_n for share in self.wind_g)
        lag_s = vehicle.effects.get("motor_lag", {}).get("time_constant_s", vehicle.rotors.time_constant_s)
        effects = {
            "constant_force": {"north_n": north, "east_n": east, "down_n": down},
            "motor_lag": {"time_constant_s": lag_s * self.lag_ratio},
        }
        return with_effects(true, effects)


def draw(
    seed: int, *, scenario: str, vehicle: str, grade: str, plant: str, period_ticks: tuple[int, int], late_ms: float
) -> World:
    """The world of a seed: links of 0 to `late_ms` both ways together."""
    rng = np.random.default_rng([8, seed])
    direction = rng.normal(size=3)
    wind = rng.uniform(0.0, _FORCE_WEIGHTS) * direction / np.linalg.norm(direction)
    link, share = rng.uniform(0.0, late_ms), rng.uniform(0.3, 0.7)
    return World(
        seed=seed, scenario=scenario, vehicle=vehicle, grade=grade, plant=plant,
        mass_ratio=float(rng.uniform(_LEAST_KNOWN_MASS, _MOST_KNOWN_MASS)),
        wind_g=(float(wind[0]), float(wind[1]), float(wind[2])),
        lag_ratio=float(rng.uniform(0.8, 1.2)), inertia_ratio=float(rng.uniform(0.85, 1.2)),
        down_ms=float(link * share), up_ms=float(link * (1.0 - share)),
        jitter_ms=float(rng.uniform(0.0, 4.0)) if late_ms > 0.0 else 0.0,
        delay_error_ms=float(rng.uniform(-2.0, 2.0)),
        period_ticks=int(rng.integers(*period_ticks)),
    )  # fmt: skip
