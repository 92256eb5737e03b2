"""`flightstack sim --px4-hil`: the physics behind a real PX4, which connects to the TCP port that is served here.

In lockstep each 4 ms wait for PX4's answer, so neither clock can run ahead; `--speed` only bounds the pace.  Before
the first answer time runs freely; a PX4 that leaves too many steps unanswered (it is stopped, or answers only some)
is waited for one step's time and no more, until it answers regularly again.  A PX4 that connects finds the vehicle at
rest on the ground; when it goes, the next may come.  With `--log` the truth is recorded.
"""

from __future__ import annotations

import gc
from collections.abc import Callable
from typing import Any

from flightstack.cli import files
from flightstack.cli.compiled import ensure_compiled
from flightstack.cli.simulate import HOST, PATIENCE_US, SimOptions, open_truth_log
from flightstack.types import InputError
from flightstack_logs.writer import FlightLog
from flightstack_sim.grade import load_grade
from flightstack_sim.px4_hil import STEP_US, PhysicsBehindPx4
from flightstack_sim.warmup import warm_up, warm_up_lockstep
from mavlink_bridge import frequent
from mavlink_bridge.pace import Pace, undisturbed
from mavlink_bridge.transport.clock import monotonic_us
from mavlink_bridge.transport.tcp import TcpServer

HIL_PORT = 4560
"""Where PX4 looks for its simulator (instance i: 4560 + i)."""
DEFAULT_VEHICLE = "iris"
DEFAULT_SENSORS = "gps"
ANSWER_LIMIT_US = 250_000
"""Of the wait for one answer, wall time: a busy machine may need some."""
SETTLED_S = 0.1
"""Of silence after the first answers: PX4 has handled everything that was sent while time ran freely."""
STALLED = 4.0
_FORGIVEN = 0.25
"""What an answer takes off the count of those that are missing."""
_SLICE_S = 0.05


def serve(
    options: SimOptions,
    *,
    stop_requested: Callable[[], str],
    on_ready: Callable[[str], None] = lambda text: None,
    on_wait: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Serve PX4 after PX4 until asked to stop or `duration_s` of simulated time is over; what was done."""
    if options.fault is not None:
        raise InputError("--fault is for the simulated autopilot: with --px4-hil, leave it out")
    truth, file = files.load_vehicle(options.vehicle or DEFAULT_VEHICLE)
    grade = load_grade(options.sensors or DEFAULT_SENSORS)
    server = TcpServer.bind(HOST, options.hil_port)
    log = open_truth_log(options, file.text)
    served: dict[str, Any] = {"clients": 0, "steps": 0, "answers": 0, "unanswered": 0, "missed": 0, "simulated_s": 0.0}
    try:
        ensure_compiled(on_wait)
        frequent.prepare()
        warm_up(truth, grade, options.plant)
        warm_up_lockstep(truth, options.plant)
        on_ready(
            f"{truth.name} is up: waiting for PX4 on TCP {HOST}:{server.address[1]}"
            " (make px4_sitl none_iris), Ctrl-C ends"
        )
        with undisturbed(real_time=options.speed <= 1.0):
            while not stop_requested() and not _over(served, options):
                if not server.accept(2 * _SLICE_S):
                    continue
                served["clients"] += 1
                on_ready("a client has connected")
                hil = PhysicsBehindPx4(truth, grade, seed=options.seed, plant=options.plant)
                _serve_one(server, hil, options, served, log, (stop_requested, on_ready))
                on_ready(f"the client has gone after {hil.t_us * 1e-6:.1f} s of simulated time ({_says(hil)})")
    finally:
        server.close()
        if log is not None:
            log.close()
    told = {"schema": "flightstack.hil/1", "vehicle": truth.name, "plant": options.plant, "seed": options.seed}
    return told | served | {"log": None if options.log is None else str(options.log)}


def _serve_one(
    server: TcpServer,
    hil: PhysicsBehindPx4,
    options: SimOptions,
    served: dict[str, Any],
    log: FlightLog | None,
    watch: tuple[Callable[[], str], Callable[[str], None]],
) -> None:
    """Step until somebody leaves; `watch`: whether to stop, and who is told."""
    stop_requested, on_word = watch
    session, began_s = HilSession(server, hil, options.speed), served["simulated_s"]
    while server.connected and not _over(served, options):
        session.step(stop_requested, on_word)
        served["simulated_s"] = began_s + hil.t_us * 1e-6
        if log is not None:
            log.truth(round(served["simulated_s"] * 1e6), hil.plant.truth())
        if hil.steps % 25 == 0 and stop_requested():
            break
    served["steps"] += hil.steps
    served["answers"] += hil.answers
    served["unanswered"] += session.unanswered
    served["missed"] += session.pace.missed
    server.drop()


def _over(served: dict[str, Any], options: SimOptions) -> bool:
    return options.duration_s is not None and served["simulated_s"] >= options.duration_s


def _says(hil: PhysicsBehindPx4) -> str:
    stats = hil.link.stats
    return f"{hil.steps} sensor messages, {hil.answers} answers, {stats.dropped} bad frames"


class HilSession:
    """One client, from its coming to its going."""

    def __init__(self, server: TcpServer, hil: PhysicsBehindPx4, speed: float = 1.0) -> None:
        self._server, self._hil = server, hil
        self.pace = Pace(STEP_US / speed, patience_us=PATIENCE_US)
        self.unanswered = 0
        """Steps in lockstep that PX4 did not answer in time."""
        self.lateness_us = 0
        """Of the last step's beginning."""
        self._missing = 0.0
        self._settled = False

    def step(self, stop_requested: Callable[[], str], on_word: Callable[[str], None] = lambda text: None) -> None:
        """One step of physics and PX4's answer to it, no earlier than it is due."""
        hil = self._hil
        self.lateness_us = self.pace.wait()
        hil.advance()
        self._server.send(hil.to_send())
        self._wait_for_answer(stop_requested)
        if hil.lockstep and not self._settled:
            self._settled = True
            self._settle()
            on_word(f"PX4 answers, in lockstep, after {hil.t_us * 1e-6:.2f} s")
        if hil.steps % 250 == 0:
            gc.collect(0)

    def _settle(self) -> None:
        """At the first answer others are on their way, to what was sent before it: take them all, so that from now on
        an answer belongs to the message that was sent last."""
        while (data := self._server.receive(SETTLED_S)) is not None:
            self._hil.receive(data)

    def _wait_for_answer(self, stop_requested: Callable[[], str]) -> None:
        """Take what has come; in lockstep wait for the answer to what was just sent."""
        hil, server = self._hil, self._server
        while (data := server.receive()) is not None:
            hil.receive(data)
        if not hil.lockstep:
            return
        limit_us = monotonic_us() + (ANSWER_LIMIT_US if self._missing < STALLED else STEP_US)
        while not hil.answered and server.connected and not stop_requested():
            left_us = limit_us - monotonic_us()
            if left_us <= 0:
                self._missing = min(self._missing + 1.0, 2.0 * STALLED)
                self.unanswered += 1
                return
            data = server.receive(min(_SLICE_S, left_us * 1e-6))
            if data is not None:
                hil.receive(data)
        self._missing = max(0.0, self._missing - _FORGIVEN)
