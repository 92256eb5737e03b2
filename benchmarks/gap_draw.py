"""What the blind flights are drawn from: vehicles, hidden effects with their magnitudes, and flight plans.

Vehicle, effects and plan are drawn independently of each other, but for one thing: wind and gusts act through drag, so
their vehicles' files know some.  Magnitudes scale with the vehicle: a share of its weight, of its arms, of its inertia.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from benchmarks.gap_flights import X_FADE, X_JET, X_MAGNET, X_PERIODIC, X_SIZE, X_SLOSH, X_TETHER, X_WAKE
from benchmarks.gap_pilot import Plan, steps
from flightstack.types import F64, STANDARD_GRAVITY_MPS2
from flightstack.vehicle import Battery, Rotors, Vehicle, with_effects

Rng = np.random.Generator
Effects = dict[str, dict[str, float]]
_G = STANDARD_GRAVITY_MPS2
_RHO = 1.225


# --- vehicles


def vehicle(rng: Rng, *, drag: bool) -> Vehicle:
    """An X quadrotor from a 100 g racer to a 4 kg carrier; half of the files know effects, all those with `drag`."""
    size = float(math.exp(rng.uniform(math.log(0.45), math.log(1.5))))
    mass = 1.2 * size**3 * rng.uniform(0.85, 1.15)
    x, y = 0.13 * size * rng.uniform(0.9, 1.2), 0.15 * size * rng.uniform(0.9, 1.2)
    radius = min(0.12 * size, 0.95 * min(x, y))
    gyration = np.array([0.098, 0.102, 0.135]) * size * rng.uniform(0.93, 1.07, 3)
    ratio = 0.13 * radius * rng.uniform(0.85, 1.15)
    thrust = mass * _G * rng.uniform(1.9, 3.0) / 4.0
    tip = rng.uniform(100.0, 140.0)
    rotors = Rotors(
        position_m=np.round([[x, y, 0.0], [-x, -y, 0.0], [x, -y, 0.0], [-x, y, 0.0]], 4),
        torque_ratio_m=np.round([ratio, ratio, -ratio, -ratio], 5),
        max_thrust_n=round(thrust, 4),
        max_speed_radps=round(tip / radius, 1),
        thrust_model_factor=round(float(rng.choice([1.0, 1.0, rng.uniform(0.3, 0.9), 0.0])), 2),
        time_constant_s=round(0.02 * size * rng.uniform(0.8, 2.0), 4),
        radius_m=round(radius, 4),
    )
    battery = None
    if rng.random() < 0.6:
        cells = 4 if size > 0.7 else 2
        hover_w = 4 * (mass * _G / 4) ** 1.5 / math.sqrt(2 * _RHO * math.pi * radius**2) / 0.6
        capacity = hover_w / (3.8 * cells) * rng.uniform(80.0, 300.0)
        battery = Battery(
            4.15 * cells, 4.2 * cells, 3.3 * cells, round(capacity, 0), round(0.05 * 4 * cells / hover_w * cells, 4)
        )
    inertia = np.round(mass * gyration**2, 9)
    inertia[2] = min(float(inertia[2]), round(0.99 * float(inertia[0] + inertia[1]), 9))
    plain = Vehicle(f"blind-{rng.integers(1_000_000):06d}", round(mass, 5), inertia, rotors, battery)
    known: Effects = {}
    if drag or rng.random() < 0.5:
        for name in ("rotor_drag", "linear_drag") if drag else rng.choice(_OFTEN_KNOWN, 2, replace=False):
            known[str(name)] = EFFECTS[str(name)](rng, plain)
    return with_effects(plain, known)


_OFTEN_KNOWN = ("rotor_drag", "linear_drag", "parasitic_drag", "angular_damping", "rotor_gyroscopic")


def _hover_speed(v: Vehicle) -> float:
    """Sum of the rotors' speeds in hover, rad/s."""
    return 4.0 * v.rotors.max_speed_radps * math.sqrt(v.weight_n / v.max_total_thrust_n)


def _signed(rng: Rng, low: float, high: float) -> float:
    return float(rng.choice([-1.0, 1.0]) * rng.uniform(low, high))


