"""The loop of the companion in real time, against a clock that is told."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from flightstack.cli import real_time
from flightstack.cli.real_time import RealTimeLoop
from mavlink_bridge.handshake import State


@pytest.mark.parametrize(
    ("state", "stopped_us", "sent"),
    [(State.STREAMING, 0, 1), (State.STREAMING, 200_000, 0), (State.OFFBOARD, 0, 1), (State.OFFBOARD, 200_000, 0)],
)  # fmt: skip
def test_what_was_decided_before_a_long_stop_is_not_said_after_it(
    monkeypatch: pytest.MonkeyPatch, state: State, stopped_us: int, sent: int
) -> None:
    """Stopped between deciding and sending; PX4's failsafe acts meanwhile, and a setpoint would end it: on a real PX4
    one body rate of 3 s before brought it from Return back to OFFBOARD for a second, and a lean of 71 degrees."""
    now = SimpleNamespace(us=1_000_000)
    monkeypatch.setattr(real_time, "monotonic_us", lambda: now.us)
    said: list[bytes] = []

    def step(now_us: int) -> None:
        now.us += stopped_us

    nothing = SimpleNamespace(
        step=lambda *given: 0, mavlink=lambda *given: None, write=lambda *given: None, event=lambda *given: None,
        receive_all=list, send=said.append, tick=lambda *given: 0, missed=0, between_us=4000, busy_us=lambda: 0,
        mark=lambda what: None, stop_requested=str, period_us=4000, keeps_wire=True,
    )  # fmt: skip
    nothing.tick = lambda *given: None
    companion: Any = SimpleNamespace(
        view=SimpleNamespace(clock=SimpleNamespace(synchronised=False, rate=1.0)), state=state, step=step, done=False,
        link=SimpleNamespace(datagrams_to_send=lambda: [b"setpoint"]),
    )  # fmt: skip
    loop = RealTimeLoop(
        companion,
        nothing,
        nothing,
        nothing,
        nothing,
        nothing,
        None,
        str,
        lambda *given: None,  # type: ignore[arg-type]
    )
    loop._tick(nothing, nothing)  # type: ignore[arg-type]
    assert len(said) == sent
