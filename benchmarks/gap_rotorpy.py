"""The gap workflow on flights of somebody else's simulator: RotorPy (Folk, Paulos, Kumar 2023), its own controller.

    python -m benchmarks.gap_rotorpy               all rows, into docs/gap-measured.md (make gap-rotorpy)
    python -m benchmarks.gap_rotorpy --row NAME    one row, printed only

RotorPy integrates its own equations (SciPy's Runge-Kutta), its SE(3) controller flies and its IMU measures; nothing of
this package takes part.  The log is the CSV of a flight with noise on every signal, at 250 Hz or less; the vehicle
file holds RotorPy's own parameters of the vehicle less what is hidden.
"""

from __future__ import annotations

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import copy
import sys
import tempfile
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import campaign
from benchmarks.gap_cases import HEADER, as_csv
from flightstack.types import F64
from flightstack.vehicle import Rotors, Vehicle, parse_vehicle, vehicle_to_toml, with_effects

_BEGIN, _END = "<!-- rotorpy: begin -->", "<!-- rotorpy: end -->"
_STEP_S, _SECONDS = 0.004, 30.0
_FRD = np.array([1.0, -1.0, -1.0])
"""RotorPy's x forward, y left, z up, of the world and of the body, as north, east, down and forward, right, down."""
_AIR = ("rotor_drag", "induced_inflow", "translational_lift", "parasitic_drag")


@dataclass(frozen=True, slots=True)
class Row:
    """One flight: what the true vehicle has that the file doesn't, and what must be named."""

    key: str
    vehicle: str
    """crazyflie or hummingbird: RotorPy's own parameters."""
    expected: tuple[str, ...] = ()
    scaled: Mapping[str, float] = field(default_factory=dict)
    """RotorPy's parameters times these."""
    given: Mapping[str, float] = field(default_factory=dict)
    """RotorPy's parameters set to these."""
    forgotten: tuple[str, ...] = ()
    """Effects of the air that RotorPy has and the file doesn't."""
    wind_mps: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gusts_mps: float = 0.0
    """Amplitude of a wind that swings: outside the table."""
    bias: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    """Of accel and gyro, x forward, y left, z up."""
    com_m: tuple[float, float] = (0.0, 0.0)
    """Shift of the centre of mass forward and left, in arms."""
    weak: float = 1.0
    """Share of thrust and torque that the front right rotor keeps."""
    every: int = 1
    """Of the samples, one in so many is logged."""


def _rows(vehicle: str) -> list[Row]:
    both = [
        Row("nothing", vehicle),
        Row("nothing, 125 Hz", vehicle, every=2),
        Row("payload", vehicle, ("payload",), {"mass": 1.15}),
        Row("thrust scale", vehicle, ("thrust_scale",), {"k_eta": 0.9, "k_m": 0.9}),
        Row("inertia", vehicle, ("inertia",), {"Ixx": 1.3, "Iyy": 1.2, "Izz": 1.25}),
        Row("centre of mass", vehicle, ("com_offset",), com_m=(0.06, -0.08)),
        Row("weak rotor", vehicle, ("rotor_fault",), weak=0.85),
        Row("rotor drag", vehicle, ("rotor_drag",), forgotten=("rotor_drag",)),
        Row("induced inflow", vehicle, ("induced_inflow",), forgotten=("induced_inflow",)),
        Row("wind", vehicle, ("steady_wind",), wind_mps=(2.0, -1.5, 0.0)),
        Row("accelerometer's bias", vehicle, ("accelerometer_bias",), bias={"accel": (0.15, -0.1, 0.2)}),
        Row("gyro's bias", vehicle, ("gyro_bias",), bias={"gyro": (0.02, -0.03, 0.02)}),
        Row("drag and payload", vehicle, ("rotor_drag", "payload"), {"mass": 1.1}, forgotten=("rotor_drag",)),
        Row("gusts (outside the table)", vehicle, gusts_mps=2.0),
    ]
    if vehicle == "crazyflie":
        return [
            *both,
            Row("motor lag", vehicle, ("motor_lag",), {"tau_m": 1.5}),
            Row("blade flapping", vehicle, ("blade_flapping",), given={"k_flap": 1.0e-9}),
            Row("all of the air", vehicle, ("rotor_drag", "induced_inflow"), forgotten=_AIR),
        ]
    return [
        *both,
        Row("translational lift", vehicle, ("translational_lift",), forgotten=("translational_lift",)),
        Row("parasitic drag", vehicle, ("parasitic_drag",), forgotten=("parasitic_drag",)),
        Row("blade flapping", vehicle, ("blade_flapping",), given={"k_flap": 1.0e-6}),
        Row("all of the air", vehicle, _AIR, forgotten=_AIR),
    ]


