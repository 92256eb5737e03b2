"""`flightstack shield`: any offboard program behind the site filter (docs/site.md)."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from pathlib import Path
from select import select
from types import MappingProxyType
from typing import Any

from flightstack.barrier.estimate_bounds import estimate_bounds
from flightstack.cli import files
from flightstack.cli.compiled import FLIGHT, SITE, ensure_compiled
from flightstack.cli.console import say
from flightstack.cli.controllers import build
from flightstack.cli.given_certificate import require_checked
from flightstack.cli.offboard import last_words
from flightstack.cli.protection import governor_for
from flightstack.cli.quiet import quieted
from flightstack.cli.result import percentiles
from flightstack.cli.sensors import error_statistics
from flightstack.cli.shield_controller import Relay
from flightstack.cli.shield_frames import is_mavlink
from flightstack.cli.shield_passing import Passing
from flightstack.cli.shield_premises import ShieldPremises
from flightstack.cli.shield_router import ShieldRouter
from flightstack.cli.shield_turns import HeldTurns
from flightstack.cli.shield_words import ShieldWords
from flightstack.cli.site import envelope, given_prior, load_site, plan_site
from flightstack.cli.site_change import SiteChanges
from flightstack.cli.vehicle_gains import ask_gains, changed, counted_on, tuned
from flightstack.cli.vehicle_site import ask_vehicle, unknowing
from flightstack.governor import Governor
from flightstack.model import Model
from flightstack.site.certificate import require_same
from flightstack.stack import Stack
from flightstack.state_observer import StateObserver
from flightstack.types import InputError
from flightstack.warmup import warm_up
from flightstack_sim.grade import load_grade
from mavlink_bridge import frequent
from mavlink_bridge.pace import undisturbed
from mavlink_bridge.transport.address import Serial, Transport, UdpOut, open_address, parse_address
from mavlink_bridge.transport.clock import monotonic_us
from mavlink_bridge.transport.dead_man import DeadManProcess, DeadManWatch
from mavlink_bridge.transport.udp import UdpSocket

PERIOD_US = 4_000
PORT_STEP = 40
_SCENARIO = "hover"
_GONE_US = 2_000_000
"""A program that was silent for so long has gone (its heartbeats come each second): another may take its place."""
_HAND_OVER_US = 2_000_000
"""PX4 takes Hold within some milliseconds; after so long its own failsafe has to do."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ShieldOptions:
    """What `shield` was asked for."""

    connect: str
    serve: str
    site: Path
    vehicle: str | None = None
    certificate: Path | None = None
    sensors: str = "mocap"
    duration_s: float | None = None
    """End after so long; None: when stopped."""


def shield_stack(
    options: ShieldOptions, place: tuple[float, float] | None, gains: Mapping[str, float] = MappingProxyType({})
) -> tuple[Stack, Relay, StateObserver | None]:
    """The stack behind the router; InputError, one line, where site, vehicle or certificate won't do."""
    site = load_site(options.site, place)
    scenario, _ = files.load_scenario(_SCENARIO)
    believed = tuned(files.load_vehicle(options.vehicle)[0], gains)
    model, limits = Model.from_vehicle(believed), envelope(scenario.limits, site)
    grade = load_grade(options.sensors)
    statistics = error_statistics(grade)
    governor = governor_for(believed, model, limits, options.sensors)
    prior, text = given_prior(options.certificate, believed, options.sensors)
    planned = plan_site(site, None, believed, model, estimate_bounds(statistics), governor, prior)
    if options.certificate is not None:
        require_checked(files.TextFile(options.certificate, text))
        require_same(text, str(options.certificate), planned.certificate)
    inner = build("flatness", model, limits, learning=False)[0]
    relay = Relay(quieted(inner, planned.certificate), model)
    stack = Stack(
        model, limits, controller=relay, safety_filter=planned.filter(model, limits), governor=Governor(believed)
    )
    return stack, relay, StateObserver(statistics) if statistics.independent else None


def open_serve(address: str) -> UdpSocket:
    """The socket for the program: udpout speaks first, from 40 ports above, as PX4 does."""
    parsed = parse_address(address)
    if isinstance(parsed, Serial):
        raise InputError(f"--serve {address}: a program is served over UDP: udpout:HOST:PORT or udpin:HOST:PORT")
    if isinstance(parsed, UdpOut):
        return UdpSocket.bind(parsed.host, parsed.port + PORT_STEP, peer=(parsed.host, parsed.port), latch=False)
    return UdpSocket.bind(parsed.host, parsed.port, latch=True, greets=is_mavlink, drop_foreign=True)


