"""Two more questions to a corrected model: is what it leaves noise, and does the logged flight come out of it again?

Whiteness: Bartlett's cumulative periodogram of the residual, in the band that is looked at (Durbin, Biometrika 1969,
gives its limit); for angular accelerations that of the rates' residual, whose white noise they are the derivative of.

Re-flight: the logged path is flown once more by the simulated autopilot, closed loop.  How it leans and how much
thrust it takes to follow a path is the physics' doing and not the controller's: both must come out as logged.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flightstack.gap.records import SIGNALS, Samples
from flightstack.gap.simulate import predict
from flightstack.gap.track import ProcessedFlight, derivative, lowpass, track
from flightstack.types import F64
from flightstack.vehicle import Vehicle
from flightstack_logs.turn import headings, rotate
from flightstack_sim.autopilot.flight_control import FlightControl, airframe_params
from flightstack_sim.autopilot.setpoint import ControlKind, ControlSetpoint
from flightstack_sim.grade import load_grade
from flightstack_sim.plant import NativePlant
from flightstack_sim.sensors import Sensors
from flightstack_sim.simulated_vehicle import SimulatedVehicle

SETTLE_S = 3.0
"""Of a re-flight: the autopilot finds its integrators' values."""
LONGEST_S = 12.0
_PATTERN_HZ = 2.0
_SETPOINT_MS = 20
_LIFT_MS = 600
_HOVER_MS = 4000
_LEAST_RUN_S = 5.0
_BARTLETT_95 = 1.358
_LOOSE = {"MPC_Z_VEL_MAX_UP": 8.0, "MPC_Z_VEL_MAX_DN": 4.0, "MPC_XY_VEL_MAX": 20.0, "MPC_TILTMAX_AIR": 80.0}


@dataclass(frozen=True, slots=True)
class Whiteness:
    """One channel's largest distance of the cumulative periodogram from a straight line, and the 95 % limit."""

    signal: str
    distance: float
    limit: float

    @property
    def white(self) -> bool:
        """Whether nothing but noise is left, as far as this test sees."""
        return self.distance <= self.limit


def whiteness(vehicle: Vehicle, samples: Samples, mask: NDArray[np.bool_]) -> tuple[Whiteness, ...]:
    """Of each physical channel's residual over the longest masked stretch; none for channels not measured."""
    flight = track(samples)
    first, last = _longest(mask & flight.usable)
    if (last - first) * samples.dt_s < _LEAST_RUN_S:
        return ()
    y = (flight.measured - predict(vehicle, samples))[first:last, : len(SIGNALS)]
    y[:, 3:] = np.cumsum(y[:, 3:], axis=0) * samples.dt_s
    out = []
    for k, signal in enumerate(SIGNALS):
        if np.isfinite(y[:, k]).all():
            out.append(Whiteness(signal, *_bartlett(y[:, k], samples.dt_s, flight.cutoff_hz)))
    return tuple(out)


def _bartlett(y: F64, dt_s: float, cutoff_hz: float) -> tuple[float, float]:
    at = np.linspace(-1.0, 1.0, len(y))
    y = y - np.polyval(np.polyfit(at, y, 1), at)
    power = np.abs(np.fft.rfft(y))[1:] ** 2
    band = power[: max(4, int(cutoff_hz * len(y) * dt_s))]
    share = np.cumsum(band) / max(float(np.sum(band)), 1e-300)
    straight = np.arange(1, len(band) + 1) / len(band)
    return float(np.max(np.abs(share - straight))), _BARTLETT_95 / math.sqrt(len(band))


def _longest(mask: NDArray[np.bool_]) -> tuple[int, int]:
    """First row and the row after the last of the longest stretch."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    if len(edges) == 0:
        return 0, 0
    k = 2 * int(np.argmax(edges[1::2] - edges[0::2]))
    return int(edges[k]), int(edges[k + 1])


@dataclass(frozen=True, slots=True)
class Reflight:
    """How far a closed-loop re-flight is from the logged one; rms over its length after settling."""

    seconds: float
    path_m: float
    """Distance from the logged path: how well the autopilot follows."""
    lean_rad: float
    """Angle between the two thrust axes, up to 2 Hz."""
    collective: float
    """Difference of the motors' mean command, 0..1, up to 2 Hz."""


def reflight(believed: Vehicle, truths: Sequence[Vehicle], samples: Samples, mask: NDArray[np.bool_]) -> list[Reflight]:
    """Fly the longest masked stretch of the logged path once with each of these vehicles as what really flies.

    `believed`: the vehicle that the autopilot is set up for.  Empty where the log can't give a path of 5 s.
    """
    flight = track(samples)
    first, last = _longest(mask & flight.usable)
    last = min(last, first + round((LONGEST_S + SETTLE_S) / samples.dt_s))
    needed = {"pos_ned_m", "vel_ned_mps", "q_ned_frd", "motor"}
    if needed & flight.missing or (last - first) * samples.dt_s < _LEAST_RUN_S + SETTLE_S:
        return []
    return [_flown(believed, truth, flight, first, last) for truth in truths]


