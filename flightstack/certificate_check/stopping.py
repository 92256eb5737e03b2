"""Certificates of a stop (`flightstack.stopping/6`): ledger, tubes and braking worked out anew; shares no code.

Across: p' = v, v' = a + d + r, a' = j, lag (rotors j'' + j') = (1 + 0.05 s / lag) (-(k_a (a + 0.85 o) + k_v (v + n_v)
+ k_p (p + n_p)) - j) - 0.05 s / lag rotors j', o' = (d - o) / 0.1 s; along: the same without j,
lag a' = -(k_v (v + n_v) + k_p (p + n_p) + o) - a.  The answers to each input are integrated by Runge and Kutta's rule;
the sum of their absolute areas, each times its bound, is the least radius that may be claimed.  So is what the ways out
are left by where turning is bounded (`left`).
"""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from .intervals import F64
from .left import ClosedLoop, Way, laid_out, left
from .reading import Refused, Unreadable, number, numbers, table_of

_KIND = "flightstack.stopping/"
SCHEMA = f"{_KIND}6"
_GRAVITY = 9.80665
_OBSERVER_S = 0.1
_STEP_S, _HORIZON_S = 0.002, 10.0
_LEAD_S, _SEEN_SHARE = 0.05, 0.85
_LITTLE = ((0j, 0j), (1 + 0j, 0j), (2 + 0j, 0j), (1 + 0j, 1.7 + 1.7j), (0j, 3 + 0j), (2 + 0j, -3 + 0j))
_MUCH = ((3 + 0j, 0j), (5 + 0j, 0j), (6 + 0j, 0j), (2 + 0j, 4 + 0j), (3 + 0j, 4j))
_MOVING = (
    (0j, 6 + 0j), (1 + 0j, 4.5 + 2.5j), (2 + 0j, 6j), (2 + 0j, -5 + 2.5j), (3 + 0j, -2.5 + 5.5j), (4 + 0j, -4 + 0.5j),
    (6 + 0j, -4.5 + 1j), (6 + 0j, -6 + 0j), (5 + 0j, 0.8 - 2.8j, 1.2 - 1.1j), (2 + 0j, 1.2 + 2.8j, 4.5 + 0.3j),
    (3 + 0j, 0.9 + 3.3j, -21.5 + 5j), (4 + 0j, -2.9 + 4.2j, 19.6 - 5.2j), (1.5 + 0j, -2.9 - 1.2j, 24.2 + 0.2j),
    (3 + 0j, 4.8 - 3j, -10 - 8.2j), (6 + 0j, -0.8 - 1.3j, 7.4 - 15.7j),
)  # fmt: skip
"""Ways out whose worst is looked for, by speed, lean and its turning: with little motion at first, with much, and
leaning or turning."""
_ROOM = 0.01
"""Share by which a claimed radius may be less than what is found: both are integrated in steps."""
_K_SIGMA = 4.3
_LIGHTEST, _HEAVIEST, _MOST_FORCE_G = 0.8, 1.5, 0.15
"""The prior of a vehicle that has not flown: nothing narrower has to be shown than this."""
_FASTER = 1.5**0.5
"""How much faster than was flown a narrower one may hold."""
_SPEEDS_MPS = (1.0, 3.0, 5.0)
_LINES = ("force", "gain", "estimate", "torque", "model")
_LOOP = (
    "lag_s", "rotors_s", "force_mps2", "rest_mps2", "eps_p_m", "eps_v_mps", "acc_ps", "vel_ps2", "pos_ps3", "radius_m",
    "demand_mps2",
)  # fmt: skip
_TOP = (
    "schema", "vehicle", "vehicle_hash", "sensors", "prior", "learned", "ledger", "across", "along", "turning",
    "way_least", "way_most", "braking", "stops_within_m",
)  # fmt: skip


def is_stopping(text: str) -> bool:
    """Whether a text looks like one, of whatever version."""
    return _KIND in text[:400]


