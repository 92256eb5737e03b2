"""Whether the vehicle file is that of the log: the order of its rotors, and thrust against weight.

Turning tells the order: differences of the motors' thrusts, weighed by the file's lever arms, must move with the
angular acceleration.  All 24 orders are tried at the lag that suits each best.  Where gusts turn the vehicle more than
its motors do, the motors move against the turning; so only what is beyond doubt is refused.
"""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from flightstack.gap.checks.flying import rotor_thrust
from flightstack.gap.checks.motion import band
from flightstack.gap.decisions import CLEAR_SHARE, HALF, ORDER_MARGIN, STOPPED, THRUST_OFF
from flightstack.gap.records import Finding, Samples, ok, refused, warning
from flightstack.types import F64, STANDARD_GRAVITY_MPS2
from flightstack.vehicle import Vehicle

_LONGEST_LAG_S = 0.16
_LOW_HZ, _HIGH_HZ = 0.5, 10.0
_LONGEST = 60_000
_RINGS_S = 0.5


def judge_vehicle(samples: Samples, vehicle: Vehicle) -> list[Finding]:
    """Refusals where the file's rotors are in another order or its thrust is far from the log's; else nothing or ok."""
    return _stopped(samples) or [*_thrust(samples, vehicle), *_order(samples, vehicle)]


def _stopped(samples: Samples) -> list[Finding]:
    """A rotor that never turns carries nothing: taken for one that does, a load on the other side is named."""
    share = np.mean(samples.motor[samples.valid] < STOPPED, axis=0)
    still = [str(place + 1) for place in np.flatnonzero(share > CLEAR_SHARE)]
    if not still:
        return []
    text = f"motor {' and '.join(still)} stands still while the vehicle flies: its command was not logged; log all four"
    return [refused("motors", text)]


def _thrust(samples: Samples, vehicle: Vehicle) -> list[Finding]:
    force = samples.accel_frd_mps2[:, 2]
    rows = samples.valid & np.isfinite(force)
    if not rows.any():
        return []
    felt = -float(np.mean(force[rows])) * vehicle.total_mass_kg
    expected = float(np.mean(rotor_thrust(vehicle, samples.motor[rows]).sum(axis=1)))
    ratio = expected / felt if felt > 0.1 * vehicle.weight_n else np.inf
    if 1.0 / THRUST_OFF < ratio < THRUST_OFF:
        return []
    return [refused("vehicle", f"the vehicle file expects {expected:.3g} N of this log's commands, its accelerometer "
                    f"felt {felt:.3g} N at the file's mass: name the file of this vehicle")]  # fmt: skip


def _order(samples: Samples, vehicle: Vehicle) -> list[Finding]:
    dt_s = samples.dt_s
    rate = np.nan_to_num(samples.rate_frd_radps[:_LONGEST])
    valid = samples.valid[:_LONGEST]
    if (
        "motor" in samples.derived
        or valid.sum() * dt_s < 3.0
        or not np.isfinite(samples.rate_frd_radps[:_LONGEST][valid]).all()
    ):
        return []
    high_hz = min(_HIGH_HZ, 0.25 / dt_s)
    inner = _inner(valid, round(_RINGS_S / dt_s))
    if not inner.any():
        return []
    turning = band(np.gradient(rate, dt_s, axis=0), dt_s, _LOW_HZ, high_hz) * inner[:, None]
    thrust = (
        band(rotor_thrust(vehicle, np.nan_to_num(samples.motor[:_LONGEST])), dt_s, _LOW_HZ, high_hz) * inner[:, None]
    )
    if not (np.ptp(thrust) > 0.0 and np.all(turning.std(axis=0) > 0.0)):
        return []
    shares = _correlations(turning, thrust, vehicle, round(_LONGEST_LAG_S / dt_s))
    kept = shares[(0, 1, 2, 3)]
    best = max(shares, key=lambda order: shares[order].mean())
    other = float(shares[best].mean())
    if min(shares[best]) > CLEAR_SHARE and other > kept.mean() + ORDER_MARGIN:
        said = ", ".join(str(place + 1) for place in best)
        text = (
            "the log's motors are in another order than the vehicle file's rotors: by how the vehicle turns, its "
            f"rotors 1, 2, 3, 4 are the log's motors {said} (correlation {other:.2f}, else {kept.mean():.2f}); "
            "put either into PX4's order"
        )
        return [refused("rotors", text)]
    text = f"(correlation of roll {kept[0]:.2f}, of pitch {kept[1]:.2f})"
    if kept.min() > HALF:
        return [ok("rotors", f"motors turn the vehicle as the file's rotors should {text}")]
    return [warning("rotors", f"the order of the rotors does not show {text}")]


def _inner(valid: NDArray[np.bool_], reach: int) -> NDArray[np.bool_]:
    """Rows that far from any that don't count: the band-pass rings after a touchdown."""
    bad = np.convolve(np.concatenate([np.ones(reach), ~valid, np.ones(reach)]), np.ones(2 * reach + 1), mode="valid")
    return np.asarray(bad < 0.5)


def _correlations(turning: F64, thrust: F64, vehicle: Vehicle, most: int) -> dict[tuple[int, ...], F64]:
    """Order (which motor is the file's rotor 1, 2, ...) -> (2,) correlation of roll and pitch torque with the turning.

    Yaw torque is left out: it is weak, and a wrong sense of rotation is no wrong order.
    """
    arms = np.stack([-vehicle.rotors.position_m[:, 1], vehicle.rotors.position_m[:, 0]])
    together = thrust.T @ thrust
    lags = [turning[lag:, :2].T @ thrust[: len(thrust) - lag] for lag in range(0, most + 1, max(1, most // 20))]
    sizes = np.sqrt(np.sum(turning[:, :2] ** 2, axis=0))
    out = {}
    for order in itertools.permutations(range(4)):
        weights = np.zeros((2, 4))
        weights[:, order] = arms
        spread = np.sqrt(np.maximum(np.einsum("ai,ij,aj->a", weights, together, weights), 1e-30))
        each = [np.einsum("ai,ai->a", weights, lag) / (spread * sizes) for lag in lags]
        out[order] = max(each, key=lambda pair: float(pair.sum()))
    return out


def moves(samples: Samples) -> bool:
    """Whether the motors answer to anything: a vehicle that is kept up by a control loop never holds them still."""
    return bool(np.any(np.std(samples.motor[samples.valid], axis=0) > 1e-4))


def felt_gravity(samples: Samples) -> float:
    """Mean specific force along body -z over g: about one in any flight that stays in the air."""
    rows = samples.valid & np.isfinite(samples.accel_frd_mps2).all(axis=1)
    if not rows.any():
        return float("nan")
    return float(np.mean(np.linalg.norm(samples.accel_frd_mps2[rows], axis=1))) / STANDARD_GRAVITY_MPS2
