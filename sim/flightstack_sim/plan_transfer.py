"""MAVLink's mission protocol on one link: uploads and downloads of missions, fences and rally points, as PX4 has them.

A transfer has one partner; the vehicle asks for item after item, again every 0.25 s, and gives up after 5 s without a
word.  One upload at a time for the whole vehicle.  Answers, doubled ones and silences are PX4's, measured.
Source: mavlink.io/en/services/mission.html.
"""

from __future__ import annotations

from enum import Enum, auto
from typing import Any, Final

from flightstack_sim.autopilot import notices
from flightstack_sim.autopilot.notices import Notice
from flightstack_sim.autopilot.requests import Sender
from flightstack_sim.plans import ALL, KINDS, MOST, Item, MissionResult, Plans, judge, returned
from mavlink_bridge import messages as m

RETRY_US: Final = 250_000
GIVE_UP_US: Final = 5_000_000
_INT_FRAMES: Final = {0: 5, 3: 6}
_FLOAT_FRAMES: Final = {5: 0, 6: 3}
_INT32: Final = 2**31 - 1


class _State(Enum):
    IDLE = auto()
    SENDING = auto()
    RECEIVING = auto()


class PlanTransfer:
    """One link's side.  `handle` and `step` return what to send; `said` collects what is to be said."""

    __slots__ = (
        "_asked_us", "_count", "_current", "_heard_us", "_incoming", "_integers", "_kind", "_next", "_partner",
        "_plans", "_state", "said",
    )  # fmt: skip

    def __init__(self, plans: Plans) -> None:
        self._plans = plans
        self._state = _State.IDLE
        self._partner: Sender | None = None
        self._kind = 0
        self._next = self._count = 0
        self._incoming: list[Item] = []
        self._current = 0
        self._integers = True
        """Whether items are asked for by MISSION_REQUEST_INT; follows what the partner speaks."""
        self._heard_us = self._asked_us = 0
        self.said: list[Notice] = []

    def handle(self, message: Any, sender: Sender, now_us: int) -> list[Any]:
        """A message of the protocol that is addressed to this vehicle."""
        answers = self._answer(message, sender, now_us)
        for answer in answers:
            if isinstance(answer, m.MissionAck) and answer.type != MissionResult.ACCEPTED and not self.said:
                self.said.append(notices.plan_refused(MissionResult(answer.type).name))
        return answers

    def _answer(self, message: Any, sender: Sender, now_us: int) -> list[Any]:
        if isinstance(message, m.MissionCount):
            return self._on_count(message, sender, now_us)
        if isinstance(message, m.MissionItemInt | m.MissionItem):
            return self._on_item(message, sender, now_us)
        if isinstance(message, m.MissionRequestList):
            return self._on_list(message, sender, now_us)
        if isinstance(message, m.MissionRequestInt | m.MissionRequest):
            return self._on_request(message, sender, now_us)
        if isinstance(message, m.MissionAck):
            return self._on_ack(message, sender, now_us)
        if isinstance(message, m.MissionClearAll):
            return self._on_clear(message, sender)
        return self._on_set_current(message)

    def step(self, now_us: int) -> list[Any]:
        """Ask again, or give up; called ten times a second."""
        if self._state is _State.IDLE:
            return []
        if now_us - self._heard_us > GIVE_UP_US:
            self._end()
            self.said.append(notices.PLAN_TIMEOUT)
            return []
        if self._state is _State.RECEIVING and now_us - self._asked_us >= RETRY_US:
            return [self._ask(now_us)]
        return []

    # --- upload ---

    def _on_count(self, message: m.MissionCount, sender: Sender, now_us: int) -> list[Any]:
        if self._state is _State.RECEIVING:
            self._heard_us = now_us
            if sender != self._partner:
                return [_ack(sender, MissionResult.ERROR, message.mission_type)]
            if self._next > 0:
                self.said.append(notices.PLAN_BUSY)
                return [_ack(sender, MissionResult.ERROR, message.mission_type)]
            return [self._ask(now_us)]
        if self._state is _State.SENDING:
            self.said.append(notices.PLAN_COUNT_IGNORED)
            return [_ack(sender, MissionResult.ERROR, self._kind)]
        if self._plans.in_transfer:
            return [_ack(sender, MissionResult.ERROR, message.mission_type)]
        self._partner, self._kind = sender, message.mission_type
        if message.items > MOST.get(self._kind, 0):
            return [_ack(sender, MissionResult.NO_SPACE, self._kind)]
        if message.items == 0:
            self._plans.clear(self._kind)
            return [_ack(sender, MissionResult.ACCEPTED, self._kind)]
        self._plans.in_transfer = True
        self._state, self._next, self._count = _State.RECEIVING, 0, message.items
        self._incoming, self._current, self._heard_us = [], 0, now_us
        return [self._ask(now_us)]

    def _ask(self, now_us: int) -> Any:
        self._asked_us = now_us
        assert self._partner is not None
        kind = m.MissionRequestInt if self._integers else m.MissionRequest
        return kind(self._partner.system, self._partner.component, self._next, self._kind)

    def _on_item(self, message: Any, sender: Sender, now_us: int) -> list[Any]:
        self._integers = isinstance(message, m.MissionItemInt)
        if self._state is not _State.RECEIVING and self._partner is None:
            self._partner = sender
        if sender != self._partner:
            self.said.append(notices.PLAN_ITEM_PARTNER)
            return []
        if self._state is _State.RECEIVING and message.mission_type != self._kind:
            return [_ack(sender, MissionResult.ERROR, self._kind)]
        if self._state is _State.IDLE:
            if self._count and self._next == message.seq + 1:  # the last item once more: its answer was lost
                return [_ack(sender, MissionResult.ACCEPTED, self._kind, self._plans.ids.get(self._kind, 0))]
            self.said.append(notices.PLAN_NO_TRANSFER)
            return [_ack(sender, MissionResult.ERROR, self._kind)]
        if self._state is _State.SENDING:
            self.said.append(notices.PLAN_ITEM_BUSY)
            return [_ack(sender, MissionResult.ERROR, self._kind)]
        self._heard_us = now_us
        if message.seq != self._next:
            return []
        item = _item(message)
        foreign = not self._integers and item.frame in _FLOAT_FRAMES
        result = MissionResult.UNSUPPORTED_FRAME if foreign else judge(item, self._kind)
        if result is not MissionResult.ACCEPTED:
            if result is not MissionResult.ERROR:
                self.said.append(notices.PLAN_ITEM_INVALID)
            self._end()
            return [_ack(sender, result, self._kind)]
        self._incoming.append(item)
        if message.current:
            self._current = message.seq
        self._next += 1
        if self._next < self._count:
            return [self._ask(now_us)]
        self._plans.store(self._kind, tuple(self._incoming), self._current)
        self._end()
        return [_ack(sender, MissionResult.ACCEPTED, self._kind, self._plans.ids[self._kind])]

    # --- download ---

    def _on_list(self, message: m.MissionRequestList, sender: Sender, now_us: int) -> list[Any]:
        sent_all = self._state is _State.SENDING and self._next == self._count
        again = self._state is _State.SENDING and self._kind == message.mission_type and sender == self._partner
        if self._state is not _State.IDLE and not sent_all and not again:
            self.said.append(notices.PLAN_LIST_IGNORED)
            return []
        items = self._plans.items(message.mission_type)
        self._state, self._kind, self._partner = _State.SENDING, message.mission_type, sender
        self._next, self._count, self._heard_us = 0, len(items), now_us
        number = self._plans.ids.get(self._kind, 0)
        return [m.MissionCount(sender.system, sender.component, len(items), self._kind, number)]

    def _on_request(self, message: Any, sender: Sender, now_us: int) -> list[Any]:
        if self._partner is not None and sender != self._partner:
            self.said.append(notices.PLAN_REQUEST_PARTNER)
            return []
        if self._state is _State.RECEIVING:
            self.said.append(notices.PLAN_REQUEST_BUSY)
        if self._state is not _State.SENDING or message.mission_type != self._kind:
            return []
        self._integers = isinstance(message, m.MissionRequestInt)
        self._heard_us = now_us
        items = self._plans.items(self._kind)
        if message.seq == self._next < self._count:
            self._next += 1
        elif message.seq != self._next - 1:
            self._end()
            self.said.append(notices.PLAN_UNEXPECTED)
            return [_ack(sender, MissionResult.ERROR, self._kind)]
        if message.seq >= len(items):  # it has become shorter meanwhile
            self._end()
            self.said.append(notices.PLAN_UNEXPECTED)
            return [_ack(sender, MissionResult.ERROR, self._kind)]
        item, current = returned(items[message.seq], self._kind), int(message.seq == self._plans.current)
        return [_item_message(item, message.seq, current, sender, self._kind, self._integers)]

    def _on_ack(self, message: m.MissionAck, sender: Sender, now_us: int) -> list[Any]:
        if self._partner is not None and sender != self._partner:
            self.said.append(notices.PLAN_ACK_PARTNER)
            return []
        if self._state is _State.SENDING and message.mission_type == self._kind:
            self._end()
        elif self._state is _State.RECEIVING:
            if message.type == MissionResult.UNSUPPORTED:
                self._integers = not self._integers
                return [self._ask(now_us)]
            if message.type == MissionResult.CANCELLED:
                self._end()
        return []

    # --- the rest ---

    def _on_clear(self, message: m.MissionClearAll, sender: Sender) -> list[Any]:
        if self._state is not _State.IDLE:
            self.said.append(notices.PLAN_CLEAR_IGNORED)
            return []
        self._kind = message.mission_type
        if self._kind in (*KINDS, ALL):
            self._plans.clear(self._kind)
        return [_ack(sender, MissionResult.ACCEPTED, self._kind)]

    def _on_set_current(self, message: m.MissionSetCurrent) -> list[Any]:
        if self._state is not _State.IDLE:
            self.said.append(notices.PLAN_CURRENT_BUSY)
        elif message.seq < len(self._plans.mission):
            self._plans.set_current(message.seq)
        else:
            self.said.append(notices.PLAN_NOT_IN_LIST)
        return []

    def _end(self) -> None:
        if self._state is _State.RECEIVING:
            self._plans.in_transfer = False
        self._state = _State.IDLE


