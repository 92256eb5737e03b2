"""What a way out and the vehicle's answer differ by without any doubt: the ledger's line `model`, over many vehicles.

The truth is the believed vehicle, no force, no link, the estimate is the truth, nothing slides a command.  While a
committed way is followed, the distance from it over what a steady rest of 1 m/s^2 moves the loop by until then is an
acceleration that explains it.  `campaigns/fence-model.toml` flies it; a row has the greatest across and along.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.attack_worlds import World
from benchmarks.fence_estimate import ErringEstimate
from benchmarks.fence_flight import RANDOM, Attack, FenceFlight, Outcome
from benchmarks.fence_vehicles import KINDS, drawn_room, drawn_vehicle
from benchmarks.fence_worlds import drawn_attack
from flightstack.barrier.estimate_bounds import EstimateBounds
from flightstack.site import tube
from flightstack.site.backup import ROW, at_time
from flightstack.site.decide import COMMITTED, KEPT, SINCE_US
from flightstack.site.filter import SiteState
from flightstack.types import F64, TickRecord

_EXACT = EstimateBounds((0.0,) * 3, (0.0,) * 3, (0.0,) * 3, 0.0)
_REST = tube.LoopBounds(0.0, 1.0, 0.0, 0.0)
_AFTER_S = 0.3
"""Before, a rest has moved the loop by millimetres."""


class ModelFlight(FenceFlight):
    """A flight of which the distance from committed ways is kept."""

    def __init__(self, world: World, site: Path, attack: Attack) -> None:
        super().__init__(world, site, attack, unslid=True)
        self._erring = ErringEstimate(_EXACT, self.score.packed)
        made = self.plan_of.certificate
        self._units = []
        for each, lags_s in zip((made.across, made.along), made.lags_s, strict=True):
            moved = tube.of_gains(each.gains, lags_s, _REST)
            assert moved is not None
            self._units.append(moved.radius_m)
        self.most_mps2, self.followed = np.zeros(2), 0

    def _judge(self, out: Outcome, record: TickRecord, time_s: float, keep: bool) -> None:
        super()._judge(out, record, time_s, keep)
        numbers, state = self.timed.numbers, self.state.filter
        after_s = 1e-6 * (self.vehicle.t_us - numbers[SINCE_US])
        if not isinstance(state, SiteState) or not numbers[KEPT] > 0.0 or after_s < _AFTER_S:
            return
        target = np.empty(ROW)
        at_time(state.committed, int(numbers[COMMITTED]), after_s, target)
        off: F64 = self.vehicle.plant.pos_ned_m - self.start_ned_m - target[:3]
        k = min(round(after_s / tube.STEP_S), len(self._units[0]) - 1)
        moved = np.array([np.hypot(off[0], off[1]) / self._units[0][k], abs(off[2]) / self._units[1][k]])
        self.most_mps2, self.followed = np.maximum(self.most_mps2, moved), self.followed + 1


def flight(values: dict[str, Any], seed: int, folder: Path) -> dict[str, Any]:
    """One flight of `seconds` of a `kind` of vehicle."""
    kind, site = values["kind"], folder / "site.toml"
    text = drawn_vehicle(seed) if kind == "drawn" else KINDS.get(kind, "")
    if text:
        (folder / "vehicle.toml").write_text(text)
    site.write_text(drawn_room(seed))
    world = World(
        seed=seed, scenario="hover", vehicle=str(folder / "vehicle.toml") if text else kind, mass_ratio=1.0,
        wind_g=(0.0, 0.0, 0.0), down_ms=0.0, up_ms=0.0,
    )  # fmt: skip
    attack = replace(drawn_attack(seed), kind=RANDOM, begins_s=4.0, gusts=False, errs=True)
    flown = ModelFlight(world, site, attack)
    flown.run(values["seconds"])
    across, along = flown.most_mps2.round(3).tolist()
    return {"across_mps2": across, "along_mps2": along, "followed": flown.followed, "exits": flown.score.exits}
