"""The ledger: every margin by its name, and the condition's constants that follow from them, worked out anew.

A source puts the predicted (e, v) off by (x, y), or along the motion by a time t: by (t v, t a), a the acceleration.
E: greatest error; S: span of the commands, A: greatest |u|; d, l, r: doubt of delay, rotors' lag and rate loop.

    delay           (delay^2 / 2 + c1 delay) E,  (t + delay) E,  t = d; lateral t = d + l of the rotors
    age             o (vel + (c1 + delay + o / 2) (E + acc)),  o (E + acc);  o: the newest sample's age
    rotor_lag       vertical: A (c1 + l / 2) l,  l S / e + w
    attitude_lag    lateral: c1 r S / 2,  r S + w
    estimate_error  pos + (c1 + delay) vel + c2 at + (c1 delay + delay^2 / 2) acc,  vel + c1 at + delay acc
                    at: vertical acc; lateral its share at the thrust that is steered with, of the greatest

    off_m, off_mps = sum of x + t sup |v|,  sum of y + t A
    eta = sup (|dh/de| x + |dh/dv| y + t |dh/de v + dh/dv a|), x, y, t the sums of all, over {h >= -eta}
    w = c1 E, lateral also c1 S / 2 times the share by which thrust is not the lead's
    its part of eta = sup |dh/de| x + sup |dh/dv| y + t sup |dh/de v + dh/dv a|
    a margin in m/s^2 = (what `off` takes for its x + t sup |v| and y + t A where braking is hardest, without the small
    parts, + gamma its part of eta) / sup |dh/dv| there

Each supremum is on the edge of an ellipse, and at the greatest speed of a stopping distance; braking is hardest at the
greatest speed that there is at the centre's e, and at the greatest speed of a stopping distance.
The attitude's error acc is part of every error: it counts to estimate_error, and E is what is left without it.
What holding a command costs (`zero_order_hold`) is part of q itself.  The other parts of the error make up its greatest
value at u_low.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from .condition import Condition, Piece
from .intervals import F64
from .knowledge import StatedKnowledge, torque_of
from .reading import Refused, number, numbers, table_of

MARGINS = (
    "gp_error", "thrust_gain", "discretisation", "zero_order_hold", "delay", "age", "rotor_lag",
    "attitude_lag", "estimate_error", "torque",
)  # fmt: skip
N_LOW, N_HIGH, N_ERROR_LOW = 3, 4, 5
"""Rows of the authority's columns, with those of the errors last."""
_DOUBTS = ("delay_s", "lag_share", "rate_lag_share", "rotor_lag_s", "age_s")
_AXES = ("north", "east", "down")
_CLOSE = 1e-3
"""Share by which a stated constant may differ; beyond it, whatever lies between three rounds of eta and all of them."""
_NEAR = 1e-6


