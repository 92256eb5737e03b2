"""COMMAND_LONG and COMMAND_INT: what is answered at once and what becomes a request to the commander.

Results, doubled acknowledgements and silences are PX4's, measured.  Parameters come from outside: any may be NaN,
infinite or huge; NaN means "not set".
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final

from flightstack.types import Tuple3
from flightstack_sim import builders, streams
from flightstack_sim.autopilot import notices
from flightstack_sim.autopilot.goal import Goal, orbit_goal
from flightstack_sim.autopilot.notices import Notice
from flightstack_sim.autopilot.requests import (
    FORCE,
    ArmRequest,
    FlyRequest,
    GoRequest,
    ModeRequest,
    Request,
    Sender,
    StartRequest,
    TerminateRequest,
)
from flightstack_sim.sensors import OFF, STUCK, WORKS
from flightstack_sim.streams import LinkStreams
from flightstack_sim.view import View
from mavlink_bridge import messages as m
from mavlink_bridge.px4 import Cmd, Result

FRAME_GLOBAL_INT: Final = 5
UNSUPPORTED_FRAME: Final = 9
"""MAV_RESULT_COMMAND_UNSUPPORTED_MAV_FRAME."""
_START: Final = 300
_TERMINATE: Final = 185
_INJECT: Final = 420
_MAG, _BARO, _GPS_UNIT, _BATTERY, _MOTOR = 2, 3, 4, 100, 101
"""FAILURE_UNIT."""
_WRONG: Final = 4
"""Of FAILURE_TYPE, beside sensors.WORKS, OFF, STUCK."""
_MOTORS: Final = 4
_GET_HOME: Final = 410
_REQUEST_PROTOCOL: Final = 519
_REQUEST_CAPABILITIES: Final = 520
_CUSTOM: Final = 1
_GLOBAL_FRAMES: Final = (0, 3, FRAME_GLOBAL_INT, 6, 11)
"""Above the sea, above home, both once more with integers, above the terrain."""
_INT32_MAX: Final = 2**31 - 1
_YAW, _ALTITUDE = 3, 6
"""Among a command's parameters."""
_FAR_M: Final = 1e5
_FASTEST_MPS: Final = 20.0

_HOME: Final = m.id_of(m.HomePosition)
_GPS: Final = m.id_of(m.GpsRawInt)
_MODES: Final = m.id_of(m.AvailableModes)
_VERSION: Final = m.id_of(m.AutopilotVersion)
_PROTOCOL: Final = m.id_of(m.ProtocolVersion)
_COMPONENT_INFORMATION: Final = m.id_of(m.ComponentInformation)
_COMPONENT_METADATA: Final = m.id_of(m.ComponentMetadata)
_NOT_ON_REQUEST: Final = frozenset({m.id_of(m.Event), m.id_of(m.CurrentEventSequence)})
_METADATA_URI: Final = "mftp://etc/extras/component_general.json.xz"


@dataclass(slots=True)
class Context:
    """What a command may look at and change."""

    view: View
    streams: LinkStreams
    """Of the link that the command came by."""
    sender: Sender
    replies: list[Any] = field(default_factory=list)
    """To send on the same link, in order."""
    requests: list[Request] = field(default_factory=list)
    """For the commander, which answers them."""
    said: list[Notice] = field(default_factory=list)
    """To be said on every link."""


Params = tuple[float, float, float, float, float, float, float]
Handler = Callable[[Context, Params], Result | None]


def handle_long(message: m.CommandLong, context: Context) -> None:
    """A COMMAND_LONG addressed to this vehicle."""
    _handle(message.command, message.params, context)


def handle_int(message: m.CommandInt, context: Context) -> None:
    """A COMMAND_INT addressed to this vehicle: frame GLOBAL_INT, for commands with a place the other global ones too.

    Whatever the frame says, PX4 takes altitudes for those above the sea.
    """
    placed = message.command in _WITH_A_PLACE
    if message.frame not in (_GLOBAL_FRAMES if placed else (FRAME_GLOBAL_INT,)):
        _answer(context, message.command, UNSUPPORTED_FRAME)
        return
    params: Params = message.params
    if placed:
        one, two, three, four, x, y, z = message.params
        params = one, two, three, four, _whole_degrees(x), _whole_degrees(y), z
    _handle(message.command, params, context)


def handle_set_mode(message: m.SetMode, context: Context) -> None:
    """The legacy SET_MODE: one acknowledgement only, the commander's."""
    if message.base_mode & _CUSTOM:
        main, sub = message.custom_mode >> 16 & 0xFF, message.custom_mode >> 24 & 0xFF
        context.requests.append(ModeRequest(context.sender, main, sub))
    else:
        _answer(context, Cmd.DO_SET_MODE, Result.TEMPORARILY_REJECTED)


def _handle(command: int, params: Params, context: Context) -> None:
    handler = _HANDLERS.get(command)
    result = handler(context, params) if handler is not None else Result.UNSUPPORTED
    if result is not None:
        _answer(context, command, result)


