"""The commander: arming, modes, failsafes and the automatic disarms, as PX4 has them.

Pure: `Commander.step(inputs, now_us)` is called once a tick with everything that happened, changes `Commander.state`
(plain data, readable by all) and returns what is to be said and answered.  No clock, no link, no vehicle.

Intention and reality are two things, as in PX4: `intended` is the mode last chosen, `mode` the one that flies.  A
failsafe changes only `mode`; when its cause goes away (a setpoint stream resumes) the intention flies again by itself.
Times follow PX4: setpoint freshness and the arming checks are looked at ten times a second.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from flightstack_sim.autopilot import arming, failsafe, modes, notices, requests
from flightstack_sim.autopilot.arming import Checks, Conditions
from flightstack_sim.autopilot.failsafe import Action, Failsafe, FailsafeStatus, battery_warning
from flightstack_sim.autopilot.goal import Goal
from flightstack_sim.autopilot.modes import Mode
from flightstack_sim.autopilot.notices import Notice
from flightstack_sim.autopilot.params import Params

_EXPLAINED_TO: Final = 190  # component id of mission planners: only they get the words of a refused mode
_EXPLAIN_US: Final = 1_000_000

_SILENCE: Final = requests.Replies((), ())


@dataclass(slots=True)
class CommanderState:
    """Everything the commander remembers."""

    checks: Checks
    mode: Mode = modes.HOLD
    intended: Mode = modes.HOLD
    kept: Mode = modes.HOLD
    """The mode that comes back after a disarm."""
    armed: bool = False
    armed_at_us: int = requests.NEVER
    flown: bool = False
    """Taken off since arming."""
    landed: bool = True
    landed_at_us: int = requests.NEVER
    takeoff_altitude_m: float = math.nan
    """Above the sea; NaN takes MIS_TAKEOFF_ALT."""
    action: Action = Action.NONE
    """The failsafe that flies, NONE without."""
    next_cycle_us: int = 0
    reported_for: Checks | None = None
    reported: tuple[Notice, ...] = ()
    reported_at_us: int = requests.NEVER
    explained_at_us: int = requests.NEVER
    goal: Goal | None = None
    """Where Hold or Orbit was sent; None: where it is."""
    gcs_lost: bool = True
    """No ground station is heard; true until one is."""
    gcs_seen: bool = False
    sticks_heard: bool = False
    """Since arming: before, nobody counts on them."""
    terminated: bool = False
    """Flight termination is for good, until the next start."""

    @property
    def in_failsafe(self) -> bool:
        """Whether a failsafe flies instead of the intention."""
        return self.action > Action.WARN


class Commander:
    """PX4's commander for one vehicle."""

    __slots__ = ("_answers", "_failsafe", "_inputs", "_notices", "_params", "state")

    def __init__(self, params: Params) -> None:
        self._params = params
        self._notices: list[Notice] = []
        self._answers: list[requests.Answer] = []
        self._failsafe = Failsafe(params)
        self._inputs = requests.Inputs(True, requests.NEVER)
        nothing = Conditions(estimate_ready=False, offboard_signal=False)
        self.state = CommanderState(arming.check(modes.HOLD, nothing))

    def step(self, inputs: requests.Inputs, now_us: int) -> requests.Replies:
        """Advance to `now_us`; requests are handled in their order, before the failsafes."""
        state, self._inputs = self.state, inputs
        if inputs.landed is not state.landed:
            self._landed_changed(inputs.landed, now_us)
        if inputs.takeoff_done and state.intended is modes.TAKEOFF and state.armed:
            state.intended = modes.HOLD
            self._apply_mode(now_us, chosen=True)
        if state.intended is modes.MISSION and state.armed:
            if inputs.mission_returns:
                self._choose(modes.RTL, now_us)
                self._notices.append(notices.RETURNING)
            elif (inputs.mission_over or not inputs.mission_valid) and not inputs.landed:
                self._choose(modes.HOLD, now_us)
        for request in inputs.requests:
            self._handle(request, inputs, now_us)
        if now_us >= state.next_cycle_us:
            state.next_cycle_us = now_us - now_us % requests.CYCLE_US + requests.CYCLE_US
            self._hear_gcs(inputs, now_us)
            self._check(inputs, now_us)
            self._apply_mode(now_us)
            self._disarm_by_timer(now_us)
            self._report(now_us)
        if not self._notices and not self._answers:
            return _SILENCE
        outputs = requests.Replies(tuple(self._notices), tuple(self._answers))
        self._notices.clear()
        self._answers.clear()
        return outputs

    # --- the ten-times-a-second part ---

    def _check(self, inputs: requests.Inputs, now_us: int) -> None:
        """Look at the conditions and evaluate the arming checks for the intended mode."""
        state = self.state
        age_us = now_us - inputs.last_setpoint_us
        ready = now_us >= requests.ESTIMATE_READY_US
        sticks = now_us - inputs.sticks_at_us < self._params.get("COM_RC_LOSS_T") * 1e6
        if sticks and state.armed:
            state.sticks_heard = True
        conditions = Conditions(
            ready and not state.terminated,
            age_us < self._params.get("COM_OF_LOSS_T") * 1e6,
            sticks=sticks,
            mission=inputs.mission_valid,
            armed=state.armed,
            position_valid=inputs.position_valid,
            gcs_missing=state.gcs_lost and not state.armed and self._params.get("NAV_DLL_ACT") > 0.0,
            silent=inputs.silent,
        )
        if ready and not state.checks.conditions.estimate_ready:
            self._notices.append(notices.READY)
        if conditions != state.checks.conditions or state.intended is not state.checks.mode:
            state.checks = arming.check(state.intended, conditions)

    def _hear_gcs(self, inputs: requests.Inputs, now_us: int) -> None:
        """Whether a ground station is there (COM_DL_LOSS_T)."""
        state = self.state
        lost = now_us - inputs.gcs_at_us > self._params.get("COM_DL_LOSS_T") * 1e6
        if lost is not state.gcs_lost:
            if lost or state.gcs_seen:
                self._notices.append(notices.GCS_LOST if lost else notices.GCS_REGAINED)
            state.gcs_lost, state.gcs_seen = lost, True

    def _apply_mode(self, now_us: int, *, chosen: bool = False) -> None:
        """Fly the intention, or the failsafe that takes its place; `chosen`: somebody has just chosen a mode."""
        state, inputs = self.state, self._inputs
        status = FailsafeStatus(
            state.intended,
            state.armed,
            state.checks.can_run,
            state.checks.conditions.offboard_signal,
            state.gcs_lost,
            battery_warning(inputs.battery_remaining, self._params),
            inputs.breached,
            state.sticks_heard and not state.checks.conditions.sticks,
            inputs.attitude_failed,
        )
        if state.terminated:
            state.mode = modes.TERMINATION
            return
        selected = self._failsafe.update(status, now_us, chosen=chosen)
        state.action = selected.action
        if selected.announce:
            self._notices.append(
                notices.failsafe(
                    state.intended.custom_mode, selected.action, selected.cause, selected.then, selected.delay_s
                )
            )
        if selected.action is Action.DISARM:
            self._disarm(notices.BY_FAILSAFE)
        else:
            state.terminated = selected.action is Action.TERMINATE
            state.mode = failsafe.ACTION_MODES.get(selected.action, state.intended)

    def _disarm_by_timer(self, now_us: int) -> None:
        """Disarm after a landing, and when nobody takes off."""
        state = self.state
        if not state.armed or not state.landed:
            return
        if state.flown:
            limit_s = self._params.get("COM_DISARM_LAND")
            if limit_s > 0.0 and now_us - state.landed_at_us >= limit_s * 1e6:
                self._disarm(notices.BY_LANDING)
        else:
            limit_s = self._params.get("COM_DISARM_PRFLT")
            spool_s = self._params.get("COM_SPOOLUP_TIME")
            if limit_s > 0.0 and now_us - state.armed_at_us > (limit_s + spool_s) * 1e6:
                self._disarm(notices.BY_PREFLIGHT)

    def _report(self, now_us: int) -> None:
        """Tell about the arming checks when they changed, at most every REPORT_US."""
        state = self.state
        if state.checks != state.reported_for and now_us - state.reported_at_us >= requests.REPORT_US:
            state.reported_for = state.checks
            burst = arming.report(state.checks)
            if burst != state.reported:
                state.reported, state.reported_at_us = burst, now_us
                self._notices.extend(burst)

    def report_again(self) -> None:
        """Repeat the report of the arming checks: a ground station has come."""
        self.state.reported_for, self.state.reported = None, ()

    # --- what happens to the vehicle ---

    def _landed_changed(self, landed: bool, now_us: int) -> None:
        state = self.state
        state.landed = landed
        if landed:
            state.landed_at_us = now_us
        elif state.armed:
            state.flown = True
        if state.armed:
            self._notices.append(notices.LANDING_DETECTED if landed else notices.TAKEOFF_DETECTED)

    def _arm(self, reason: int, now_us: int) -> None:
        state = self.state
        state.armed = True
        state.armed_at_us = now_us
        state.flown = not state.landed
        self._notices.append(notices.armed(reason))

    def _disarm(self, reason: int) -> None:
        state = self.state
        state.armed = False
        state.flown = False
        state.action = Action.NONE
        self._failsafe.reset()
        if not state.intended.kept_after_disarm:
            state.intended = state.kept
        state.mode = modes.TERMINATION if state.terminated else state.intended
        state.sticks_heard = False
        self._notices.append(notices.disarmed(reason))

    # --- requests ---

    def _handle(self, request: requests.Request, inputs: requests.Inputs, now_us: int) -> None:
        if isinstance(request, requests.ModeRequest):
            self._check(inputs, now_us)  # a client's first setpoint and its wish for OFFBOARD come within a millisecond
            result = self._choose_by_number(request, now_us)
            self._answers.append(requests.Answer(request.sender, requests.COMMAND_SET_MODE, result))
        elif isinstance(request, requests.ArmRequest):
            self._arm_or_disarm(request, inputs, now_us)
        elif isinstance(request, requests.GoRequest):
            self._answers.append(requests.Answer(request.sender, request.command, self._go(request, now_us)))
        elif isinstance(request, requests.TerminateRequest):
            self._terminate(now_us)
            self._answers.append(requests.Answer(request.sender, requests.COMMAND_TERMINATE, requests.ACCEPTED))
        elif isinstance(request, requests.StartRequest):
            self._answers.append(
                requests.Answer(request.sender, requests.COMMAND_START, self._start_mission(inputs, now_us))
            )
        else:
            self._answers.append(requests.Answer(request.sender, request.command, self._fly(request, now_us)))

    def _choose_by_number(self, request: requests.ModeRequest, now_us: int) -> int:
        """DO_SET_MODE and SET_MODE."""
        mode = modes.mode_for(request.main, request.sub)
        if mode is None or mode is modes.TERMINATION:
            auto = request.main == modes.MAIN_AUTO
            self._notices.append(notices.UNSUPPORTED_AUTO_MODE if auto else notices.UNSUPPORTED_MAIN_MODE)
            return requests.TEMPORARILY_REJECTED
        if self._choose(mode, now_us):
            return requests.ACCEPTED
        state = self.state
        if request.sender.component == _EXPLAINED_TO and now_us - state.explained_at_us >= _EXPLAIN_US:
            state.explained_at_us = now_us
            self._notices.append(notices.mode_not_available(mode.title, mode.custom_mode, mode.nav_state))
        return requests.TEMPORARILY_REJECTED

    def _choose(self, mode: Mode, now_us: int) -> bool:
        """Make `mode` the intention; a disarmed vehicle takes any, an armed one only what can run."""
        state = self.state
        if state.armed and mode is not modes.LAND and not state.checks.runs(mode):
            return False
        state.intended, state.goal = mode, None
        if mode.kept_after_disarm and not mode.prevents_arming:
            state.kept = mode
        state.checks = arming.check(mode, state.checks.conditions)
        self._apply_mode(now_us, chosen=True)
        return True

    def _fly(self, request: requests.FlyRequest, now_us: int) -> int:
        """Take off, land or return."""
        if request.command == requests.COMMAND_TAKEOFF:
            chosen, notice = self._choose(modes.TAKEOFF, now_us), None
            if chosen:
                self.state.takeoff_altitude_m = request.altitude_m
        elif request.command == requests.COMMAND_LAND:
            chosen, notice = self._choose(modes.LAND, now_us), notices.LANDING_HERE
        else:
            chosen, notice = self._choose(modes.RTL, now_us), notices.RETURNING
        if chosen and notice is not None:
            self._notices.append(notice)
        return requests.ACCEPTED if chosen else requests.TEMPORARILY_REJECTED

    def _terminate(self, now_us: int) -> None:
        """DO_FLIGHTTERMINATION: the motors stop, for good."""
        state = self.state
        if not state.terminated:
            state.terminated, state.action = True, Action.TERMINATE
            self._notices.append(notices.failsafe(state.intended.custom_mode, Action.TERMINATE))
            self._notices.append(notices.TERMINATED)
        self._apply_mode(now_us)

    def _start_mission(self, inputs: requests.Inputs, now_us: int) -> int:
        """MISSION_START: choose the mode, and arm."""
        self._check(inputs, now_us)
        if not inputs.mission_valid or not self._choose(modes.MISSION, now_us):
            self._notices.append(notices.NO_VALID_MISSION)
            return requests.DENIED
        if not self.state.armed:
            if not self.state.checks.arms(modes.MISSION):
                self._notices.append(notices.ARMING_DENIED)
                return requests.TEMPORARILY_REJECTED
            self._arm(notices.BY_MISSION_START, now_us)
            self._apply_mode(now_us)
        return requests.ACCEPTED

    def _go(self, request: requests.GoRequest, now_us: int) -> int:
        """Reposition (in Hold) or orbit; without the change of mode the goal counts where Hold flies already."""
        mode = modes.ORBIT if request.command == requests.COMMAND_ORBIT else modes.HOLD
        if request.changes_mode and not self._choose(mode, now_us):
            orbit = mode is modes.ORBIT
            self._notices.append(notices.ORBIT_REJECTED if orbit else notices.REPOSITION_REJECTED)
            return requests.TEMPORARILY_REJECTED
        if self.state.intended is mode:
            self.state.goal = request.goal
        return requests.ACCEPTED

    def _arm_or_disarm(self, request: requests.ArmRequest, inputs: requests.Inputs, now_us: int) -> None:
        """COMPONENT_ARM_DISARM; a value that is neither 0 nor 1 gets words but no answer, as on PX4."""
        state = self.state
        result = requests.ACCEPTED
        if request.param == 1.0:
            if not state.armed:
                self._check(inputs, now_us)
                if state.checks.arms(state.intended):
                    self._arm(notices.BY_COMMAND, now_us)
                    self._apply_mode(now_us)
                else:
                    self._notices.append(notices.ARMING_DENIED)
                    if not state.checks.conditions.estimate_ready:
                        self._notices.append(notices.HEADING_NOT_STABLE)
                    if state.checks.conditions.gcs_missing:
                        self._notices.append(notices.NO_GCS)
                    for sensor in state.checks.conditions.silent:
                        self._notices.append(Notice(0, 0, b"", notices.CRITICAL, notices.NO_DATA.format(sensor)))
                    result = requests.TEMPORARILY_REJECTED
        elif request.param == 0.0:
            if state.armed and not state.landed and not request.force:
                self._notices.append(notices.DISARMING_DENIED)
                result = requests.TEMPORARILY_REJECTED
            elif state.armed:
                self._disarm(notices.BY_COMMAND)
        else:
            value = request.param if math.isfinite(request.param) else math.nan
            self._notices.append(notices.unsupported_arm_param(value))
            return
        self._answers.append(requests.Answer(request.sender, requests.COMMAND_ARM, result))