ROWS = (*_rows("crazyflie"), *_rows("hummingbird"))
_RADIUS_M = {"crazyflie": 0.023, "hummingbird": 0.1}
_SPEED = {"crazyflie": (1.7, 1.5), "hummingbird": (3.5, 3.0)}
"""Of the path: speed m/s and size m."""


def parameters(name: str) -> dict[str, Any]:
    """RotorPy's own parameters of a vehicle."""
    from rotorpy.vehicles import crazyflie_params, hummingbird_params

    module = {"crazyflie": crazyflie_params, "hummingbird": hummingbird_params}[name]
    return copy.deepcopy(dict(module.quad_params))


def believed(row: Row) -> tuple[Vehicle, list[int]]:
    """The vehicle file's vehicle, and RotorPy's number of each of its rotors."""
    p = parameters(row.vehicle)
    places = np.array([p["rotor_pos"][f"r{i}"] for i in range(1, 5)]) * _FRD
    order = sorted(range(4), key=lambda i: _PLACES.index((bool(places[i, 0] > 0), bool(places[i, 1] > 0))))
    turns = -np.asarray(p["rotor_directions"], dtype=np.float64) * p["k_m"] / p["k_eta"]
    rotors = Rotors(
        position_m=places[order],
        torque_ratio_m=turns[order],
        max_thrust_n=p["k_eta"] * p["rotor_speed_max"] ** 2,
        max_speed_radps=float(p["rotor_speed_max"]),
        thrust_model_factor=1.0,
        time_constant_s=p["tau_m"],
        radius_m=_RADIUS_M[row.vehicle],
    )
    bare = Vehicle(row.vehicle, p["mass"], np.array([p["Ixx"], p["Iyy"], p["Izz"]]), rotors, None)
    air = {
        "rotor_drag": {"k_d_kg_per_rad": p["k_d"]},
        "induced_inflow": {"k_z_kg_per_rad": p["k_z"]},
        "translational_lift": {"k_h_kg_per_m": p["k_h"]},
        "parasitic_drag": {f"c_{axis}_kg_per_m": p[f"c_D{axis}"] for axis in "xyz"},
    }
    known = {e: v for e, v in air.items() if e not in row.forgotten and any(v.values())}
    return with_effects(bare, known), order


_PLACES = [(True, True), (False, False), (True, False), (False, True)]
"""Front right, rear left, front left, rear right: whether a rotor lies in front, and whether right."""


