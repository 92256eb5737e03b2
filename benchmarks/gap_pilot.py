"""The pilot of the blind flights: a cascaded PID position, attitude and rate controller, compiled, and its references.

It is not the flight stack's controller: it believes in the vehicle's file, flies on noisy measurements and takes what
the file lacks out by integration, as a plain autopilot does.  References are sampled every `OUTER_US`.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.ndimage import gaussian_filter1d

from flightstack.jit import njit
from flightstack.types import F64, STANDARD_GRAVITY_MPS2
from flightstack.vehicle import Vehicle

OUTER_US = 4000
_G = STANDARD_GRAVITY_MPS2

# --- what the pilot believes and how stiff it is: one row
B_MASS, B_INERTIA, B_UNMIX, B_MAX, B_FACTOR = 0, 1, 4, 20, 21
B_POSITION, B_VELOCITY, B_INTEGRAL, B_ATTITUDE, B_RATE, B_RATE_INTEGRAL, B_TILT = 22, 23, 24, 25, 26, 27, 28
B_SIZE = 29

# --- reference row
R_POS, R_VEL, R_ACC, R_YAW, R_YAW_RATE, R_RATE, R_THRUST, R_IDLE = 0, 3, 6, 9, 10, 11, 14, 15
R_SIZE = 16
"""Position, velocity, acceleration (NED), yaw and its rate, body rates added to the demand, specific thrust added
(m/s^2, upwards in the body), and 1 while the motors idle on the ground."""

# --- the pilot's memory
M_ACC_INTEGRAL, M_RATE_INTEGRAL, M_RATE_DEMAND, M_THRUST, M_RATE = 0, 3, 6, 9, 10
M_SIZE = 13
_GYRO_S = 1.0 / (2.0 * math.pi * 40.0)
"""The gyro's low-pass: 40 Hz."""


def believed_row(vehicle: Vehicle, latency_s: float) -> F64:
    """(B_SIZE,) of a vehicle without its effects; `latency_s`: motors' lag and delay that the gains were tuned for."""
    row = np.zeros(B_SIZE)
    arms, ratio = vehicle.rotors.position_m, vehicle.rotors.torque_ratio_m
    mix = np.stack([np.ones(4), -arms[:, 1], arms[:, 0], ratio])  # thrusts -> collective, torques
    row[B_MASS] = vehicle.total_mass_kg
    row[B_INERTIA : B_INERTIA + 3] = vehicle.inertia_kgm2
    row[B_UNMIX : B_UNMIX + 16] = np.linalg.inv(mix).ravel()
    row[B_MAX], row[B_FACTOR] = vehicle.rotors.max_thrust_n, vehicle.rotors.thrust_model_factor
    rate = min(22.0, 0.35 / (latency_s + 0.004))
    row[B_RATE], row[B_RATE_INTEGRAL], row[B_ATTITUDE] = rate, 0.15 * rate * rate, rate / 2.6
    row[B_VELOCITY], row[B_POSITION] = row[B_ATTITUDE] / 1.9, row[B_ATTITUDE] / 4.8
    row[B_INTEGRAL] = 0.25 * row[B_VELOCITY] * row[B_POSITION]
    row[B_TILT] = 0.8
    return row


@njit
def _desired_attitude(ax: float, ay: float, az: float, yaw: float) -> tuple[float, float, float, float]:
    """The attitude whose thrust axis points along (ax, ay, az) NED (upwards: az < 0) at this yaw."""
    norm = math.sqrt(ax * ax + ay * ay + az * az)
    zx, zy, zz = -ax / norm, -ay / norm, -az / norm
    cx, cy = math.cos(yaw), math.sin(yaw)
    yx, yy, yz = -zz * cy, zz * cx, zx * cy - zy * cx  # z x heading
    norm = math.sqrt(yx * yx + yy * yy + yz * yz)
    yx, yy, yz = yx / norm, yy / norm, yz / norm
    xx, xy, xz = yy * zz - yz * zy, yz * zx - yx * zz, yx * zy - yy * zx
    w = math.sqrt(max(0.0, 1.0 + xx + yy + zz)) / 2.0
    x = math.copysign(math.sqrt(max(0.0, 1.0 + xx - yy - zz)) / 2.0, yz - zy)
    y = math.copysign(math.sqrt(max(0.0, 1.0 - xx + yy - zz)) / 2.0, zx - xz)
    z = math.copysign(math.sqrt(max(0.0, 1.0 - xx - yy + zz)) / 2.0, xy - yx)
    return w, x, y, z