def _answer(context: Context, command: int, result: int) -> None:
    context.replies.append(m.CommandAck(command, int(result), 0, 0, context.sender.system, context.sender.component))


def _integer(value: float) -> int:
    """A whole number from a float parameter; -1 for what is none."""
    return int(value) if math.isfinite(value) and abs(value) < 2**31 else -1


def _whole_degrees(value: float) -> float:
    """A coordinate of COMMAND_INT in degrees; INT32_MAX is unset."""
    return math.nan if value == _INT32_MAX else value * 1e-7


def _place(context: Context, params: Params) -> Tuple3 | None:
    """A command's place in the local frame, NaN where it is unset; None where it is none on this globe."""
    lat, lon, altitude_m = params[4:7]
    frame = context.view.frame
    north = east = math.nan
    if math.isfinite(lat) and math.isfinite(lon):
        if abs(lat) > 90.0 or abs(lon) > 180.0:
            return None
        north, east = frame.to_local(lat, lon)
    down = frame.altitude_m - altitude_m
    return north, east, down if abs(down) < _FAR_M else math.nan


# --- to the commander, which answers ---


def _set_mode(context: Context, params: Params) -> Result | None:
    """DO_SET_MODE has two acknowledgements: the receiver's, at once and always good, then the commander's verdict."""
    _answer(context, Cmd.DO_SET_MODE, Result.ACCEPTED)
    if not _integer(params[0]) & _CUSTOM or _integer(params[0]) < 0:
        return Result.TEMPORARILY_REJECTED
    context.requests.append(ModeRequest(context.sender, _integer(params[1]), max(0, _integer(params[2]))))
    return None


def _arm(context: Context, params: Params) -> None:
    context.requests.append(ArmRequest(context.sender, params[0], params[1] == FORCE))


def _take_off(context: Context, params: Params) -> None:
    context.requests.append(FlyRequest(context.sender, Cmd.NAV_TAKEOFF, params[_ALTITUDE]))


def _terminate(context: Context, params: Params) -> Result | None:
    """DO_FLIGHTTERMINATION; there is no way back."""
    if not params[0] > 0.5:
        return Result.DENIED
    context.requests.append(TerminateRequest(context.sender))
    return None


def _inject(context: Context, params: Params) -> Result | None:
    """INJECT_FAILURE; what isn't simulated is UNSUPPORTED, and DENIED is all without SYS_FAILURE_EN."""
    if context.view.vehicle.params.get("SYS_FAILURE_EN") != 1.0:
        return Result.DENIED
    unit, kind, instance = (_integer(value) if math.isfinite(value) else 0 for value in params[:3])
    view, sensors = context.view, context.view.vehicle.sensors
    if unit == _MOTOR and kind in (STUCK, _WRONG) and 0 <= instance <= _MOTORS:
        pass  # PX4 spoils the telemetry of its motor controllers, which is not sent here
    elif unit == _MOTOR and kind in (WORKS, OFF) and 0 <= instance <= _MOTORS:
        view.vehicle.fail_motor(instance, failed=kind == OFF)
    elif unit == _BATTERY and kind in (WORKS, OFF):
        view.battery.forced = 0.0 if kind == OFF else None
    elif unit in (_MAG, _BARO) and kind in (WORKS, OFF, STUCK) and 0 <= instance <= 1:
        (sensors.magnetometer if unit == _MAG else sensors.barometer).become(kind, view.t_us)
    elif unit == _GPS_UNIT and kind == WORKS:
        sensors.position_valid = True
    elif unit == _GPS_UNIT and kind in (OFF, STUCK, _WRONG):
        sensors.position_valid = False  # whatever is wrong with it, the estimator takes it no more
    else:
        return Result.UNSUPPORTED
    return Result.ACCEPTED


def _start_mission(context: Context, params: Params) -> None:
    context.requests.append(StartRequest(context.sender))


def _land(context: Context, params: Params) -> None:
    context.requests.append(FlyRequest(context.sender, Cmd.NAV_LAND))


def _return(context: Context, params: Params) -> None:
    context.requests.append(FlyRequest(context.sender, Cmd.NAV_RETURN_TO_LAUNCH))


def _reposition(context: Context, params: Params) -> Result | None:
    """DO_REPOSITION: hold there; its heading is in radians."""
    place = _place(context, params)
    if place is None:
        return Result.DENIED
    if context.view.fence.forbids(place[0], place[1]):
        context.said.append(notices.OUTSIDE_FENCE)  # PX4 takes the command for all that
        return Result.ACCEPTED
    if params[0] > 0.0:  # False where it is unset
        context.view.navigator.cruise_mps = min(params[0], _FASTEST_MPS)
    yaw = math.remainder(params[_YAW], 2.0 * math.pi) if math.isfinite(params[_YAW]) else math.nan
    changes = bool(_integer(params[1]) & 1) and _integer(params[1]) > 0
    context.requests.append(GoRequest(context.sender, Cmd.DO_REPOSITION, Goal(place, yaw), changes))
    return None


