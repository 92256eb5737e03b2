"""Where a command sends the vehicle: a place to hold, or a circle to fly.  NaN is unset: what it has now."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from flightstack.types import Tuple3
from flightstack_sim.autopilot.setpoint import NAN, ControlKind, ControlSetpoint

_ON_CIRCLE_M: Final = 1.0
DEFAULT_RADIUS_M: Final = 5.0
DEFAULT_SPEED_MPS: Final = 2.0
_LEAST_RADIUS_M, _MOST_RADIUS_M = 1.0, 1000.0
_MOST_SPEED_MPS: Final = 10.0
_MOST_TURN_MPS2: Final = 2.5
"""Centripetal acceleration: the speed is held down to it, as PX4 does."""

# ORBIT_YAW_BEHAVIOUR
FACES_CENTRE, KEEPS_YAW, FREE, ALONG_CIRCLE = 0, 1, 2, 3


class Goal(NamedTuple):
    """A place (NED, m) and a heading; with a radius the centre of a circle."""

    pos_ned_m: Tuple3
    yaw_rad: float = NAN
    radius_m: float = 0.0
    """0: no circle; negative: counter-clockwise."""
    speed_mps: float = NAN
    faces: int = FACES_CENTRE


def orbit_goal(centre_ned_m: Tuple3, radius_m: float, speed_mps: float, faces: float) -> Goal:
    """A circle as DO_ORBIT asks for it, held within what can be flown; NaN takes PX4's defaults."""
    radius = radius_m if math.isfinite(radius_m) and radius_m != 0.0 else DEFAULT_RADIUS_M
    radius = math.copysign(min(max(abs(radius), _LEAST_RADIUS_M), _MOST_RADIUS_M), radius)
    speed = abs(speed_mps) if math.isfinite(speed_mps) else DEFAULT_SPEED_MPS
    speed = min(speed, _MOST_SPEED_MPS, math.sqrt(_MOST_TURN_MPS2 * abs(radius)))
    behaviour = int(faces) if math.isfinite(faces) and 0.0 <= faces <= 3.0 else FACES_CENTRE
    return Goal(centre_ned_m, radius_m=radius, speed_mps=speed, faces=behaviour)


def hold_at(goal: Goal) -> ControlSetpoint:
    """Fly there and stay."""
    return ControlSetpoint(ControlKind.GOTO, pos_ned_m=goal.pos_ned_m, yaw_rad=goal.yaw_rad)


class Circle:
    """A circle that is being flown; `step` gives the setpoint of the next tick."""

    __slots__ = ("_angle_rad", "_centre", "_goal", "_last_us", "_reached")

    def __init__(self, goal: Goal, pos_ned_m: Tuple3, now_us: int) -> None:
        self._goal = goal
        north, east, down = (
            here if math.isnan(wanted) else wanted for wanted, here in zip(goal.pos_ned_m, pos_ned_m, strict=True)
        )
        self._centre = (north, east, down)
        self._angle_rad = math.atan2(pos_ned_m[1] - east, pos_ned_m[0] - north)
        self._last_us = now_us
        self._reached = False

    def step(self, pos_ned_m: Tuple3, now_us: int) -> ControlSetpoint:
        """To the nearest point of the circle first, then round."""
        goal, (north, east, down), angle = self._goal, self._centre, self._angle_rad
        step_s, self._last_us = (now_us - self._last_us) * 1e-6, now_us
        radius, turn = abs(goal.radius_m), math.copysign(1.0, goal.radius_m)
        cos, sin = math.cos(angle), math.sin(angle)
        place = (north + radius * cos, east + radius * sin, down)
        yaw_rad = self._yaw_rad(angle, turn)
        self._reached = self._reached or math.dist(place, pos_ned_m) < _ON_CIRCLE_M
        if not self._reached:
            return ControlSetpoint(ControlKind.GOTO, pos_ned_m=place, yaw_rad=yaw_rad)
        rate = turn * goal.speed_mps / radius
        self._angle_rad = math.remainder(angle + rate * step_s, 2.0 * math.pi)
        speed, pull = rate * radius, rate * rate * radius
        return ControlSetpoint(
            ControlKind.GOTO,
            pos_ned_m=place,
            vel_ned_mps=(-speed * sin, speed * cos, 0.0),
            acc_ned_mps2=(-pull * cos, -pull * sin, NAN),
            yaw_rad=yaw_rad,
        )

    def _yaw_rad(self, angle_rad: float, turn: float) -> float:
        if self._goal.faces == FACES_CENTRE:
            return math.remainder(angle_rad + math.pi, 2.0 * math.pi)
        if self._goal.faces == ALONG_CIRCLE:
            return math.remainder(angle_rad + turn * math.pi / 2.0, 2.0 * math.pi)
        return NAN
