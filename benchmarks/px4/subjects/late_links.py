"""figure8 through a relay that keeps back what passes, each way by so much: error, tilt, the thrust gain learned."""

from __future__ import annotations

import math
import os

import numpy as np

from benchmarks.px4.companion import fly
from benchmarks.px4.records import Bench, Row
from benchmarks.px4.relay import Manner, Relay
from benchmarks.px4.station import OFFBOARD_PORT, Px4

ASKED = (
    "figure8 at default parameters through a link that takes longer, each way by so much: completed, settled rmse of "
    "PX4's own position at most 0.06 m, tilt at most 45 degrees, thrust gain within 0.03 and 3 sigma of 1.  "
    "`LINKS=15/15,0/30` names some."
)
RUNS = 3
TRACK_S, AIRBORNE_M = 24.0, 0.5
LIMIT_M, LIMIT_DEG, GAIN_OFF, SIGMAS = 0.06, 45.0, 0.03, 3.0
LINKS = {
    "0/0": Manner(),
    "5/5": Manner(up_s=0.005, down_s=0.005),
    "10/10": Manner(up_s=0.010, down_s=0.010),
    "15/15": Manner(up_s=0.015, down_s=0.015),
    "20/20": Manner(up_s=0.020, down_s=0.020),
    "0/30": Manner(down_s=0.030),
    "30/0": Manner(up_s=0.030),
    "15/15+5": Manner(up_s=0.015, down_s=0.015, jitter_s=0.005),
}
"""ms to PX4 and from it; what follows a `+` is drawn for each datagram besides."""


def run(bench: Bench, runs: int) -> list[Row]:
    """`runs` flights of every link, each on a PX4 started anew."""
    wanted = [word for word in os.environ.get("LINKS", "").split(",") if word] or list(LINKS)
    return [_link(bench, name, LINKS[name], runs) for name in wanted]


def _link(bench: Bench, name: str, manner: Manner, runs: int) -> Row:
    errors, tilts, gains, trips, notes = [], [], [], [], []
    for number in range(runs):
        with Px4(bench) as px4, Relay(OFFBOARD_PORT + px4.instance, manner) as relay:
            address = f"udpin:127.0.0.1:{relay.port}"
            flown = fly(bench, px4, "figure8", "--duration", f"{TRACK_S:g}", "--connect", address)
            tilt = max((math.degrees(t.tilt_rad) for t in px4.truth if t.up_m > AIRBORNE_M), default=0.0)
        result = flown.result
        error_m, learned = result.get("tracking", {}).get("rmse_settled_m"), result.get("gp", {})
        gain, sigma = learned.get("thrust_gain"), learned.get("thrust_gain_sigma")
        link = result.get("link", {})
        trip_ms = 1e-3 * (link.get("round_trip_us", {}).get("p50") or math.nan)
        wrong = [] if flown.code == 0 else [f"exit {flown.code}, {result.get('reason') or flown.said[-200:]!r}"]
        if error_m is None or gain is None:
            wrong.append("nothing measured")
        else:
            errors.append(error_m)
            gains.append(gain)
            wrong += ["error"] if error_m > LIMIT_M else []
            wrong += ["gain"] if abs(gain - 1.0) > min(GAIN_OFF, SIGMAS * sigma) else []
        wrong += ["tilt"] if tilt > LIMIT_DEG else []
        tilts.append(tilt)
        trips.append(trip_ms)
        told = f"{error_m} m, tilt {tilt:.0f}, gain {gain} +- {sigma}, {trip_ms:.0f} ms there and back"
        told += f", commands felt after {link.get('command_latency_s')} s"
        print(f"{name}, run {number}: {'; '.join(wrong) or 'good'} | {told}", flush=True)
        notes += [f"run {number}: {'; '.join(wrong)}; {told}"] if wrong else []
    measured = f"tilt {', '.join(f'{tilt:.0f}' for tilt in tilts)} degrees; {np.median(trips):.0f} ms there and back"
    if errors:
        measured = (
            f"{np.mean(errors):.3f} m, worst {max(errors):.3f}; {measured}; gain {min(gains):.3f} to {max(gains):.3f}"
        )
    return Row(f"{name} ms", measured, not notes, runs, notes)