class _Path:
    """Sums of sines along every axis and in yaw, that begin at rest."""

    def __init__(self, rng: np.random.Generator, vehicle: str) -> None:
        speed, size = _SPEED[vehicle]
        self._size = size * np.array([[1.0, 1.0, 0.3], [0.2, 0.2, 0.12], [0.05, 0.05, 0.03]])
        self._rate = speed / size * rng.uniform(0.7, 1.1, (3, 3)) * np.array([[1.0], [1.7], [2.7]])
        self._phase = rng.uniform(0.0, 2.0 * np.pi, (3, 3))

    def _at(self, t_s: float) -> F64:
        begun = 1.0 - np.exp(-t_s / 1.5)
        swing = np.sum(self._size * np.sin(self._rate * t_s + self._phase), axis=0)
        return np.asarray(begun * swing + np.array([0.0, 0.0, 4.0]))

    def update(self, t_s: float) -> dict[str, Any]:
        """Flat outputs as RotorPy wants them."""
        h = 0.01
        p = [self._at(t_s + k * h) for k in (-2, -1, 0, 1, 2)]
        return {
            "x": p[2],
            "x_dot": (p[3] - p[1]) / (2 * h),
            "x_ddot": (p[3] - 2 * p[2] + p[1]) / h**2,
            "x_dddot": (p[4] - 2 * p[3] + 2 * p[1] - p[0]) / (2 * h**3),
            "x_ddddot": (p[4] - 4 * p[3] + 6 * p[2] - 4 * p[1] + p[0]) / h**4,
            "yaw": 1.2 * np.sin(0.35 * t_s),
            "yaw_dot": 0.42 * np.cos(0.35 * t_s),
            "yaw_ddot": -0.147 * np.sin(0.35 * t_s),
        }


def _truth(row: Row, order: list[int]) -> Any:
    """RotorPy's vehicle with what is hidden."""
    from rotorpy.vehicles.multirotor import Multirotor

    p = parameters(row.vehicle)
    hover = np.full(4, np.sqrt(p["mass"] * 9.81 / 4.0 / p["k_eta"]))
    p |= {name: p[name] * share for name, share in row.scaled.items()} | dict(row.given)
    arm = abs(p["rotor_pos"][f"r{order[0] + 1}"][:2]).max()
    shift = np.array([row.com_m[0] * arm, row.com_m[1] * arm, 0.0])
    p["rotor_pos"] = {name: place - shift for name, place in p["rotor_pos"].items()}
    start = {"x": np.array([0.0, 0.0, 4.0]), "v": np.zeros(3), "q": np.array([0.0, 0.0, 0.0, 1.0]), "w": np.zeros(3)}
    made = Multirotor(
        p, start | {"wind": np.zeros(3), "rotor_speeds": hover}, control_abstraction="cmd_motor_speeds", aero=True
    )
    if row.weak < 1.0:
        whole, k = made.compute_body_wrench, order[0]

        def weak(rates: F64, speeds: F64, airspeed: F64) -> tuple[F64, F64]:
            force, torque = whole(rates, speeds, airspeed)
            thrust = (1.0 - row.weak) * np.array([0.0, 0.0, made.k_eta * speeds[k] ** 2])
            turn = (1.0 - row.weak) * np.array([0.0, 0.0, made.rotor_dir[k] * made.k_m * speeds[k] ** 2])
            return force - thrust, torque - np.cross(made.rotor_geometry[k], thrust) - turn

        made.compute_body_wrench = weak
    return made


