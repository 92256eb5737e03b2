"""Compiled parts of the design: shapes from ratios, whether they fit, and the area of a slice.

A shape's size is one number; `fit` finds the largest that lies in the safe set and meets the condition on a few
hundred points of {h >= inner - eta}, most of them near its boundary.  Points prove nothing: the cover does, afterwards.
"""

from __future__ import annotations

import math

import numpy as np

from flightstack.barrier.condition import Reach, Setting, interval
from flightstack.barrier.shapes import (
    BRAKE,
    CENTRE_E,
    CENTRE_V,
    K_EE,
    K_EV,
    K_VV,
    KIND,
    LIMIT,
    P11,
    P12,
    P22,
    REACTION,
    ROW,
    SCALE,
    SIGN,
)
from flightstack.jit import njit, njit_called
from flightstack.types import F64

QUADRATIC, STOPPING = 0, 1
_LAST_RATIO = 3
V_LOW, V_HIGH, U_LOW, U_HIGH, ERROR_LOW, ERROR_HIGH = range(6)
"""Of a band (`cover.bands`)."""
_SPEEDS = 48
"""Speeds at which the condition is tried."""
_ACROSS = 6
"""Steps across the region at each of them."""
_HALVINGS = 7
_AREA_SPEEDS = 160
"""Speeds that an area in the search is summed over; the smooth substitution makes it good to 1e-4."""


@njit_called
def build(kind: int, x: F64, size: float, safe: F64, reaches: F64, rows: F64) -> int:
    """Rows of the shape with ratios x (n,) and a size in (0, 1]; how many there are, 0 if it's none.

    quadratic: x = c (the centre's speed is c r half widths in v), correlation r of P, half width in e / limit, e of the
    centre / half width in e.  With c between -1 and 1 both tips move inwards.  stopping: x = reaction time (s), braking
    towards low / greatest there, edges / limit (high, low).
    """
    u_low, u_high, v_most = (
        reaches[:, U_LOW].max(),
        reaches[:, U_HIGH].min(),
        max(-reaches[0, V_LOW], reaches[-1, V_HIGH]),
    )
    if kind == QUADRATIC:
        half_e, half_v = x[2] * safe[0], size * v_most
        free = 1.0 - x[1] * x[1]
        if not (free >= 1e-3 and half_e > 0.0 and half_v > 0.0):
            return 0
        p11, p12, p22 = 1.0 / (half_e * half_e * free), x[1] / (half_e * half_v * free), 1.0 / (half_v * half_v * free)
        rows[0, KIND], rows[0, CENTRE_E], rows[0, CENTRE_V] = 0.0, x[_LAST_RATIO] * half_e, x[0] * x[1] * half_v
        rows[0, P11], rows[0, P12], rows[0, P22] = p11, p12, p22
        rows[0, K_EE], rows[0, K_EV], rows[0, K_VV] = 2.0 * p11, 2.0 * p12, 2.0 * p22
        return 1
    t, brake_high, brake_low = x[0], -size * u_low, x[1] * u_high
    high, low = x[2] * safe[0] - 0.5 * brake_high * t * t, 0.5 * brake_low * t * t - x[_LAST_RATIO] * safe[0]
    if not (high - low >= 0.05 * safe[0] and t > 0.0 and brake_high > 0.0 and brake_low > 0.0):
        return 0
    scale = 0.5 * (high - low)
    rows[:2] = 0.0
    rows[0, :6] = np.array([1.0, 1.0, high, t, brake_high, scale])
    rows[1, :6] = np.array([1.0, -1.0, -low, t, brake_low, scale])
    rows[0, K_VV], rows[1, K_VV] = 1.0 / (brake_high * scale), 1.0 / (brake_low * scale)
    return 2


