"""Faults that can be injected: one table, the words on the command line, and what makes them happen.

    NAME[:VALUE][@SECONDS][+DURATION], several with commas: link-degraded,gcs-loss:3@5

SECONDS count from take-off (the vehicle has left the ground), simulated; a fault without them comes DEFAULT_TIME_S
after it, a link fault with the first message.  With DURATION it ends again.  What the autopilot does about a fault
follows its parameters, as on PX4; VALUE of some faults sets the one that matters.
Faults of the vehicle act inside the server; link faults act on the datagrams (`sim.link_faults`).
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from flightstack.types import InputError
from flightstack_sim.link_faults import LINK_FAULTS, LinkQuality
from mavlink_bridge import messages as m

if TYPE_CHECKING:
    from flightstack_sim.server import Server

DEFAULT_TIME_S: Final = 10.0
_UNSET: Final = math.nan
Act = Callable[["Server", float], None]


@dataclass(frozen=True, slots=True)
class FaultSpec:
    """One row of the table."""

    name: str
    does: str
    reaction: str
    """What is expected, at the autopilot's default parameters."""
    test: str
    """The test that flies it."""
    value: float = _UNSET
    """What VALUE stands for where none is given; NaN: nothing."""
    unit: str = ""
    """What VALUE is; empty: there is none."""
    limits: tuple[float, float] = (0.0, 0.0)
    start: Act | None = None
    """None: a link fault."""
    stop: Act | None = None
    """Takes it back; None: it can't be."""
    settings: tuple[tuple[str, float], ...] = ()
    """Of a link fault: what it makes of the link where no value says otherwise."""


def _set(server: Server, name: str, value: float) -> None:
    if not math.isnan(value):
        server.vehicle.params.set(name, float(round(value)))


_SETPOINTS: Final = frozenset({m.SetAttitudeTarget, m.SetPositionTargetLocalNed, m.SetPositionTargetGlobalInt})
_HEARTBEATS: Final = frozenset({m.Heartbeat})
_POSITIONS: Final = frozenset({m.LocalPositionNed, m.GlobalPositionInt, m.Odometry})
_ATTITUDES: Final = frozenset({m.Attitude, m.AttitudeQuaternion, m.Odometry})


def _lose_setpoints(server: Server, value: float) -> None:
    _set(server, "COM_OBL_RC_ACT", value)
    server.deaf_to |= _SETPOINTS


def _hear_setpoints(server: Server, value: float) -> None:
    server.deaf_to -= _SETPOINTS


def _lose_gcs(server: Server, value: float) -> None:
    """PX4's default does nothing about a lost ground station: Return, unless somebody has chosen."""
    if math.isnan(value) and server.vehicle.params.get("NAV_DLL_ACT") == 0.0:
        value = 2.0
    _set(server, "NAV_DLL_ACT", value)
    server.deaf_to |= _HEARTBEATS


def _hear_gcs(server: Server, value: float) -> None:
    server.deaf_to -= _HEARTBEATS


def _drain(server: Server, value: float) -> None:
    server.view.battery.forced = value


def _charge(server: Server, value: float) -> None:
    server.view.battery.forced = None


def _shrink_fence(server: Server, value: float) -> None:
    """The fence comes down to half of the height that the vehicle has: it is outside at once."""
    _set(server, "GF_ACTION", value)
    server.vehicle.params.set("GF_MAX_VER_DIST", max(0.01, 0.5 * server.view.relative_alt_m))


def _lift_fence(server: Server, value: float) -> None:
    server.vehicle.params.set("GF_MAX_VER_DIST", 0.0)


def _lose_position(server: Server, value: float) -> None:
    server.vehicle.sensors.position_valid = False


def _find_position(server: Server, value: float) -> None:
    server.vehicle.sensors.position_valid = True


def _silence_position(server: Server, value: float) -> None:
    server.view.silenced |= _POSITIONS


def _tell_position(server: Server, value: float) -> None:
    server.view.silenced -= _POSITIONS


def _freeze_position(server: Server, value: float) -> None:
    server.view.freeze()


def _thaw_position(server: Server, value: float) -> None:
    server.view.thaw()


def _reset_estimate(server: Server, value: float) -> None:
    server.vehicle.sensors.jump_north(value)


def _silence_attitude(server: Server, value: float) -> None:
    server.vehicle.sensors.attitude_valid = False
    server.view.silenced |= _ATTITUDES


def _tell_attitude(server: Server, value: float) -> None:
    server.vehicle.sensors.attitude_valid = True
    server.view.silenced -= _ATTITUDES


def _stop_motor(server: Server, value: float) -> None:
    server.vehicle.fail_motor(int(value), failed=True)


def _run_motor(server: Server, value: float) -> None:
    server.vehicle.fail_motor(int(value), failed=False)