def _orbit(context: Context, params: Params) -> Result | None:
    """DO_ORBIT: circle there."""
    place = _place(context, params)
    if place is None:
        return Result.DENIED
    goal = orbit_goal(place, params[0], params[1], params[2])
    context.requests.append(GoRequest(context.sender, Cmd.DO_ORBIT, goal))
    return None


# --- answered here ---


def _change_speed(context: Context, params: Params) -> Result:
    """DO_CHANGE_SPEED: horizontal speed of automatic modes; 0 or less takes the parameter's again."""
    speed = params[1]
    if math.isfinite(speed):
        context.view.navigator.cruise_mps = min(speed, _FASTEST_MPS) if speed > 0.0 else math.nan
    return Result.ACCEPTED


def _set_home(context: Context, params: Params) -> Result:
    """DO_SET_HOME: here, or a whole place."""
    view, navigator = context.view, context.view.navigator
    if params[0] > 0.5:
        place: Tuple3 | None = view.pos_ned_m
    else:
        place = _place(context, params)
        if place is None or not all(map(math.isfinite, place)):
            return Result.DENIED
    if not view.vehicle.sensors.position_valid:
        return Result.TEMPORARILY_REJECTED
    navigator.home_ned_m, navigator.home_t_us, navigator.home_is_manual = place, view.t_us, True
    return Result.ACCEPTED


def _reboot(context: Context, params: Params) -> Result:
    return Result.DENIED


def _set_interval(context: Context, params: Params) -> Result:
    if any(math.isfinite(params[place]) and params[place] != 0.0 for place in (2, 3, 6)):
        return Result.FAILED
    interval = params[1]
    if math.isnan(interval):
        interval_us = 0
    else:
        interval_us = int(min(max(interval, -1.0), 1e12))
    done = context.streams.set_interval(_integer(params[0]), interval_us, context.view.t_us)
    return Result.ACCEPTED if done else Result.FAILED


def _get_interval(context: Context, params: Params) -> Result:
    message_id = max(0, min(_integer(params[0]), 0xFFFF))
    context.replies.append(m.MessageInterval(message_id, context.streams.interval_us(message_id)))
    return Result.ACCEPTED


def _request_message(context: Context, params: Params) -> Result:
    """Send one message now, then acknowledge."""
    message_id = _integer(params[0])
    view = context.view
    if message_id in _NOT_ON_REQUEST:
        return Result.DENIED
    if message_id == _GPS and view.fixes_reported == view.vehicle.sensors.fix_count:
        return Result.DENIED
    if message_id == _MODES:
        return _request_modes(context, params)
    if message_id in (_COMPONENT_METADATA, _COMPONENT_INFORMATION):
        context.replies.append(_metadata(message_id, view))
        return Result.ACCEPTED
    return _send(context, message_id)


def _send(context: Context, message_id: int) -> Result:
    message = streams.build_once(message_id, context.view)
    if message is None:
        return Result.DENIED
    context.replies.append(message)
    return Result.ACCEPTED


def _request_modes(context: Context, params: Params) -> Result:
    """AVAILABLE_MODES: all of them, or the one with this index."""
    listed = builders.available_modes(context.view)
    index = max(0, _integer(params[1]))
    if index > len(listed):
        return Result.DENIED
    context.replies.extend(listed if index == 0 else listed[index - 1 : index])
    return Result.ACCEPTED


def _metadata(message_id: int, view: View) -> Any:
    if message_id == _COMPONENT_METADATA:
        return m.ComponentMetadata(view.t_us, 0, _METADATA_URI)
    return m.ComponentInformation(view.t_us, 0, _METADATA_URI)


def _get_home(context: Context, params: Params) -> Result:
    return _send(context, _HOME)


def _request_protocol(context: Context, params: Params) -> Result:
    return _send(context, _PROTOCOL)


def _request_capabilities(context: Context, params: Params) -> Result:
    return _send(context, _VERSION)


_WITH_A_PLACE: Final = frozenset({Cmd.DO_REPOSITION, Cmd.DO_ORBIT, Cmd.DO_SET_HOME})
_HANDLERS: Final[dict[int, Handler]] = {
    Cmd.DO_SET_MODE: _set_mode,
    Cmd.COMPONENT_ARM_DISARM: _arm,
    Cmd.NAV_TAKEOFF: _take_off,
    Cmd.NAV_LAND: _land,
    _START: _start_mission,
    _TERMINATE: _terminate,
    _INJECT: _inject,
    Cmd.NAV_RETURN_TO_LAUNCH: _return,
    Cmd.PREFLIGHT_REBOOT_SHUTDOWN: _reboot,
    Cmd.SET_MESSAGE_INTERVAL: _set_interval,
    Cmd.GET_MESSAGE_INTERVAL: _get_interval,
    Cmd.REQUEST_MESSAGE: _request_message,
    Cmd.DO_REPOSITION: _reposition,
    Cmd.DO_ORBIT: _orbit,
    Cmd.DO_CHANGE_SPEED: _change_speed,
    Cmd.DO_SET_HOME: _set_home,
    _GET_HOME: _get_home,
    _REQUEST_PROTOCOL: _request_protocol,
    _REQUEST_CAPABILITIES: _request_capabilities,
}
