"""The whole flight stack in order: learn -> certify -> control -> limit -> filter -> guard, and a record of why.

One pure function, `Stack.tick`: no clock, no socket, no hidden state, the same for a real vehicle and a simulated one.
Before it the streams are predicted to their newest sample (`flightstack.predictor`) and carried on to `now_us` by what
was sent (`Stack.carried`), after it the command goes to the link.
In flight nothing raises: what goes wrong ends as the guard's fallback, named in the record.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from flightstack.applied import Applied
from flightstack.barrier.initial import DOWN
from flightstack.barrier.premise_watch import (
    RATE_GAINS,
    Seen,
    WatchState,
    ended_by,
    interrupted,
    is_inside,
    watch,
    watched,
)
from flightstack.barrier.records import Certificate
from flightstack.control.feedback import FlatnessController
from flightstack.governor import Governor, GovernorState
from flightstack.guard import Guard, carried_thrust, stale
from flightstack.lift_off import LiftOff
from flightstack.model import Limiter, Limits, Model
from flightstack.rows import ATTITUDE, F_STATUS, Q_Z
from flightstack.seams import Certifier, Controller, Learner, NoCertifier, NoFilter, NoLearner, SafetyFilter
from flightstack.types import F64, Command, Filtered, FlatOutput, Learned, Measurement, Proposal, TickRecord, made
from flightstack.under_way import UnderWay


class StackState(NamedTuple):
    """Everything that one tick hands to the next."""

    control: Any
    learner: object
    certifier: object
    filter: object
    filtered: Filtered
    """What the filter said last."""
    measurement: Measurement
    """The last one that was there."""
    sent: Command
    origin_ned_m: F64
    """Where the flight began, (3,)."""
    carried_n: float
    """Vertical thrust of the last second or so: what the guard trusts to carry the vehicle."""
    applied: Applied = Applied()
    """What the motors made of the thrust that was sent."""
    governor: GovernorState | None = None
    """The rate loop as modelled; None: there is no governor."""
    watch: WatchState = WatchState()
    """Of the premises of the certificate in force."""
    learned: Learned = Learned.nothing()
    """What the learner said last."""
    under_way: F64 | None = None
    """Commands sent of late; None: none yet.  Written in place."""
    lift_off: LiftOff = LiftOff()


class Stack:
    """The flight stack of one believed vehicle; final, holds only constants."""

    __slots__ = (
        "braking", "certifier", "controller", "filter", "governor", "guard", "learner", "limiter", "limits", "model",
        "under_way",
    )  # fmt: skip

    def __init__(
        self,
        model: Model,
        limits: Limits | None = None,
        *,
        controller: Controller | None = None,
        learner: Learner | None = None,
        certifier: Certifier | None = None,
        safety_filter: SafetyFilter | None = None,
        governor: Governor | None = None,
    ) -> None:
        """`governor`: of rate commands, which has the last word while a certificate that counts on it is in force.

        Where a premise of a certificate ended it the stack's own controller flies to rest, whoever flew before: the
        filter alone goes by bounds that no longer hold, and lets a controller that pushes outwards push on.
        """
        self.model = model
        self.limits = limits or Limits()
        self.controller: Controller = controller or FlatnessController(model, limits=self.limits)
        own = isinstance(self.controller, FlatnessController)
        self.braking: Controller = self.controller if own else FlatnessController(model, limits=self.limits)
        self.learner: Learner = learner or NoLearner()
        self.certifier: Certifier = certifier or NoCertifier()
        self.filter: SafetyFilter = safety_filter or NoFilter()
        self.governor = governor
        self.guard = Guard(model, self.limits)
        self.limiter = Limiter(model, self.limits)
        self.under_way = UnderWay(model)

    def init(self, measurement: Measurement, origin_ned_m: F64 | None = None, *, stands: bool = False) -> StackState:
        """State at the start: nothing is corrected, learned or carried beyond the weight.

        `origin_ned_m` (3,): where the flight began, if that is better known than from this one measurement; `stands`:
        at rest on the ground, where it turns gently only before it flies.
        """
        weight = self.model.weight_n
        sent = Command(measurement.t_us, weight, self.model.norm_of(weight), np.zeros(3))
        control = self.controller.init(measurement.t_us)
        origin = (measurement.pos_ned_m if origin_ned_m is None else origin_ned_m).copy()
        filtered = self.filter.init(origin)
        certifier = self.certifier.init()
        return StackState(
            control, self.learner.init(), certifier, filtered, _UNFILTERED, measurement, sent, origin, weight,
            governor=None if self.governor is None else self.governor.init(), under_way=self.under_way.init(),
            lift_off=LiftOff(stands),
        )  # fmt: skip

    def resume(self, state: StackState, measurement: Measurement) -> StackState:
        """State to go on from after somebody else flew: what was learned and certified stays, control begins anew."""
        weight = self.model.weight_n
        sent = Command(measurement.t_us, weight, self.model.norm_of(weight), np.zeros(3))
        control = self._pilot(state.watch).init(measurement.t_us)
        return state._replace(
            control=control, sent=sent, measurement=measurement, carried_n=weight, filtered=_UNFILTERED,
            watch=interrupted(state.watch),
        )  # fmt: skip

    def gains_changed(self, state: StackState) -> StackState:
        """State after the vehicle told of other rate gains: a certificate in force is over, the vehicle is braked."""
        watch = ended_by(state.watch, state.measurement, RATE_GAINS)
        control = self._handed(state.control, state.watch, self._pilot(watch), state.sent.t_us)
        return state._replace(watch=watch, control=control)

    def carried(self, state: StackState | None, measurement: Measurement, now_us: int) -> Measurement:
        """A state as of its newest sample, at `now_us`; before each tick.  No stack's state: nothing was sent."""
        if state is None or state.under_way is None:
            none = Command(measurement.t_us, 0.0, math.nan, np.zeros(3))
            return self.under_way.carry(self.under_way.init(), measurement, none, _NOT_LEARNING, now_us)
        sent = state.applied.of(state.sent)
        in_force = self.filter.in_force(state.filter)
        return self.under_way.carry(state.under_way, measurement, sent, state.learned, now_us, in_force)

    def tick(
        self, state: StackState, measurement: Measurement | None, setpoint: FlatOutput, now_us: int
    ) -> tuple[StackState, Command, TickRecord]:
        """One step: the next state, the command to send and the record.  `measurement` None: nothing was heard yet."""
        seen = measurement or state.measurement
        usable = not stale(measurement, self.limits)
        control, learner, certifier, safe, before, _, sent, origin, carried, applied, governing, premises, *_ = state
        proposal, learned, wanted, saturated = _NO_PROPOSAL, _NOT_LEARNING, sent, False
        filtered, turned, lift_off = _UNFILTERED, False, state.lift_off
        if usable:
            lift_off = lift_off.step(seen, (now_us - sent.t_us) * 1e-6)
            applied = applied.follow(sent, seen.motor_command, self.model, now_us - sent.t_us)
            learner, learned = self.learner.step(learner, seen, applied.of(sent), setpoint)
            certifier, certificate = self.certifier.step(certifier, learner, seen, learned, before)
            if certificate is not None:
                safe = self.filter.adopt(safe, certificate)
                premises = _watched(certificate, self.model)
            if premises.version >= 0 and before.row.item(F_STATUS) >= _ENGAGED:
                since = sent, learned, applied.ratio, (now_us - sent.t_us) * 1e-6, is_inside(before)
                premises = watch(premises, seen, made(Seen, since), self.model.mass_kg, setpoint.yaw_rad)
            setpoint = setpoint if premises.rest is None else premises.rest
            bent = self.filter.bend(safe, setpoint)
            pilot = self._pilot(premises)
            control = self._handed(control, state.watch, pilot, now_us)
            met, bent, forward = _met(pilot, seen, bent, learned)
            control, proposal = pilot.step(control, met, bent, forward, sent, now_us)
            wanted, saturated = self.limiter.limit(proposal.thrust_n, proposal.rate_frd_radps, now_us)
            wanted, turned = self.guard.turn_back(wanted, seen, origin, carried, now_us)
            safe, wanted, filtered = self.filter.step(safe, seen, wanted, sent, learned)
            if premises.version >= 0:
                filtered = filtered.with_premise(premises.broken, premises.ended)
        command, guard = self.guard.check(wanted, measurement, origin, carried, now_us, turned)
        command = command if guard else lift_off.of(command)
        governing, command, governed = self._govern(governing, command, safe, seen)
        if guard and not self._pilot(premises).healthy(control):
            control = self._pilot(premises).init(now_us)
        if not guard:
            carried = carried_thrust(carried, command, seen, now_us - sent.t_us)
        said = now_us, setpoint, seen, proposal, learned, command, saturated, guard, filtered, governed
        after = (
            control, learner, certifier, safe, filtered, seen, command, origin, carried, applied, governing, premises,
            learned if usable else state.learned, state.under_way, lift_off,
        )  # fmt: skip
        return made(StackState, after), command, made(TickRecord, said)

    def _pilot(self, watch: WatchState) -> Controller:
        return self.controller if watch.rest is None else self.braking

    def _handed(self, control: Any, before: WatchState, pilot: Controller, now_us: int) -> Any:
        """The state of whoever flies: anew where it is another one than before."""
        return control if pilot is self._pilot(before) else pilot.init(now_us)

    def _govern(
        self, state: GovernorState | None, command: Command, safe: object, seen: Measurement
    ) -> tuple[GovernorState | None, Command, bool]:
        """The command as torque's bounds leave it, and whether they changed it."""
        if self.governor is None or state is None:
            return state, command, False
        heading_rad = 2.0 * math.atan2(seen.row.item(ATTITUDE + Q_Z), seen.row.item(ATTITUDE))
        state, norm, rate = self.governor.step(state, command, self.filter.governed(safe), heading_rad)
        if rate is None and norm == command.thrust_norm:
            return state, command, False
        thrust = command.thrust_n if norm == command.thrust_norm else self.model.thrust_of(norm)
        return state, Command(command.t_us, thrust, norm, command.rate_frd_radps if rate is None else rate), True