def _flown(believed: Vehicle, truth: Vehicle, flight: ProcessedFlight, first: int, last: int) -> Reflight:
    dt = flight.samples.dt_s
    t_s: F64 = dt * np.arange(last - first, dtype=np.float64)
    path = flight.path_ned_m[first:last].copy()
    if "height_m" not in flight.missing:
        path[:, 2] = flight.pos_ned_m[first:last, 2]
    axis = flight.q_ned_frd[first:last]
    yaw = np.unwrap(headings(axis))
    wanted = np.hstack([path, flight.vel_ned_mps[first:last], flight.acc_ned_mps2[first:last]])
    wanted[:, 6:] = lowpass(wanted[:, 6:], _PATTERN_HZ, dt)
    wanted = np.hstack([wanted, yaw[:, None], lowpass(derivative(yaw[:, None], dt), _PATTERN_HZ, dt)])
    vehicle = _in_the_air(believed, truth, flight, first, path[0])
    rows = []
    ticks = int(t_s[-1] / (0.001 * _SETPOINT_MS))
    begin: F64 = 0.001 * _SETPOINT_MS * np.arange(ticks, dtype=np.float64)
    for now in np.stack([np.interp(begin, t_s, column) for column in wanted.T], axis=1).tolist():
        vehicle.advance(_setpoint(now), _SETPOINT_MS)
        plant = vehicle.plant
        rows.append(np.concatenate([plant.pos_ned_m, plant.q_ned_frd, [vehicle.motor_command.mean()]]))
    table = np.array(rows)
    return _compared(
        table, begin + 0.001 * _SETPOINT_MS, t_s, path, axis, flight.samples.motor[first:last].mean(axis=1)
    )


def _compared(table: F64, at: F64, t_s: F64, path: F64, axis: F64, collective: F64) -> Reflight:
    step = float(at[1] - at[0])
    settled = at > SETTLE_S

    def smooth(x: F64) -> F64:
        return lowpass(x, _PATTERN_HZ, step)[settled]

    def logged(x: F64) -> F64:
        return np.stack([np.interp(at, t_s, column) for column in x.T], axis=1)

    up = np.array([[0.0, 0.0, -1.0]])
    flown = smooth(rotate(table[:, 3:7], np.tile(up, (len(table), 1))))
    was = smooth(logged(rotate(axis, np.tile(up, (len(axis), 1)))))
    cosine = np.sum(flown * was, axis=1) / (np.linalg.norm(flown, axis=1) * np.linalg.norm(was, axis=1))
    lean = np.arccos(np.clip(cosine, -1.0, 1.0))
    thrust = smooth(table[:, 7:8]) - smooth(logged(collective[:, None]))
    away = (table[:, 0:3] - logged(path))[settled]
    return Reflight(
        float(settled.sum() * step),
        float(np.sqrt(np.mean(np.sum(away**2, axis=1)))),
        float(np.sqrt(np.mean(lean**2))),
        float(np.sqrt(np.mean(thrust**2))),
    )


def _in_the_air(believed: Vehicle, truth: Vehicle, flight: ProcessedFlight, first: int, start: F64) -> SimulatedVehicle:
    """A simulated vehicle with the state that the log has at this sample, after a hover that let its loops settle."""
    plant = NativePlant(truth, seed=0, ground=False)
    params = airframe_params(believed)
    for name, value in _LOOSE.items():
        params.set(name, value)
    vehicle = SimulatedVehicle(plant, Sensors(load_grade("mocap"), seed=0), FlightControl(believed, params))
    plant.pos_ned_m[:] = start
    vehicle.advance(ControlSetpoint(ControlKind.RATE, thrust_norm=1.0), _LIFT_MS)  # it must notice that it flies
    plant.vel_ned_mps[:] = 0.0
    yaw = float(headings(flight.q_ned_frd[first : first + 1])[0])
    hold = ControlSetpoint(ControlKind.POSITION, pos_ned_m=(start[0], start[1], start[2]), yaw_rad=yaw)
    vehicle.advance(hold, _HOVER_MS)
    plant.pos_ned_m[:] = start
    plant.vel_ned_mps[:] = flight.vel_ned_mps[first]
    plant.q_ned_frd[:] = flight.q_ned_frd[first]
    plant.rate_frd_radps[:] = flight.rate_frd_radps[first]
    return vehicle


def _setpoint(now: Sequence[float]) -> ControlSetpoint:
    n, e, d, vn, ve, vd, an, ae, ad, yaw_rad, yaw_rate_radps = now
    return ControlSetpoint(
        ControlKind.POSITION,
        pos_ned_m=(n, e, d),
        vel_ned_mps=(vn, ve, vd),
        acc_ned_mps2=(an, ae, ad),
        yaw_rad=math.remainder(yaw_rad, 2.0 * math.pi),
        yaw_rate_radps=yaw_rate_radps,
    )