def _jump_clock(server: Server, value: float) -> None:
    server.view.clock_offset_us += round(1e6 * value)


_FAILSAFES: Final = "tests/loopback/test_fault_flights.py::test_the_autopilot_reacts_as_the_table_says"
_HANDED_BACK: Final = "tests/loopback/test_fault_flights.py::test_the_companion_hands_back_what_it_can_not_trust"
_DEGRADED: Final = "tests/loopback/test_fault_flights.py::test_tracking_degrades_gracefully_on_a_bad_link"
_LANDS: Final = "the companion hands back: Land within {} s"

FAULTS: Final[tuple[FaultSpec, ...]] = (
    FaultSpec(
        "setpoint-loss", "no setpoint reaches the autopilot", "Return after COM_OF_LOSS_T (1.0 to 1.1 s)", _FAILSAFES,
        unit="COM_OBL_RC_ACT", limits=(0.0, 7.0), start=_lose_setpoints, stop=_hear_setpoints,
    ),
    FaultSpec(
        "gcs-loss", "no ground station's heartbeat reaches the autopilot (NAV_DLL_ACT 0 becomes 2)",
        "Hold after COM_DL_LOSS_T (10 s), Return after COM_FAIL_ACT_T (5 s) more", _FAILSAFES,
        unit="NAV_DLL_ACT", limits=(0.0, 6.0), start=_lose_gcs, stop=_hear_gcs,
    ),
    FaultSpec(
        "low-battery", "the charge that is left falls to VALUE",
        "low: a warning; critical: Hold, after COM_FAIL_ACT_T (5 s) Return; emergency: Hold, then Land",
        _FAILSAFES, value=0.06, unit="0..1", limits=(0.0, 1.0), start=_drain, stop=_charge,
    ),
    FaultSpec(
        "geofence", "the fence (GF_MAX_VER_DIST) comes down to half of the vehicle's height", "Hold at once",
        _FAILSAFES,
        unit="GF_ACTION", limits=(0.0, 5.0), start=_shrink_fence, stop=_lift_fence,
    ),
    FaultSpec(
        "estimator-loss", "the estimate has no position: flags fall, position streams end",
        "body rates fly on; what needs a position ends in Descend", _FAILSAFES,
        start=_lose_position, stop=_find_position,
    ),
    FaultSpec(
        "position-stale", "the position streams stop coming", _LANDS.format(0.6), _HANDED_BACK,
        start=_silence_position, stop=_tell_position,
    ),
    FaultSpec(
        "position-frozen", "the position streams repeat one place and speed with fresh stamps",
        _LANDS.format(0.2), _HANDED_BACK, start=_freeze_position, stop=_thaw_position,
    ),
    FaultSpec(
        "ekf-reset", "the estimate jumps VALUE metres north and counts a reset", "the companion flies on",
        "tests/loopback/test_fault_flights.py::test_a_counted_reset_ends_nothing",
        value=1.0, unit="m", limits=(-100.0, 100.0), start=_reset_estimate,
    ),
    FaultSpec(
        "attitude-loss", "the attitude streams stop coming and the estimator's attitude flag falls", _LANDS.format(0.5),
        _HANDED_BACK, start=_silence_attitude, stop=_tell_attitude,
    ),
    FaultSpec(
        "clock-jump", "every stamp of the autopilot's jumps by VALUE seconds", "the companion hands back: Hold at once",
        _HANDED_BACK, value=1.0, unit="s", limits=(-1e4, 1e4), start=_jump_clock,
    ),
    FaultSpec(
        "motor-loss", "motor VALUE (1 to 4) gives no thrust", "it tumbles and falls",
        "tests/unit/test_by_hand.py::test_a_quadrotor_that_loses_a_motor_tumbles_and_falls",
        value=1.0, unit="1..4", limits=(1.0, 4.0), start=_stop_motor, stop=_run_motor,
    ),
    *(
        FaultSpec(
            row.name, row.does, "tracking degrades", _DEGRADED,
            value=row.value, unit=row.unit, limits=row.limits, settings=row.settings,
        )
        for row in LINK_FAULTS
    ),
)  # fmt: skip
"""The table."""

