"""What an error of the velocity does to a drag: where nothing moves along an axis, it is all that is measured there.

Least squares on a velocity that errs find a drag too small by the error's share of the power (errors in variables), and
a drag of the file then "is not there".  The expectation of a velocity given its measurement is that less this share; a
regression on expectations is not biased (Berkson, J. Am. Stat. Assoc. 1950).  How much of it is taken away is fitted
beside the effects, for each level axis of the body.  Simulated freely, velocity errs by more: what sampled commands
don't say tips the vehicle.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from flightstack.gap.compare import rollout_starts
from flightstack.gap.decisions import MOVED, SLOW_ERROR_S
from flightstack.gap.records import Samples
from flightstack.gap.rollouts import WINDOW_S, rollout
from flightstack.gap.run import ModelEvaluation, params_row
from flightstack.gap.simulate import predict
from flightstack.gap.track import COLUMNS, track
from flightstack.types import F64
from flightstack.vehicle import Vehicle
from flightstack_logs.turn import rotate, rotate_inverse

DRAGS = frozenset({"linear_drag", "rotor_drag", "parasitic_drag"})
_BY_AIR = DRAGS | {"induced_inflow"}
_STILL_MPS = 0.01
"""A mean error that intervals need not hold."""
_NONE = 0.01
"""Share of a velocity's power that passes for none."""
_MOST_STARTS = 60


def moves(samples: Samples) -> bool:
    """Whether the level velocity is motion rather than error: in a hover it may be an estimator's alone."""
    flight = track(samples)
    varies = np.nanvar(flight.vel_ned_mps[samples.valid, :2], axis=0)
    return not float(varies.sum()) < MOVED**2 * float(np.sum(flight.vel_std_mps[:2] ** 2))


def doubt(vehicle: Vehicle, samples: Samples) -> F64:
    """(N, 12, 2) how the prediction changes if of the forward, the sideward velocity only its expectation is true."""
    flight = track(samples)
    out = np.zeros((len(samples.t_s), COLUMNS, 2))
    body = rotate_inverse(flight.q_ned_frd, flight.vel_ned_mps)
    power = np.mean(body[samples.valid, :2] ** 2, axis=0)
    error = float(np.mean(flight.vel_std_mps[:2] ** 2))
    if not error > 0.0:
        return out
    p = params_row(vehicle, flight.step_s)
    base = predict(vehicle, samples)
    for axis, of in enumerate(power.tolist()):
        share = min(error / max(of, 1e-12), 1.0)
        if share < _NONE:
            continue
        less = np.zeros_like(body)
        less[:, axis] = share * body[:, axis]
        expected = replace(flight, vel_ned_mps=flight.vel_ned_mps - rotate(flight.q_ned_frd, less))
        out[:, :, axis] = flight.lowpass(ModelEvaluation(p, expected).shown(p) - base)
    return out


def offset(samples: Samples, mask: NDArray[np.bool_]) -> F64:
    """(3,) NED standard deviation of the velocity's mean error over these samples; 0 where nothing says."""
    length_s = max(float(mask.sum()) * samples.dt_s, 1e-9)
    return np.asarray(track(samples).vel_std_mps * min(1.0, (SLOW_ERROR_S / length_s) ** 0.5))


def share_of_motion(samples: Samples, mask: NDArray[np.bool_]) -> F64:
    """(3,) FRD, the velocity's error over how much it varies in these samples, squared; 0 where nothing says."""
    flight = track(samples)
    if not mask.any() or {"vel_ned_mps", "q_ned_frd"} & flight.missing:
        return np.zeros(3)
    north, east, down = flight.vel_std_mps**2
    body = rotate_inverse(flight.q_ned_frd[mask], flight.vel_ned_mps[mask])
    level = 0.5 * (north + east)
    return np.asarray(np.array([level, level, down]) / np.maximum(np.var(body, axis=0), 1e-12))


def offset_columns(vehicle: Vehicle, samples: Samples) -> F64:
    """(N, 12, 3) how the prediction changes for each m/s by which the velocity over ground is off."""
    flight = track(samples)
    out = np.zeros((len(samples.t_s), COLUMNS, 3))
    if not vehicle.effects.keys() & _BY_AIR or np.max(offset(samples, samples.valid)) < _STILL_MPS:
        return out
    p = params_row(vehicle, flight.step_s)
    base = predict(vehicle, samples)
    for axis in range(3):
        moved = replace(flight, vel_ned_mps=flight.vel_ned_mps + np.eye(3)[axis])
        out[:, :, axis] = flight.lowpass(ModelEvaluation(p, moved).shown(p) - base)
    return out


def lost(
    vehicle: Vehicle, flights: Sequence[Samples], masks: Sequence[NDArray[np.bool_]], effects: Collection[str]
) -> set[tuple[str, str]]:
    """Drags' parameters that free simulations of these flights would find too small: velocity errs too much in them."""
    if not DRAGS & set(effects):
        return set()
    error, power = np.zeros(2), np.zeros(2)
    for samples, mask in zip(flights, masks, strict=True):
        flight = track(samples)
        starts = rollout_starts(samples, mask, WINDOW_S)
        if not len(starts) or {"vel_ned_mps", "q_ned_frd"} & flight.missing:
            continue
        starts = starts[:: max(1, len(starts) // _MOST_STARTS)]
        run = rollout(vehicle, samples, starts, WINDOW_S)
        at = (starts[:, None] + np.arange(run.vel_ned_mps.shape[1])).ravel()
        turned = flight.q_ned_frd[at]
        off = rotate_inverse(turned, run.vel_ned_mps.reshape(-1, 3) - flight.vel_ned_mps[at])[:, :2]
        body = rotate_inverse(turned, flight.vel_ned_mps[at])[:, :2]
        error += np.mean(off**2, axis=0) + float(np.mean(flight.vel_std_mps[:2] ** 2))
        power += np.mean(body**2, axis=0)
    gone = [axis for axis, err, of in zip("xy", error, power, strict=True) if of < MOVED**2 * err]
    whole = error.sum() * MOVED**2 > power.sum()
    slots = {(effect, f"{name}_{axis}_{unit}") for axis in gone for effect, name, unit in _SIDES if effect in effects}
    return slots | ({("rotor_drag", "k_d_kg_per_rad")} if whole and "rotor_drag" in effects else set())


_SIDES = (("linear_drag", "d", "kgps"), ("parasitic_drag", "c", "kg_per_m"))
