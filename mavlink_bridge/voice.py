"""What the companion says to one vehicle: heartbeats, setpoints, its clock.  Nothing here decides anything."""

from __future__ import annotations

import math

from flightstack.types import F64, Command, Tuple3, Tuple4
from mavlink_bridge import messages as m
from mavlink_bridge import px4
from mavlink_bridge.link import Link
from mavlink_bridge.vehicle_params import ParamReader

RATES = 128
"""SET_ATTITUDE_TARGET: ignore the attitude, take body rates and thrust.  Never the throttle-ignore bit (64)."""
LEVEL = 7
"""Ignore the body rates, take attitude and thrust: PX4's own attitude loop levels the vehicle."""
_HEARTBEAT_US = 1_000_000
_TIMESYNC_US = 100_000
_NO_TURN: Tuple4 = (1.0, 0.0, 0.0, 0.0)


class Voice:
    """Speaks to `system` once it is known; before (0) to nobody, or, where it `speaks_first`, a heartbeat to all."""

    def __init__(self, link: Link, *, speaks_first: bool = False) -> None:
        self._link, self._speaks_first = link, speaks_first
        self.system = 0
        self._factor = 0.0
        self.rate_max_radps: Tuple3 = (math.inf, math.inf, math.inf)
        """The vehicle's MC_*RATE_MAX, which PX4 itself does not apply to body rates."""
        self.is_ground_station = True
        """Whether it speaks as one, too: PX4 then tells it its texts, and takes a lost pilot's station for present."""
        self._heartbeat_due_us = 0
        self._timesync_due_us = 0

    @property
    def thrust_model_factor(self) -> float:
        """The vehicle's THR_MDL_FAC, within 0..1: the curve that PX4 undoes before the motors."""
        return self._factor

    @thrust_model_factor.setter
    def thrust_model_factor(self, told: float) -> None:
        self._factor = min(1.0, max(0.0, told))

    def heed(self, params: ParamReader) -> None:
        """Go by the vehicle's parameters as they are now.  Whoever set NAV_DLL_ACT counts on PX4 noticing that the
        ground station is gone."""
        self.thrust_model_factor = params.values.get("THR_MDL_FAC", 0.0)
        self.rate_max_radps = params.rate_max_radps
        self.is_ground_station = not params.values.get("NAV_DLL_ACT", 0.0)

    def keep_in_touch(self, now_us: int, *, heartbeat_missing: bool) -> None:
        """Heartbeats as onboard controller and as a ground station (PX4 sends STATUSTEXT only to links that saw one);
        TIMESYNC questions; and, where the vehicle's own heartbeats stay away, the question for one: it alone tells
        whether the vehicle is armed."""
        if not (self.system or self._speaks_first):
            return
        if now_us >= self._heartbeat_due_us:
            self._heartbeat_due_us = now_us + _HEARTBEAT_US
            if heartbeat_missing and self.system:
                asked = (float(m.id_of(m.Heartbeat)), *(math.nan,) * 6)
                self._link.send(m.CommandLong(self.system, px4.COMPONENT_AUTOPILOT, px4.Cmd.REQUEST_MESSAGE, 0, asked))
            self._link.send(m.Heartbeat(px4.TYPE_ONBOARD_CONTROLLER, 8, 0, 0, 4))
            if self.is_ground_station and self.system:
                self._link.send(m.Heartbeat(px4.TYPE_GCS, 8, 0, 0, 4), component=px4.COMPONENT_GCS)
        if now_us >= self._timesync_due_us and self.system:
            self._timesync_due_us = now_us + _TIMESYNC_US
            self._link.send(m.Timesync(0, now_us * 1000, self.system, px4.COMPONENT_AUTOPILOT))

    def fly(self, command: Command) -> None:
        """A setpoint of the stack: body rates and thrust."""
        (x, y, z), (roll, pitch, yaw) = self.rate_max_radps, command.rate_frd_radps.tolist()
        if not (-x <= roll <= x and -y <= pitch <= y and -z <= yaw <= z):
            roll, pitch, yaw = min(x, max(-x, roll)), min(y, max(-y, pitch)), min(z, max(-z, yaw))
        self._setpoint(command.t_us, RATES, _NO_TURN, (roll, pitch, yaw), command.thrust_norm)

    def stand(self, t_us: int) -> None:
        """A setpoint that does nothing on the ground."""
        self._setpoint(t_us, RATES, _NO_TURN, (0.0, 0.0, 0.0), 0.0)

    def calm(self, t_us: int, thrust_norm: float, yaw_rad: float | None) -> None:
        """Safe words: level at a heading, or, where the attitude can't be trusted (None), no rotation; some thrust."""
        rest = (0.0, 0.0, 0.0)
        if yaw_rad is None or not math.isfinite(yaw_rad):
            self._setpoint(t_us, RATES, _NO_TURN, rest, thrust_norm)
        else:
            heading = (math.cos(0.5 * yaw_rad), 0.0, 0.0, math.sin(0.5 * yaw_rad))
            self._setpoint(t_us, LEVEL, heading, rest, thrust_norm)

    def stay(self, t_us: int, thrust_norm: float, q_ned_frd: F64) -> None:
        """The attitude that is, before PX4 is asked for a mode of its own: for a cycle or two its attitude loop goes by
        the last attitude that it was told, which would be that of before the take-off, without thrust."""
        w, x, y, z = q_ned_frd.tolist()
        self._setpoint(t_us, LEVEL, (w, x, y, z), (0.0, 0.0, 0.0), thrust_norm)

    def _setpoint(self, t_us: int, mask: int, q: Tuple4, rates: Tuple3, thrust: float) -> None:
        f = self._factor
        wire = f * thrust * thrust + (1.0 - f) * thrust  # PX4 undoes the same curve
        if not 0.0 <= wire <= 1.0:
            wire = min(1.0, max(0.0, wire))
        self._link.send(m.SetAttitudeTarget(t_us, self.system, px4.COMPONENT_AUTOPILOT, mask, q, rates, wire))


def yaw_of(q_ned_frd: F64) -> float:
    """Heading of an attitude (4,)."""
    w, x, y, z = (float(value) for value in q_ned_frd)
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