def check_ledger(
    condition: Condition, axis: dict[str, Any], nodes: F64, known: StatedKnowledge, name: str, estimate: F64
) -> str:
    """Verify an axis' margins; what was verified, in words.  `estimate` (3,): bounds of position, velocity and of the
    acceleration that thrust gives along this axis."""
    stated = _margins(axis["margins"], name)
    response = numbers(axis["response"], ("c1_s", "c2_s2", "delay_s"), f"{name}.response")
    if min(response) < 0.0:
        raise Refused(f"{name}.response: lags and delay must be at least 0")
    if name == "down" and response[1] != 0.0:
        raise Refused(f"down.response.c2_s2 = {response[1]:.6g}, thrust follows its command by one lag: 0")
    low, acc = float(nodes[N_ERROR_LOW].max()), float(estimate[2])
    torque = torque_of(known, _AXES.index(name))
    if not abs(stated["torque"] - torque) <= _NEAR:
        raise Refused(f"{name}: margin torque = {stated['torque']:.9g} m/s^2, the governor's limits give {torque:.9g}")
    if not abs(stated["gp_error"] + stated["thrust_gain"] + torque + acc - low) <= _NEAR:
        raise Refused(
            f"{name}: gp_error, thrust_gain, torque and attitude's error do not make up the error at u_low, {low:.9g}"
        )
    doubts = known.data.get("doubts")
    if doubts is None:
        raise Refused("knowledge.doubts is missing: nothing says what the ledger rests on")
    share = known.lead / known.box.greatest
    sources, eta = _sources(name == "down", response, nodes, doubts, estimate, share), 0.0
    lag, hardest = "rotor_lag" if name == "down" else "attitude_lag", float(np.abs(nodes[3:5]).max())
    x, y, t = sources[lag]
    sources[lag] = x, y + _apart(name == "down", response, nodes, known, acc), t
    per_m, per_mps, steep = _hardest(condition, nodes)
    rounds = list[tuple[tuple[float, float, float, float], dict[str, float]]]()
    for _ in range(30):  # eta widens the region whose suprema it comes from
        at = _suprema(condition, nodes, eta)
        eta_of = {key: at["he"] * x + at["hv"] * y + at["flow_h"] * t for key, (x, y, t) in sources.items()}
        off = {key: (x + t * at["speed"], y + t * hardest) for key, (x, y, t) in sources.items()}
        eta = min(_eta_together(condition, nodes, eta, sources), 1.0)
        found = {key: per_m * x + per_mps * y + condition.gamma * eta_of[key] / steep for key, (x, y) in off.items()}
        found["estimate_error"] += acc
        found |= {"discretisation": 0.0, "zero_order_hold": at["hold"] / at["hv"]}
        off_m, off_mps = (sum(each[i] for each in off.values()) for i in range(2))
        rounds.append(((eta, off_m, 0.0, off_mps), found))
    for key in rounds[2][1]:
        ends = sorted(rounds[i][1][key] for i in (2, -1))
        if not (1.0 - _CLOSE) * ends[0] - _NEAR <= stated[key] <= (1.0 + _CLOSE) * ends[1] + _NEAR:
            raise Refused(f"{name}: margin {key} = {stated[key]:.9g} m/s^2, its sources give {ends[1]:.9g}")
    held = (
        ("eta", condition.eta),
        ("off_m", condition.off_m),
        ("inner", condition.inner),
        ("off_mps", condition.off_mps),
    )
    for (key, value), least in zip(held, rounds[2][0], strict=True):
        if not value >= least * (1.0 - _CLOSE):
            raise Refused(f"{name}.setting.{key} = {value:.9g} is less than the {least:.9g} that its margins need")
    total = sum(stated.values())
    return f"{name}: all {len(MARGINS)} margins of the ledger, {total:.4g} m/s^2 in all, held by eta and the offsets"


def _margins(value: Any, name: str) -> dict[str, float]:
    if not isinstance(value, list):
        raise Refused(f"{name}.margins must be a list")
    stated = {}
    for i, entry in enumerate(value):
        table_of(entry, ("name", "mps2", "because"), f"{name}.margins[{i}]")
        if not isinstance(entry["name"], str) or not isinstance(entry["because"], str):
            raise Refused(f"{name}.margins[{i}]: name and because must be words")
        stated[entry["name"]] = number(entry["mps2"], f"{name}.margins[{i}].mps2")
    if len(value) != len(MARGINS) or set(stated) != set(MARGINS) or min(stated.values()) < 0.0:
        raise Refused(f"{name}.margins must state each of {', '.join(MARGINS)} once, at least 0")
    return stated


def _sources(
    vertical: bool, response: list[float], nodes: F64, doubts: Any, estimate: F64, share: float
) -> dict[str, tuple[float, float, float]]:
    """(x, y, t) by name."""
    pos, vel, acc = (float(each) for each in estimate)
    late, lag_share, rate_share, rotor, old = numbers(doubts, _DOUBTS, "knowledge.doubts")
    if min(late, lag_share, rate_share, rotor, old) < 0.0:
        raise Refused("knowledge.doubts must be at least 0")
    c1, c2, delay = response
    error, span = float(nodes[5:].max()) - acc, float((nodes[N_HIGH] - nodes[N_LOW]).max())
    steered = acc if vertical else share * acc
    lag, turn = lag_share * c1, rate_share * c2 / c1 if c1 > 0.0 else 0.0
    most, none = float(np.abs(nodes[3:5]).max()), (0.0, 0.0, 0.0)
    late += 0.0 if vertical else lag_share * rotor
    return {
        "delay": ((0.5 * delay**2 + c1 * delay) * error, (late + delay) * error, late),
        "age": (old * vel + (old * c1 + old * delay + 0.5 * old**2) * (error + acc), old * (error + acc), 0.0),
        "rotor_lag": (most * (c1 + 0.5 * lag) * lag, lag * span / math.e, 0.0) if vertical else none,
        "attitude_lag": none if vertical else (0.5 * c1 * turn * span, turn * span, 0.0),
        "estimate_error": (
            pos + (c1 + delay) * vel + c2 * steered + (c1 * delay + 0.5 * delay**2) * acc,
            vel + c1 * steered + delay * acc,
            0.0,
        ),
    }