def _level(rng: Rng, low: float, high: float) -> tuple[float, float]:
    """A level vector of random direction."""
    size, angle = rng.uniform(low, high), rng.uniform(-math.pi, math.pi)
    return float(size * math.cos(angle)), float(size * math.sin(angle))


# --- effects of the table


def _payload(rng: Rng, v: Vehicle) -> dict[str, float]:
    return {"mass_kg": v.mass_kg * float(rng.choice([-1.0, 1.0, 1.0]) * rng.uniform(0.06, 0.3))}


def _thrust_curve(rng: Rng, v: Vehicle) -> dict[str, float]:
    f = v.rotors.thrust_model_factor
    return {"thrust_model_factor": f - rng.uniform(0.2, 0.5) if f > 0.5 else f + rng.uniform(0.2, 0.5)}


def _rotor_fault(rng: Rng, v: Vehicle) -> dict[str, float]:
    return {"rotor": float(rng.integers(1, 5)), "effectiveness": rng.uniform(0.75, 0.95)}


def _com_offset(rng: Rng, v: Vehicle) -> dict[str, float]:
    x, y = _level(rng, 0.03, 0.12)
    arm = abs(v.rotors.position_m[0, 0])
    return {"x_m": x * arm, "y_m": y * arm, "z_m": _signed(rng, 0.0, 0.2) * arm}


def _inertia(rng: Rng, v: Vehicle) -> dict[str, float]:
    """Of a body that can exist: no moment exceeds the sum of the other two."""
    while True:
        scale = np.where(rng.random(3) < 0.5, rng.uniform(0.7, 0.9, 3), rng.uniform(1.12, 1.5, 3))
        turned = scale * v.inertia_kgm2
        if 2.0 * turned.max() <= turned.sum():
            return {f"scale_{axis}": float(scale[i]) for i, axis in enumerate("xyz")}


def _linear_drag(rng: Rng, v: Vehicle) -> dict[str, float]:
    side = rng.uniform(0.1, 0.5)
    return {f"d_{axis}_kgps": v.mass_kg * side * rng.uniform(0.8, 1.25) for axis in "xyz"}


def _angular_damping(rng: Rng, v: Vehicle) -> dict[str, float]:
    return {f"k_{axis}_nms": float(v.inertia_kgm2[i]) * rng.uniform(1.0, 4.0) for i, axis in enumerate("xyz")}


def _parasitic_drag(rng: Rng, v: Vehicle) -> dict[str, float]:
    side = rng.uniform(0.02, 0.08)
    return {f"c_{axis}_kg_per_m": v.mass_kg * side * rng.uniform(0.7, 1.4) for axis in "xyz"}


def _rotor_inertia(rng: Rng, v: Vehicle) -> dict[str, float]:
    blade_kg = 0.006 * (v.rotors.radius_m / 0.12) ** 3
    return {"rotor_inertia_kgm2": blade_kg * v.rotors.radius_m**2 * rng.uniform(0.5, 2.0)}


def _wind(rng: Rng, v: Vehicle) -> dict[str, float]:
    north, east = _level(rng, 1.5, 6.0)
    return {"north_mps": north, "east_mps": east}


def _constant_force(rng: Rng, v: Vehicle) -> dict[str, float]:
    north, east = _level(rng, 0.03, 0.12)
    return {"north_n": north * v.weight_n, "east_n": east * v.weight_n}


def _flapping(rng: Rng, v: Vehicle) -> dict[str, float]:
    turn = rng.uniform(0.3, 1.5)  # rad/s^2 for each m/s of airspeed
    return {"k_flap_nms2_per_rad_m": turn * float(v.inertia_kgm2[1]) / _hover_speed(v)}


def _bias(rng: Rng, names: tuple[str, str, str], low: float, high: float) -> dict[str, float]:
    values = rng.standard_normal(3)
    values *= rng.uniform(low, high) / float(np.linalg.norm(values))
    return dict(zip(names, values.tolist(), strict=True))


