"""The simulated vehicle on its MAVLink links, sans-IO: bytes in, milliseconds forward, bytes out.

    server.receive(index, data)            whatever arrived on a link; acts in the next advance()
    server.advance(4)                      commander, navigator, vehicle, then the streams that are due
    server.datagrams(index)                what the link has to say

Time is the plant's.  A 4 ms tick is: requests to the commander, mode to setpoint, vehicle, one look at it, streams.
Nothing raises on what comes in.  Sockets, ports and pacing are the shell's.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final

from flightstack.geodesy import PX4_SIH, LocalFrame
from flightstack_sim import commands, protocols
from flightstack_sim.autopilot import modes, notices
from flightstack_sim.autopilot.commander import Commander
from flightstack_sim.autopilot.failure_detector import FailureDetector
from flightstack_sim.autopilot.mission import MissionFlight
from flightstack_sim.autopilot.navigator import NOT_STARTED, Navigator
from flightstack_sim.autopilot.notices import Notice
from flightstack_sim.autopilot.offboard import from_attitude_target, from_global_target, from_position_target
from flightstack_sim.autopilot.requests import NEVER, Inputs, Replies, Request, Sender
from flightstack_sim.autopilot.setpoint import POSITION_KINDS, ControlSetpoint
from flightstack_sim.autopilot.sticks import FLOWN_BY_STICKS, StickFlight, Sticks, from_manual_control
from flightstack_sim.builders import gps_global_origin
from flightstack_sim.console import Console
from flightstack_sim.faults import Fault, Injector
from flightstack_sim.fence import FenceWatch
from flightstack_sim.plans import Plans
from flightstack_sim.port import Port
from flightstack_sim.protocols import EventMemory
from flightstack_sim.simulated_vehicle import SimulatedVehicle
from flightstack_sim.streams import LinkKind
from flightstack_sim.view import View
from mavlink_bridge import messages as m
from mavlink_bridge.link import Link, Received
from mavlink_bridge.px4 import COMPONENT_GCS, TYPE_GCS

SLOW_US: Final = 100_000
HOME_SET_US: Final = 3_820_000
"""PX4 sets home this long after boot."""
UNIX_AT_BOOT_US: Final = 1_767_225_600_000_000
"""2026-01-01: the simulated wall clock starts there."""


class Server:
    """A simulated vehicle that speaks MAVLink like PX4.

    `links`: the kinds of its links, in the order of their indices.  `commander.state` and `vehicle` may be read freely.
    """

    def __init__(
        self,
        vehicle: SimulatedVehicle,
        *,
        links: Sequence[LinkKind] = (LinkKind.ONBOARD, LinkKind.GCS),
        system: int = 1,
        frame: LocalFrame = PX4_SIH,
        unix_at_boot_us: int = UNIX_AT_BOOT_US,
        faults: tuple[Fault, ...] = (),
    ) -> None:
        self.vehicle = vehicle
        vehicle.sensors.origin_altitude_m = frame.altitude_m
        self.system = system
        self.commander = Commander(vehicle.params)
        self.plans = Plans()
        self.fence = FenceWatch(self.plans, vehicle.params, frame)
        self.mission = MissionFlight(self.plans, vehicle.params, frame, self.fence.forbids)
        self.navigator = Navigator(vehicle.params, frame.altitude_m, self.mission)
        self.view = View(vehicle, self.commander.state, self.navigator.state, frame, unix_at_boot_us)
        self.view.plans, self.view.fence = self.plans, self.fence
        self.view.sysid = system
        self.events = EventMemory()
        self.console = Console()
        self.faults = Injector(faults)
        self.deaf_to: frozenset[type[Any]] = frozenset()
        """Messages that a fault keeps from the autopilot."""
        self.gcs_waiting: set[int] | None = None
        """Links whose ground station has come, where whoever steps says when it counts (`hear_gcs`); None: at once."""
        self._ports = [Port(kind, system, self.plans) for kind in links]
        self._requests: list[Request] = []
        self._offboard: ControlSetpoint | None = None
        self._offboard_at_us = NEVER
        self._breached = False
        self.stick_flight = StickFlight(vehicle.params)
        self.detector = FailureDetector(vehicle.params)
        self._sticks, self._sticks_at_us = Sticks(), NEVER
        self._tell_reached_us = 0
        self._next_slow_us = 0
        self._was_armed = False

    @property
    def t_us(self) -> int:
        """Simulated time since boot."""
        return self.vehicle.plant.t_us

    def port(self, index: int) -> Port:
        """All that one link has for itself."""
        return self._ports[index]

    def link(self, index: int) -> Link:
        """The protocol side of a link: statistics, and whatever a test wants to see."""
        return self._ports[index].link

    # --- in ---

    def receive(self, link_index: int, data: bytes) -> None:
        """Take a datagram of one link."""
        port = self._ports[link_index]
        port.link.receive_datagram(data, self.vehicle.plant.t_us)
        for received in port.link.take_events():
            kind = type(received.message)
            handler = _HANDLERS.get(kind)
            if handler is not None and kind not in self.deaf_to and self._addressed(received.message):
                handler(self, link_index, received)
            if self.gcs_waiting is not None and received.component == COMPONENT_GCS:
                self.gcs_waiting.add(link_index)  # before its first heartbeat, which comes by the wall's time

    def _addressed(self, message: Any) -> bool:
        """Whether a message is for us: our system or all, the autopilot or all components."""
        system, component = getattr(message, "target_system", 0), getattr(message, "target_component", 0)
        return system in (0, self.system) and component in (0, 1)

    def _on_attitude_target(self, link_index: int, received: Received) -> None:
        setpoint = from_attitude_target(received.message, self._offboard)
        if setpoint is not None:
            self._offboard, self._offboard_at_us = setpoint, received.t_us

    def _on_position_target(self, link_index: int, received: Received) -> None:
        message, view = received.message, self.view
        if isinstance(message, m.SetPositionTargetLocalNed):
            setpoint = from_position_target(message, view.heading_rad)
        else:
            setpoint = from_global_target(message, view.frame, view.home_altitude_m)
        if setpoint is not None:
            self._offboard, self._offboard_at_us = setpoint, received.t_us

    def _on_sticks(self, link_index: int, received: Received) -> None:
        """MANUAL_CONTROL, where parameters let it count (COM_RC_IN_MODE 1 to 3)."""
        addressed = received.message.target in (0, self.system)
        if addressed and 1.0 <= self.vehicle.params.get("COM_RC_IN_MODE") <= 3.0:
            self._sticks, self._sticks_at_us = from_manual_control(received.message), received.t_us

    def _on_heartbeat(self, link_index: int, received: Received) -> None:
        if received.message.type == TYPE_GCS:
            there = self._ports[link_index].has_gcs(self.t_us, self.vehicle.params)
            self.hear_gcs(link_index) if there or self.gcs_waiting is None else self.gcs_waiting.add(link_index)

    def hear_gcs(self, link_index: int) -> None:
        """A link's ground station is there now."""
        if m.Heartbeat not in self.deaf_to:
            port = self._ports[link_index]
            if not port.has_gcs(self.t_us, self.vehicle.params):
                self.commander.report_again()
            port.gcs_at_us = self.t_us

    def _on_command(self, link_index: int, received: Received) -> None:
        port = self._ports[link_index]
        sender = Sender(link_index, received.system, received.component)
        context = commands.Context(self.view, port.streams, sender)
        message = received.message
        if isinstance(message, m.CommandLong):
            commands.handle_long(message, context)
        elif isinstance(message, m.CommandInt):
            commands.handle_int(message, context)
        else:
            commands.handle_set_mode(message, context)
        for reply in context.replies:
            port.link.send(reply)
        self._requests.extend(context.requests)
        self._say(context.said, self.view.t_us)

    def _on_plan(self, link_index: int, received: Received) -> None:
        """Missions, fences and rally points."""
        sender = Sender(link_index, received.system, received.component)
        port = self._ports[link_index]
        for answer in port.plans.handle(received.message, sender, received.t_us):
            port.link.send(answer)
        self._tell_of_plans(port)
        self._watch_mission()  # whoever stores one starts it at once

    def _tell_of_plans(self, port: Port) -> None:
        if port.plans.said:
            self._say(port.plans.said, self.view.t_us)
            port.plans.said.clear()

    def _on_protocol(self, link_index: int, received: Received) -> None:
        """Everything that is answered at once on the same link."""
        port = self._ports[link_index]
        sender = Sender(link_index, received.system, received.component)
        message = received.message
        answer: Any = None
        if isinstance(message, m.Timesync):
            if message.tc1_ns != 0 and message.ts1_ns <= 1000 * self.view.stamp_us:
                port.synced_us = message.ts1_ns // 1000
            answer = protocols.answer_timesync(message, sender, self.view.stamp_us)
        elif isinstance(message, m.Ping):
            answer = protocols.answer_ping(message, sender)
        elif isinstance(message, m.ParamRequestRead):
            answer = protocols.read_parameter(message, self.vehicle.params, sender)
        elif isinstance(message, m.ParamRequestList):
            port.parameters.start()
        elif isinstance(message, m.SetGpsGlobalOrigin):
            answer = gps_global_origin(self.view)
        elif isinstance(message, m.FileTransferProtocol):
            answer = protocols.answer_file(message, sender)
        elif isinstance(message, m.RequestEvent):
            for event in self.events.answer(message, sender):
                port.link.send(event)
        if answer is not None:
            port.link.send(answer)

    def _on_parameter_set(self, link_index: int, received: Received) -> None:
        sender = Sender(link_index, received.system, received.component)
        answer, for_all = protocols.set_parameter(received.message, self.vehicle.params, sender)
        for index, port in enumerate(self._ports):
            if for_all or index == link_index:
                port.link.send(answer)

    # --- forward ---

    def advance(self, n_ms: int = 4) -> None:
        """Simulate n_ms milliseconds under what has been received, then queue the streams that are due."""
        vehicle, view, state = self.vehicle, self.view, self.commander.state
        now_us = view.t_us
        if self.faults.faults or self.faults.begun:
            self.faults.step(self)
        landed = vehicle.control.land_detector.landed
        if self._requests or now_us >= state.next_cycle_us or landed is not state.landed:
            self._command(landed, now_us)  # between its cycles the commander sleeps unless something happens
        setpoint, said = self.navigator.step(
            state.mode,
            self._offboard,
            view.pos_ned_m,
            armed=state.armed,
            takeoff_altitude_m=state.takeoff_altitude_m,
            goal=state.goal,
            now_us=now_us,
            landed=landed,
        )
        if said:
            self._say(said, now_us)
        if state.armed and state.mode in FLOWN_BY_STICKS:
            setpoint = self.stick_flight.step(
                state.mode, self._sticks, view.pos_ned_m, view.vel_ned_mps, view.heading_rad,
                vehicle.control.hover_thrust.value,
            )  # fmt: skip
        else:
            self.stick_flight.leave()
        if setpoint is not view.setpoint:
            view.use(setpoint)
        vehicle.advance(setpoint, n_ms)
        view.refresh()
        if view.t_us >= self._next_slow_us:
            self._slow()
        for port in self._ports:
            port.streams.emit(view, port.link)
            port.send_parameters(vehicle.params)

    def answer(self) -> None:
        """Answer what has been received without moving time: commands, and parameters that were asked for."""
        if self._requests:
            self._command(self.vehicle.control.land_detector.landed, self.view.t_us)
        for port in self._ports:
            port.send_parameters(self.vehicle.params)

    def _command(self, landed: bool, now_us: int) -> None:
        """The commander's tick."""
        requests: tuple[Request, ...] = ()
        if self._requests:
            requests = tuple(self._requests)
            self._requests.clear()
        outputs = self.commander.step(self._inputs(landed, requests), now_us)
        armed = self.commander.state.armed
        if armed is not self._was_armed:
            self._was_armed = armed
            if armed:
                self.navigator.set_home(self.view.pos_ned_m, now_us)
        if outputs.notices or outputs.answers:
            self._tell(outputs, now_us)

    def _inputs(self, landed: bool, requests: tuple[Request, ...]) -> Inputs:
        """What the commander looks at; a position setpoint without a position is no signal."""
        valid, offboard = self.vehicle.sensors.position_valid, self._offboard
        usable = valid or offboard is None or offboard.kind not in POSITION_KINDS
        return Inputs(
            landed,
            self._offboard_at_us if usable else NEVER,
            self.navigator.state.takeoff_done,
            requests,
            max(port.gcs_at_us for port in self._ports),
            self.view.battery.remaining,
            valid,
            self._breached,
            self.mission.valid,
            self.mission.finished,
            self._sticks_at_us,
            self.detector.failed,
            self.view.silent(),
            self.mission.returns,
        )

    def _slow(self) -> None:
        """What is looked at ten times a second."""
        view = self.view
        self.detector.look(view.q_ned_frd, view.t_us, armed=self.commander.state.armed)
        self._watch_fence()
        self._watch_mission()
        for port in self._ports:
            for message in port.plans.step(view.t_us):
                port.link.send(message)
            self._tell_of_plans(port)
        self._next_slow_us = view.t_us - view.t_us % SLOW_US + SLOW_US
        view.refresh_slow()
        if view.t_us >= HOME_SET_US and self.navigator.state.home_ned_m is None:
            self.navigator.set_home(view.pos_ned_m, view.t_us)

    def _watch_mission(self) -> None:
        """What was stored, and which item was reached: said once at once, then every second."""
        said, state = self.mission.renew(), self.navigator.state
        waits = self.mission.reached < 0 and self.commander.state.mode is not modes.MISSION
        if said or waits or not self.mission.valid:
            state.mission_state = NOT_STARTED
        self.view.mission_valid = self.mission.valid
        self._say(said, self.view.t_us)
        news = self.mission.news
        if not news and self.mission.reached >= 0 and self.view.t_us >= self._tell_reached_us:
            news.append(self.mission.reached)
        if news:
            self._tell_reached_us = self.view.t_us + 1_000_000
            for port in self._ports:
                for reached in news:
                    port.link.send(m.MissionItemReached(reached))
            news.clear()

    def _watch_fence(self) -> None:
        """The cylinder of the parameters, and what a client has stored."""
        view, position = self.view, self.view.pos_ned_m
        self._say(self.fence.renew(position, self.navigator.state.home_ned_m, landed=self.vehicle.landed), view.t_us)
        breached = self.navigator.outside_fence(position) or self.fence.outside(position[0], position[1])
        if breached and not self._breached and self.vehicle.params.get("GF_ACTION") != 0.0:
            self._say((notices.FENCE_LEFT,), view.t_us)
        self._breached = breached

    # --- out ---

    def datagrams(self, link_index: int, max_bytes: int = 0) -> list[bytes]:
        """What to send on a link now: a datagram per message as PX4 does, or packed to at most `max_bytes`."""
        return self._ports[link_index].link.datagrams_to_send(max_bytes)

    def _tell(self, outputs: Replies, now_us: int) -> None:
        for sender, command, result in outputs.answers:
            ack = m.CommandAck(command, result, 0, 0, sender.system, sender.component)
            self._ports[sender.link].link.send(ack)
        self._say(outputs.notices, now_us)

    def _say(self, notices: Sequence[Notice], now_us: int) -> None:
        """EVENTs go to every link, texts only to those that hear from a ground station."""
        for notice in notices:
            self.console.add(notice, now_us)
            event = None
            if notice.event_id:
                event = self.events.add(notice.event_id, notice.log_levels, notice.arguments, now_us)
                self.view.event_sequence = self.events.sequence
            for port in self._ports:
                port.tell(notice, event, self.t_us, self.vehicle.params)


