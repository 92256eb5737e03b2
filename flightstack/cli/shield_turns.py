"""What the governor holds back of the turning that a program asks for: told, for nobody else would know.  Sans-IO.

Yaw torque takes thrust that a site's certificate counts on, so it leaves little of it (`barrier.torque`).  A vehicle
whose frame brakes its turning then stays at a rate below the asked one, however long it is asked for.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from flightstack.cli.shield_router import ShieldRouter

WINDOW_US = 3_000_000
"""quad-x has turned up to 40 deg/s after 2 s: what is slower than that for so long is held back."""
_AGAIN_US = 60_000_000
_SHORT = 0.8
"""Flown over asked rate, above which a program has what it wants."""
_LEAST_RADPS = math.radians(5.0)
"""A rate below is nobody's wish but noise."""
_CUT_SHARE, _ONE_WAY_SHARE = 0.5, 0.9
"""Of a window's ticks: in which the governor cut the rate (a noisy gyro leaves some that it did not), and that ask for
the same way round."""
_GAP_US = 100_000
_SETTLED_US = 1_000_000
"""Of a window's end, in which the flown rate is looked at: before, it rises."""


class HeldTurn(NamedTuple):
    """A window in which yaw was held back: means, of the flown rate over its last second."""

    asked_radps: float
    flown_radps: float


class HeldTurns:
    """Looks at every tick that the router flies."""

    def __init__(self, yaw_max: float) -> None:
        """`yaw_max`: the governor's bound, a share of full yaw torque."""
        self.yaw_max = yaw_max
        self.seconds = 0.0
        """Flown so, in all."""
        self.worst: HeldTurn | None = None
        """Of the windows the one that lacks most."""
        self._t_us = self._began_us = self._told_us = -1
        self._ticks = self._cut = self._late = 0
        self._asked = self._flown = self._sign = 0.0
        self._is_on = False

    def look(self, router: ShieldRouter) -> list[str]:
        """The line to say, if any."""
        record = router.record
        if not router.flies or record is None:
            self._t_us, self._is_on = -1, False
            return []
        if record.t_us == self._t_us:
            return []
        if not 0 < record.t_us - self._t_us < _GAP_US or self._began_us < 0:
            self._begin(record.t_us)
        self._t_us = record.t_us
        asked, flown = (float(each.rate_frd_radps[2]) for each in (record.proposal, record.measurement))
        sent = float(record.command.rate_frd_radps[2])
        if not math.isfinite(asked + flown):  # the guard flies
            return []
        sign = math.copysign(1.0, asked)
        self._ticks += 1
        self._cut += record.governed and sign * (asked - sent) > (1.0 - _SHORT) * abs(asked)
        self._asked, self._sign = self._asked + abs(asked), self._sign + sign
        if record.t_us - self._began_us > WINDOW_US - _SETTLED_US:
            self._late, self._flown = self._late + 1, self._flown + sign * flown
        return self._judge(record.t_us) if record.t_us - self._began_us >= WINDOW_US else []

    def _begin(self, t_us: int) -> None:
        self._began_us, self._ticks, self._cut, self._late = t_us, 0, 0, 0
        self._asked = self._flown = self._sign = 0.0

    def _judge(self, t_us: int) -> list[str]:
        ticks, began_us = self._ticks, self._began_us
        turn = HeldTurn(self._asked / ticks, self._flown / self._late) if self._late else HeldTurn(0.0, 0.0)
        one_way = abs(self._sign) > _ONE_WAY_SHARE * ticks
        is_held = one_way and self._cut > _CUT_SHARE * ticks and turn.asked_radps > _LEAST_RADPS
        is_held = is_held and turn.flown_radps < _SHORT * turn.asked_radps
        self._begin(t_us)
        was_on, self._is_on = self._is_on, is_held
        if not is_held:
            return []
        self.seconds += 1e-6 * (t_us - began_us)
        if self.worst is None or _lacks(turn) > _lacks(self.worst):
            self.worst = turn
        if was_on or (self._told_us >= 0 and t_us - self._told_us < _AGAIN_US):
            return []
        self._told_us = t_us
        return [f"{self._in_words(turn)}: {self._why}"]

    @staticmethod
    def _in_words(turn: HeldTurn) -> str:
        asked, flown = math.degrees(turn.asked_radps), math.degrees(turn.flown_radps)
        return f"the program asks to turn at {asked:.0f} deg/s and gets {flown:.0f}"

    @property
    def _why(self) -> str:
        return (
            f"yaw torque takes thrust that the site's certificate counts on, so the governor leaves "
            f"{100.0 * self.yaw_max:.1f} % of it"
        )

    @property
    def summary(self) -> str:
        """One line at the end; empty where nothing was held back."""
        if self.worst is None:
            return ""
        return f"turning was held back for {self.seconds:.0f} s ({self._in_words(self.worst)}): {self._why}"

    def as_json(self) -> dict[str, Any] | None:
        """`yaw_held_back` of the shield's JSON; None where nothing was."""
        if self.worst is None:
            return None
        return {"seconds": self.seconds, **self.worst._asdict(), "torque_share": self.yaw_max}


def _lacks(turn: HeldTurn) -> float:
    return turn.asked_radps - turn.flown_radps
