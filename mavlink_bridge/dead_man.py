"""The dead-man: answers the companion's silence within 50 ms.  Sans-IO: records and bytes in, bytes out, time given.

A stock PX4 goes on with the last body rates for COM_OF_LOSS_T, one second: in a manoeuvre that ends on the ground.  So
when no setpoint went out for `SILENCE_NS` although setpoints are streamed, the dead-man

1. reads what the vehicle said meanwhile; in any other mode than OFFBOARD somebody has taken over: it says nothing;
2. sends body rates that level the vehicle (an attitude setpoint would be worse: PX4 takes 0.16 s to change from rates
   to attitudes), asks for the mode, and commands Hold on the answer OFFBOARD, or after `ANSWER_NS` without an answer
   where the companion itself had seen OFFBOARD;
3. repeats both until another mode than OFFBOARD is seen, for `GIVE_UP_NS` at most: then PX4's own failsafe acts;
4. watches the mode for the rest of `WATCH_NS`, so that a companion that comes back knows whether Hold is still its own.

Who notices the silence `LATE_NS` late has stood still, too (a machine that was suspended): PX4's own failsafe may have
acted meanwhile, and what is read first is of before.  Then it asks, and says nothing else until it is told OFFBOARD.

A companion that ticks again is left alone at once.
"""

from __future__ import annotations

from math import acos, hypot, isfinite, nan

from mavlink_bridge.dead_man_frames import (
    ACTIVE,
    ATTITUDE_QUATERNION,
    COMMAND_ACK,
    COMMAND_LONG,
    CURRENT_MODE,
    HEARTBEAT,
    IN_OFFBOARD,
    NOBODY,
    SET_ATTITUDE_TARGET,
    CompanionRecord,
    Keyed,
    Reader,
    build,
    signed,
)

MS = 1_000_000
SILENCE_NS = 50 * MS
"""Twelve ticks of 4 ms: stalls of a busy machine are shorter."""
LATE_NS = 50 * MS
"""PX4's failsafe acts after 0.1 s of silence at the soonest (COM_OF_LOSS_T)."""
ANSWER_NS = 12 * MS
"""PX4 answers a request within 1 to 8 ms."""
GIVE_UP_NS = 1_000 * MS
WATCH_NS = 600 * MS
"""The companion takes back after stalls below half a second."""
_STEP_NS = 5 * MS
_RATES_NS = 10 * MS
_HOLD_AGAIN_NS = 100 * MS
_IDLE_NS = 100 * MS
_LEVEL_PER_S = 6.0
"""Rate per tilt: about PX4's own MC_ROLL_P."""
_RATE_MAX_RADPS = 3.0
_LEAST_COSINE = 0.7
"""Thrust is raised by 1 / cos(tilt) up to here."""
_RATES_ONLY, _ATTITUDE_ONLY = 128, 7
_OFFBOARD_MAIN = 6
_HOLD_MODE = 0x03040000
_DO_SET_MODE, _ARM_DISARM, _REQUEST_MESSAGE = 176, 400, 512
_MODE_COMMANDS = frozenset({_DO_SET_MODE, _ARM_DISARM, 16, 20, 21, 22, 192, 252})
"""Commands whose acceptance, to anybody else, means that he has taken the vehicle."""
_HOLD = (1.0, 4.0, 3.0)
_ARMED = 0x80
_BASE_MODE, _TARGET_SYSTEM = 3, 4
"""Fields of HEARTBEAT and of COMMAND_ACK."""
_WATCHING, _ACTING, _HELD, _SILENT = range(4)