@njit
def chord(rows: F64, v: float, level: float) -> tuple[float, float]:
    """Least and greatest e with h >= level at a speed; the first is greater where there is none."""
    low, high = -np.inf, np.inf
    for i in range(rows.shape[0]):
        row = rows[i]
        if row[KIND] == 0.0:
            dv = v - row[CENTRE_V]
            root = (row[P12] * dv) ** 2 - row[P11] * (row[P22] * dv * dv - (1.0 - level))
            if root < 0.0:
                return 1.0, 0.0
            middle, half = row[CENTRE_E] - row[P12] * dv / row[P11], np.sqrt(root) / row[P11]
            low, high = max(low, middle - half), min(high, middle + half)
        else:
            toward = max(row[SIGN] * v, -row[BRAKE] * row[REACTION])
            edge = row[LIMIT] - row[REACTION] * toward - toward * toward / (2.0 * row[BRAKE]) - level * row[SCALE]
            if row[SIGN] > 0.0:
                high = min(high, edge)
            else:
                low = max(low, -edge)
    return low, high


@njit
def speeds(rows: F64, level: float) -> tuple[float, float]:
    """Least and greatest v with h >= level."""
    row = rows[0]
    if row[KIND] == 0.0:
        half = np.sqrt((1.0 - level) * row[P11] / (row[P11] * row[P22] - row[P12] * row[P12]))
        return row[CENTRE_V] - half, row[CENTRE_V] + half
    room = row[LIMIT] + rows[1, LIMIT] - 2.0 * level * row[SCALE]
    return -_fastest(room, rows[1, REACTION], rows[1, BRAKE], rows[0, BRAKE]), _fastest(
        room, row[REACTION], row[BRAKE], rows[1, BRAKE]
    )


@njit
def _fastest(room: float, t: float, brake: float, other: float) -> float:
    """Speed whose way to stop takes all the room; below other * t the far edge is still curved."""
    v = brake * (np.sqrt(t * t + (2.0 * room + other * t * t) / brake) - t)
    return float(v if v >= other * t else np.sqrt(2.0 * room / (1.0 / brake + 1.0 / other)))


@njit_called
def holds_on_points(rows: F64, setting: Setting, reaches: F64) -> bool:
    """Whether commands exist on points of {h >= inner - eta}."""
    v_low, v_high = speeds(rows, setting.inner - setting.eta)
    if not (v_low >= reaches[0, V_LOW] and v_high <= reaches[-1, V_HIGH]):
        return False
    for i in range(rows.shape[0]):  # where no command changes h at once: the tips of an ellipse, the ends of a way
        row = rows[i]
        if row[KIND] == 0.0:
            tip = row[P12] * np.sqrt(
                (1.0 + setting.eta - setting.inner) / (row[P22] * (row[P11] * row[P22] - row[P12] * row[P12]))
            )
            if not (
                _holds_at(rows, row[CENTRE_V] + tip, setting, reaches)
                and _holds_at(rows, row[CENTRE_V] - tip, setting, reaches)
            ):
                return False
        elif not _holds_at(rows, -row[SIGN] * row[BRAKE] * row[REACTION], setting, reaches):
            return False
    for i in range(_SPEEDS):
        v = 0.5 * (v_low + v_high) - 0.5 * (v_high - v_low) * np.cos(np.pi * (i + 0.02) / (_SPEEDS - 0.96))
        if not _holds_at(rows, v, setting, reaches):
            return False
    return True


@njit_called
def largest_size(rows: F64, by_speed: bool, highest: float, setting: Setting, reaches: F64) -> float:
    """The largest size (`sized`) that holds on points; 0 if none from the highest down to a fiftieth of it."""
    low, out = highest, np.empty_like(rows)
    if not low > 0.0:  # not even the smallest lies in the safe set
        return 0.0
    while not holds_on_points(sized(rows, by_speed, low, out), setting, reaches):
        low *= 0.85
        if not low > 0.02 * highest:
            return 0.0
    if low == highest:
        return low
    high = low / 0.85
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        if holds_on_points(sized(rows, by_speed, middle, out), setting, reaches):
            low = middle
        else:
            high = middle
    return low


