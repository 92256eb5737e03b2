"""Everything that can go wrong round the companion: one table.

A row says what happens, how it is noticed and from when on, what is done about it, how long that takes (from the fault
to the companion's deed, measured in the test that the row names), and the test.  `docs/safety.md` holds the same table,
and a test keeps both and the tests' names together.

PX4 goes on with the last setpoint that it got until COM_OF_LOSS_T has passed.  So whoever stops sending says safe last
words first: level, no rotation, the thrust that carried so far; then a mode of PX4's.
"""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple


class Reaction(Enum):
    """What the companion does."""

    REREFERENCE = "goes on: the jump is taken out of the position, nothing is chased"
    LAND = "hands back: safe words until PX4 is seen in its Land"
    HOLD = "hands back: safe words until PX4 is seen in its Hold, then silence"
    HANDS_OFF = "hands off: silence, no way back but a new run"
    STOP = "brakes, then PX4's Land"
    REFUSE = "refuses before the flight, one line says why; no setpoint is sent"
    DROP = "drops the frame and counts it"
    PX4 = "nothing: PX4's own offboard-loss failsafe acts"
    DEAD_MAN = "the dead-man levels by body rates and commands PX4's Hold"
    RETAKE = "the dead-man levels and commands PX4's Hold; OFFBOARD is taken back, at most once in 10 s"


class FaultReaction(NamedTuple):
    """A row."""

    what: str
    """In words."""
    noticed: str
    """By what, and from when on."""
    reaction: Reaction
    after_s: float | None
    """From the fault to the deed, measured by the test (250 Hz lockstep); None where time has no meaning."""
    test: str
    """File under tests/ and name of the test that shows it."""


_W = "unit/test_watchdogs.py::"
_L = "unit/test_ways_out.py::"
_S = "unit/test_signing.py::"
_C = "unit/test_companion.py::"
_P = "unit/test_vehicle_params.py::"
_D = "loopback/test_dead_companion.py::"