def check_stopping(text: str) -> list[str]:
    """What was verified, a line each; Refused where something does not hold."""
    try:
        said = json.loads(text)
    except (ValueError, RecursionError):
        raise Unreadable("not valid JSON") from None
    if isinstance(said, dict) and said.get("schema") != SCHEMA:
        schema = str(said.get("schema"))[:40]
        raise Unreadable(
            f'schema is "{schema}", not "{SCHEMA}": make the certificate of a stop anew with certify --site'
        )
    top = table_of(said, _TOP, "certificate")
    low, high, force_g, speed = numbers(top["prior"], ("mass_low", "mass_high", "force_g", "speed_mps"), "prior")
    if not (0.3 <= low <= high <= 3.0 and 0.0 <= force_g <= 1.0):
        raise Refused("prior: a range of masses from 0.3 to 3 and a force of at most 1 g are looked at")
    _learned(top["learned"], (low, high, force_g, speed))
    sums = _ledger(top["ledger"], force_g)
    lines = ["prior: holds what the flight is said to have shown", f"ledger: {len(_LINES)} lines, force {force_g:g} g"]
    turning = _turning(top["turning"], top["braking"], high)
    ways = [_way(top[name], name, turning) for name in ("way_least", "way_most")]
    loops = {}
    for i, name in enumerate(("across", "along")):
        loops[name] = loop = dict(zip(_LOOP, numbers(top[name], _LOOP, name), strict=True))
        for key, total in zip(("force_mps2", "rest_mps2"), sums[i], strict=True):
            if not loop[key] >= total - 1e-9:
                raise Refused(f"{name}.{key} = {loop[key]:.4g} is less than its lines in the ledger: {total:.4g}")
        found = _radius(loop, i == 0)
        if not loop["radius_m"] >= (1.0 - _ROOM) * found:
            raise Refused(f"{name}: the tube reaches {found:.4f} m, not {loop['radius_m']:.4f} m")
        lines.append(f"{name}: tube of {loop['radius_m']:.3f} m, found {found:.3f} m")
    radius = loops["across"]["radius_m"]
    steps = [number(top["ledger"][line]["across_mps2"], "ledger") for line in (0, 1)]
    _braking(top["braking"], (low, high, force_g))
    lines.append("braking: thrust carries weight, force and braking together")
    _ways(top["stops_within_m"], float(top["braking"]["across_mps2"]), radius)
    lines.append(
        "stops_within_m: no shorter than that braking allows; vehicle and sensors are compared where it is flown"
    )
    return lines + _left(ways, loops["across"], turning, float(np.hypot(steps[0], steps[1])))


def _learned(value: Any, prior: tuple[float, float, float, float]) -> None:
    """The prior is no narrower than what was learned leaves open, nor than what is known without any flight; and holds
    no faster than was flown in every direction, with the force that grows with the square of the speed."""
    gain, sigma, force, _, flown = numbers(
        value, ("gain", "gain_sigma", "force_mps2", "flight_s", "speed_mps"), "learned"
    )
    low, high, force_g, speed = prior
    if not (sigma >= 0.0 and force >= 0.0 and gain > 0.0 and flown >= 0.0):
        raise Refused("learned: a gain is above 0, its deviation, a force and a speed are not below")
    least, most = max(gain - _K_SIGMA * sigma, 1.0 / _HEAVIEST), min(gain + _K_SIGMA * sigma, 1.0 / _LIGHTEST)
    if not (1.0 / high <= least + 1e-9 and 1.0 / low >= most - 1e-9):
        raise Refused(f"prior: masses of {low:.4g} to {high:.4g} leave out what learned.gain allows")
    if force > _MOST_FORCE_G * _GRAVITY:
        raise Refused(f"learned.force_mps2 = {force:.4g}: more than {_MOST_FORCE_G:g} g is not held against")
    is_narrow = low > _LIGHTEST or high < _HEAVIEST or force_g < _MOST_FORCE_G
    if is_narrow and not speed <= _FASTER * flown + 1e-9:
        raise Refused(f"prior: {speed:.4g} m/s are more than {_FASTER:.3f} times learned.speed_mps = {flown:.4g}")
    force *= max(speed / flown, 1.0) ** 2 if is_narrow and flown > 0.0 else 1.0
    if not force_g * _GRAVITY >= min(force, _MOST_FORCE_G * _GRAVITY) - 1e-9:
        raise Refused(f"prior: {force_g:.4g} g is less than learned.force_mps2 at its speed: {force:.4g}")


def _ways(value: Any, across_mps2: float, radius_m: float) -> None:
    """Each way is at least the ideal one and the tube, and grows with speed."""
    names = tuple(f"{speed:g} m/s" for speed in _SPEEDS_MPS)
    before = 0.0
    for speed, way in zip(_SPEEDS_MPS, numbers(value, names, "stops_within_m"), strict=True):
        least = max(0.5 * speed * speed / across_mps2 + radius_m, before)
        if not way >= least:
            raise Refused(f"stops_within_m: from {speed:g} m/s it is at least {least:.3f} m, not {way:.3f} m")
        before = way


