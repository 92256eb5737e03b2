"""How gyro and accelerometer lie in the vehicle, told by how it turns and moves.

In: what attitude and velocity say of the turning and the specific force, and what was measured, both band-limited, in
body axes.  Out: a mounting, the turn that takes what was measured to forward, right, down.  A board may be built in
on its side and turned about z, its driver may have the axes of another frame, and some sensors tell gravity in place
of what holds against it.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np

from flightstack.gap.checks.agreement import agreement, correlation, is_better
from flightstack.gap.decisions import CONVENTION_CHANCE, CONVENTION_MARGIN, CONVENTION_POOR
from flightstack.types import F64

_FLU = (1.0, -1.0, -1.0)
_FLU_PRICE, _YAW_PRICE, _SIGN_PRICE = 0.02, 0.04, 0.05
"""What a reading has to agree better by: in the other frame, turned about z, for each axis of the opposite sign."""
_ON_ITS_SIDE = 2.0
"""How often as long as the others the component is along which a quadrotor's own thrust is felt."""
_LIVE_MPS2 = 1e-3
"""Less than any accelerometer's own noise."""


@dataclass(frozen=True, slots=True)
class Mounting:
    """From the sensor's axes to FRD: tipped by a quarter turn about x or y, FLU, a turn about z, then signs."""

    tip: tuple[int, int] | None = None
    """Axis, 0 or 1, and degrees, 90 or -90."""
    is_flu: bool = False
    yaw_deg: int = 0
    signs: tuple[float, float, float] = (1.0, 1.0, 1.0)

    def turned(self, value: F64) -> F64:
        """(N, 3) in FRD."""
        c, s = np.cos(np.radians(self.yaw_deg)), np.sin(np.radians(self.yaw_deg))
        about_z = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        matrix = about_z * _FLU if self.is_flu else about_z
        if self.tip is not None:
            matrix = matrix @ _tipped(*self.tip)
        out: F64 = (value @ matrix.T) * self.signs
        return out

    @property
    def price(self) -> float:
        """What it has to agree better by than a sensor that lies straight."""
        turned = (self.yaw_deg != 0) + (self.tip is not None)
        return self.is_flu * _FLU_PRICE + turned * _YAW_PRICE + self.signs.count(-1.0) * _SIGN_PRICE

    def said(self) -> str:
        """In words, with what was done about it."""
        words = []
        if self.tip is not None:
            words.append(f"was built in tipped by {self.tip[1]} degrees about {'xy'[self.tip[0]]}")
        if self.is_flu:
            words.append("was in FLU")
        if self.yaw_deg:
            words.append(f"was built in turned by {self.yaw_deg} degrees about z")
        if axes := " and ".join(axis for axis, sign in zip("xyz", self.signs, strict=True) if sign < 0.0):
            words.append(f"{axes} had the opposite sign")
        return f"{', '.join(words)}; turned into FRD"


STRAIGHT = Mounting()
_YAWS_DEG = (45, 90, 135, 180, -135, -90, -45)
_TURNED = [Mounting(is_flu=flu, yaw_deg=yaw) for flu, yaw in itertools.product((False, True), _YAWS_DEG)]


def tip_of(felt: F64) -> Mounting:
    """How a board lies on whose x or y an accelerometer feels what carries the vehicle; felt (N, 3) in flight.

    A quadrotor's rotors push along one axis of the body, however it leans.  An axis that never moves is dead or stuck,
    and then nothing tells how the others lie.
    """
    if np.std(felt, axis=0).min() < _LIVE_MPS2:
        return STRAIGHT
    mean = np.median(felt, axis=0)
    axis = int(np.argmax(np.abs(mean)))
    if axis == 2 or abs(mean[axis]) < _ON_ITS_SIDE * np.delete(np.abs(mean), axis).max():
        return STRAIGHT
    about, degrees = (0, 90) if axis == 1 else (1, -90)
    return Mounting(tip=(about, degrees if mean[axis] < 0.0 else -degrees))


def _tipped(axis: int, degrees: int) -> F64:
    """(3, 3) turn about x or y."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    if axis == 0:
        return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def gyro_mounting(turning: F64, gyro: F64, dt_s: float, tip: Mounting = STRAIGHT) -> tuple[float, Mounting]:
    """(agreement less the price, how it lies): `turning` (N, 3) is the attitude's, rad/s in any unit; `tip` is how the
    accelerometer lies, on the same board as a rule."""
    straight, flu = (_with_signs(turning, gyro, dt_s, each) for each in (STRAIGHT, Mounting(is_flu=True)))
    best = flu if is_better(flu[0], straight[0]) else straight
    if best[0] < 1.0 - CONVENTION_MARGIN:
        lain = _TURNED if tip == STRAIGHT else [*_TURNED, *(replace(tip, yaw_deg=yaw) for yaw in (0, *_YAWS_DEG))]
        turned = max((_with_signs(turning, gyro, dt_s, each) for each in lain), key=lambda each: each[0])
        # the best of many agrees somewhat by chance
        if turned[0] > 1.0 - CONVENTION_POOR and is_better(turned[0], best[0]):
            best = turned
    return best


def accelerometer_mounting(force: F64, felt: F64, dt_s: float, gyro: Mounting) -> Mounting:
    """How it lies: `force` (N, 3) is the specific force that velocity and attitude tell; z is right already.

    Where nothing pushes to the side nothing tells how, and nothing is spoilt; what does push, drag or wind, would come
    from elsewhere.  An eighth of a turn is believed where the gyro lies so (`gyro`), and any where both lie on their
    side.
    """
    likely = Mounting(yaw_deg=gyro.yaw_deg)
    best = likely if gyro.tip is not None else STRAIGHT
    felt_so = best.turned(felt)[:, :2]
    signs = _signs(force[:, :2], felt_so, dt_s)
    if min(signs) < 0.0:
        return replace(best, signs=(signs[0], signs[1], 1.0))
    found = kept = agreement(force[:, :2], felt_so, dt_s)
    for each in (Mounting(yaw_deg=90), Mounting(yaw_deg=-90), likely):
        turned = each.turned(felt)[:, :2]
        signs = _signs(force[:, :2], turned, dt_s)
        agreed = agreement(force[:, :2], turned * signs, dt_s)
        if agreed > max(found, 1.0 - CONVENTION_POOR) and is_better(agreed, kept):
            found, best = agreed, Mounting(yaw_deg=each.yaw_deg, signs=(signs[0], signs[1], 1.0))
    return best


def _with_signs(known: F64, measured: F64, dt_s: float, lies: Mounting) -> tuple[float, Mounting]:
    """(agreement less the price, the same with the signs that are beyond doubt)."""
    turned = lies.turned(measured)
    x, y, z = _signs(known, turned, dt_s)
    lies = replace(lies, signs=(x, y, z))
    return agreement(known, turned * (x, y, z), dt_s) - lies.price, lies


def _signs(known: F64, measured: F64, dt_s: float) -> list[float]:
    """-1 for each axis that beyond doubt agrees with what is known once it is turned round."""
    signs = []
    for k in range(known.shape[1]):
        as_it_is, turned = (correlation(known[:, [k]], sign * measured[:, [k]], dt_s)[0] for sign in (1.0, -1.0))
        opposite = turned > 1.0 - CONVENTION_POOR and turned - as_it_is > CONVENTION_CHANCE
        signs.append(-1.0 if opposite else 1.0)
    return signs