class DeadMan:
    """See the module's text; `step` whenever `wake_ns` has come, with what arrived where `reading`."""

    def __init__(self, key: bytes | None = None, *, link_id: int = 1, stream: bool = False) -> None:
        """key: of MAVLink's signing, 32 bytes; link_id: of the signatures; stream: frames may arrive in pieces."""
        self.record = NOBODY
        self.wake_ns = 0
        self.reading = False
        """Whether what arrives is wanted; else it is the companion's."""
        self._keyed = None if key is None else Keyed(key, link_id)
        self._stream = stream
        self._reader = Reader(self._keyed, stream=stream)
        self._phase = _WATCHING
        self._serial = -1
        """The companion's tick after which it fell silent."""
        self._q = (1.0, 0.0, 0.0, 0.0)
        self._mode = -1
        """Custom mode by the newest report since the silence began; -1: none."""
        self._mode_at_ns = 0
        self._armed = True
        self._asked_ns = self._rates_ns = self._hold_ns = 0
        self._late = False
        """The silence was noticed late."""

    def step(self, now_ns: int, companion: CompanionRecord, received: list[bytes]) -> list[bytes]:
        """What to send at `now_ns`, after what was received; `wake_ns` and `reading` say when and how to go on."""
        if self._phase != _WATCHING and companion.serial != self._serial:
            self._phase, self.reading = _WATCHING, False  # it is back
        out: list[bytes] = []
        if self._phase == _WATCHING:
            self._watch(now_ns, companion)
        elif self._phase == _SILENT:
            self.wake_ns = now_ns + _STEP_NS
        else:
            for data in received:
                self._hear(data, companion, now_ns)
            out = self._act(now_ns, companion)
        self.record = self.record._replace(alive_ns=now_ns, frames=self.record.frames + len(out))
        return out

    def is_over(self, companion: CompanionRecord) -> bool:
        """Whether nothing is left to do where the companion is gone for good."""
        answered = companion.serial == self._serial
        return self._phase in (_HELD, _SILENT) or (
            self._phase == _WATCHING and (answered or not companion.flags & ACTIVE)
        )

    def _watch(self, now_ns: int, companion: CompanionRecord) -> None:
        if not companion.flags & ACTIVE:
            self.wake_ns = now_ns + _IDLE_NS
        elif companion.serial == self._serial:
            self.wake_ns = now_ns + _STEP_NS  # this silence was answered
        elif now_ns < companion.sent_ns + SILENCE_NS:
            self.wake_ns = min(companion.sent_ns + SILENCE_NS, now_ns + _IDLE_NS)
        else:
            self._phase, self.reading, self.wake_ns = _ACTING, True, now_ns
            self._serial = companion.serial
            self._late = now_ns > companion.sent_ns + SILENCE_NS + LATE_NS
            self._q = (companion.q_w, companion.q_x, companion.q_y, companion.q_z)
            self._mode, self._mode_at_ns, self._armed = -1, 0, True
            self._asked_ns = self._rates_ns = self._hold_ns = 0
            self._reader = Reader(self._keyed, stream=self._stream)
            self.record = self.record._replace(
                acts=self.record.acts + 1, silent_ns=companion.sent_ns, began_ns=now_ns,
                hold_ns=self._standing_hold_ns(now_ns, companion), held_ns=0, touched=0, sequence=companion.sequence,
            )  # fmt: skip

    def _standing_hold_ns(self, now_ns: int, companion: CompanionRecord) -> int:
        """When the Hold was commanded that still stands; 0: there is none, for somebody touched it or the companion has
        spoken since to a vehicle in OFFBOARD.  A word that was stopped on its way tells of before the Hold."""
        record = self.record
        old = not companion.flags & IN_OFFBOARD or companion.sent_ns < record.hold_ns
        return record.hold_ns if old and not record.touched and now_ns - record.hold_ns < GIVE_UP_NS else 0

    def _hear(self, data: bytes, companion: CompanionRecord, now_ns: int) -> None:
        for number, fields in self._reader.read(data, companion):
            if number == ATTITUDE_QUATERNION:
                self._q = fields[1:5]  # type: ignore[assignment]  # a message of four floats
            elif number in (HEARTBEAT, CURRENT_MODE):
                self._mode, self._mode_at_ns = int(fields[0]), now_ns
                if number == HEARTBEAT:
                    self._armed = bool(int(fields[_BASE_MODE]) & _ARMED)
                self.record = self.record._replace(mode=self._mode, mode_ns=now_ns)
            elif number == COMMAND_ACK and fields[0] in _MODE_COMMANDS and fields[1] == 0:
                ours = int(fields[_TARGET_SYSTEM]) in (0, companion.own_system)
                self.record = self.record if ours else self.record._replace(touched=1)

    def _act(self, now_ns: int, companion: CompanionRecord) -> list[bytes]:
        self.wake_ns = now_ns + _STEP_NS
        in_offboard = self._mode >> 16 & 0xFF == _OFFBOARD_MAIN if self._mode >= 0 else True
        if self._phase == _HELD:
            if self._mode != _HOLD_MODE:
                self.record = self.record._replace(touched=1)
            if now_ns - self.record.silent_ns > WATCH_NS:
                self._fall_silent()
            return []
        if not in_offboard or not self._armed:
            if self._mode == _HOLD_MODE and self.record.hold_ns and self._armed:
                self._phase = _HELD
                self.record = self.record._replace(held_ns=now_ns)
            else:
                self.record = self.record._replace(touched=1)
                self._fall_silent()
            return []
        if now_ns - self.record.began_ns > GIVE_UP_NS:
            self._fall_silent()
            return []
        return self._words(now_ns, companion)

    def _words(self, now_ns: int, companion: CompanionRecord) -> list[bytes]:
        """Rates that level, the question for the mode, the command to hold: what is due of them."""
        out: list[bytes] = []
        answered = self._mode >= 0 and self._mode_at_ns > self._asked_ns
        if self._late and not (self._asked_ns and answered):
            if now_ns - self._asked_ns < _RATES_NS:
                return out
            self._asked_ns = self._asked_ns or now_ns
            return [self._command(_REQUEST_MESSAGE, (float(CURRENT_MODE),), companion)]
        waited = now_ns - self._asked_ns >= ANSWER_NS and (self._mode >= 0 or bool(companion.flags & IN_OFFBOARD))
        holds = self._asked_ns and (answered or waited or self._hold_ns) and now_ns - self._hold_ns >= _HOLD_AGAIN_NS
        if (holds or now_ns - self._rates_ns >= _RATES_NS) and companion.thrust_norm > 0.0:
            self._rates_ns = now_ns
            words = self._levelling(now_ns, companion)
            if holds:  # Hold's first cycles go by it: else by an attitude of before the take-off, without thrust
                attitude = (words[0], *self._q, *words[5:-1], _ATTITUDE_ONLY)
                out.append(self._frame(SET_ATTITUDE_TARGET, attitude, companion))
            out.append(self._frame(SET_ATTITUDE_TARGET, words, companion))
        if not self._asked_ns:
            self._asked_ns = now_ns
            out.append(self._command(_REQUEST_MESSAGE, (float(CURRENT_MODE),), companion))
        if holds:
            if not self._hold_ns:
                self.record = self.record._replace(hold_ns=now_ns)
            self._hold_ns = now_ns
            out.append(self._command(_DO_SET_MODE, _HOLD, companion))
        return out

    def _fall_silent(self) -> None:
        self._phase, self.reading = _SILENT, False

    def _levelling(self, now_ns: int, companion: CompanionRecord) -> tuple[float, ...]:
        """Fields of SET_ATTITUDE_TARGET: body rates towards level, the thrust that carries the vehicle at its tilt."""
        roll, pitch, cosine = levelling_rates(self._q)
        thrust = min(1.0, companion.thrust_norm / max(cosine, _LEAST_COSINE))
        thrust = companion.thrust_factor * thrust * thrust + (1.0 - companion.thrust_factor) * thrust
        stamp_ms = (companion.stamp_us + (now_ns - companion.sent_ns) // 1000) // 1000 & 0xFFFFFFFF
        rates = (roll, pitch, 0.0)
        return (stamp_ms, 1.0, 0.0, 0.0, 0.0, *rates, thrust, companion.system, 1, _RATES_ONLY)

    def _command(self, command: int, given: tuple[float, ...], companion: CompanionRecord) -> bytes:
        params = (*given, *(nan,) * (7 - len(given)))
        return self._frame(COMMAND_LONG, (*params, command, companion.system, 1, 0), companion)

    def _frame(self, number: int, values: tuple[float, ...], companion: CompanionRecord) -> bytes:
        sequence = self.record.sequence
        self.record = self.record._replace(sequence=(sequence + 1) & 0xFF)
        frame = build(number, values, sequence, companion)
        if self._keyed is None:
            return frame
        elapsed = (self.wake_ns - companion.sent_ns) // (10 * 1000)  # stamps count tens of microseconds
        return signed(frame, number, self._keyed, companion.next_stamp + elapsed)


def levelling_rates(q: tuple[float, float, float, float]) -> tuple[float, float, float]:
    """Roll and pitch rate, rad/s, that turn an attitude (body to NED, scalar first) to level the shortest way; and the
    cosine of its tilt.  What is no attitude: no rotation."""
    w, x, y, z = q
    down_x, down_y, cosine = 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)
    if not (isfinite(down_x) and isfinite(down_y) and -1.01 <= cosine <= 1.01):
        return 0.0, 0.0, 1.0
    sine = hypot(down_x, down_y)
    if sine < 1e-6:
        return 0.0, 0.0, cosine
    rate = min(_RATE_MAX_RADPS, _LEVEL_PER_S * acos(min(1.0, max(-1.0, cosine)))) / sine
    return -rate * down_y, rate * down_x, cosine