EFFECTS: dict[str, Callable[[Rng, Vehicle], dict[str, float]]] = {
    "payload": _payload,
    "thrust_scale": lambda rng, v: {"scale": 1.0 + _signed(rng, 0.05, 0.18)},
    "thrust_curve": _thrust_curve,
    "rotor_fault": _rotor_fault,
    "com_offset": _com_offset,
    "inertia": _inertia,
    "motor_lag": lambda rng, v: {"time_constant_s": v.rotors.time_constant_s * rng.uniform(1.6, 3.0)},
    "transport_delay": lambda rng, v: {"delay_s": rng.uniform(0.008, 0.035)},
    "battery_sag": lambda rng, v: {
        "thrust_loss_per_v": rng.uniform(0.25, 0.9) / (v.battery.full_v if v.battery else 16.0)
    },
    "linear_drag": _linear_drag,
    "angular_damping": _angular_damping,
    "rotor_drag": lambda rng, v: {"k_d_kg_per_rad": v.mass_kg * rng.uniform(0.12, 0.6) / _hover_speed(v)},
    "induced_inflow": lambda rng, v: {"k_z_kg_per_rad": v.mass_kg * rng.uniform(0.12, 0.6) / _hover_speed(v)},
    "parasitic_drag": _parasitic_drag,
    "translational_lift": lambda rng, v: {"k_h_kg_per_m": v.weight_n / 4.0 * rng.uniform(0.04, 0.2) / 25.0},
    "blade_flapping": _flapping,
    "rotor_gyroscopic": _rotor_inertia,
    "ground_effect": lambda rng, v: {"strength": rng.uniform(0.7, 3.0)},
    "vortex_ring": lambda rng, v: {"strength": rng.uniform(0.15, 0.5)},
    "steady_wind": _wind,
    "constant_force": _constant_force,
    "turbulence": lambda rng, v: {"sigma_mps": rng.uniform(0.8, 2.5), "length_m": rng.uniform(5.0, 50.0)},
    "slung_load": lambda rng, v: {"mass_kg": v.mass_kg * rng.uniform(0.08, 0.25), "length_m": rng.uniform(0.4, 1.5)},
    "accelerometer_bias": lambda rng, v: _bias(rng, ("x_mps2", "y_mps2", "z_mps2"), 0.15, 0.6),
    "gyro_bias": lambda rng, v: _bias(rng, ("x_radps", "y_radps", "z_radps"), 0.01, 0.06),
    "attitude_misalignment": lambda rng, v: _bias(rng, ("roll_rad", "pitch_rad", "yaw_rad"), 0.02, 0.08),
}
"""Every effect of the table: how its parameters are drawn for a vehicle."""

NEEDS_DRAG = frozenset({"steady_wind", "turbulence"})
NEEDS_BATTERY = frozenset({"battery_sag"})


# --- outside the table


def _draw_tether(rng: Rng, v: Vehicle, x: F64) -> tuple[str, ...]:
    x[X_TETHER : X_TETHER + 3] = (*_level(rng, 0.0, 2.0), 0.0)
    x[X_TETHER + 3], x[X_TETHER + 4] = rng.uniform(1.0, 3.0), v.weight_n * rng.uniform(0.02, 0.08)
    return ("position", "height")


def _draw_jet(rng: Rng, v: Vehicle, x: F64) -> tuple[str, ...]:
    x[X_JET : X_JET + 2] = _level(rng, 0.0, 4.0)
    x[X_JET + 2] = rng.uniform(1.0, 2.5)
    x[X_JET + 3 : X_JET + 5] = _level(rng, 0.1 * v.weight_n, 0.3 * v.weight_n)
    return ("position",)


def _draw_magnet(rng: Rng, v: Vehicle, x: F64) -> tuple[str, ...]:
    x[X_MAGNET] = float(v.inertia_kgm2[2]) * rng.uniform(1.5, 5.0)
    x[X_MAGNET + 1] = rng.uniform(-math.pi, math.pi)
    return ("heading", "attitude")


def _draw_slosh(rng: Rng, v: Vehicle, x: F64) -> tuple[str, ...]:
    x[X_SLOSH], x[X_SLOSH + 1] = v.total_mass_kg * rng.uniform(0.15, 0.35), rng.uniform(4.0, 12.0)
    x[X_SLOSH + 2] = rng.uniform(0.03, 0.15)
    return ("acceleration", "attitude", "rate", "time")