def _ledger(value: Any, force_g: float) -> list[tuple[float, float]]:
    """What the accelerometer shows and what not, across and along."""
    if not isinstance(value, list) or len(value) != len(_LINES):
        raise Unreadable(f"ledger must be {len(_LINES)} lines")
    table = []
    for name, line in zip(_LINES, value, strict=True):
        parts = table_of(line, ("name", "across_mps2", "along_mps2"), f"ledger.{name}")
        if parts["name"] != name:
            raise Refused(f"ledger: {name} is expected, not {str(parts['name'])[:40]}")
        sizes = [number(parts[key], f"ledger.{name}.{key}") for key in ("across_mps2", "along_mps2")]
        if min(sizes) < 0.0:
            raise Refused(f"ledger.{name} is negative")
        table.append(sizes)
    if min(table[0]) < force_g * _GRAVITY - 1e-9:
        raise Refused(f"ledger.force is less than the prior's {force_g:g} g")
    return [(sum(row[way] for row in table[:2]), sum(row[way] for row in table[2:])) for way in (0, 1)]


def _radius(loop: dict[str, float], is_across: bool) -> float:
    """The sum of bounds times areas, after the initial errors."""
    if not (loop["lag_s"] > 1e-3 and min(loop.values()) >= 0.0):
        raise Refused("a loop's lag is at least 1 ms, and nothing in it is negative")
    if is_across != (loop["rotors_s"] > 1e-3):
        raise Refused("across, rotors make the answer later by at least 1 ms; along, their lag is the loop's own")
    order = 6 if is_across else 4
    a, into = np.zeros((order, order)), np.zeros((order, 4))
    a[0, 1] = a[1, 2] = 1.0
    asked, last = order - 2, order - 1
    a[asked, :2] = -loop["pos_ps3"], -loop["vel_ps2"]
    gain = loop["acc_ps"] if is_across else 1.0
    a[asked, 3 if is_across else asked] -= 1.0
    if is_across:
        a[2, 3] = a[3, asked] = 1.0
        a[asked, 2] = -gain
    a[asked, last] = -gain * (_SEEN_SHARE if is_across else 1.0)
    into[asked, 2:] = -loop["pos_ps3"], -loop["vel_ps2"]
    late = loop["lag_s"] * (loop["rotors_s"] if is_across else 1.0)
    if is_across:
        late /= 1.0 + _LEAD_S / loop["lag_s"]
    a[asked] /= late
    into[asked] /= late
    if is_across:
        a[asked, asked] = -1.0 / loop["rotors_s"] - _LEAD_S / loop["lag_s"] ** 2
    a[last, last] = -1.0 / _OBSERVER_S
    into[1, :2] = 1.0
    into[last, 0] = 1.0 / _OBSERVER_S
    if float(np.linalg.eigvals(a).real.max()) > -0.3:
        raise Refused("a loop does not settle")
    starts = np.zeros((order, 3))
    starts[0, 0] = starts[1, 1] = starts[last, 2] = 1.0
    starts[2, 2] = -1.0  # the way begins with the lean that there is, whatever of the force is seen
    bounds = np.array([loop["force_mps2"], loop["rest_mps2"], loop["eps_p_m"], loop["eps_v_mps"]])
    begun = np.array([loop["eps_p_m"], loop["eps_v_mps"], loop["force_mps2"]])
    return _greatest(a, np.hstack([into, starts]), bounds, begun)


def _greatest(a: F64, x: F64, bounds: F64, begun: F64) -> float:
    """The greatest sum at any time; x (order, 7): the answers' first values."""
    h, area, greatest = _STEP_S, np.zeros(4), 0.0
    for _ in range(round(_HORIZON_S / _STEP_S)):
        k1 = a @ x
        k2 = a @ (x + 0.5 * h * k1)
        k3 = a @ (x + 0.5 * h * k2)
        after = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + a @ (x + h * k3))
        area += 0.5 * h * (np.abs(x[0, :4]) + np.abs(after[0, :4]))
        x = after
        greatest = max(greatest, float(area @ bounds + np.abs(x[0, 4:]) @ begun))
    return greatest