@njit_called
def sized(rows: F64, by_speed: bool, size: float, out: F64) -> F64:
    """Rows of `design.at_speed` or else `design.at_level`, to the last bit; also in `out`."""
    root = 1.0 if by_speed else math.sqrt(size)
    out[:] = rows
    for i in range(rows.shape[0]):
        row = rows[i]
        if row[KIND] == 0.0:
            out[i, CENTRE_E], out[i, CENTRE_V] = root * row[CENTRE_E], (size if by_speed else root) * row[CENTRE_V]
            out[i, P11] = row[P11] if by_speed else row[P11] / size
            out[i, P12] = row[P12] / size
            out[i, P22] = row[P22] / (size * size if by_speed else size)
            out[i, K_EE], out[i, K_EV], out[i, K_VV] = 2.0 * out[i, P11], 2.0 * out[i, P12], 2.0 * out[i, P22]
            continue
        out[i, LIMIT] = root * row[LIMIT]
        if by_speed:
            out[i, REACTION], out[i, BRAKE] = row[REACTION] / size, size * size * row[BRAKE]
        out[i, SCALE] = 0.5 * (root * rows[0, LIMIT] + root * rows[1, LIMIT])
        out[i, K_VV] = 1.0 / (out[i, BRAKE] * out[i, SCALE])
    return out


@njit_called
def _holds_at(rows: F64, v: float, setting: Setting, reaches: F64) -> bool:
    """The same on points across the region at one speed."""
    k = 0
    while k < reaches.shape[0] - 1 and v > reaches[k, V_HIGH]:
        k += 1
    reach = Reach(reaches[k, U_LOW], reaches[k, U_HIGH], reaches[k, ERROR_LOW], reaches[k, ERROR_HIGH])
    e_low, e_high = chord(rows, v, setting.inner - setting.eta)
    if e_low > e_high:
        return True
    for j in range(_ACROSS + 1):
        e = e_low + (0.5 - 0.5 * np.cos(np.pi * j / _ACROSS)) * (e_high - e_low)
        if not interval(rows, e, v, setting, reach)[2] >= 0.0:
            return False
    return True


@njit
def within(rows: F64, safe: F64) -> bool:
    """Whether {h >= 0} lies in the safe set: exact for a quadratic, on points of its edge for the other family."""
    if rows[0, KIND] == 0.0:
        return farthest(rows[0], safe) <= 1.0 + 1e-9
    v_low, v_high = speeds(rows, 0.0)
    for i in range(_SPEEDS + 1):
        v = v_low + (v_high - v_low) * i / _SPEEDS
        low, high = chord(rows, v, 0.0)
        most = max(-low, high) / safe[0]
        if most * most + (v / safe[1]) ** 2 > 1.0 + 1e-9:
            return False
    return True


@njit_called
def farthest(row: F64, safe: F64) -> float:
    """Greatest e^2 / a^2 + v^2 / b^2 over an ellipse, by its S-lemma dual: sound at every s, exact at the least.

    max |c + L y|^2 over |y| <= 1 is min over s > lambda_max of s + sum_i s c_i^2 / (s - lambda_i), lambda_i the
    eigenvalues of L L^T and c_i the centre along their vectors (S. Boyd, L. Vandenberghe, "Convex Optimization", 2004,
    appendix B).
    """
    det = row[P11] * row[P22] - row[P12] * row[P12]
    q11, q12, q22 = row[P22] / det / safe[0] ** 2, -row[P12] / det / (safe[0] * safe[1]), row[P11] / det / safe[1] ** 2
    c_e, c_v = row[CENTRE_E] / safe[0], row[CENTRE_V] / safe[1]
    middle, half = 0.5 * (q11 + q22), np.hypot(0.5 * (q11 - q22), q12)
    turn = 0.5 * np.arctan2(2.0 * q12, q11 - q22)
    one, two = middle + half, middle - half
    along, across = (c_e * np.cos(turn) + c_v * np.sin(turn)) ** 2, (c_v * np.cos(turn) - c_e * np.sin(turn)) ** 2
    low, high = one, one + np.sqrt(one * (along + across))
    for _ in range(50):
        s = 0.5 * (low + high)
        if one * along / (s - one + 1e-300) ** 2 + two * across / (s - two + 1e-300) ** 2 > 1.0:
            low = s
        else:
            high = s
    value = high
    for share, eigen in ((along, one), (across, two)):
        if share > 0.0:
            value += high * share / max(high - eigen, 1e-300)
    return float(value)