def _draw_spring(rng: Rng, v: Vehicle, x: F64) -> tuple[str, ...]:
    """A rubber band to a point: a tether without slack."""
    x[X_TETHER : X_TETHER + 3] = (*_level(rng, 0.0, 2.0), -rng.uniform(0.5, 2.0))
    x[X_TETHER + 4] = v.weight_n * rng.uniform(0.02, 0.06)
    return ("position", "height")


def _draw_periodic(rng: Rng, v: Vehicle, x: F64) -> tuple[str, ...]:
    x[X_PERIODIC : X_PERIODIC + 2] = _level(rng, 0.05 * v.weight_n, 0.15 * v.weight_n)
    x[X_PERIODIC + 2] = v.weight_n * rng.uniform(-0.1, 0.1)
    x[X_PERIODIC + 3] = 2.0 * math.pi * rng.uniform(0.1, 1.0)
    return ("time",)


def _draw_wake(rng: Rng, v: Vehicle, x: F64) -> tuple[str, ...]:
    x[X_WAKE : X_WAKE + 2] = _level(rng, 0.0, 3.0)
    x[X_WAKE + 2] = rng.uniform(0.7, 2.0)
    x[X_WAKE + 3] = v.weight_n * rng.uniform(0.1, 0.3)
    x[X_WAKE + 4] = float(v.inertia_kgm2[2]) * rng.uniform(-4.0, 4.0)
    return ("position",)


def _draw_fade(rng: Rng, v: Vehicle, x: F64) -> tuple[str, ...]:
    x[X_FADE] = rng.uniform(0.08, 0.2) / 60.0
    return ("time", "battery")


OUTSIDE: dict[str, Callable[[Rng, Vehicle, F64], tuple[str, ...]]] = {
    "tether": _draw_tether,
    "jet": _draw_jet,
    "magnet": _draw_magnet,
    "slosh": _draw_slosh,
    "fading_thrust": _draw_fade,
    "spring": _draw_spring,
    "periodic_force": _draw_periodic,
    "wake": _draw_wake,
}
"""What no effect of the table explains: fills the flight's row and says on what it truly depends."""


def outside(rng: Rng, v: Vehicle, name: str) -> tuple[F64, tuple[str, ...]]:
    """(X_SIZE,) of one of OUTSIDE, or of none (empty name), and what it depends on."""
    row = np.zeros(X_SIZE)
    return row, (OUTSIDE[name](rng, v, row) if name else ())


# --- flight plans


def _yaw_at_speed(plan: Plan, rng: Rng, v: Vehicle) -> None:
    """To and fro over a straight line, with the heading turned by half a turn between, and half of it once more."""
    speed, course = rng.uniform(3.5, 7.0), rng.uniform(-math.pi, math.pi)
    along = np.array([math.cos(course), math.sin(course), 0.0]) * speed * 1.5
    start = plan.here.copy()
    plan.go(start + along, speed, yaw=plan.yaw + rng.uniform(0.0, 1.0))
    plan.go(start, speed)
    plan.go(start + 0.6 * along, 0.7 * speed, yaw=plan.yaw + rng.uniform(1.6, 3.1))
    plan.go(start, 0.7 * speed)


def _doublets(plan: Plan, rng: Rng, v: Vehicle) -> None:
    """Body-rate doublets on each axis."""
    for axis in rng.permutation(3):
        n = steps(rng.uniform(0.12, 0.22))
        rate = np.zeros((2 * n + steps(1.0), 3))
        size = rng.uniform(0.6, 1.0) if axis == 2 else rng.uniform(1.2, 2.2)
        rate[:n, axis], rate[n : 2 * n, axis] = size, -size
        plan.add(np.tile(plan.here, (len(rate), 1)), rate=rate)


def _chirp(plan: Plan, rng: Rng, v: Vehicle) -> None:
    """Thrust up and down, 0.5 to 6 Hz."""
    t = np.arange(steps(5.0)) * 0.004
    phase = 2.0 * math.pi * (0.5 * t + 0.5 * (6.0 - 0.5) / t[-1] * t * t)
    plan.add(np.tile(plan.here, (len(t), 1)), thrust=rng.uniform(2.0, 4.0) * np.sin(phase))