@njit
def outer(b: F64, m: F64, r: F64, pos: F64, vel: F64, q: F64) -> None:
    """Position and attitude loops, every OUTER_US: rate demand and thrust into the memory `m`."""
    dt = 1e-6 * OUTER_US
    m[M_THRUST] = 0.0
    if r[R_IDLE] > 0.0:
        for j in range(M_SIZE):
            m[j] = 0.0
        return
    ax = ay = az = 0.0
    for j in range(3):
        error = r[R_POS + j] - pos[j]
        error = min(max(error, -2.0), 2.0)
        demand = r[R_VEL + j] + b[B_POSITION] * error
        speed_error = demand - vel[j]
        limit = 0.6 * _G
        m[M_ACC_INTEGRAL + j] += b[B_INTEGRAL] * error * dt
        m[M_ACC_INTEGRAL + j] = min(max(m[M_ACC_INTEGRAL + j], -limit), limit)
        value = r[R_ACC + j] + b[B_VELOCITY] * speed_error + m[M_ACC_INTEGRAL + j]
        if j == 0:
            ax = value
        elif j == 1:
            ay = value
        else:
            az = value
    az = min(az, 0.7 * _G) - _G
    side = math.sqrt(ax * ax + ay * ay)
    most = -az * math.tan(b[B_TILT])
    if side > most:
        ax, ay = ax * most / side, ay * most / side
    dw, dx, dy, dz = _desired_attitude(ax, ay, az, r[R_YAW])
    w, x, y, z = q[0], q[1], q[2], q[3]
    ew = w * dw + x * dx + y * dy + z * dz
    ex = w * dx - x * dw - y * dz + z * dy
    ey = w * dy + x * dz - y * dw - z * dx
    ez = w * dz - x * dy + y * dx - z * dw
    gain = 2.0 * b[B_ATTITUDE] * (1.0 if ew >= 0.0 else -1.0)
    down_x, down_y, down_z = 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)
    m[M_RATE_DEMAND] = gain * ex + r[R_YAW_RATE] * down_x + r[R_RATE]
    m[M_RATE_DEMAND + 1] = gain * ey + r[R_YAW_RATE] * down_y + r[R_RATE + 1]
    m[M_RATE_DEMAND + 2] = 0.5 * gain * ez + r[R_YAW_RATE] * down_z + r[R_RATE + 2]
    # body z axis in the world
    bx, by, bz = 2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)
    m[M_THRUST] = b[B_MASS] * (max(-(ax * bx + ay * by + az * bz), 0.1 * _G) + r[R_THRUST])


@njit
def inner(b: F64, m: F64, rate: F64, dt: float, motor: F64) -> None:
    """Rate loop and mixer, every step: normalised motor commands (4,)."""
    if m[M_THRUST] == 0.0:
        for i in range(4):
            motor[i] = 0.05
        return
    torque = np.empty(3)
    keep = math.exp(-dt / _GYRO_S)
    for j in range(3):
        m[M_RATE + j] = keep * m[M_RATE + j] + (1.0 - keep) * rate[j]
        error = m[M_RATE_DEMAND + j] - m[M_RATE + j]
        share = 0.4 if j == 2 else 1.0
        m[M_RATE_INTEGRAL + j] += share * b[B_RATE_INTEGRAL] * error * dt
        m[M_RATE_INTEGRAL + j] = min(max(m[M_RATE_INTEGRAL + j], -40.0), 40.0)
        torque[j] = b[B_INERTIA + j] * (share * b[B_RATE] * error + m[M_RATE_INTEGRAL + j])
    for i in range(4):
        thrust = b[B_UNMIX + 4 * i] * m[M_THRUST]
        for j in range(3):
            thrust += b[B_UNMIX + 4 * i + 1 + j] * torque[j]
        share = min(max(thrust / b[B_MAX], 0.0), 1.0)
        f = b[B_FACTOR]
        u = share if f < 1e-9 else (f - 1.0 + math.sqrt((1.0 - f) * (1.0 - f) + 4.0 * f * share)) / (2.0 * f)
        motor[i] = min(max(u, 0.03), 1.0)