FAULTS: dict[str, FaultReaction] = {
    "stale-position": FaultReaction(
        "position and velocity stop arriving",
        "older than 34 ms: the guard levels and sinks; 0.5 s of it",
        Reaction.LAND, 0.536, _W + "test_every_fault_of_the_state_has_its_stated_reaction_in_its_stated_time",
    ),
    "stale-attitude": FaultReaction(
        "the attitude stops arriving",
        "older than 25 ms: the guard stops all rotation; 0.5 s of it",
        Reaction.LAND, 0.528, _W + "test_every_fault_of_the_state_has_its_stated_reaction_in_its_stated_time",
    ),
    "stale-imu": FaultReaction(
        "the IMU stops arriving",
        "older than 22 ms: the guard levels and sinks; 0.5 s of it",
        Reaction.LAND, 0.524, _W + "test_every_fault_of_the_state_has_its_stated_reaction_in_its_stated_time",
    ),
    "frozen-position": FaultReaction(
        "position or velocity repeat themselves with stamps that go on",
        "the very same numbers for 0.1 s",
        Reaction.LAND, 0.096, _W + "test_every_fault_of_the_state_has_its_stated_reaction_in_its_stated_time",
    ),
    "frozen-attitude": FaultReaction(
        "the attitude repeats itself with stamps that go on",
        "the very same numbers for 0.1 s; the last words hold the rates at zero",
        Reaction.LAND, 0.096, _W + "test_every_fault_of_the_state_has_its_stated_reaction_in_its_stated_time",
    ),
    "frozen-imu": FaultReaction(
        "the IMU repeats itself with stamps that go on",
        "the very same numbers for 0.1 s",
        Reaction.LAND, 0.096, _W + "test_every_fault_of_the_state_has_its_stated_reaction_in_its_stated_time",
    ),
    "velocity-against-imu": FaultReaction(
        "velocity runs away from what the IMU felt",
        "2 m/s apart within half a second or so (shown at 8 m/s^2)",
        Reaction.LAND, 0.348, _W + "test_every_fault_of_the_state_has_its_stated_reaction_in_its_stated_time",
    ),
    "position-against-velocity": FaultReaction(
        "position runs away from velocity",
        "1.5 m apart within a second or so (shown at 4 m/s)",
        Reaction.LAND, 0.472, _W + "test_every_fault_of_the_state_has_its_stated_reaction_in_its_stated_time",
    ),
    "attitude-against-gyro": FaultReaction(
        "the attitude tilts and the gyro feels nothing",
        "0.35 rad apart (shown at 30 degrees); the last words hold the rates at zero",
        Reaction.LAND, 0.0, _W + "test_every_fault_of_the_state_has_its_stated_reaction_in_its_stated_time",
    ),
    "estimator-attitude": FaultReaction(
        "the estimator says that its attitude is not good",
        "ESTIMATOR_STATUS twice (5 Hz: 0.2 to 0.4 s); the last words hold the rates at zero",
        Reaction.LAND, 0.356, _W + "test_every_fault_of_the_state_has_its_stated_reaction_in_its_stated_time",
    ),
    "estimator-position": FaultReaction(
        "the estimator says that position, velocity or height is not good",
        "ESTIMATOR_STATUS twice (5 Hz: 0.2 to 0.4 s)",
        Reaction.LAND, 0.356, _W + "test_every_fault_of_the_state_has_its_stated_reaction_in_its_stated_time",
    ),
    "reset": FaultReaction(
        "the estimator resets its position and counts it",
        "ODOMETRY's reset_counter, and a step of 0.05 m or more that velocity does not explain (shown at 3 m)",
        Reaction.REREFERENCE, 0.0, _W + "test_a_counted_reset_is_not_chased",
    ),
    "resets": FaultReaction(
        "the estimator resets its position again and again",
        "the third counted step within 10 s",
        Reaction.LAND, 0.04, _W + "test_a_third_reset_within_ten_seconds_hands_back",
    ),
    "jump": FaultReaction(
        "position jumps and no reset is counted",
        "a step of 0.25 m, taken out at once, and no count within 0.2 s (shown at 3 m)",
        Reaction.LAND, 0.204, _W + "test_every_fault_of_the_state_has_its_stated_reaction_in_its_stated_time",
    ),
    "reboot": FaultReaction(
        "the vehicle's time since boot goes back: it started anew",
        "an IMU stamp 1 s or more behind the newest, off the line through the earlier ones",
        Reaction.HOLD, 0.0, _W + "test_every_fault_of_the_state_has_its_stated_reaction_in_its_stated_time",
    ),
    "clock": FaultReaction(
        "the vehicle's clock jumps ahead, or this machine slept",
        "stamps or a TIMESYNC answer 0.5 s off the line through the earlier ones",
        Reaction.HOLD, 0.0, _W + "test_every_fault_of_the_state_has_its_stated_reaction_in_its_stated_time",
    ),
    "overrun-gap": FaultReaction(
        "no tick for a while: the machine was busy, the process was stopped",
        "0.25 s between two ticks; noticed with the next one",
        Reaction.HOLD, 0.0, _W + "test_a_long_gap_between_ticks_hands_back_to_hold",
    ),
    "overrun-rate": FaultReaction(
        "the machine is too slow: ticks are missed all the time",
        "210 of 250 missed within 1 s (shown with nine of ten)",
        Reaction.HOLD, 0.96, _W + "test_too_many_missed_ticks_hand_back_to_hold",
    ),
    "guard": FaultReaction(
        "outside the envelope, tipped over, or a command that is no number",
        "at once the guard brakes; 0.5 s of it without a break",
        Reaction.LAND, 0.504, _W + "test_a_guard_that_does_not_let_go_ends_the_flight",
    ),
    "exception": FaultReaction(
        "an exception in the companion (a bug), or a second Ctrl-C",
        "at once",
        Reaction.HOLD, 0.0, _L + "test_an_exception_in_flight_says_safe_last_words_and_asks_for_hold",
    ),
    "stopped": FaultReaction(
        "Ctrl-C or SIGTERM in flight",
        "within 0.1 s",
        Reaction.STOP, 0.0, _C + "test_stop_in_flight_lands_and_is_no_completed_flight",
    ),
    "killed": FaultReaction(
        "the companion is killed in flight (SIGKILL)",
        "by the dead-man: 50 ms after the last setpoint",
        Reaction.DEAD_MAN, 0.06, _D + "test_kills_at_random_moments_of_a_figure_8_are_harmless",
    ),
    "stalled": FaultReaction(
        "the companion stands still for 50 ms to 0.5 s (SIGSTOP, a busy machine)",
        "by the dead-man: 50 ms after the last setpoint",
        Reaction.RETAKE, 0.06, _D + "test_a_short_stall_is_taken_back_and_the_flight_completes",
    ),
    "stalled-long": FaultReaction(
        "the companion stands still for longer, or again within 10 s, or somebody else changed the mode meanwhile",
        "by the dead-man: 50 ms after the last setpoint",
        Reaction.HOLD, 0.06, _D + "test_a_long_stall_ends_in_hold",
    ),
    "dead-man-lost": FaultReaction(
        "the dead-man's process ends in flight",
        "within 0.1 s; with COM_OF_LOSS_T of 0.5 s or less the flight goes on and the log says so",
        Reaction.LAND, 0.1, _D + "test_without_its_dead_man_a_flight_at_a_long_loss_time_lands",
    ),
    "both-dead": FaultReaction(
        "companion and dead-man die together, or the whole machine freezes or loses its power",
        "by PX4: COM_OF_LOSS_T after the last setpoint, until then the last rates go on",
        Reaction.PX4, 1.1, "loopback/test_safety.py::test_both_dead_only_a_short_loss_time_keeps_the_vehicle_upright",
    ),
    "restarted": FaultReaction(
        "the companion is started again while the vehicle still flies",
        "armed, and OFFBOARD is what PX4 would go back to, or --arm was given, or the mode is not known",
        Reaction.REFUSE, None, _L + "test_a_restarted_companion_does_not_touch_a_vehicle_that_still_flies",
    ),
    "started-twice": FaultReaction(
        "a second companion on the same UDP port or serial line",
        "the port is bound, the line locked by the first alone",
        Reaction.REFUSE, None, _L + "test_a_second_companion_on_the_same_port_is_refused",
    ),
    "other-companion": FaultReaction(
        "another companion on the same link, through a router",
        "heartbeats of our own system and component, or another system's offboard setpoints",
        Reaction.REFUSE, None, _L + "test_another_companion_on_the_link_is_refused",
    ),
    "pilot-mode": FaultReaction(
        "the pilot changes the mode",
        "HEARTBEAT or CURRENT_MODE (10 Hz)",
        Reaction.HANDS_OFF, 0.1, _L + "test_a_pilots_mode_ends_the_flight_at_once_and_for_good",
    ),
    "pilot-disarm": FaultReaction(
        "the pilot disarms (kill switch)",
        "HEARTBEAT (1 Hz)",
        Reaction.HANDS_OFF, 1.0, _L + "test_a_pilots_kill_switch_ends_the_flight_and_nothing_arms_again",
    ),
    "link-lost": FaultReaction(
        "the link is lost both ways",
        "no usable state for 0.5 s: Land is asked for, safe words for 1 s, then silence",
        Reaction.LAND, 0.524, _L + "test_a_lost_link_falls_silent_before_it_may_come_back",
    ),
    "link-back": FaultReaction(
        "the link comes back after PX4's failsafe has acted",
        "another mode than OFFBOARD",
        Reaction.HANDS_OFF, 0.1, _L + "test_a_link_that_comes_back_finds_a_companion_that_keeps_its_hands_off",
    ),
    "unsigned": FaultReaction(
        "a frame without a signature although a key is set", "every frame but RADIO_STATUS",
        Reaction.DROP, None, _S + "test_unsigned_frames_are_dropped_and_counted",
    ),
    "wrong-key": FaultReaction(
        "a frame signed with another key, or altered on the way", "every frame",
        Reaction.DROP, None, _S + "test_frames_of_another_key_are_dropped_and_counted",
    ),
    "replayed": FaultReaction(
        "a signed frame that was recorded and is sent again", "its stamp is not newer, across restarts too",
        Reaction.DROP, None, _S + "test_replayed_frames_are_dropped_and_counted",
    ),
    "foreign": FaultReaction(
        "frames of another system", "system and component of every frame",
        Reaction.DROP, None, _C + "test_messages_of_other_systems_do_not_count",
    ),
    "parameters": FaultReaction(
        "the vehicle's parameters would make the flight unsafe",
        "COM_OF_LOSS_T not 0.1 to 2 s (0.5 s: no dead-man), COM_OBL_RC_ACT 6 or 7, MC_*RATE_MAX < 30, or not told",
        Reaction.REFUSE, None, _P + "test_unsafe_parameters_are_refused_with_the_reason",
    ),
}  # fmt: skip
