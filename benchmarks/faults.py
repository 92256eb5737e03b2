"""Every fault, flown, and what came of it: the table of docs/safety.md.

    python -m benchmarks.faults            all of them, as a Markdown table
    python -m benchmarks.faults NAME...    these, written as for --fault
    python -m benchmarks.faults --links    figure8 on links that are bad in every way, and on a good one

A hover is flown in lockstep with the companion; the fault comes 2 s after take-off unless it says otherwise.  Times
are simulated seconds from the fault to each change of the autopilot's mode and to the disarm.
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from flightstack.cli.flight import FlyOptions, SimulatedFlight, fly, prepare
from flightstack_logs.writer import FlightLog
from flightstack_sim.faults import FAULTS
from flightstack_sim.link_faults import LINK_FAULTS

LIMIT_S = 60.0
_LINK = {row.name for row in LINK_FAULTS}
VARIANTS = ("gcs-loss:3@2", "low-battery:0.1@2", "low-battery:0.04@2", "geofence:3@2", "setpoint-loss:5@2")
"""Besides one flight a row: other values of the parameter that matters."""


@dataclass(frozen=True, slots=True)
class FaultFlight:
    """One flight with a fault; times in seconds from the fault."""

    fault: str
    modes: tuple[tuple[float, str, bool], ...]
    """Each change of the autopilot's mode: when, which, whether by a failsafe."""
    disarmed_s: float
    """Infinite: not within LIMIT_S."""
    companion: str
    reason: str
    speed_at_ground_mps: float
    """Downward speed at which it met the ground; NaN where it didn't."""
    drift_m: float
    """Horizontal way from the fault to the end."""


def fly_fault(fault: str, *, scenario: str = "hover", seed: int = 0, limit_s: float = LIMIT_S) -> FaultFlight:
    """Fly `scenario` with a fault until the vehicle is disarmed or `limit_s` after the fault."""
    options = FlyOptions(scenario=scenario, fault=fault, seed=seed, duration_s=limit_s)
    with tempfile.TemporaryDirectory() as folder:
        log = FlightLog.open(Path(folder) / "flight.mcap", metadata={})
        flight = SimulatedFlight(prepare(options), options, log)
        try:
            return _watch(flight, fault, limit_s)
        finally:
            flight.close()
            log.close()


def _watch(flight: SimulatedFlight, fault: str, limit_s: float) -> FaultFlight:
    server, plant = flight.shell.server, flight.vehicle.plant
    state = server.commander.state
    while not server.faults.happened and not flight.companion.done:
        flight.step()
    start_us, at = flight.t_us, plant.pos_ned_m.copy()
    changes: list[tuple[float, str, bool]] = []
    mode, touched, sinking = state.mode, float("nan"), 0.0
    while state.armed and flight.t_us - start_us < 1e6 * limit_s:
        flight.step()
        if state.armed and state.mode is not mode:
            mode = state.mode
            changes.append(((flight.t_us - start_us) * 1e-6, mode.title, state.in_failsafe))
        if plant.on_ground and touched != touched and sinking > 0.0:
            touched = sinking
        sinking = float(plant.vel_ned_mps[2])
    drift = plant.pos_ned_m[:2] - at[:2]
    return FaultFlight(
        fault,
        tuple(changes),
        float("inf") if state.armed else (flight.t_us - start_us) * 1e-6,
        flight.companion.state.value,
        flight.companion.reason,
        touched,
        float((drift @ drift) ** 0.5),
    )


LINKS = (
    "", *(row.name for row in LINK_FAULTS), "link-delay:50", "link-loss:0.3", "link-loss:0.3,link-jitter:40",
)  # fmt: skip


def fly_link(fault: str, *, seed: int = 0) -> str:
    """A row of the table of links: figure8, two laps."""
    with tempfile.TemporaryDirectory() as folder:
        options = FlyOptions(scenario="figure8", duration_s=16.0, fault=fault or None, seed=seed, out=Path(folder))
        result = fly(options, stop_requested=lambda: "").as_json()
    tracking = result["tracking"]
    figures = " | ".join("-" if tracking[key] is None else f"{100 * tracking[key]:.1f}" for key in ("rmse_m", "max_m"))
    return f"| {f'`{fault}`' if fault else 'none'} | {figures} | {'yes' if result['completed'] else 'no'} |"


def show_links() -> None:
    """Print the table of links."""
    print("| fault | tracking, rms cm | most, cm | completed |")
    print("| --- | --- | --- | --- |")
    for fault in LINKS:
        print(fly_link(fault), flush=True)


def main(names: list[str]) -> None:
    """Print the table."""
    if names == ["--links"]:
        show_links()
        return
    asked = names or [f"{row.name}@2" for row in FAULTS if row.name not in _LINK] + list(VARIANTS)
    print("| fault | the autopilot's modes, s after the fault | disarmed, s | companion |")
    print("| --- | --- | --- | --- |")
    for fault in asked:
        flown = fly_fault(fault)
        modes = ", ".join(f"{t:.2f} {name}{' (failsafe)' if by else ''}" for t, name, by in flown.modes) or "kept"
        landed = f"{flown.disarmed_s:.1f}" if flown.disarmed_s < LIMIT_S else "flies on"
        print(f"| `{fault}` | {modes} | {landed} | {flown.companion}: {flown.reason or 'completed'} |", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