class Plan:
    """A reference in the making: manoeuvre after manoeuvre from where the last one ended, smoothed at the end."""

    def __init__(self, *, smooth_s: float = 0.12) -> None:
        self._pos: list[F64] = []
        self._yaw: list[F64] = []
        self._rate: list[F64] = []
        self._thrust: list[F64] = []
        self._idle: list[F64] = []
        self.here = np.zeros(3)
        self.yaw = 0.0
        self._smooth = smooth_s / (1e-6 * OUTER_US)

    def add(
        self,
        pos: F64,
        yaw: F64 | None = None,
        *,
        rate: F64 | None = None,
        thrust: F64 | None = None,
        idle: bool = False,
    ) -> None:
        """Positions (n, 3) every OUTER_US, with yaw (n,), added body rates (n, 3), added specific thrust (n,)."""
        n = len(pos)
        self._pos.append(pos)
        self._yaw.append(np.full(n, self.yaw) if yaw is None else yaw)
        self._rate.append(np.zeros((n, 3)) if rate is None else rate)
        self._thrust.append(np.zeros(n) if thrust is None else thrust)
        self._idle.append(np.full(n, float(idle)))
        self.here, self.yaw = pos[-1].copy(), float(self._yaw[-1][-1])

    def hold(self, seconds: float, *, idle: bool = False) -> None:
        """Stay."""
        self.add(np.tile(self.here, (steps(seconds), 1)), idle=idle)

    def go(self, to: F64, speed: float, *, yaw: float | None = None) -> None:
        """A smooth straight line at about this speed, turning on the way."""
        distance = float(np.linalg.norm(to - self.here))
        turn = 0.0 if yaw is None else abs(yaw - self.yaw)
        seconds = max(1.9 * distance / speed, 1.9 * turn / 1.5, 0.8)
        s = np.linspace(0.0, 1.0, steps(seconds))
        s = s**3 * (10.0 - 15.0 * s + 6.0 * s * s)
        turned = None if yaw is None else self.yaw + s * (yaw - self.yaw)
        self.add(self.here + s[:, None] * (to - self.here), turned)

    def reference(self) -> F64:
        """(n, R_SIZE)."""
        pos, yaw = np.concatenate(self._pos), np.concatenate(self._yaw)
        rows = np.zeros((len(pos), R_SIZE))
        dt = 1e-6 * OUTER_US
        pos = gaussian_filter1d(pos, self._smooth, axis=0, mode="nearest")
        yaw = gaussian_filter1d(yaw, self._smooth, mode="nearest")
        rows[:, R_POS : R_POS + 3] = pos
        rows[:, R_VEL : R_VEL + 3] = np.gradient(pos, dt, axis=0)
        rows[:, R_ACC : R_ACC + 3] = np.gradient(rows[:, R_VEL : R_VEL + 3], dt, axis=0)
        rows[:, R_YAW], rows[:, R_YAW_RATE] = yaw, np.gradient(yaw, dt)
        rows[:, R_RATE : R_RATE + 3] = np.concatenate(self._rate)
        rows[:, R_THRUST], rows[:, R_IDLE] = np.concatenate(self._thrust), np.concatenate(self._idle)
        return rows


def steps(seconds: float) -> int:
    """Rows of a reference that lasts so long."""
    return max(2, round(seconds * 1e6 / OUTER_US))
