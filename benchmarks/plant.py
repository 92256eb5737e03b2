"""How fast is the plant?  Steps of 1 ms per second of wall time, ours and peers' in the same run.

    python benchmarks/plant.py [--json FILE] [--seconds S]

Peers that are not installed are skipped, saying so (`pip install .[bench]`).  Each row is the best of ten runs: a
busy neighbour can only make a run slower.  JSBSim's model is the least quadrotor it takes: a rigid body under four
forces.  crazyflow's one world is stepped with motor commands, by its RK4 and by its Euler method; many worlds hold them
for 20 steps, as our batch does, which flies high above the ground.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib.util
import io
import json
import os
import platform
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path

os.environ.setdefault("SCIPY_ARRAY_API", "1")  # crazyflow wants it before SciPy is imported

import numpy as np

from flightstack.trajectory import sinusoid
from flightstack.types import F64
from flightstack.vehicle import Vehicle, parse_vehicle, with_effects
from flightstack_sim.batch import BatchClosedLoop, BatchPlant
from flightstack_sim.plant import NativePlant

ROOT = Path(__file__).resolve().parent.parent
DT_S = 1e-3
RUNS = 10
BATCH = 10_000
STEPS = 20
COMMAND = np.full(4, 0.7)
IN_THE_AIR = "--plant jsbsim, in the air"
ALL_EFFECTS: dict[str, dict[str, float]] = {
    "payload": {"mass_kg": 0.1},
    "thrust_scale": {"scale": 1.05},
    "thrust_curve": {"thrust_model_factor": 0.8},
    "rotor_fault": {"rotor": 1, "effectiveness": 0.99},
    "com_offset": {"x_m": 0.001, "y_m": 0.001, "z_m": 0.01},
    "inertia": {"scale_x": 1.1, "scale_y": 1.1, "scale_z": 1.1},
    "motor_lag": {"time_constant_s": 0.03},
    "transport_delay": {"delay_s": 0.0125},
    "battery_sag": {"thrust_loss_per_v": 0.05},
    "linear_drag": {"d_x_kgps": 0.2, "d_y_kgps": 0.2, "d_z_kgps": 0.2},
    "angular_damping": {"k_x_nms": 0.05, "k_y_nms": 0.05, "k_z_nms": 0.05},
    "rotor_drag": {"k_d_kg_per_rad": 1.6e-4},
    "induced_inflow": {"k_z_kg_per_rad": 1e-4},
    "parasitic_drag": {"c_x_kg_per_m": 0.02, "c_y_kg_per_m": 0.02, "c_z_kg_per_m": 0.03},
    "translational_lift": {"k_h_kg_per_m": 0.004},
    "blade_flapping": {"k_flap_nms2_per_rad_m": 1e-6},
    "rotor_gyroscopic": {"rotor_inertia_kgm2": 5e-5},
    "ground_effect": {"strength": 1.0},
    "vortex_ring": {"strength": 0.3},
    "steady_wind": {"north_mps": 3.0, "east_mps": 1.0, "down_mps": 0.0},
    "constant_force": {"north_n": 0.2, "east_n": 0.1, "down_n": 0.0},
    "turbulence": {"sigma_mps": 1.0, "length_m": 50.0},
    "slung_load": {"mass_kg": 0.1, "length_m": 1.0},
}


@dataclass(frozen=True, slots=True)
class Row:
    """One measurement: vehicle steps per second of wall time, None where skipped."""

    system: str
    what: str
    steps_per_s: float | None
    note: str = ""


def best_rate(run: Callable[[], int], seconds: float) -> float:
    """Steps per second of `run` (which makes and returns some number of steps), warmed up, best of RUNS."""
    run()
    rates = []
    for _ in range(RUNS):
        steps, start = 0, time.perf_counter()
        while (took := time.perf_counter() - start) < seconds / RUNS:
            steps += run()
        rates.append(steps / took)
    return max(rates)


def ours(seconds: float) -> Iterator[Row]:
    """The native plant: a call a step, a compiled loop, a batch; with no effect set and with all of them."""
    text = (ROOT / "flightstack/data/vehicles" / "quad-x.toml").read_text()
    plain = parse_vehicle(text, "quad-x.toml")
    for vehicle, label in ((plain, "no effect on"), (with_effects(plain, ALL_EFFECTS), "all effects on")):
        yield Row("flightstack", f"one vehicle, a call a step, {label}", best_rate(calls(vehicle), seconds), "RK4")
        yield Row("flightstack", f"one vehicle, compiled loop, {label}", best_rate(loop(vehicle), seconds), "RK4")
        for steps, what in ((1, "a call a step"), (STEPS, "compiled loop")):
            rate = best_rate(batch(vehicle, steps), seconds)
            yield Row("flightstack", f"{BATCH} vehicles, {what}, {label}", rate, "RK4, all cores")
        rate = best_rate(closed_loop(vehicle), seconds)
        yield Row("flightstack", f"{BATCH} closed loops, ticks of 4 ms, {label}", rate, "four RK4 steps a tick")


def calls(vehicle: Vehicle) -> Callable[[], int]:
    """One vehicle, a call a step."""
    plant = NativePlant(vehicle, seed=0)

    def run() -> int:
        step = plant.step
        for _ in range(2000):
            step(COMMAND)
        return 2000

    return run


def loop(vehicle: Vehicle) -> Callable[[], int]:
    """One vehicle, many steps in a call."""
    plant = NativePlant(vehicle, seed=0)

    def run() -> int:
        plant.run(COMMAND, 20_000)
        return 20_000

    return run


def batch(vehicle: Vehicle, steps: int, threads: int | None = None) -> Callable[[], int]:
    """BATCH vehicles with masses of their own, so many steps in a call."""
    rng = np.random.default_rng(0)
    masses = rng.uniform(-0.2, 0.4, BATCH)
    plant = BatchPlant(
        [with_effects(vehicle, {"payload": {"mass_kg": mass}}) for mass in masses.tolist()], seed=0, threads=threads
    )
    commands: F64 = rng.uniform(0.5, 0.9, (BATCH, 4))

    plant.pos_ned_m[:, 2] = -5000.0

    def run() -> int:
        plant.run(commands, steps)
        return BATCH * steps

    return run


def closed_loop(vehicle: Vehicle, threads: int | None = None) -> Callable[[], int]:
    """BATCH closed loops."""
    plain = replace(vehicle, effects={})
    path = sinusoid((0.0, 0.0, -1.5), (1.0, 0.8, 0.3), (1.2, 1.0, 0.7), (0.0, 0.5, 0.0), yaw_rad=0.3)
    reference = np.array([path.at(0.004 * k).row for k in range(64)])
    fleet = BatchClosedLoop(plain, [vehicle] * BATCH)

    def run() -> int:
        fleet.fly(reference, threads=threads)
        return 64 * BATCH

    return run


def rotorpy(seconds: float) -> Iterator[Row]:
    """RotorPy's Multirotor with its default integrator (SciPy's RK45) and aerodynamics."""
    from rotorpy.vehicles.crazyflie_params import quad_params
    from rotorpy.vehicles.multirotor import Multirotor

    vehicle = Multirotor(quad_params)
    state = dict(vehicle.initial_state)
    control = {"cmd_motor_speeds": np.full(4, 1788.0)}

    def run() -> int:
        nonlocal state
        for _ in range(50):
            state = vehicle.step(state, control, DT_S)
        return 50

    yield Row("RotorPy", "one vehicle, a call a step", best_rate(run, seconds), "RK45")


JSBSIM_QUAD = """<?xml version="1.0"?>
<fdm_config name="quad" version="2.0" release="BETA">
 <metrics><wingarea unit="M2">1</wingarea><wingspan unit="M">1</wingspan><chord unit="M">1</chord>
  <location name="AERORP" unit="M"><x>0</x><y>0</y><z>0</z></location></metrics>
 <mass_balance><ixx unit="KG*M2">0.012</ixx><iyy unit="KG*M2">0.013</iyy><izz unit="KG*M2">0.022</izz>
  <emptywt unit="KG">1.2</emptywt><location name="CG" unit="M"><x>0</x><y>0</y><z>0</z></location></mass_balance>
 <ground_reactions/><propulsion/><flight_control name="none"/><aerodynamics/>
 <external_reactions>{forces}</external_reactions>