def _turning(value: Any, braking: Any, high: float) -> tuple[float, float, float]:
    """Snap, lean, fastest turning; the lean is no more than thrust carries."""
    snap, lean, fastest = numbers(value, ("snap_mps4", "lean_mps2", "fastest_mps3"), "turning")
    if not (snap > 0.0 and lean > 0.0 and fastest > 0.0):
        raise Refused("turning: nothing of it may be 0")
    thrust = float(braking["thrust_mps2"]) / high
    if not np.hypot(_GRAVITY, lean) <= thrust + 1e-9:
        raise Refused(f"turning: a lean of {lean:.3f} m/s^2 takes more than the least thrust, {thrust:.3f} m/s^2")
    return snap, lean, fastest


def _way(value: Any, name: str, turning: tuple[float, float, float]) -> Way:
    """How ways are laid out, for the least gain or the greatest; they take no more than all of the snap."""
    way = Way(*numbers(value, Way._fields, name))
    if not (min(way[:-2]) > 0.0 and min(way[-2:]) >= 0.0 and way.slow_mps4 <= way.fast_mps4 <= turning[0]):
        raise Refused(f"{name}: nothing of it may be 0, and a way takes no more than all of the snap")
    if not way.lean_mps2 >= turning[1]:
        raise Refused(f"{name}: a lean of {way.lean_mps2:.3f} m/s^2 is less than that of the least gain")
    return way


def _left(
    ways: list[Way], across: dict[str, float], turning: tuple[float, float, float], force_mps2: float
) -> list[str]:  # fmt: skip
    """Each kind of way is left by no more than its radius."""
    sizes, lines = np.array([force_mps2, across["rest_mps2"], across["eps_p_m"], across["eps_v_mps"]]), []
    if not across["radius_m"] >= max(way.rest_radius_m for way in ways) - 1e-9:
        raise Refused("across: the tube at rest is the widest of both ways'")
    for name, way in zip(("least", "most")[: len(set(ways))], ways, strict=False):
        loop = ClosedLoop(*[*(across[key] for key in ClosedLoop._fields[:5]), turning[0], way.lean_mps2, turning[2]])
        ways_out = [laid_out(way, loop, *motion) for motion in (*_LITTLE, *_MUCH, *_MOVING)]
        found = left(ways_out, loop, sizes)
        little, much, moving = np.split(found, [len(_LITTLE), len(_LITTLE) + len(_MUCH)])
        claims = [
            ("little motion", float(little.max()), way.rest_radius_m),
            ("much motion", float(much.max()), way.most_radius_m),
        ]
        for (_, lean, *turns), most, laid in zip(_MOVING, moving.tolist(), ways_out[-len(_MOVING) :], strict=True):
            began = f", turning {abs(turns[0]):.1f} m/s^3" if turns else ""
            if len(laid):
                claims.append((f"leaning {abs(lean):.1f} m/s^2{began}", most, way.claimed_m(laid)))
        for kind, most, radius in claims:
            if not radius >= (1.0 - _ROOM) * most:
                raise Refused(f"across: ways out (gain {name}, {kind}) are left by {most:.4f} m, not {radius:.4f} m")
        lines.append(f"ways out (gain {name}): left by up to {found.max():.3f} m, tube of {way.most_radius_m:.3f} m")
    return lines


def _braking(value: Any, prior: tuple[float, float, float]) -> None:
    """With the least gain, thrust carries the weight, the force from any side and the braking; with the greatest, the
    least thrust leaves what brakes a climb beside a force upwards."""
    names = ("thrust_mps2", "least_thrust_mps2", "across_mps2", "up_mps2", "down_mps2")
    thrust, idle, across, up, down = numbers(value, names, "braking")
    low, high, force_g = prior
    force, least = force_g * _GRAVITY, thrust / high
    if not (across > 0.0 and up > 0.0 and down > 0.0 and idle >= 0.0):
        raise Refused("braking: nothing of it may be 0, and thrust is not negative")
    left = _GRAVITY - idle / low - force
    if not down <= left:
        raise Refused(f"braking: the least thrust and the force leave {left:.3f} m/s^2 of the weight, not {down:.3f}")
    phi = np.linspace(0.0, 0.5 * np.pi, 91)
    needed = np.hypot(_GRAVITY + force * np.sin(phi) + up, across + force * np.cos(phi))
    if not float(needed.max()) <= least + 1e-9:
        raise Refused(f"braking: {needed.max():.3f} m/s^2 of thrust are needed, the least is {least:.3f}")
