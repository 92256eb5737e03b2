"""`make soak`: an hour of real time at 250 Hz, `sim` and `offboard` as two processes beside two busy loops.

    python -m benchmarks.soak                  an hour with real-time priority, a quarter of one without
    python -m benchmarks.soak --real-time-s 600 --normal-s 0

A bare loop of the same period and priority, which does nothing but sleep to its next deadline, runs beside each flight:
what it shows is the machine's.  Everybody has a session of their own, as services have; without priority means without
the permission for one (`setpriv` takes it away).  Lateness: time between two ticks beyond the period.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from datetime import date, datetime
from pathlib import Path
from typing import Any

from benchmarks import campaign

PERIOD_US = 4000
GAP_US = 8000
"""Between two ticks: counted, and each with its cause among the flight's `stalls`."""
_MOST_US, _P99_US, _BARE = 2000.0, 200.0, 1.2
"""Lateness that no tick, and that one of a hundred, may have with real-time priority; without, the latter is held to
so many times the bare loop's."""
_BUSY = 2
_OWN = ("setsid",)
_NORMAL = ("setsid", "setpriv", "--inh-caps=-sys_nice", "--bounding-set=-sys_nice", "chrt", "-o", "0")
_REAL_TIME = "real-time"
_BESIDE_S = 600.0
_SPINS = "while True: pass"
_QUAD, _CAPACITY = campaign.ROOT / "flightstack/data/vehicles" / "quad-x.toml", "capacity_as = 18000"
"""Ten times the battery: with its own the vehicle hovers for 27 minutes, then returns."""


def bare(seconds: float, plain: bool) -> dict[str, float | int]:
    """Sleep from deadline to deadline until told to end; the same figures as a flight's.

    `plain`: as anybody would write it, without the short turns on the processor that a flight asks for.
    """
    import numpy as np

    from mavlink_bridge.pace import Pace, undisturbed

    between_us = np.full(int(1e6 * seconds / PERIOD_US), float(PERIOD_US))
    ended: list[int] = []
    signal.signal(signal.SIGTERM, lambda number, frame: ended.append(number))
    with undisturbed(real_time=not plain) as is_ahead:
        pace = Pace(PERIOD_US, is_ahead=is_ahead)
        pace.wait()
        for k in range(len(between_us)):
            pace.wait()
            between_us[k] = pace.between_us
            if ended:
                break
    late_us = np.maximum(0.0, between_us[: k + 1] - PERIOD_US)
    return {
        "p50": float(np.percentile(late_us, 50)), "p99": float(np.percentile(late_us, 99)),
        "max": float(late_us.max()), "gaps": int((late_us > GAP_US - PERIOD_US).sum()),
    }  # fmt: skip


@contextlib.contextmanager
def _running(*commands: list[str]) -> Iterator[list[subprocess.Popen[str]]]:
    started: list[subprocess.Popen[str]] = []
    try:
        for command in commands:
            started.append(subprocess.Popen(command, env=_environment(), stdout=subprocess.PIPE, text=True))
        yield started
    finally:
        for process in started:
            process.kill()
            process.wait()


def _environment() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}