_BY_NAME: Final = {spec.name: spec for spec in FAULTS}
_FORM: Final = re.compile(
    r"(?P<name>[a-z-]+?)(:(?P<value>[^@+]+))?(@(?P<at>[.\d]+))?(\+(?P<duration>[.\d]+))?", re.ASCII
)


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault that was asked for."""

    spec: FaultSpec
    value: float
    at_s: float
    """After take-off; NaN: from the first message."""
    duration_s: float = math.inf

    @property
    def words(self) -> str:
        """For the log."""
        value = "" if math.isnan(self.value) else f" {self.value:g}"
        return f"{self.spec.name}{value}"


def parse_faults(text: str | None) -> tuple[Fault, ...]:
    """The faults of `--fault`; InputError, one line that lists the table, where a name or number is none."""
    return tuple(_parse(word.strip()) for word in (text or "").split(",") if word.strip())


def _parse(word: str) -> Fault:
    form = _FORM.fullmatch(word)
    spec = _BY_NAME.get(form["name"]) if form else None
    if form is None or spec is None:
        raise InputError(
            f"fault {word!r}: unknown; write NAME[:VALUE][@SECONDS][+DURATION] with one of {', '.join(_BY_NAME)}"
        )
    value = _number(word, form["value"], spec.value)
    if form["value"] and not spec.unit:
        raise InputError(f"fault {word!r}: {spec.name} takes no value")
    if form["value"] and not spec.limits[0] <= value <= spec.limits[1]:
        raise InputError(f"fault {word!r}: the value ({spec.unit}) must lie in {spec.limits[0]:g}..{spec.limits[1]:g}")
    if form["duration"] and spec.start is not None and spec.stop is None:
        raise InputError(f"fault {word!r}: {spec.name} happens once and can't end: leave +DURATION out")
    default_s = math.nan if spec.start is None else DEFAULT_TIME_S
    return Fault(spec, value, _number(word, form["at"], default_s), _number(word, form["duration"], math.inf))


def _number(word: str, text: str | None, default: float) -> float:
    if text is None:
        return default
    try:
        return float(text)
    except ValueError:
        raise InputError(f"fault {word!r}: {text!r} is no number") from None


class Injector:
    """Lets the faults of one flight begin and end; `happened` is what has, with its time."""

    __slots__ = ("_seen", "_todo", "begun", "faults", "happened", "takeoff_us")

    def __init__(self, faults: tuple[Fault, ...]) -> None:
        self.faults = faults
        self.happened: list[tuple[int, str]] = []
        self.takeoff_us = -1
        self._seen = 0
        self._todo: list[tuple[int, bool, Fault]] = []
        self.begun: list[tuple[int, Fault]] = []
        """Those that somebody let begin, and when."""

    def new(self) -> list[tuple[int, str]]:
        """What has happened since the last call."""
        fresh = self.happened[self._seen :]
        self._seen = len(self.happened)
        return fresh

    def step(self, server: Server) -> None:
        """Once a tick, before it."""
        now_us = server.t_us
        state = server.commander.state
        if self.takeoff_us < 0 and state.armed and state.flown:
            self.takeoff_us = now_us
            self._plan(now_us)
        while self._todo and self._todo[0][0] <= now_us:
            _, begins, fault = self._todo.pop(0)
            act = fault.spec.start if begins else fault.spec.stop
            if act is not None:
                act(server, fault.value)
            self.happened.append((now_us, f"{fault.words} {'begins' if begins else 'ends'}"))

    def begin(self, faults: tuple[Fault, ...], now_us: int) -> None:
        """These faults begin now, whatever time they name."""
        for fault in faults:
            self.begun.append((now_us, fault))
            self._schedule(fault, now_us)

    def _schedule(self, fault: Fault, begin_us: int) -> None:
        self._todo.append((begin_us, True, fault))
        if math.isfinite(fault.duration_s):
            self._todo.append((begin_us + round(1e6 * fault.duration_s), False, fault))
        self._todo.sort(key=lambda entry: entry[0])

    def _plan(self, now_us: int) -> None:
        for fault in self.faults:
            if math.isnan(fault.at_s):
                continue
            self._schedule(fault, now_us + round(1e6 * fault.at_s))

    def link_quality(self, now_us: int) -> LinkQuality:
        """What the link faults make of the link now."""
        quality = LinkQuality()
        for fault in self.faults:
            if fault.spec.start is None and self._holds(fault, now_us):
                quality = quality.with_settings(fault.spec.settings, fault.value)
        for begin_us, fault in self.begun:
            if fault.spec.start is None and 0.0 <= 1e-6 * (now_us - begin_us) < fault.duration_s:
                quality = quality.with_settings(fault.spec.settings, fault.value)
        return quality

    def _holds(self, fault: Fault, now_us: int) -> bool:
        if math.isnan(fault.at_s):
            return not math.isfinite(fault.duration_s) or now_us < 1e6 * fault.duration_s
        if self.takeoff_us < 0:
            return False
        since_s = 1e-6 * (now_us - self.takeoff_us) - fault.at_s
        return 0.0 <= since_s < fault.duration_s

    @property
    def on_the_link(self) -> bool:
        """Whether any of them is a link fault."""
        if not self.faults and not self.begun:
            return False
        return any(fault.spec.start is None for fault in (*self.faults, *(fault for _, fault in self.begun)))