</fdm_config>"""
JSBSIM_FORCE = """<force name="rotor{i}" frame="BODY"><location unit="M"><x>{x}</x><y>{y}</y><z>0</z></location>
 <direction><x>0</x><y>0</y><z>-1</z></direction></force>"""


def jsbsim_step(folder: Path) -> Callable[[], int]:
    """JSBSim, a call a step, a rigid body under four rotor forces; its files are written into `folder`."""
    import jsbsim as module

    places = ((0.13, 0.16), (-0.13, -0.16), (0.13, -0.16), (-0.13, 0.16))
    forces = "".join(JSBSIM_FORCE.format(i=i, x=-x, y=y) for i, (x, y) in enumerate(places))
    (folder / "quad").mkdir()
    (folder / "quad" / "quad.xml").write_text(JSBSIM_QUAD.format(forces=forces))
    fdm = module.FGFDMExec(None)
    fdm.set_debug_level(0)
    fdm.set_aircraft_path(str(folder))
    fdm.load_model("quad")
    fdm["ic/h-sl-ft"] = 1e5
    fdm.set_dt(DT_S)
    fdm.run_ic()
    for i in range(4):
        fdm[f"external_reactions/rotor{i}/magnitude"] = 0.66

    def run() -> int:
        for _ in range(2000):
            fdm.run()
        return 2000

    return run


def jsbsim(seconds: float) -> Iterator[Row]:
    """JSBSim's own step, and our plant on it."""
    with tempfile.TemporaryDirectory() as folder:
        rate = best_rate(jsbsim_step(Path(folder)), seconds)
    yield Row("JSBSim", "one vehicle, a call a step", rate, "its default integrators")
    for path in sorted((ROOT / "flightstack/data/vehicles").glob("*.toml")):
        vehicle = parse_vehicle(path.read_text(), path.name)
        yield Row("JSBSim plant", f"{path.stem}, a call a step", best_rate(_jsbsim_plant(vehicle), seconds), IN_THE_AIR)
    moved_by_air = ("rotor_drag", "translational_lift")
    text = (ROOT / "flightstack/data/vehicles" / "quad-x.toml").read_text()
    vehicle = with_effects(parse_vehicle(text, "quad-x.toml"), {name: ALL_EFFECTS[name] for name in moved_by_air})
    what = "quad-x, rotor drag and lift, a call a step"
    yield Row("JSBSim plant", what, best_rate(_jsbsim_plant(vehicle), seconds), IN_THE_AIR)