_HANDLERS: Final[dict[type[Any], Callable[[Server, int, Received], None]]] = {
    m.ManualControl: Server._on_sticks,
    m.SetAttitudeTarget: Server._on_attitude_target,
    m.SetPositionTargetLocalNed: Server._on_position_target,
    m.SetPositionTargetGlobalInt: Server._on_position_target,
    m.Heartbeat: Server._on_heartbeat,
    m.CommandLong: Server._on_command,
    m.CommandInt: Server._on_command,
    m.SetMode: Server._on_command,
    m.ParamSet: Server._on_parameter_set,
    m.ParamRequestRead: Server._on_protocol,
    m.ParamRequestList: Server._on_protocol,
    m.Timesync: Server._on_protocol,
    m.Ping: Server._on_protocol,
    m.FileTransferProtocol: Server._on_protocol,
    m.SetGpsGlobalOrigin: Server._on_protocol,
    m.RequestEvent: Server._on_protocol,
    m.MissionRequestList: Server._on_plan,
    m.MissionClearAll: Server._on_plan,
    m.MissionCount: Server._on_plan,
    m.MissionRequestInt: Server._on_plan,
    m.MissionRequest: Server._on_plan,
    m.MissionItemInt: Server._on_plan,
    m.MissionItem: Server._on_plan,
    m.MissionAck: Server._on_plan,
    m.MissionSetCurrent: Server._on_plan,
}