def flight(seconds: float, prefix: tuple[str, ...], port: int, out: Path) -> dict[str, Any]:
    """Hover for so long beside a bare loop and busy ones; the flight's JSON and the bare loop's figures."""
    out.mkdir(parents=True)
    vehicle = out / "vehicle.toml"
    vehicle.write_text(_QUAD.read_text().replace(_CAPACITY, f"{_CAPACITY}0"))
    python, cli = [*prefix, sys.executable], [*prefix, sys.executable, "-m", "flightstack"]
    busy = [[*_NORMAL, sys.executable, "-c", _SPINS]] * _BUSY
    loop = [*python, "-m", "benchmarks.soak", "--bare", str(seconds + _BESIDE_S), *["--plain"] * (prefix == _NORMAL)]
    sim = [*cli, "sim", "--port", str(port), "--gcs-port", str(port + 1), "--vehicle", str(vehicle)]
    command = [*cli, "offboard", "--connect", f"udpin:127.0.0.1:{port}", "--arm", "--scenario", "hover"]
    command += ["--duration", str(seconds), "--out", str(out), "--json", str(out / "flight.json")]
    with _running(sim, *busy, loop) as (simulator, *_, beside):
        assert simulator.stdout is not None
        simulator.stdout.readline()
        code = subprocess.run(command, env=_environment(), stdout=subprocess.DEVNULL, check=False).returncode
        beside.terminate()
        alone = json.loads(beside.communicate(timeout=_BESIDE_S)[0])
    if not (out / "flight.json").exists():
        sys.exit(f"error: offboard ended with exit code {code} and no result")
    result = json.loads((out / "flight.json").read_text())
    return {"exit_code": code, "bare": alone, "load": os.getloadavg()[0], **result}


def words(name: str, found: dict[str, Any]) -> str:
    """One line of the table."""
    loop, alone = found["loop"], found["bare"]
    late, gaps = loop["lateness_us"], sum(stall["s"] > 1e-6 * GAP_US for stall in loop["stalls"])
    ours = (late["p50"], late["p99"], late["max"], loop["missed"], gaps)
    cells = (found["flight_time_s"], found["exit_code"], *ours, *(alone[key] for key in ("p50", "p99", "max", "gaps")))
    return f"| {name} | {' | '.join(f'{cell:.0f}' for cell in cells)} | {found['load']:.1f} |"


def shortcoming(name: str, found: dict[str, Any]) -> str:
    """What is not as asked, in words."""
    late, alone = found["loop"]["lateness_us"], found["bare"]
    if found["exit_code"]:
        return f"{name}: the flight was ended, {found['reason']}"
    if name == _REAL_TIME and not found["loop"]["real_time_priority"]:
        return f"{name}: the priority is not permitted here"
    if name == _REAL_TIME and not (late["p99"] <= _P99_US and late["max"] <= _MOST_US):
        return f"{name}: late by {late['p99']:.0f} us (p99), {late['max']:.0f} us (most)"
    if name != _REAL_TIME and not late["p99"] <= _BARE * alone["p99"]:
        return f"{name}: late by {late['p99']:.0f} us (p99) where a bare loop is by {alone['p99']:.0f}"
    return ""


def main() -> None:
    """Fly, print markdown; exit code 1 where a flight was ended, or was later than is asked."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--real-time-s", type=float, default=3600.0)
    parser.add_argument("--normal-s", type=float, default=900.0)
    parser.add_argument("--port", type=int, default=14_660)
    parser.add_argument("--out", type=Path, default=Path("runs") / f"soak-{datetime.now():%Y%m%d-%H%M%S}")
    parser.add_argument("--bare", type=float, help=argparse.SUPPRESS)
    parser.add_argument("--plain", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.bare:
        print(json.dumps(bare(options.bare, options.plain)))
        return
    print(f"{date.today()}, {campaign.processor()}, {_BUSY} busy loops\n")
    print("| priority | flight, s | exit code | late, us: p50 | p99 | most | missed | gaps > 8 ms, named |", end="")
    print(" bare loop, us: p50 | p99 | most | gaps | load |\n| --- |" + " --: |" * 12)
    found = {}
    for name, seconds, prefix in ((_REAL_TIME, options.real_time_s, _OWN), ("normal", options.normal_s, _NORMAL)):
        if seconds:
            found[name] = flight(seconds, prefix, options.port, (options.out / name).absolute())
            print(words(name, found[name]), flush=True)
            (options.out / "soak.json").write_text(json.dumps(found, indent=1) + "\n")
    said = [words for words in (shortcoming(*each) for each in found.items()) if words]
    sys.exit("\n".join(said) if said else 0)


if __name__ == "__main__":
    main()