def _jsbsim_plant(vehicle: Vehicle) -> Callable[[], int]:
    """Our plant on JSBSim: commands in, a frame, all that a `Plant` shows out."""
    from flightstack_sim.jsbsim.plant import JsbsimPlant

    plant = JsbsimPlant(vehicle, seed=0)
    plant.place(pos_ned_m=(0.0, 0.0, -50.0), motor_u=COMMAND.tolist())

    def run() -> int:
        for _ in range(2000):
            plant.step(COMMAND)
        return 2000

    return run


def crazyflow(seconds: float) -> Iterator[Row]:
    """crazyflow (JAX): one world by calls and in its compiled loop, and many worlds."""
    import jax
    from crazyflow.sim import Sim

    for integrator in ("rk4", "euler"):
        for worlds, steps, what in (
            (1, 1, "one vehicle, a call a step"),
            (1, 5000, "one vehicle, compiled loop"),
            (BATCH, STEPS, f"{BATCH} vehicles, compiled loop"),
        ):
            sim = Sim(n_worlds=worlds, control="rotor_vel", integrator=integrator, freq=1000)

            def run(sim: Sim = sim, worlds: int = worlds, steps: int = steps) -> int:
                sim.step(steps)
                jax.block_until_ready(sim.data.states.pos)
                return worlds * steps

            yield Row("crazyflow", what, best_rate(run, seconds), integrator)


def measure(seconds: float) -> list[Row]:
    """All rows; a peer that is missing or fails is a row that says so."""
    rows = list(ours(seconds))
    for name, peer in (("RotorPy", rotorpy), ("JSBSim", jsbsim), ("crazyflow", crazyflow)):
        if importlib.util.find_spec(name.lower()) is None:
            rows.append(Row(name, "", None, "skipped: not installed"))
            continue
        try:
            with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
                warnings.simplefilter("ignore")
                rows += peer(seconds)
        except Exception as error:  # a peer's own trouble must not end the run
            rows.append(Row(name, "", None, f"skipped: {type(error).__name__}: {error}"))
    return rows


def show(rows: list[Row]) -> None:
    """The table, with the ratio of ours to each peer's of the same kind: no effect on / all effects on."""
    own = {row.what: row.steps_per_s for row in rows if row.system == "flightstack"}
    print(
        f"steps of 1 ms per second; {platform.platform()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    )
    print(f"| {'system':<12} | {'what':<48} | {'steps/s':>12} | {'ours/theirs':>15} | note")
    print(f"| {'-' * 12} | {'-' * 48} | {'-' * 12} | {'-' * 15} | ---")
    for row in rows:
        pair = [own.get(f"{row.what}, {label}") for label in ("no effect on", "all effects on")]
        theirs = row.steps_per_s
        ratio = " / ".join(f"{ours / theirs:.2f}" for ours in pair if ours and theirs)
        rate = f"{theirs:,.0f}" if theirs else ""
        print(f"| {row.system:<12} | {row.what:<48} | {rate:>12} | {ratio:>15} | {row.note}")


def main() -> None:
    """Measure, print, and write the rows as JSON where asked."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--json", metavar="FILE", help="write the rows there")
    parser.add_argument("--seconds", type=float, default=3.0, help="time spent on each row (default 3)")
    arguments = parser.parse_args()
    rows = measure(arguments.seconds)
    show(rows)
    if arguments.json:
        machine = {"platform": platform.platform(), "cores": os.cpu_count(), "python": platform.python_version()}
        result = {"schema": "flightstack.benchmark/1", "machine": machine, "rows": [asdict(row) for row in rows]}
        Path(arguments.json).write_text(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
