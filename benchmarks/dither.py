"""Dithered rates and switched thrust against the governor: how far torque moves thrust, beside the ledger's line.

Rate loop, allocation, rotors and plant alone, high above the ground.  Each trial draws a vehicle within the doubts
(inertia 0.85 to 1.2 on each axis by itself, rotors' lag +-20 %, up to 1.4 times the mass) and square, sine or random
rates of 1 to 25 Hz and up to 6 rad/s (yaw 2), while thrust jumps between its ends; all measured against T(u) of the
delayed collective command.

    python -m benchmarks.dither [--trials 200] [--vehicle quad-x] [--free]
"""

from __future__ import annotations

import argparse
import math
import sys
from typing import NamedTuple

import numpy as np

from flightstack.barrier.torque import GovernorTerms, governor_terms
from flightstack.cli import files
from flightstack.governor import Governor
from flightstack.model import Limits, Model
from flightstack.types import F64, Command
from flightstack.vehicle import Vehicle, with_effects
from flightstack_sim.autopilot.setpoint import ControlKind, ControlSetpoint
from flightstack_sim.grade import load_grade
from flightstack_sim.simulated_vehicle import SimulatedVehicle, simulated_vehicle

TICK_MS = 4
_SETTLED_MS = 500
_INERTIA, _LAG, _MASS = (0.85, 1.2), (0.8, 1.2), (1.0, 1.4)


class Trial(NamedTuple):
    """Greatest values of one trial."""

    spread: float
    """Of a rotor's command from the collective one: at most D."""
    gain_mps2: float
    """Believed specific thrust that torque added."""
    loss_mps2: float
    changed: float
    """Share of the commands that the governor changed."""


def terms_of(vehicle: Vehicle, grade: str = "mocap") -> GovernorTerms:
    """The governor's terms in a flight with the usual limits."""
    noise = load_grade(grade).imu.gyro_noise_radps_rthz
    return governor_terms(vehicle, Model.from_vehicle(vehicle), Limits(), noise)


def trial(
    vehicle: Vehicle, terms: GovernorTerms, seed: int, *, seconds: float = 4.0, governed: bool = True,
    plant: str = "native",
) -> Trial:  # fmt: skip
    """One trial, the first half second not counted."""
    rng = np.random.default_rng(seed)
    truth = _drawn(vehicle, rng)
    flies = simulated_vehicle(vehicle, truth, load_grade("mocap"), seed=seed, plant=plant)
    flies.plant.pos_ned_m[2] = -500.0
    model = Model.from_vehicle(vehicle)
    ends = [model.norm_of(weight * model.weight_n) for weight in (Limits().thrust_min_weights, 1.8)]
    rates, thrusts = _commands(rng, ends, round(250 * (seconds + 1e-3 * _SETTLED_MS)))
    limits, governor = terms.limits if governed else None, Governor(vehicle)
    state, rows, changed = governor.init(), [], 0
    lag = truth.effects["motor_lag"]["time_constant_s"]
    delayed = float(thrusts[0])
    flies.motor_command[:] = delayed
    _start_rotors(flies, delayed)
    for tick, (wanted, norm) in enumerate(zip(rates, thrusts, strict=True)):
        state, sent, rate = governor.step(state, Command(1000 * TICK_MS * tick, 0.0, float(norm), wanted), limits)
        changed += rate is not None
        p, q, r = (wanted if rate is None else rate).tolist()
        for _ in range(TICK_MS):
            flies.advance(ControlSetpoint(ControlKind.RATE, (p, q, r), sent), 1)
            delayed = sent + math.exp(-1e-3 / lag) * (delayed - sent)
            spread = float(np.abs(flies.motor_command - sent).max())
            rows.append((spread, _thrust(vehicle, np.array(flies.plant.truth().motor_u)) - _thrust(vehicle, delayed)))
    spreads, errors = np.array(rows[_SETTLED_MS:]).T
    errors = errors * model.max_thrust_n / model.mass_kg
    return Trial(float(spreads.max()), float(errors.max()), float(-errors.min()), changed / len(rates))


def _drawn(vehicle: Vehicle, rng: np.random.Generator) -> Vehicle:
    """A vehicle within the doubts."""
    return with_effects(
        vehicle,
        {
            "inertia": {f"scale_{axis}": float(rng.uniform(*_INERTIA)) for axis in "xyz"},
            "motor_lag": {"time_constant_s": vehicle.rotors.time_constant_s * float(rng.uniform(*_LAG))},
            "payload": {"mass_kg": vehicle.mass_kg * float(rng.uniform(*_MASS) - 1.0)},
        },
    )


def _commands(rng: np.random.Generator, ends: list[float], ticks: int) -> tuple[F64, F64]:
    """(ticks, 3) rates and (ticks,) collective commands."""
    t = 1e-3 * TICK_MS * np.arange(ticks)[:, None]
    amplitude, hz, phase = rng.uniform(0.0, (6.0, 6.0, 2.0)), rng.uniform(1.0, 25.0, 3), rng.uniform(0.0, 6.28, 3)
    kind = rng.choice(["square", "sine", "random"])
    wave = np.sin(2.0 * math.pi * hz * t + phase)
    if kind == "square":
        wave = np.sign(wave)
    elif kind == "random":
        held = np.repeat(rng.uniform(-1.0, 1.0, (ticks, 3)), max(round(125.0 / hz[0]), 1), axis=0)
        wave = held[:ticks]
    pauses = rng.exponential(rng.uniform(0.02, 0.5), ticks)
    side = np.searchsorted(np.cumsum(pauses), t[:, 0]) % 2
    return amplitude * wave, np.array(ends)[side]


def _thrust(vehicle: Vehicle, u: F64 | float) -> float:
    """Mean of the rotors' thrust over the greatest."""
    f = vehicle.rotors.thrust_model_factor
    return float(np.mean(f * np.square(u) + (1.0 - f) * np.asarray(u)))


def _start_rotors(flies: SimulatedVehicle, norm: float) -> None:
    rotors = getattr(flies.plant, "motor_u", None)
    if rotors is not None:
        rotors[:] = norm


def main(arguments: list[str]) -> int:
    """Print the worst of many trials; 1 where a bound of the ledger does not hold."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=200)
    parser.add_argument("--vehicle", action="append")
    parser.add_argument("--free", action="store_true", help="without the governor")
    options = parser.parse_args(arguments)
    held = True
    for name in options.vehicle or ("quad-x", "px4-sihsim-quadx"):
        vehicle = files.load_vehicle(name)[0]
        terms = terms_of(vehicle)
        rows = np.array([trial(vehicle, terms, seed, governed=not options.free) for seed in range(options.trials)])
        spread, gain, loss, _ = rows.max(axis=0)
        print(
            f"{name}: r_max {terms.roll_pitch_max:.4f}, y_max {terms.yaw_max:.4f}; worst of {len(rows)} trials: "
            f"spread {spread:.4f} of {terms.margin:.4f}, gain {gain:.4f} of {terms.lift_mps2:.4f} m/s^2, "
            f"loss {loss:.5f}"
        )
        held = held and spread <= terms.margin and gain <= terms.lift_mps2 + 1e-3 and loss <= terms.loss_mps2 + 5e-3
    return 0 if held or options.free else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
