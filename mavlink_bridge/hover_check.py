"""The first hover decides what no parameter told: is the hover thrust that of the vehicle file?  And whether it flies.

Only where MPC_THR_HOVER stands at its default and the file is far from it (`flightstack.airframe`).  After the climb
the vehicle stands still for a moment; the mean of the commanded thrust is then its hover thrust, whatever file the
command was made with: the position loop asks for what carries the vehicle.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from flightstack.airframe import HOVER_TOLERANCE, hover_differs, hover_setpoint, unsettled_hover
from flightstack.mission import LEAST_RISE, Mission, never_flew, stands
from flightstack.model import Model
from flightstack.types import TickRecord
from mavlink_bridge.vehicle_view import VehicleView

_FROM_S, _TO_S = 0.4, 1.4
"""After the climb's end: its last acceleration has died away; the mission waits for 1.5 s."""


_CLIMB_LEAST_M = 0.5
"""A lower first climb is not told from what an estimate wanders by."""
_ASKED_M, _RISEN = 2.0, 0.25
"""In a high climb: once so much is asked for, the vehicle has risen by this share of it (one that lifts off is less
than half a metre behind)."""


class HoverCheck:
    """A planner that changes nothing, and asks for a stop where the first hover contradicts the vehicle file."""

    def __init__(self, model: Model, view: VehicleView, stop: Callable[[str], None]) -> None:
        self.contradiction = ""
        """Why the file is another vehicle's, one line; empty while nothing says so."""
        self._model, self._view, self._stop = model, view, stop
        self._sum = self._rose_m = 0.0
        self._count = 0
        self._decided = False

    def step(self, mission: Mission, t_s: float, record: TickRecord) -> Mission:
        """See Planner."""
        if self._decided:
            return mission
        self._rose_m = max(self._rose_m, mission.ground_down_m - float(record.measurement.pos_ned_m[2]))
        if t_s < mission.takeoff_end_s + _FROM_S:
            return mission
        values = self._view.params.values
        if not unsettled_hover(values, self._model.hover_norm):
            self._decided = True
        elif t_s < mission.takeoff_end_s + _TO_S:
            thrust = record.command.thrust_norm
            if math.isfinite(thrust):
                self._sum, self._count = self._sum + thrust, self._count + 1
        else:
            self._decide(hover_setpoint(values, self._model.hover_norm), _first_climb_m(mission))
        return mission

    def _decide(self, believed: float, climb_m: float) -> None:
        self._decided = True
        if not self._count:
            return
        measured = hover_setpoint(self._view.params.values, self._sum / self._count)
        if self._view.on_ground:
            said = f"with {measured:.2f} it has not left the ground"
        elif climb_m > _CLIMB_LEAST_M and not self._rose_m >= LEAST_RISE * climb_m:
            # standing on the ground, too: by its land detector PX4 is in the air there where its motors are loud
            said = (
                f"with {measured:.2f} it rose {max(self._rose_m, 0.0):.2f} m of the {climb_m:.2f} m of its first climb"
            )
        elif hover_differs(believed, measured):
            said = f"{measured:.2f} in the first hover (more than {HOVER_TOLERANCE:.0%} apart)"
        else:
            return
        self.contradiction = f"hover thrust: {believed:.2f} by the vehicle file, {said}"
        self._stop(self.contradiction)


class RiseCheck:
    """A planner that changes nothing, and asks for a stop where the vehicle has not risen in its first climb.

    Held by something, too heavy or with too little thrust it would else run its motors for the whole scenario, leaning
    to follow it on the ground.
    """

    def __init__(self, stop: Callable[[str], None]) -> None:
        self._stop = stop
        self._rose_m = 0.0
        self._decided = False

    def step(self, mission: Mission, t_s: float, record: TickRecord) -> Mission:
        """See Planner."""
        if self._decided:
            return mission
        self._rose_m = max(self._rose_m, mission.ground_down_m - float(record.measurement.pos_ned_m[2]))
        if t_s >= mission.takeoff_end_s + _TO_S:
            self._decided = True
            climb_m = _first_climb_m(mission)
            if climb_m > _CLIMB_LEAST_M and not self._rose_m >= LEAST_RISE * climb_m:
                self._stop(never_flew(self._rose_m, climb_m))
        elif t_s < mission.takeoff_end_s:
            asked_m = mission.ground_down_m - float(mission.reference(t_s).pos_ned_m[2])
            if asked_m > _ASKED_M and self._rose_m < _RISEN * asked_m:
                self._decided = True
                self._stop(stands(self._rose_m, asked_m))
        return mission


def _first_climb_m(mission: Mission) -> float:
    return mission.ground_down_m - float(mission.reference(mission.takeoff_end_s).pos_ned_m[2])