_NO_PROPOSAL = Proposal(np.nan, np.full(20, np.nan))
_NOT_LEARNING = Learned.nothing()
_UNFILTERED = Filtered.nothing()
_ENGAGED = 2.0


def _met(
    pilot: Controller, seen: Measurement, bent: FlatOutput, learned: Learned
) -> tuple[Measurement, FlatOutput, Learned]:
    """State, reference and what is fed forward as a command that goes out now will meet them, beyond what the link
    takes; the filter goes by the state as it is, and by its certificate's own delay."""
    if seen.felt is None or not isinstance(pilot, FlatnessController):
        return seen, bent, learned
    span_s, row = 1e-6 * seen.late_us, learned.row.copy()
    row[0:3] += span_s * row[3:6]
    ages_us = seen.position_age_us, seen.attitude_age_us, seen.imu_age_us
    met = Measurement(seen.t_us + seen.late_us, seen.felt, *ages_us, seen.battery_v)
    return met, bent.later(span_s), Learned(row)


def _watched(certificate: Certificate, model: Model) -> WatchState:
    """The watch of a certificate that is taken; one without premises is not watched."""
    premises = certificate.premises
    if premises is None:
        return WatchState()
    down = next((axis.authority.table for axis in certificate.axes if axis.axis == DOWN), np.empty((7, 0)))
    north, east, along = (each / model.mass_kg for each in model.drag_kgps)
    return watched(certificate.version, premises, down, (north, east, along))