def _low_pass(plan: Plan, rng: Rng, v: Vehicle) -> None:
    """Down to a rotor's radius or two, along a line, and up again."""
    reach = float(np.linalg.norm(v.rotors.position_m[0, :2]))
    low = -max(v.rotors.radius_m * rng.uniform(1.0, 2.0), 0.35 * reach + 0.1)  # tilted, it must not touch
    back, course = plan.here.copy(), rng.uniform(-math.pi, math.pi)
    along = np.array([math.cos(course), math.sin(course), 0.0]) * rng.uniform(2.0, 4.0)
    down = plan.here + along / 2.0
    down[2] = low
    plan.go(down, 2.5)
    plan.hold(0.6)
    plan.go(down + along / 2.0, 1.5)
    plan.go(back, 3.0)


def _circle(plan: Plan, rng: Rng, v: Vehicle) -> None:
    """A lap, nose along the path or fixed."""
    speed, seconds = rng.uniform(1.2, 2.5), 8.0
    radius = speed * seconds / (2.0 * math.pi)
    t = np.arange(steps(seconds)) * 0.004
    s = t / t[-1]
    angle = 2.0 * math.pi * s * s * s * (10.0 - 15.0 * s + 6.0 * s * s)
    pos = plan.here + radius * np.stack([np.cos(angle) - 1.0, np.sin(angle), 0.0 * t], axis=1)
    plan.add(pos, plan.yaw + (angle if rng.random() < 0.5 else 0.0 * t))


def _climb_and_sink(plan: Plan, rng: Rng, v: Vehicle) -> None:
    """Straight up and down, down about as fast as the rotors' own wake."""
    induced = math.sqrt(v.weight_n / 4.0 / (2.0 * _RHO * math.pi * v.rotors.radius_m**2))
    here = plan.here.copy()
    plan.go(here - np.array([0.0, 0.0, rng.uniform(5.0, 8.0)]), 4.5)
    plan.go(here, min(max(rng.uniform(0.6, 1.0) * induced, 2.0), 4.5))


def _weave(plan: Plan, rng: Rng, v: Vehicle) -> None:
    """Sines of incommensurate rates on all axes."""
    t = np.arange(steps(rng.uniform(6.0, 9.0))) * 0.004
    fade = np.minimum(1.0, np.minimum(t, t[-1] - t) / 1.0)
    pos = np.tile(plan.here, (len(t), 1))
    for axis, size in enumerate((2.0, 2.0, 0.6)):
        for _ in range(2):
            angle = rng.uniform(0.8, 2.2) * t + rng.uniform(0.0, 6.0)
            pos[:, axis] += fade * size * rng.uniform(0.3, 0.6) * np.sin(angle)
    plan.add(pos, plan.yaw + fade * rng.uniform(0.0, 1.2) * np.sin(rng.uniform(0.3, 1.0) * t))


def _stand(plan: Plan, rng: Rng, v: Vehicle) -> None:
    """Hover."""
    plan.hold(rng.uniform(3.0, 8.0))


_RICH = (_yaw_at_speed, _doublets, _chirp, _low_pass, _circle, _climb_and_sink, _weave)
_POOR = (_stand, _circle, _weave, _low_pass)


def plan(rng: Rng, v: Vehicle, *, rich: bool) -> F64:
    """A reference: on the ground, up, manoeuvres in random order (all kinds where `rich`), half the time down again."""
    made = Plan()
    made.hold(rng.uniform(0.5, 1.5), idle=True)
    height = rng.uniform(2.0, 4.0)
    made.go(np.array([0.0, 0.0, -height]), 2.0)
    made.hold(1.0)
    if rich:
        kinds = [_RICH[i] for i in rng.permutation(len(_RICH))]
    else:
        kinds = [_POOR[i] for i in rng.choice(len(_POOR), 5)]
    for kind in kinds:
        kind(made, rng, v)
        made.hold(0.3)
    if rng.random() < 0.5:
        made.go(np.array([made.here[0], made.here[1], -0.03]), 1.0)
        made.hold(1.0, idle=True)
    return made.reference()
