"""A MAVLink router whose setpoints are made safe; sans-IO: datagrams in, datagrams out, time given.

From the vehicle everything passes, but for the answers to the router's own clock questions; from the program
everything but setpoints (SET_ATTITUDE_TARGET, SET_POSITION_TARGET_LOCAL_NED, _GLOBAL_INT) to whomever, and bytes that
are no frame.  What setpoints ask for goes through the stack, and every 4 ms body rates and thrust go to the vehicle,
for as long as setpoints come.

The program's silence for SILENT_US, or OFFBOARD entered where no way out is clear: the vehicle stops and holds; after
HOLDS_US of that it is handed over to PX4's Hold.  The router never selects OFFBOARD, arms or takes a mode away from a
pilot: outside OFFBOARD, while the program speaks, it asks for level flight, so that PX4 may enter OFFBOARD.  Only where
the router itself stood still and the dead-man commanded Hold meanwhile does it take OFFBOARD back, or land a vehicle
that has not risen (`shield_stall`).
Whatever ends it hands the vehicle over first.

A vehicle that restarts ends it (`ended`): its local frame, so the site's place, and its gains may be others.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from flightstack.cli.shield_controller import Relay, hold_of, is_whole, reference_of
from flightstack.cli.shield_frames import SETPOINT_IDS, SETPOINTS, decoded, without
from flightstack.cli.shield_premises import ShieldPremises
from flightstack.cli.shield_stall import AfterStall
from flightstack.cli.shield_streams import COMMAND_IDS, ShieldStreams
from flightstack.cli.site import TimedSiteFilter
from flightstack.geodesy import LocalFrame
from flightstack.predictor import predict, sampled
from flightstack.site.decide import PASSED
from flightstack.site.filter import SiteState, gain_of
from flightstack.site.shape import Site
from flightstack.stack import Stack, StackState
from flightstack.state_observer import StateObserver
from flightstack.types import F64, Measurement, TickRecord
from flightstack_sim.autopilot.offboard import from_attitude_target, from_global_target, from_position_target
from flightstack_sim.autopilot.setpoint import ControlSetpoint
from mavlink_bridge import messages as m
from mavlink_bridge import px4
from mavlink_bridge.aid_watch import AidWatch
from mavlink_bridge.dead_man_frames import ACTIVE, IN_OFFBOARD, CompanionRecord, DeadManRecord
from mavlink_bridge.framing import Frame
from mavlink_bridge.last_word import record_of
from mavlink_bridge.link import Link
from mavlink_bridge.requests import CommandQueue, set_mode
from mavlink_bridge.stalls import Stalls
from mavlink_bridge.vehicle_view import VehicleView
from mavlink_bridge.voice import Voice, yaw_of

SILENT_US = 500_000
HOLDS_US = 5_000_000
TIMESYNC_ID = m.id_of(m.Timesync)
_HEARTBEAT_US, _TIMESYNC_US = 1_000_000, 100_000
_STALE_US = 100_000
_BACK_US, _BACK_TIMES = 1_000_000, 10
"""A clock so far behind what it was, and so often on end: no link reorders like that, it is another boot."""
_OWN_STAMPS = 64
_RESTED = 500
"""Ticks that the place of rest is a mean of."""


@dataclass(slots=True)
class ShieldScore:
    """What was done with what was asked for."""

    setpoints: int = 0
    """Of the program."""
    ticks: int = 0
    """In which the stack flew the vehicle."""
    changed: int = 0
    governed: int = 0
    stopped: int = 0
    """In which nobody asked for anything any more, or no way out was clear."""
    handed_over: bool = False
    sites_replaced: int = 0


class ShieldRouter:
    """One vehicle and one program."""

    def __init__(
        self,
        stack: Stack,
        relay: Relay,
        refiner: StateObserver | None,
        place: tuple[float, float] | None = None,
        unknowing: Callable[[VehicleView], str] = lambda view: "",
    ) -> None:
        """`place`: latitude and longitude round which a site on the globe was laid out; None: it is none.  `unknowing`:
        what the vehicle says against the sensors that the margins are for; before it is armed that ends the router."""
        self.link, self.view, self.score = Link(240, 191), VehicleView(), ShieldScore()
        self.system = 0
        self.record: TickRecord | None = None
        """Of the last tick in OFFBOARD."""
        self.premises = ShieldPremises({})
        """What the site's certificate counts on."""
        self.origin_ned_m: F64 | None = None
        """Where the vehicle was armed first: the site stays where it is when the program lands and takes off again."""
        self._stack, self._relay, self._refiner, self._asked_place = stack, relay, refiner, place
        self._unknowing = unknowing
        self._commands, self._voice = CommandQueue(self.link), Voice(self.link)
        self._state: StackState | None = None
        self._wish: ControlSetpoint | None = None
        self._wish_us = self._obeyed_us = -1
        self._hold: tuple[F64, float] | None = None
        """Place and heading that are held while nobody is obeyed."""
        self._globe: LocalFrame | None = None
        self._home_m = 0.0
        self._rest, self._rested = np.zeros(3), 0
        self._heartbeat_us = self._timesync_us = -1_000_000_000
        self._stamps: set[int] = set()
        self._measurement: Measurement | None = None
        self._t_us = 0
        self._streams = ShieldStreams(self.view, self._commands)
        self.after_stall = AfterStall(self.view, self._commands)
        self.has_spoken = False
        """Whether a setpoint went out in the newest step."""
        self._is_alone = self.is_lost = False
        """There is no dead-man any more; the estimate has lost its satellites, so that nobody is obeyed."""
        self._aid = AidWatch()
        self.ended = ""
        """Why nothing is flown any more; empty while all is well."""
        self._newest_us = self._back = 0
        self._flies = self._is_certain = self._is_laid = self._asks_hold = False
        """Certain: a way out was committed since the stack began to fly.  Laid: the site no longer moves."""

    def replace_site(self, site: Site) -> str:
        """Keep to another site, in metres from where the vehicle was armed first; one line where that is not taken."""
        measurement, kept = self._measurement, self._stack.filter
        if measurement is None or self.origin_ned_m is None or not isinstance(kept, TimedSiteFilter):
            return f"{site.source}: where the vehicle is is not known yet"
        state = kept.init(self.origin_ned_m) if self._state is None else self._state.filter
        refused = kept.replace(state, site, measurement) if isinstance(state, SiteState) else "no site is kept"
        self.score.sites_replaced += not refused
        return refused

    # ---------------------------------------------------------------- pass

    def from_vehicle(self, data: bytes, now_us: int) -> list[bytes]:
        """Take a datagram of the vehicle; what the program gets of it."""
        self.link.receive_datagram(data, now_us)
        has_own = False
        for received in self.link.take_events():
            message = received.message
            has_own |= isinstance(message, m.Timesync) and message.ts1_ns in self._stamps
            if not self.system and isinstance(message, m.Heartbeat):
                if (message.autopilot, message.type) == (px4.AUTOPILOT_PX4, px4.TYPE_QUADROTOR):
                    self.system = self._voice.system = received.system
            if received.system == self.system and received.component == px4.COMPONENT_AUTOPILOT:
                if isinstance(message, m.CommandAck) and message.target_system == self.link.system:
                    self.after_stall.acknowledge(message, now_us)
                elif not isinstance(message, m.Timesync) or message.ts1_ns in self._stamps:
                    self.view.update(message, now_us)
                    self._place(message, now_us)
                    self._note_boot(message)
        return without(data, self._is_own_answer, whole=False) if has_own else [data]  # each frame twice takes time

    def _place(self, message: object, now_us: int) -> None:
        """Where local frame and home lie on the globe; the gains; and what the estimate goes by."""
        if isinstance(message, m.GpsGlobalOrigin):
            self._globe = LocalFrame(message.lat_deg, message.lon_deg, message.alt_msl_m)
        elif isinstance(message, m.HomePosition):
            self._home_m = message.alt_msl_m
        elif isinstance(message, m.ParamValue):
            self.premises.take(message)
        elif isinstance(message, m.GpsRawInt):
            self._aid.gps(message.fix_type, now_us)
        elif isinstance(message, m.EstimatorStatus):
            self._aid.estimator(message)

    def _note_boot(self, message: object) -> None:
        """Whether the vehicle's clock began anew."""
        if not isinstance(message, m.HighresImu):
            return
        self._back = self._back + 1 if message.t_us < self._newest_us - _BACK_US else 0
        self._newest_us = max(self._newest_us, message.t_us)
        if self._back >= _BACK_TIMES and not self.ended:
            self._flies, self.after_stall.since_us = False, -1
            self.ended = (
                "the vehicle restarted: where the site lies and its gains may have changed; start the shield anew"
            )

    def from_program(self, data: bytes, now_us: int) -> list[bytes]:
        """Take a datagram of the program; what the vehicle gets of it."""
        return without(data, lambda frame, payload: self._take_setpoint(frame, payload, now_us), whole=True)

    def _is_own_answer(self, frame: Frame, payload: bytes) -> bool:
        if frame.id != TIMESYNC_ID:
            return False
        message: Any = decoded(frame, payload)
        return message is not None and message.tc1_ns != 0 and message.ts1_ns in self._stamps

    def _take_setpoint(self, frame: Frame, payload: bytes, now_us: int) -> bool:
        """Whether a frame was a setpoint: then it goes no further, to whomever it is; for this vehicle it counts."""
        if frame.id in COMMAND_IDS:
            self._streams.note(decoded(frame, payload))
        if frame.id not in SETPOINT_IDS:
            return False
        message: Any = decoded(frame, payload)
        if not isinstance(message, SETPOINTS) or message.target_system not in (0, self.system):
            return True
        wish = self._wished(message, now_us) if message.target_component in (0, px4.COMPONENT_AUTOPILOT) else None
        if wish is not None:
            self._wish, self._wish_us = wish, now_us
            self.score.setpoints += 1
        return True

    def _wished(self, message: Any, now_us: int) -> ControlSetpoint | None:
        """What a setpoint asks for, as PX4 reads it; None where it asks for nothing."""
        if isinstance(message, m.SetAttitudeTarget):
            return from_attitude_target(message, self._wish) if is_whole(message) else None
        if isinstance(message, m.SetPositionTargetGlobalInt):
            return None if self._globe is None else from_global_target(message, self._globe, self._home_m)
        measurement = predict(self.view.streams, self.view.clock.vehicle_us(now_us))
        return from_position_target(message, 0.0 if measurement is None else yaw_of(measurement.q_ned_frd))

    # ---------------------------------------------------------------- stalls and ends

    @property
    def stalls(self) -> Stalls:
        """The dead-man's deeds."""
        return self.after_stall.stalls

    @property
    def flies(self) -> bool:
        """Whether the vehicle goes by the router's setpoints."""
        return self._flies

    def hear_dead_man(self, report: DeadManRecord, ended: str = "") -> None:
        """Take what the dead-man did of late, before each step."""
        self.stalls.hear(report)
        self.view.note_mode(report.mode, report.mode_ns // 1000)
        self._is_alone = bool(ended)

    def last_word(self, sent_us: int) -> CompanionRecord:
        """What the dead-man has to know if nothing follows; `sent_us`: local time of what was sent last."""
        active = self._flies or self.after_stall.is_taking_back
        flags = ACTIVE * active | IN_OFFBOARD * (active and self.view.in_offboard)
        thrust = 0.0 if self.view.on_ground else self._carrying_norm()
        return record_of(self._voice, self.link, self._measurement, thrust, flags, (sent_us, self._t_us))

    def hand_over(self, now_us: int) -> bool:
        """Ask for PX4's Hold while the router flies, before each step; whether nothing is in its hands any more."""
        if not self._flies:
            return True
        self._ask_for_hold(now_us)
        return False

    def _ask_for_hold(self, now_us: int) -> None:
        self._asks_hold = True
        if self._commands.ensure(set_mode(px4.MODE_HOLD), now_us) and self._measurement is not None:
            self._voice.stay(self._t_us, self._carrying_norm(), self._measurement.q_ned_frd)

    def say_last_words(self, reason: str) -> None:
        """The process is about to end, whatever the cause: level what the router flies, and ask for Hold."""
        if self._flies:
            heading = None if self._measurement is None else yaw_of(self._measurement.q_ned_frd)
            self._voice.calm(self._t_us, self._carrying_norm(), heading)
            self._commands.insist(set_mode(px4.MODE_HOLD))

    def _carrying_norm(self) -> float:
        model = self._stack.model
        return model.norm_of(self._state.carried_n if self._state else model.weight_n)

    # ---------------------------------------------------------------- step

    def step(self, now_us: int) -> list[bytes]:
        """Every 4 ms: what goes to the vehicle."""
        self.has_spoken = False
        if self.system and not self.ended:
            self._keep_in_touch(now_us)
            speaks, blind = now_us - self._wish_us <= SILENT_US, self._is_blind(self.view.clock.vehicle_us(now_us))
            self.after_stall.step(now_us, speaks=speaks, is_blind=blind, height_m=self._height_m)
            self._fly(now_us)
            if self.is_lost or (self._is_alone and self.view.params.needs_dead_man):
                self.hand_over(now_us)
            self._commands.step(now_us, self.system)
        return self.link.datagrams_to_send()

    def _keep_in_touch(self, now_us: int) -> None:
        if now_us - self._heartbeat_us >= _HEARTBEAT_US:
            self._heartbeat_us = now_us
            self.link.send(m.Heartbeat(px4.TYPE_ONBOARD_CONTROLLER, 8, 0, 0, 4))
        if now_us - self._timesync_us >= _TIMESYNC_US:
            self._timesync_us = now_us
            if len(self._stamps) > _OWN_STAMPS:
                self._stamps.clear()
            self._stamps.add(now_us * 1000)
            self.link.send(m.Timesync(0, now_us * 1000, self.system, px4.COMPONENT_AUTOPILOT))
        self.view.params.ask(self.link, self.system, now_us)
        self._streams.ask(now_us, lacks_place=self._globe is None, lacks_fixes=self._aid.is_silent(now_us))

    def _fly(self, now_us: int) -> None:
        t_us = self._t_us = self.view.clock.vehicle_us(now_us)
        measurement = self._measurement = self._measured(t_us)
        factor = self.view.params.values.get("THR_MDL_FAC")
        if measurement is None or factor is None or self._is_blind(t_us):
            return
        self._voice.thrust_model_factor = self._relay.thrust_model_factor = factor
        grounded = self.view.on_ground
        if grounded and not self.view.armed and not self._is_laid:
            self.ended = self.ended or self._unknowing(self.view)
            self._rested = min(self._rested + 1, _RESTED)
            self._rest += (measurement.pos_ned_m - self._rest) / self._rested
            self.origin_ned_m = self._origin(self._rest)
        self._is_laid |= self.view.armed
        if self.origin_ned_m is None:
            return
        self.is_lost = self._aid.is_lost(now_us)
        silent = self._wish is None or now_us - self._wish_us > SILENT_US or self.is_lost
        if not (self.view.armed and self.view.in_offboard) or (silent and grounded):
            self.score.handed_over |= self._asks_hold and self.view.custom_mode == px4.MODE_HOLD
            self._state, self._flies = self._state if self.view.armed else None, False
            if not silent:
                self._stand_by(measurement, t_us)
            return
        if not self._flies:
            state = self._state
            self._state = (
                self._stack.resume(state, measurement) if state else self._stack.init(measurement, self.origin_ned_m)
            )
            self._flies, self._is_certain, self._obeyed_us, self._hold = True, False, now_us, None
        assert self._state is not None
        self._tick(self._state, measurement, self._wish if not silent else None, t_us, now_us)

    @property
    def _height_m(self) -> float:
        """Above the place of arming; NaN where that is not known."""
        if self._measurement is None or self.origin_ned_m is None:
            return math.nan
        return float(self.origin_ned_m[2] - self._measurement.pos_ned_m[2])

    def _origin(self, rest_ned_m: F64) -> F64:
        """Where the site is laid out from: where the vehicle rests; of a site on the globe the place that it was laid
        out round, which ends the router where the vehicle was carried farther from it than its chute has room."""
        kept = self._stack.filter
        if self._asked_place is None or self._globe is None or not isinstance(kept, TimedSiteFilter):
            return rest_ned_m.copy()
        origin = np.array([*self._globe.to_local(*self._asked_place), rest_ned_m[2]])
        away_m = float(np.linalg.norm(rest_ned_m - origin))
        if away_m > kept.chute_room_m and self._rested == _RESTED and not self.ended:
            self.ended = f"the vehicle was carried {away_m:.1f} m since its site was laid out; start the shield anew"
        return origin

    def _is_blind(self, t_us: int) -> bool:
        """Whether the attitude is too old to fly by: then nothing is said, and the dead-man answers the silence."""
        return abs(t_us - self.view.streams.attitude_us) > _STALE_US  # nor of another boot's clock

    def _stand_by(self, measurement: Measurement, t_us: int) -> None:
        """A setpoint that does no harm until the router hears that OFFBOARD was selected: PX4 asks for some before."""
        self.has_spoken = True
        if self.view.on_ground or not self.view.armed:
            self._voice.stand(t_us)
        else:  # body rates where they will follow: PX4 takes 0.16 s to change from attitudes to them
            heading = None if self.after_stall.is_taking_back else yaw_of(measurement.q_ned_frd)
            self._voice.calm(t_us, self._carrying_norm(), heading)

    def _tick(
        self, state: StackState, measurement: Measurement, wish: ControlSetpoint | None, t_us: int, now_us: int
    ) -> None:
        if wish is None or not self._is_certain:
            if self._hold is None:
                speed = measurement.vel_ned_mps
                place = measurement.pos_ned_m + 0.25 * float(np.linalg.norm(speed)) * speed
                self._hold = place, yaw_of(measurement.q_ned_frd)
            self._relay.wish, reference = None, hold_of(*self._hold)
            self.score.stopped += 1
            if now_us - self._obeyed_us > HOLDS_US:
                self._ask_for_hold(now_us)
        else:
            self._hold, self._obeyed_us, self._asks_hold = None, now_us, False
            self._relay.wish, reference = wish, reference_of(wish, measurement)
        self._relay.gain = gain_of(state.filter)
        self._state, command, self.record = self._stack.tick(state, measurement, reference, t_us)
        self._voice.fly(command)
        self.has_spoken = True
        self._is_certain |= self.record.filtered.status >= PASSED
        self.score.ticks += 1
        self.score.changed += self.record.filtered.intervened == 1.0
        self.score.governed += self.record.governed

    def _measured(self, t_us: int) -> Measurement | None:
        measurement = sampled(self.view.streams, t_us, corrected=self._refiner is None)
        if measurement is None:
            return None
        measurement.late_us = self.view.way.late_us
        measurement = measurement if self._refiner is None else self._refiner.refine(measurement)
        return self._stack.carried(self._state, measurement, t_us)