@njit_called
def overlap(rows: F64, shear_s: float, shift_m: float, shift_mps: float, points: int, inner: float = 0.0) -> float:
    """Area of the (p, v) with h(p, v) >= 0 and h(p + shear v + shift_m, v + shift_mps) >= inner, m^2/s."""
    low, high = speeds(rows, 0.0)
    low, high = max(low, low - shift_mps), min(high, high - shift_mps)
    if low >= high:
        return 0.0
    total = 0.0
    for i in range(points):
        angle = np.pi * (i + 0.5) / points
        v = 0.5 * (low + high) - 0.5 * (high - low) * np.cos(angle)
        one_low, one_high = chord(rows, v, 0.0)
        two_low, two_high = chord(rows, v + shift_mps, inner)
        move = shear_s * v + shift_m
        width = min(one_high, two_high - move) - max(one_low, two_low - move)
        total += max(width, 0.0) * np.sin(angle)
    return float(total * 0.5 * (high - low) * np.pi / points)


@njit_called
def fit(kind: int, x: F64, safe: F64, setting: Setting, reaches: F64, shear_s: float, rows: F64) -> tuple[float, float]:
    """Area on the slice of zero acceleration of the largest shape with these ratios, and its size; (0, 0) if none."""
    low, high, size = 0.0, 1.0, 1.0
    while True:  # from the largest down, since what is too small may fail as well
        if _fits(kind, x, size, safe, setting, reaches, rows):
            low = size
            break
        high, size = size, 0.9 * size
        if size < 0.02:
            return 0.0, 0.0
    for _ in range(9):
        size = 0.5 * (low + high)
        if _fits(kind, x, size, safe, setting, reaches, rows):
            low = size
        else:
            high = size
    n = build(kind, x, low, safe, reaches, rows)
    return overlap(rows[:n], shear_s, 0.0, 0.0, _AREA_SPEEDS), low


@njit_called
def _fits(kind: int, x: F64, size: float, safe: F64, setting: Setting, reaches: F64, rows: F64) -> bool:
    n = build(kind, x, size, safe, reaches, rows)
    return n > 0 and within(rows[:n], safe) and holds_on_points(rows[:n], setting, reaches)


@njit_called
def climb(
    kind: int, start: F64, steps: F64, safe: F64, setting: Setting, reaches: F64, shear_s: float
) -> tuple[F64, float, float]:
    """Pattern search of the ratios from a start; ratios, area, size.  A ratio whose step is 0 stays."""
    rows = np.zeros((2, ROW))
    x, step = start.copy(), steps.copy()
    area, size = fit(kind, x, safe, setting, reaches, shear_s, rows)
    while step.max() > 2e-3 * steps.max():
        better = False
        for i in range(x.size):
            for j in range(i, x.size):  # along one ratio, and along two at once: the best lie on ridges
                for k in range(2 if i == j else 4):
                    if step[i] == 0.0 or step[j] == 0.0:
                        continue
                    trial = x.copy()
                    trial[i] += step[i] * (1.0 if k & 1 else -1.0)
                    if i != j:
                        trial[j] += step[j] * (1.0 if k & 2 else -1.0)
                    found, found_size = fit(kind, trial, safe, setting, reaches, shear_s, rows)
                    if found > area:
                        x, area, size, better = trial, found, found_size, True
        if not better:
            step *= 0.5
    return x, area, size