def shield(
    options: ShieldOptions, *, stop_requested: Callable[[], str], on_progress: Callable[[float, str], None]
) -> dict[str, Any]:
    """Route until stopped; the JSON."""
    site, place = ask_vehicle(options.site, options.connect, 10.0)
    options = replace(options, site=site)
    file, _ = files.load_vehicle(options.vehicle)
    gains = ask_gains(options.connect, None, 10.0, file)
    if others := changed(file, gains):
        say(others)
    ensure_compiled(lambda text: on_progress(0.0, text), FLIGHT, SITE)
    stack, relay, refiner = shield_stack(options, place, gains)
    frequent.prepare()
    warm_up(stack, files.load_scenario(_SCENARIO)[0])
    bounds = estimate_bounds(error_statistics(load_grade(options.sensors)))
    router = ShieldRouter(stack, relay, refiner, place, lambda view: unknowing(view, bounds, options.sensors))
    governed = stack.filter.governed(None)  # of a site the same in every state
    turns = HeldTurns(governed.yaw_max if governed else math.inf)
    router.premises = ShieldPremises(counted_on(tuned(file, gains)))
    began_us = monotonic_us()
    with ExitStack() as opened:
        opened.enter_context(undisturbed(real_time=True))
        vehicle = opened.enter_context(closing(open_address(options.connect)))
        program = opened.enter_context(closing(open_serve(options.serve)))
        dead_man = DeadManWatch(opened.enter_context(DeadManProcess(vehicle.fileno())), router, vehicle)
        on_progress(0.0, "routing")
        opened.enter_context(last_words(router, vehicle))
        changes = opened.enter_context(closing(SiteChanges(options.site, place)))
        latencies = _route(
            router, (vehicle, program), dead_man, changes, turns, _until(options.duration_s, stop_requested)
        )
        summary = dead_man.summary()
    result = result_of(router, options, latencies, 1e-6 * (monotonic_us() - began_us))
    if turns.summary:
        say(turns.summary)
    return result | {
        "dead_man": summary,
        "yaw_held_back": turns.as_json(),
        "gains_changed": sorted(router.premises.changed),
    }


def _until(duration_s: float | None, stop_requested: Callable[[], str]) -> Callable[[], bool]:
    """Whether the router is to end."""
    ends_us = math.inf if duration_s is None else monotonic_us() + 1e6 * duration_s
    return lambda: bool(stop_requested()) or monotonic_us() > ends_us


def _route(
    router: ShieldRouter,
    links: tuple[Transport, UdpSocket],
    dead_man: DeadManWatch,
    changes: SiteChanges,
    turns: HeldTurns,
    is_to_end: Callable[[], bool],
) -> list[float]:
    """Until it is to end and the vehicle is out of the router's hands; what passing a batch took, microseconds."""
    vehicle, program = links
    passing = Passing(router, vehicle, program)
    next_us, ends_us, told = monotonic_us(), 0, False
    words = ShieldWords()
    heard_us = next_us
    while True:
        select([vehicle.fileno(), program.fileno()], [], [], max(next_us - monotonic_us(), 0) * 1e-6)
        came_ns, now_us = time.perf_counter_ns(), monotonic_us()
        heard_us = now_us if passing.step(now_us, came_ns) else heard_us
        if now_us < next_us:
            continue
        next_us = max(next_us + PERIOD_US, now_us)
        if now_us - heard_us > _GONE_US:
            program.unlatch()
        if router.ended:
            return passing.latencies_us
        if is_to_end():
            ends_us = ends_us or now_us + _HAND_OVER_US
            if router.hand_over(now_us):
                return passing.latencies_us
            if now_us > ends_us:
                say(f"the vehicle did not take Hold within {1e-6 * _HAND_OVER_US:g} s: left to its own failsafe")
                return passing.latencies_us
        if (change := changes.take()) is not None:
            refused = change if isinstance(change, str) else router.replace_site(change)
            say(f"the site is not replaced: {refused}" if refused else "the site is replaced")
        for line in (*words.look(router, now_us), *turns.look(router), *router.premises.look()):
            say(line)
        dead_man.hear()
        if dead_man.ended and not told:
            told = True
            say(f"{dead_man.ended}: nobody would answer for the shield, so PX4's Hold has the vehicle")
        for data in router.step(now_us):
            vehicle.send(data)
        if router.has_spoken or not router.flies:  # where it can't speak its silence is answered
            dead_man.tell()


def result_of(router: ShieldRouter, options: ShieldOptions, latencies: list[float], seconds: float) -> dict[str, Any]:
    """`flightstack.shield/1`."""
    score = router.score
    share = 1.0 / score.ticks if score.ticks else 0.0
    return {
        "schema": "flightstack.shield/1",
        "site": str(options.site),
        "seconds": seconds,
        "vehicle_heard": router.system != 0,
        "setpoints": score.setpoints,
        "ticks": score.ticks,
        "changed_share": score.changed * share,
        "governor_share": score.governed * share,
        "stopped_ticks": score.stopped,
        "handed_over": score.handed_over,
        "ended": router.ended,
        "sites_replaced": score.sites_replaced,
        "added_latency_us": percentiles(latencies),
    }
