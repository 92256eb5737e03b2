"""The age of commands at the motors, as the companion finds it from SERVO_OUTPUT_RAW; with 10 ms more on the way."""

from __future__ import annotations

from statistics import mean

from benchmarks.px4.companion import fly
from benchmarks.px4.records import Bench, Row
from benchmarks.px4.relay import Manner, Relay
from benchmarks.px4.station import OFFBOARD_PORT, Px4

ASKED = (
    "Hover at default parameters: the latency of commands found within 2 ms of what it is (10 ms more on the way from "
    "companion to PX4 are found as such), or called unknown."
)
RUNS = 2
MORE_S, WITHIN_S = 0.010, 0.002


def run(bench: Bench, runs: int) -> list[Row]:
    """`runs` hovers straight, through a relay, and through a relay that keeps the commands back."""
    straight = [_hover(bench, None) for _ in range(runs)]
    relayed = [_hover(bench, 0.0) for _ in range(runs)]
    later = [_hover(bench, MORE_S) for _ in range(runs)]
    known = [each for each in relayed if each is not None]
    found = [each - mean(known) for each in later if each is not None and known]
    good = all(abs(each - MORE_S) <= WITHIN_S for each in found)
    return [
        Row("straight", _words(straight), None, runs),
        Row("through a relay", _words(relayed), None, runs),
        Row(f"through a relay, {1e3 * MORE_S:.0f} ms later", f"{_words(later)}; {_words(found)} more", good, runs),
    ]


def _words(latencies_s: list[float | None] | list[float]) -> str:
    return ", ".join("unknown" if each is None else f"{1e3 * each:.1f} ms" for each in latencies_s)


def _hover(bench: Bench, delay_s: float | None) -> float | None:
    with Px4(bench) as px4:
        if delay_s is None:
            flown = fly(bench, px4, "hover")
        else:
            with Relay(OFFBOARD_PORT + px4.instance, Manner(up_s=delay_s)) as relay:
                flown = fly(bench, px4, "hover", "--connect", f"udpin:127.0.0.1:{relay.port}")
    found: float | None = flown.result.get("link", {}).get("command_latency_s")
    print(f"delay {delay_s}: exit {flown.code}, {found}", flush=True)
    return found