def _ack(sender: Sender, result: MissionResult, kind: int, number: int = 0) -> m.MissionAck:
    return m.MissionAck(sender.system, sender.component, int(result), kind, number)


def _item(message: Any) -> Item:
    """An item of either message; coordinates of MISSION_ITEM_INT are ten millionths of a degree."""
    one, two, three, four, x, y, z = message.params
    if isinstance(message, m.MissionItemInt) and message.frame != 2:
        x, y = x * 1e-7, y * 1e-7
    return Item(message.frame, message.command, message.autocontinue, (one, two, three, four), float(x), float(y), z)


def _item_message(item: Item, seq: int, current: int, sender: Sender, kind: int, integers: bool) -> Any:
    """An item as PX4 sends it back: in the frame of the message that it was asked for by."""
    to = sender.system, sender.component
    if not integers:
        frame = _FLOAT_FRAMES.get(item.frame, item.frame)
        place = item.x, item.y, item.z
        return m.MissionItem(*to, seq, frame, item.command, current, item.autocontinue, (*item.params, *place), kind)
    frame = _INT_FRAMES.get(item.frame, item.frame)
    scale = 1e7 if item.placed else 1.0
    x, y = (max(-_INT32 - 1, min(_INT32, round(value * scale))) for value in (item.x, item.y))
    params = (*item.params, x, y, item.z)
    return m.MissionItemInt(*to, seq, frame, item.command, current, item.autocontinue, params, kind)
