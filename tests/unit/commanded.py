"""A commander alone, with its clock and what the vehicle around it reports: for tests of modes and failsafes."""

from __future__ import annotations

from dataclasses import dataclass, field

from flightstack_sim.autopilot import modes, notices
from flightstack_sim.autopilot.commander import Commander
from flightstack_sim.autopilot.params import ParamResult, Params
from flightstack_sim.autopilot.requests import ACCEPTED, NEVER, Answer, ArmRequest, Inputs, ModeRequest, Request, Sender

ME = Sender(0, 245, 190)
TICK_US = 4_000
HOLD = ModeRequest(ME, 4, 3)
OFFBOARD = ModeRequest(ME, 6, 0)
ARM = ArmRequest(ME, 1.0, False)
DISARM = ArmRequest(ME, 0.0, False)


@dataclass
class Flight:
    """A commander with its clock and what the vehicle around it reports."""

    params: Params = field(default_factory=Params)
    now_us: int = 0
    landed: bool = True
    streaming: bool = False
    last_setpoint_us: int = NEVER
    takeoff_done: bool = False
    gcs: bool = False
    """A ground station's heartbeat comes with every tick."""
    gcs_at_us: int = NEVER
    battery: float = 1.0
    position_valid: bool = True
    breached: bool = False
    notices: list[notices.Notice] = field(default_factory=list)
    answers: list[Answer] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.commander = Commander(self.params)
        self.state = self.commander.state

    def tick(self, *requests: Request) -> None:
        self.now_us += TICK_US
        if self.streaming:
            self.last_setpoint_us = self.now_us
        if self.gcs:
            self.gcs_at_us = self.now_us
        inputs = Inputs(
            self.landed, self.last_setpoint_us, self.takeoff_done, requests,
            self.gcs_at_us, self.battery, self.position_valid, self.breached,
        )  # fmt: skip
        outputs = self.commander.step(inputs, self.now_us)
        self.notices.extend(outputs.notices)
        self.answers.extend(outputs.answers)

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds * 1e6) // TICK_US):
            self.tick()

    def timeline(self, seconds: float) -> list[tuple[float, modes.Mode]]:
        """Run, and give every change of mode with the time it came after."""
        start_us, mode, changes = self.now_us, self.state.mode, []
        for _ in range(round(seconds * 1e6) // TICK_US):
            self.tick()
            if self.state.mode is not mode:
                mode = self.state.mode
                changes.append((round((self.now_us - start_us) * 1e-6, 1), mode))
        return changes

    def ask(self, request: Request) -> int | None:
        """The result of the request's answer, None without one."""
        count = len(self.answers)
        self.tick(request)
        new = self.answers[count:]
        assert all(answer.sender == request.sender for answer in new)
        return new[0].result if new else None

    def texts(self) -> list[str]:
        return [notice.text.rstrip("\t") for notice in self.notices if notice.text]

    def set(self, name: str, value: float) -> None:
        assert self.params.set(name, value) is ParamResult.OK


def ready() -> Flight:
    """Booted and ready, disarmed in Hold."""
    flight = Flight()
    flight.run(5.0)
    return flight


def in_offboard() -> Flight:
    """In the air in OFFBOARD with a setpoint stream."""
    flight = ready()
    flight.streaming = True
    flight.run(0.5)
    assert flight.ask(OFFBOARD) == ACCEPTED
    assert flight.ask(ARM) == ACCEPTED
    flight.run(0.5)
    flight.landed = False
    flight.run(1.0)
    assert flight.state.mode is modes.OFFBOARD
    flight.notices.clear()
    return flight