def _apart(vertical: bool, response: list[float], nodes: F64, known: StatedKnowledge, acc: float) -> float:
    """By how much z moves apart from its speed, m/s: acceleration not known, thrust that is not the lead's."""
    error, span = float(nodes[5:].max()) - acc, float((nodes[N_HIGH] - nodes[N_LOW]).max())
    apart = max(known.box.high - known.lead, known.lead - known.box.low) / known.lead
    return response[0] * error + (0.0 if vertical else response[0] * 0.5 * span * apart)


def _suprema(condition: Condition, nodes: F64, eta: float) -> dict[str, float]:
    """Greatest slopes of h, and of q without gamma h, on {h >= -eta} for all commands and accelerations."""
    ends, error, dt = np.array([nodes[N_LOW].min(), nodes[N_HIGH].max()]), float(nodes[5:].max()), condition.dt
    half, command, most = 0.5 * dt, float(np.abs(ends).max()), dict[str, float]()
    for piece in condition.pieces:
        kee, cross, kvv = (float(k.hi) for k in piece.curvature())
        kev = abs(cross)
        v, he, hv = _edge(condition, piece, eta)
        speed, steep = float(np.abs(v).max()), float(np.abs(he).max())
        flow_h = np.abs((he * v)[:, None] + hv[:, None] * ends)
        bent, early = kvv + kev * dt + kee * half * half, half * command
        kappa = dt * ((kee * half + kev) * (speed + early) + (kev * half + kvv) * command) + half * bent * error
        found = {
            "he": steep, "hv": float(np.abs(hv).max()), "flow_h": float(flow_h.max()), "speed": speed,
            "hold": steep * early + half * kee * speed * (speed + dt * command) + dt * kev * speed * command
            + half * bent * command**2 + (steep * half + kappa) * error,
        }  # fmt: skip
        most = {key: max(value, most.get(key, 0.0)) for key, value in found.items()}
    return most


def _eta_together(
    condition: Condition, nodes: F64, eta: float, sources: dict[str, tuple[float, float, float]]
) -> float:
    """Where all sources together put h off by most."""
    x, y, t = (sum(each[i] for each in sources.values()) for i in range(3))
    worst = 0.0
    for piece in condition.pieces:
        v, he, hv = _edge(condition, piece, eta)
        flow = np.maximum(*(np.abs(he * v + hv * a) for a in (nodes[N_LOW].min(), nodes[N_HIGH].max())))
        worst = max(worst, float((np.abs(he) * x + np.abs(hv) * y + t * flow).max()))
    return worst


def _hardest(condition: Condition, nodes: F64) -> tuple[float, float, float]:
    """What q loses for each m and m/s of offset where braking is hardest, over |dh/dv| there; that; of both ways."""
    low, high = float(nodes[N_LOW].min()), float(nodes[N_HIGH].max())
    lost = list[tuple[float, float, float]]()
    for piece in condition.pieces:
        kee, kev, kvv = (float(k.hi) for k in piece.curvature())
        if piece.quadratic:
            _, centre, _, p12, p22 = piece.p
            for out, u in ((p22**-0.5, low), (-(p22**-0.5), high)):
                v, steep, he = centre + out, 2.0 * p22 * abs(out), -2.0 * p12 * out
                lost.append((abs(kee * v + kev * u) / steep, abs(he - kev * v - kvv * u) / steep, steep))
            continue
        sign, _, reaction, brake, scale = piece.p
        steep, u = (reaction + condition.fastest_of(piece) / brake) / scale, low if sign > 0.0 else high
        lost.append((0.0, (1.0 / scale + kvv * abs(u)) / steep, steep))
    return max(x for x, _, _ in lost), max(y for _, y, _ in lost), max(z for _, _, z in lost)


def _edge(condition: Condition, piece: Piece, eta: float) -> tuple[F64, F64, F64]:
    """Speeds and gradients where slopes are greatest: an ellipse's edge, the ends of a stopping distance's speeds."""
    if piece.quadratic:
        _, cv, p11, p12, p22 = piece.p
        angle, det = np.linspace(0.0, 2.0 * np.pi, 3601), p11 * p22 - p12 * p12
        grown = math.sqrt(1.0 + eta)
        dv = grown * math.sqrt(p11 / det) * np.sin(angle)
        de = grown / math.sqrt(p11) * np.cos(angle) - p12 / p11 * dv
        return cv + dv, -2.0 * (p11 * de + p12 * dv), -2.0 * (p12 * de + p22 * dv)
    sign, _, reaction, brake, scale = piece.p
    v = (condition.fastest() + eta * scale / reaction) * np.array([-1.0, 1.0])
    return v, np.full(2, -sign / scale), -sign * (reaction + np.maximum(sign * v, -brake * reaction) / brake) / scale
