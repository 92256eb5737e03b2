"""How fast, how accurate, how punctual: lockstep flights, tracking errors, and real-time lateness in two processes.

    python -m benchmarks.flight                  all three parts (make bench-flight)
    python -m benchmarks.flight --seeds 3 --realtime-s 0 --json results.json
    python -m benchmarks.flight --plant jsbsim   lockstep flights on that plant only

Lockstep: every message goes through UDP on loopback; the factor is flight time over the wall time of the flight (log
written, report not counted).  Tracking: 3-D distance of the true position from the scenario's reference, rms over the
track.  Real time: `sim` and `offboard --arm` as two processes, lateness of each 4 ms tick against its deadline.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from datetime import date
from pathlib import Path
from typing import Any

from benchmarks import campaign

FLIGHTS = (
    ("hover", True, "native"),
    ("figure8", True, "native"),
    ("minimum-snap", True, "native"),
    ("paper-tracking", True, "native"),
    ("paper-tracking", False, "native"),
    ("hover", True, "jsbsim"),
    ("figure8", True, "jsbsim"),
    ("figure8", False, "jsbsim"),
    ("paper-tracking", True, "jsbsim"),
)
"""Scenario, whether it learns, and the plant."""


def lockstep(seeds: int, plants: set[str]) -> list[dict[str, Any]]:
    """Every scenario with both grades of sensors, over the seeds."""
    from flightstack.cli.flight import FlyOptions, fly

    rows = []
    for scenario, learning, plant in FLIGHTS:
        for sensors in ("mocap", "gps") if plant in plants else ():
            flights = []
            for seed in range(seeds):
                with tempfile.TemporaryDirectory() as folder:
                    out = Path(folder)
                    options = FlyOptions(
                        scenario=scenario, sensors=sensors, seed=seed, learning=learning, plant=plant, out=out
                    )
                    flights.append(fly(options, stop_requested=lambda: "").as_json())
            factors = [flight["realtime_factor"] for flight in flights]
            errors = [flight["tracking"]["rmse_m"] for flight in flights]
            rows.append(
                {
                    "scenario": scenario if learning else f"{scenario}, no learning",
                    "plant": plant,
                    "sensors": sensors,
                    "completed": sum(flight["completed"] for flight in flights),
                    "flights": seeds,
                    "rmse_cm": [100 * min(errors), 100 * statistics.median(errors), 100 * max(errors)],
                    "realtime_factor": [min(factors), statistics.median(factors), max(factors)],
                }
            )
            print_lockstep(rows[-1])
    return rows


def print_lockstep(row: dict[str, Any]) -> None:
    """One line of the table, as soon as it is known."""
    errors = " / ".join(f"{value:.1f}" for value in row["rmse_cm"])
    factors = " / ".join(f"{value:.1f}" for value in row["realtime_factor"])
    flights = f"{row['completed']} of {row['flights']}"
    print(f"| {row['scenario']} | {row['plant']} | {row['sensors']} | {flights} | {errors} | {factors} |", flush=True)


def realtime(seconds: float, port: int = 14_640) -> dict[str, Any]:
    """Lateness of `offboard` against `sim` in another process; the track lasts `seconds`."""
    cli = [sys.executable, "-m", "flightstack"]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    with tempfile.TemporaryDirectory() as folder:
        result_file = Path(folder) / "result.json"
        sim = subprocess.Popen(
            [*cli, "sim", "--port", str(port), "--gcs-port", str(port + 1)],
            cwd=folder,
            env=environment,
            stdout=subprocess.PIPE,
            text=True,
        )
        try:
            assert sim.stdout is not None
            sim.stdout.readline()
            flight = [*cli, "offboard", "--connect", f"udpin:127.0.0.1:{port}", "--arm", "--scenario", "hover"]
            flight += ["--duration", str(seconds), "--out", folder, "--json", str(result_file)]
            subprocess.run(flight, cwd=folder, env=environment, stdout=subprocess.DEVNULL, check=False)
        finally:
            sim.terminate()
            sim.communicate()
        result: dict[str, Any] = json.loads(result_file.read_text())
        return result


def spin_lateness(samples: int = 2_000) -> dict[str, float]:
    """What this machine allows: the same pacing with nothing to do."""
    from flightstack.cli.result import percentiles
    from mavlink_bridge.pace import Pace

    pace = Pace(1_000.0)
    return percentiles([pace.wait() for _ in range(samples)])  # type: ignore[return-value]


def main() -> None:
    """Run and print markdown."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--realtime-s", type=float, default=60.0)
    parser.add_argument("--plant", choices=("native", "jsbsim"))
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    load = os.getloadavg()[0]
    print(f"{date.today()}, {platform.machine()}, {campaign.processor()}, load {load:.1f} at the start,")
    print(f"Python {platform.python_version()}\n")
    results: dict[str, Any] = {}
    if options.seeds:
        print("| scenario | plant | sensors | completed | true rmse, cm (min / median / max) | times real time |")
        print("| --- | --- | --- | --- | --- | --- |")
        results["lockstep"] = lockstep(options.seeds, {options.plant} if options.plant else {"native", "jsbsim"})
    if options.realtime_s and not options.plant:
        started = time.monotonic()
        results["realtime"] = realtime(options.realtime_s)
        results["pacing_alone_us"] = spin_lateness()
        loop, alone = results["realtime"]["loop"], results["pacing_alone_us"]
        print(f"\nreal time, two processes, {time.monotonic() - started:.0f} s in all:")
        print("| | p50, us | p99, us | max, us | missed |")
        print("| --- | --- | --- | --- | --- |")
        late = loop["lateness_us"]
        print(f"| offboard at 250 Hz | {late['p50']:.0f} | {late['p99']:.0f} | {late['max']:.0f} | {loop['missed']} |")
        print(f"| pacing alone at 1 kHz | {alone['p50']:.0f} | {alone['p99']:.0f} | {alone['max']:.0f} | |")
    if options.json is not None:
        options.json.write_text(json.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    main()
