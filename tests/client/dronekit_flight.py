"""A flight by DroneKit, as a user of DroneKit writes it: `python dronekit_flight.py udpin:127.0.0.1:14540`.

Prints a line of JSON for every step done: {"step": ..., "saw": ...}.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from typing import Any

import dronekit

PATIENCE_S = 30.0


def done(step: str, saw: Any = None) -> None:
    """One step has been done."""
    print(json.dumps({"step": step, "saw": saw}), flush=True)


def wait(condition: Callable[[], bool], what: str) -> None:
    """Until it holds."""
    limit = time.monotonic() + PATIENCE_S
    while not condition():
        if time.monotonic() > limit:
            raise TimeoutError(what)
        time.sleep(0.05)


def main(url: str) -> None:
    """Connect, arm, take off, change modes, land."""
    vehicle = dronekit.connect(url, wait_ready=False, heartbeat_timeout=PATIENCE_S)
    done("connected", str(vehicle.version))
    vehicle.wait_ready("parameters", "gps_0", "armed", "mode", "attitude", timeout=PATIENCE_S)
    done("parameters", len(list(vehicle.parameters.keys())))
    wait(lambda: vehicle.system_status.state == "STANDBY", "arming checks")
    vehicle.armed = True
    wait(lambda: vehicle.armed, "arm")
    done("armed")
    frame = vehicle.location
    vehicle.mode = dronekit.VehicleMode("TAKEOFF")
    wait(lambda: (frame.global_relative_frame.alt or 0.0) > 1.8, "take-off")
    done("takeoff", frame.global_relative_frame.alt)
    for name in ("LOITER", "RTL", "LAND"):
        vehicle.mode = dronekit.VehicleMode(name)
        wait(lambda name=name: vehicle.mode.name == name, name)  # type: ignore[misc]
        done(name)
    wait(lambda: not vehicle.armed, "landing")
    done("disarmed", frame.global_relative_frame.alt)
    vehicle.close()


if __name__ == "__main__":
    main(sys.argv[1])
