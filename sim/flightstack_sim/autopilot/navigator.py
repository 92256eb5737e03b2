"""The navigator: from the mode that flies to the setpoint of the control loops, and the home position.

Hold keeps the place, take-off climbs MIS_TAKEOFF_ALT, Land goes down where it is, Return flies home and lands: within
RTL_MIN_DIST of home at the height it has, from further away at RTL_RETURN_ALT above home at least.
Follow, orbit and VTOL take-off hold (there is nothing to follow or to transition), Precision Landing lands.
Descend goes down level and lets the vehicle drift.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from flightstack.types import Tuple3
from flightstack_sim.autopilot import modes, notices
from flightstack_sim.autopilot.goal import Circle, Goal, hold_at
from flightstack_sim.autopilot.mission import MissionFlight
from flightstack_sim.autopilot.modes import Mode
from flightstack_sim.autopilot.notices import Notice
from flightstack_sim.autopilot.params import Params
from flightstack_sim.autopilot.setpoint import HOLD, LAND, NAN, OFF, ControlKind, ControlSetpoint

_ARRIVED_M: Final = 1.0
_LANDING_MODES: Final = (modes.LAND, modes.PRECLAND)
_MISSION_LIKE: Final = (modes.MISSION, modes.TAKEOFF, modes.LAND)
NOT_STARTED, ACTIVE, PAUSED, COMPLETE = 2, 3, 4, 5
"""MISSION_STATE."""


@dataclass(slots=True)
class NavigatorState:
    """Everything the navigator remembers."""

    home_ned_m: Tuple3 | None = None
    home_t_us: int = 0
    mode: Mode | None = None
    armed: bool = False
    setpoint: ControlSetpoint = OFF
    takeoff_down_m: float = 0.0
    takeoff_done: bool = False
    home_is_manual: bool = False
    """A client has said where it is: it stays there."""
    cruise_mps: float = NAN
    """Horizontal speed of automatic modes by DO_CHANGE_SPEED; NaN: MPC_XY_CRUISE."""
    goal: Goal | None = None
    circle: Circle | None = None
    mission_state: int = 2
    """MISSION_STATE: 2 not started, 3 active, 4 paused, 5 complete."""
    mission_mode: int = 2
    """1: the mode that flies is one that follows a mission; 2: suspended."""


class Navigator:
    """PX4's navigator for one vehicle; `state` is plain data."""

    __slots__ = ("_altitude_m", "_params", "mission", "state")

    def __init__(self, params: Params, home_altitude_m: float, mission: MissionFlight | None = None) -> None:
        self._params = params
        self.mission = mission
        self._altitude_m = home_altitude_m
        self.state = NavigatorState()

    def set_home(self, pos_ned_m: Tuple3, now_us: int) -> None:
        """Home is here from now on, unless a client has said where it is."""
        if not self.state.home_is_manual:
            self.state.home_ned_m, self.state.home_t_us = pos_ned_m, now_us

    def outside_fence(self, pos_ned_m: Tuple3) -> bool:
        """Whether a place lies outside the cylinder round home (GF_MAX_HOR_DIST, GF_MAX_VER_DIST; 0: no such wall)."""
        home, get = self.state.home_ned_m, self._params.get
        radius_m, height_m = get("GF_MAX_HOR_DIST"), get("GF_MAX_VER_DIST")
        if home is None:
            return False
        return bool(
            (radius_m > 0.0 and math.dist(home[:2], pos_ned_m[:2]) > radius_m)
            or (height_m > 0.0 and home[2] - pos_ned_m[2] > height_m)
        )

    def step(
        self,
        mode: Mode,
        offboard: ControlSetpoint | None,
        pos_ned_m: Tuple3,
        *,
        armed: bool,
        takeoff_altitude_m: float = NAN,
        goal: Goal | None = None,
        now_us: int = 0,
        landed: bool = False,
    ) -> tuple[ControlSetpoint, tuple[Notice, ...]]:
        """The setpoint for this tick and what is to be said about it."""
        state = self.state
        said: tuple[Notice, ...] = ()
        if mode is not state.mode or armed is not state.armed:
            self._tell_mission(mode, state.mode)
            state.setpoint, said = self._enter(mode, pos_ned_m, takeoff_altitude_m, landed) if armed else (OFF, ())
            state.mode, state.armed, state.goal, state.circle = mode, armed, None, None
            state.takeoff_done = False
        if not armed:
            return OFF, said
        if mode is modes.OFFBOARD:
            return offboard if offboard is not None else HOLD, said
        if mode is modes.TAKEOFF:
            state.takeoff_done = abs(pos_ned_m[2] - state.takeoff_down_m) < self._params.get("NAV_MC_ALT_RAD") / 2.0
        elif mode is modes.RTL:
            said += self._fly_home(pos_ned_m)
        elif mode is modes.HOLD or mode is modes.ORBIT:
            self._pursue(goal, pos_ned_m, now_us)
        elif mode is modes.MISSION and self.mission is not None:
            self._fly_mission(self.mission, pos_ned_m, now_us, landed)
        return self._paced(state.setpoint), said

    def _fly_mission(self, mission: MissionFlight, pos_ned_m: Tuple3, now_us: int, landed: bool) -> None:
        state = self.state
        state.setpoint = mission.step(pos_ned_m, now_us, landed=landed)
        if mission.cruise_mps is not None:
            state.cruise_mps, mission.cruise_mps = mission.cruise_mps, None
        state.mission_state = COMPLETE if mission.finished else ACTIVE

    def _tell_mission(self, mode: Mode, before: Mode | None) -> None:
        """What MISSION_CURRENT says of it."""
        state = self.state
        state.mission_mode = 1 if mode in _MISSION_LIKE else 2
        if mode is modes.MISSION:
            state.mission_state = COMPLETE if self.mission is not None and self.mission.finished else ACTIVE
        elif before is modes.MISSION and state.mission_state == ACTIVE:
            state.mission_state = PAUSED

    def _pursue(self, goal: Goal | None, pos_ned_m: Tuple3, now_us: int) -> None:
        """Go where a command said."""
        state = self.state
        if goal is not state.goal and goal is not None:
            state.circle = Circle(goal, pos_ned_m, now_us) if goal.radius_m else None
            state.setpoint = hold_at(goal)
        state.goal = goal
        if state.circle is not None:
            state.setpoint = state.circle.step(pos_ned_m, now_us)

    def _paced(self, setpoint: ControlSetpoint) -> ControlSetpoint:
        """With the speed that was asked for; the same object as long as nothing changes."""
        cruise = self.state.cruise_mps
        if setpoint.speed_mps == cruise or (math.isnan(cruise) and math.isnan(setpoint.speed_mps)):
            return setpoint
        self.state.setpoint = setpoint._replace(speed_mps=cruise)
        return self.state.setpoint

    def _enter(
        self, mode: Mode, pos_ned_m: Tuple3, takeoff_altitude_m: float, landed: bool
    ) -> tuple[ControlSetpoint, tuple[Notice, ...]]:
        """First setpoint of a mode that an armed vehicle has just entered."""
        if mode is modes.TAKEOFF:
            return self._start_takeoff(pos_ned_m, takeoff_altitude_m)
        if mode is modes.RTL:
            return self._start_return(pos_ned_m)
        if mode is modes.MISSION and self.mission is not None:
            return HOLD, self.mission.start(self.state.home_ned_m, pos_ned_m, landed=landed)
        if mode is modes.DESCEND:
            return self._descend(), ()
        if mode in _LANDING_MODES:
            return LAND, ()
        if mode is modes.HOLD and self.state.takeoff_done:
            return ControlSetpoint(ControlKind.GOTO, pos_ned_m=(NAN, NAN, self.state.takeoff_down_m)), ()
        return (OFF if mode is modes.TERMINATION else HOLD), ()

    def _descend(self) -> ControlSetpoint:
        """Down at the landing speed, level: for want of a position nothing holds the place."""
        vel = (NAN, NAN, self._params.get("MPC_LAND_SPEED"))
        return ControlSetpoint(ControlKind.POSITION, vel_ned_mps=vel, acc_ned_mps2=(0.0, 0.0, NAN))

    def _start_takeoff(self, pos_ned_m: Tuple3, altitude_m: float) -> tuple[ControlSetpoint, tuple[Notice, ...]]:
        """Climb to an altitude above the sea, where one was named above the vehicle, else by MIS_TAKEOFF_ALT."""
        said: tuple[Notice, ...] = ()
        down_m = self._altitude_m - altitude_m
        if not down_m < pos_ned_m[2]:  # NaN, or not upwards
            height_m = self._params.get("MIS_TAKEOFF_ALT")
            down_m, said = pos_ned_m[2] - height_m, (notices.takeoff_altitude(height_m),)
        self.state.takeoff_down_m = down_m
        return ControlSetpoint(ControlKind.TAKEOFF, pos_ned_m=(NAN, NAN, down_m)), said

    def _start_return(self, pos_ned_m: Tuple3) -> tuple[ControlSetpoint, tuple[Notice, ...]]:
        """First leg: climb where it is; near home there is no need to."""
        home = self.state.home_ned_m
        if home is None:
            return LAND, ()
        down = pos_ned_m[2]
        if math.dist(home[:2], pos_ned_m[:2]) > self._params.get("RTL_MIN_DIST"):
            down = min(down, home[2] - self._params.get("RTL_RETURN_ALT"))
        notice = notices.return_start(math.ceil(self._altitude_m - down), math.ceil(home[2] - down))
        return ControlSetpoint(ControlKind.GOTO, pos_ned_m=(pos_ned_m[0], pos_ned_m[1], down)), (notice,)

    def _fly_home(self, pos_ned_m: Tuple3) -> tuple[Notice, ...]:
        """Next leg of a return once this one is done: across, then down."""
        state = self.state
        home, target = state.home_ned_m, state.setpoint.pos_ned_m
        if home is None or state.setpoint.kind is ControlKind.LAND or math.dist(target, pos_ned_m) > _ARRIVED_M:
            return ()
        if math.dist(home[:2], pos_ned_m[:2]) > _ARRIVED_M:
            state.setpoint = ControlSetpoint(ControlKind.GOTO, pos_ned_m=(home[0], home[1], target[2]))
            return ()
        state.setpoint = ControlSetpoint(ControlKind.LAND, pos_ned_m=(home[0], home[1], NAN))
        return (notices.RTL_LANDS,)