def fly(row: Row, seed: int) -> dict[str, F64]:
    """The log of a flight, column by column."""
    from rotorpy.controllers.quadrotor_control import SE3Control
    from rotorpy.sensors.imu import Imu
    from scipy.spatial.transform import Rotation

    _, order = believed(row)
    rng, own = np.random.default_rng(seed), parameters(row.vehicle)
    np.random.seed(seed)  # noqa: NPY002  RotorPy's IMU draws from there
    vehicle, control, path = _truth(row, order), SE3Control(own), _Path(rng, row.vehicle)
    root = np.sqrt(0.5 / _STEP_S)
    none = (0.0, 0.0, 0.0)
    imu = Imu(
        *(
            {"initial_bias": np.array(row.bias.get(name, none)), "noise_density": np.full(3, std / root)}
            | {"random_walk": np.zeros(3)}
            for name, std in (("accel", 0.06), ("gyro", 0.004))
        ),
        sampling_rate=1.0 / _STEP_S,
    )
    state, rows = vehicle.initial_state, []
    for k in range(round(_SECONDS / _STEP_S)):
        t_s = k * _STEP_S
        swing = np.sin(np.array([0.7, 0.9, 0.5]) * 2.0 * np.pi * t_s + np.array([0.0, 1.0, 2.0]))
        state["wind"] = np.array(row.wind_mps) + row.gusts_mps * np.array([1.0, 1.0, 0.25]) * swing
        seen = state | {
            "x": state["x"] + rng.normal(0.0, 0.003, 3),
            "v": state["v"] + rng.normal(0.0, 0.02, 3),
            "w": state["w"] + rng.normal(0.0, 0.01, 3),
        }
        speeds = control.update(t_s, seen, path.update(t_s))["cmd_motor_speeds"]
        sent = {"cmd_motor_speeds": np.clip(speeds, own["rotor_speed_min"], own["rotor_speed_max"])}
        felt = imu.measurement(state, vehicle.statedot(state, sent, _STEP_S), with_noise=True)
        motors = sent["cmd_motor_speeds"][order] / own["rotor_speed_max"]
        rows.append((t_s, state["x"], state["v"], state["q"], felt["gyro"], felt["accel"], motors))
        state = vehicle.step(state, sent, _STEP_S)
    t, pos, vel, q, gyro, accel, motors = (np.array(part) for part in zip(*rows[:: row.every], strict=True))
    turned = Rotation.from_quat(q) * Rotation.from_rotvec(rng.normal(0.0, 0.0012, (len(q), 3)))
    x, y, z, w = turned.as_quat().T
    columns = np.hstack(
        [
            t[:, None],
            (pos + rng.normal(0.0, 0.002, pos.shape)) * _FRD,
            (vel + rng.normal(0.0, 0.015, vel.shape)) * _FRD,
            np.stack([w, x, -y, -z], axis=1),
            gyro * _FRD,
            accel * _FRD,
            motors,
        ]
    )
    return dict(zip(HEADER.split(","), columns.T, strict=False))


def line(row: Row) -> tuple[bool, str]:
    """Whether the row is as it must be, and its line of the table."""
    from flightstack.gap.workflow import analyse

    vehicle, _ = believed(row)
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "flight.csv"
        log.write_text(as_csv(fly(row, seed=ROWS.index(row))), encoding="utf-8")
        result = analyse([log], parse_vehicle(vehicle_to_toml(vehicle), row.vehicle))
    named = {found.name for found in result.found}
    kept = named == set(row.expected) and result.unexplained.significant == bool(row.gusts_mps)
    words = "; ".join(
        f"{found.name} " + ", ".join(f"{e.estimate:.4g}" for e in found.parameters.values()) for found in result.found
    )
    rest = f"unexplained ({', '.join(result.unexplained.depends_on)})" if result.unexplained.significant else ""
    closed = "–" if result.gap.closed is None else f"{100.0 * result.gap.closed:.0f} %"
    said = "; ".join(part for part in (words, rest) if part) or "nothing"
    return kept, f"| {row.vehicle} | {row.key} | {said} | {closed} | {'yes' if kept else '**no**'} |"


def main() -> int:
    """Fly, name, print the table and put it into docs/gap-measured.md; 1 where a row is not as it must be."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--row", action="append", help="only rows of this name, printed (may be repeated)")
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    options = parser.parse_args()
    rows = [row for row in ROWS if not options.row or row.key in options.row]
    lines, good = [], 0
    with ProcessPoolExecutor(options.processes, get_context("spawn")) as pool:
        for kept, text in pool.map(line, rows):
            lines.append(text)
            good += kept
            print(text, flush=True)
    print(f"{good} of {len(rows)} as they must be")
    if not options.row:
        head = "| vehicle | hidden | says | closed | as it must |\n| --- | --- | --- | --: | --- |"
        about = campaign.stamp(f"`make gap-rotorpy`: {good} of {len(rows)} as they must be.")
        campaign.put("\n".join([about, "", head, *lines]), _BEGIN, _END)
    return 0 if good == len(rows) else 1


if __name__ == "__main__":
    sys.exit(main())
