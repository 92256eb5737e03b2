"""What ties a certificate to a flight: all that its bounds rest on, derived anew from the log and the vehicle file.

    file        the vehicle's SHA-256, drag, rotors, mass, inertia, damping and lag, its autopilot's gains and limits
                and the rate loop's lag (`autopilot`); the log's SHA-256 over its ticks (`samples`); the seal of the
                certificate that the log itself ends with
    points      each x and y is the mean of the samples of its own window, to 1e-9; no two windows overlap
    noise       stated with the windows' own colour (`confidence`), at least the lower limit of what all windows show
    windows     all windows from a store's first on, not only those chosen, miss mean -+ 3 sigma no more often
                than 1 % can explain
    lag, delay  some pair within the doubts of both (the lag's and half a tick) explains the force's fast part as well
                as the best of all pairs does: as one in 40 true ones does not, by chi squared of two.  Below 0.2 m/s^2
                of thrust's fast part the log says nothing
    log         over 1 s spans, rates explain the attitude and force explains the velocity, in all but 0.1 %
    age         in 49 of 50 ticks the newest sample was no older than the premise's age_s, which the maker takes so that
                99 of 100 are

A log that is invented from beginning to end passes: only a signature by the recorder would help.
"""

from __future__ import annotations

import hashlib
import json
import math
import tomllib
from typing import Any, BinaryIO

import numpy as np

from .autopilot import check_autopilot
from .confidence import check_colour
from .gaussian import posterior
from .intervals import F64, I64
from .knowledge import StatedKnowledge, StatedProcess
from .log import FlightRecording, read_log
from .reading import Refused, Unreadable, table_of
from .samples import AWAY_M, WANTED, WINDOW, Believed, DerivedSamples, Ticks, lagged, matrices, samples

_KEYS = ("log_sha256", "vehicle_sha256", "from_us", "until_us")
_FINAL = "certificate-final.json"
_NEAR = 1e-9
_LATEST_US = 2**53
_SIGMAS, _CLAIM = 3.0, 0.01
_EXCITED_MPS2 = 0.2
_SLOW_S = 0.1
_HALF_TICK_S = 0.002
_LADDER_S = np.geomspace(0.004, 0.1, 9)
"""Lags that any vehicle's rotors may have."""
_CHI2 = 7.4
_OLDER, _ROUNDED_S = 0.02, 0.0005


def check_keys(value: Any, stores: list[StatedProcess]) -> bool:
    """Whether the file names a flight; `Unreadable` where it does so in another form."""
    if value is None:
        return False
    table = table_of(value, _KEYS, "provenance")
    for key in _KEYS[:2]:
        if not isinstance(table[key], str) or len(table[key]) != 64:
            raise Unreadable(f"provenance.{key} must be a SHA-256 in hexadecimal")
    for key in _KEYS[2:]:
        if type(table[key]) is not int or not 0 <= table[key] < _LATEST_US:
            raise Refused(f"provenance.{key} must be a whole number from 0")
    for store in stores:
        windows = store.windows_us
        if len(windows) != len(store.x) or not np.all(windows[:, 0] < windows[:, 1]):
            raise Refused("provenance: a point does not name its window's beginning and end")
        if windows.min() < table["from_us"] or windows.max() > table["until_us"]:
            raise Refused("provenance: a window lies outside the ticks that are named")
    return True


def _away_m(estimate: Any) -> float:
    """So far from the place of take-off learning may begin: no vehicle at rest there seems to be further away."""
    return max(AWAY_M, 2.0 * math.hypot(*estimate["pos_m"]))


def check_flight(
    data: dict[str, Any], known: StatedKnowledge, log: BinaryIO | FlightRecording, vehicle: bytes | None, seal: Any
) -> list[str]:
    """Verify a certificate that is valid for itself against its log; what was verified, in words."""
    if not known.stores:
        raise Refused("provenance: nothing was learned, so no flight is named")
    if not check_keys(data["provenance"], known.stores):
        raise Refused("provenance: the certificate names no flight")
    named = data["provenance"]
    recording = log if isinstance(log, FlightRecording) else read_log(log, WANTED)
    believed = _vehicle(named, known, recording, vehicle)
    _check_frame(data["governor"]["vehicle"], known.data["doubts"], believed)
    check_autopilot(data["governor"], data["axes"], believed.file)
    ticks = Ticks.of(recording, named["from_us"], named["until_us"])
    if hashlib.sha256(ticks.bytes()).hexdigest() != named["log_sha256"]:
        raise Refused("provenance.log_sha256 is not the hash of this log's ticks")
    if _sealed(recording) != seal:
        raise Refused("log: the certificate that it ends with is another one")
    lines = [f"log: {len(ticks.t_us)} ticks of the flight that is named, from {named['from_us'] * 1e-6:.2f} s on"]
    found = samples(ticks, believed, _away_m(data["premises"]["estimate"]))
    lines.append(_check_points(known, found))
    lines += _check_windows(known, found)
    lines.append(_check_delay(data, known, found, believed))
    lines.append(_check_itself(ticks, data["premises"]["estimate"]))
    lines.append(check_age(ticks, float(data["premises"]["age_s"])))
    return lines


def check_age(ticks: Ticks, age_s: float) -> str:
    """Refused where the newest sample was older than stated more often than now and then."""
    ages_s = np.min([ticks.tick[f"{name}_age_us"] for name in ("position", "attitude", "imu")], axis=0) * 1e-6
    older = int(np.sum(ages_s > age_s + _ROUNDED_S))
    if older > _OLDER * len(ages_s):
        raise Refused(
            f"premises.age_s = {age_s:g}: in {older} of {len(ages_s)} ticks of the log the newest sample was older"
        )
    return f"age: the newest sample older than {1e3 * age_s:.3g} ms in {older} of {len(ages_s)} ticks"


def _vehicle(
    named: dict[str, Any], known: StatedKnowledge, recording: FlightRecording, vehicle: bytes | None
) -> Believed:
    """The believed vehicle: of the file given, or of the one that the log carries."""
    data = recording.attachments.get("vehicle.toml") if vehicle is None else vehicle
    if data is None:
        raise Unreadable("log: carries no vehicle.toml; name the vehicle file")
    data = data.replace(b"\r\n", b"\n")
    if hashlib.sha256(data).hexdigest() != named["vehicle_sha256"]:
        raise Refused("provenance.vehicle_sha256 is not the hash of this vehicle file")
    try:
        believed = Believed.of(tomllib.loads(data.decode()))
    except (UnicodeDecodeError, tomllib.TOMLDecodeError):
        raise Unreadable("vehicle: is no TOML file") from None
    drag = believed.drag_kgps / believed.mass_kg
    stated = np.array([*known.data["drag_per_s"], known.data["rotor_radius_m"]])
    if not np.abs(stated - np.array([*drag, believed.radius_m])).max() <= _NEAR:
        raise Refused("knowledge.drag_per_s and rotor_radius_m are not the vehicle file's")
    return believed


def _check_frame(stated: dict[str, Any], doubts: dict[str, Any], believed: Believed) -> None:
    """Refused where the governor's vehicle, or the lag that lateral delays count with, is not the vehicle file's."""
    of_file = believed.frame | {
        "max_thrust_n": believed.max_thrust_n, "mass_kg": believed.mass_kg, "rotor_lag_s": believed.lag_s,
        "thrust_model_factor": believed.factor,
    }  # fmt: skip
    for key, value in of_file.items():
        if not np.allclose(np.array(stated[key], np.float64), np.array(value, np.float64), rtol=_NEAR, atol=_NEAR):
            raise Refused(f"governor.vehicle.{key} is not the vehicle file's")
    if not abs(float(doubts["rotor_lag_s"]) - believed.lag_s) <= _NEAR:
        raise Refused("knowledge.doubts.rotor_lag_s is not the rotors' lag of the vehicle file")


def _sealed(recording: FlightRecording) -> Any:
    """The seal of the certificate that the log ends with."""
    try:
        return json.loads(recording.attachments[_FINAL])["seal"]
    except (KeyError, ValueError, TypeError, RecursionError):
        raise Refused("log: it ends without a certificate") from None


def _check_points(known: StatedKnowledge, found: DerivedSamples) -> str:
    for name, store, columns in zip(("lateral", "vertical"), known.stores, (slice(0, 2), slice(2, 3)), strict=True):
        first, last = (
            np.searchsorted(found.t_us, store.windows_us[:, 0]),
            np.searchsorted(found.t_us, store.windows_us[:, 1]),
        )
        last = np.minimum(last, len(found.t_us) - 1)
        there = (found.t_us[np.minimum(first, last)] == store.windows_us[:, 0]) & (
            found.t_us[last] == store.windows_us[:, 1]
        )
        whole = there & (last - first == WINDOW - 1)
        if not whole.all():
            raise Refused(
                f"knowledge.{name}: point {np.flatnonzero(~whole)[0]}: its window is not {WINDOW} ticks of the log"
            )
        if np.any(np.diff(np.sort(first)) < WINDOW):
            raise Refused(f"knowledge.{name}: two windows overlap")
        index = first[:, None] + np.arange(WINDOW)
        if not found.fit[index].all():
            raise Refused(f"knowledge.{name}: a window holds samples that are not fit to learn from")
        for what, stated, derived in (("x", store.x, found.x[index]), ("y", store.y, found.y[index][:, :, columns])):
            mean = derived.mean(axis=1)
            off = np.abs(stated - mean) - _NEAR * (1.0 + np.abs(mean))
            if not off.max() <= 0.0:
                i, j = np.unravel_index(np.argmax(off), off.shape)
                raise Refused(f"knowledge.{name}.{what}[{i}][{j}] = {stated[i, j]:.9g}, the log gives {mean[i, j]:.9g}")
    return f"points: {' and '.join(str(len(s.x)) for s in known.stores)} derived anew from their windows in the log"


def all_windows(found: DerivedSamples, from_us: int) -> tuple[F64, F64, I64]:
    """x (n, 7), y (n, 3) and last sample (n,) of windows of fit samples one after the other, from a stamp on."""
    run, ends = 0, list[int]()
    for i in range(int(np.searchsorted(found.t_us, from_us)), len(found.fit)):
        run = run + 1 if found.fit[i] else 0
        if run == WINDOW:
            ends.append(i)
            run = 0
    last = np.array(ends, np.int64)
    index = last[:, None] + np.arange(1 - WINDOW, 1)
    return found.x[index].mean(axis=1), found.y[index].mean(axis=1), last


def _check_windows(known: StatedKnowledge, found: DerivedSamples) -> list[str]:
    """Noise and misses of all windows."""
    lines = []
    for name, store, columns in zip(("lateral", "vertical"), known.stores, (slice(0, 2), slice(2, 3)), strict=True):
        x, y, last = all_windows(found, int(store.windows_us.min()))
        mean, variance, _ = posterior(store.spec, store.x, store.y, store.lower, x, name)
        error = y[:, columns] - mean
        steady = error - store.drifted(found.t_us[last])
        for i in range(error.shape[1]):
            blocks = max(len(error) // 10, 2)
            stated = float(store.inflation[i]), float(store.excess[i])
            try:
                shown = check_colour(steady[:, i], last, store.noise_var, *stated)
            except Refused as refused:
                raise Refused(f"knowledge.{name}, output {i}: {refused}") from None
            known_var = store.noise_var + stated[0] ** 2 * variance + stated[1]
            missed = np.abs(error[:, i]) > _SIGMAS * np.sqrt(known_var)
            in_blocks = int(np.add.reduceat(missed, np.arange(0, len(missed), 10)).astype(bool).sum())
            if not _could_be(in_blocks, blocks, 10.0 * _CLAIM):
                raise Refused(
                    f"knowledge.{name}: {int(missed.sum())} of {len(missed)} windows of the flight lie beyond mean "
                    f"-+ {_SIGMAS:g} sigma, on output {i}"
                )
            lines.append(
                f"{name} {i}: of all {len(missed)} windows {int(missed.sum())} beyond mean -+ {_SIGMAS:g} sigma; "
                f"their spectrum's peak {math.sqrt(shown):.3g} m/s^2, "
                f"stated {stated[0] * math.sqrt(store.noise_var):.3g}"
            )
    return lines


def _could_be(misses: int, trials: int, claim: float) -> bool:
    """Whether so many misses have a chance of 2.5 % or more, each trial missing with `claim`."""
    below = math.fsum(
        math.exp(math.lgamma(trials + 1) - math.lgamma(k + 1) - math.lgamma(trials - k + 1)
                 + k * math.log(claim) + (trials - k) * math.log1p(-claim))
        for k in range(misses)
    )  # fmt: skip
    return 1.0 - below >= 0.025


def _check_delay(data: dict[str, Any], known: StatedKnowledge, found: DerivedSamples, believed: Believed) -> str:
    """Of all pairs of lag and delay one within their doubts explains the force's fast part as well as the best does."""
    for axis in data["axes"]:
        if axis["axis"] == "down" and abs(float(axis["response"]["c1_s"]) - believed.lag_s) > _NEAR:
            raise Refused("down.response.c1_s is not the rotors' lag of the vehicle file")
    doubts, lag_s = known.data["doubts"], believed.lag_s
    delay = max(float(axis["response"]["delay_s"]) for axis in data["axes"])
    slack, share_s = float(doubts["delay_s"]), float(doubts["lag_share"]) * lag_s + _HALF_TICK_S
    delays = np.unique(np.maximum(delay + 2e-3 * np.arange(-8, 9), 0.0))
    counted = np.abs(delays - delay) <= slack + _NEAR
    force = _fast(found.force_z[:, None], found.dt_s)[found.fit]
    within, best = math.inf, (math.inf, 0.0, 0.0)
    near = np.maximum(lag_s + share_s * np.linspace(-1.0, 1.0, 7), 1e-3)
    for lag in (*near, *_LADDER_S):  # one after the other: less memory
        lags = np.full(len(delays), lag)
        thrust = believed.thrust_n(lagged(found.sent_s, found.sent_norm, found.middle_s, found.dt_s, delays, lags))
        fast = _fast(thrust / believed.mass_kg, found.dt_s)[found.fit]
        if not fast.std(axis=0).max() >= _EXCITED_MPS2:
            return "lag and delay: thrust was too steady to tell; the file's doubts alone speak"
        left = ((force - fast * ((fast * force).sum(axis=0) / (fast * fast).sum(axis=0))) ** 2).sum(axis=0)
        place = int(np.argmin(left))
        best = min(best, (float(left[place]), float(lag), float(delays[place])))
        if abs(lag - lag_s) <= share_s + _NEAR:
            within = min(within, float(left[counted].min()))
    worse = (within / best[0] - 1.0) * len(force)
    if not worse <= _CHI2 * float(known.stores[1].inflation[0]) ** 2:
        raise Refused(
            f"response: {1e3 * lag_s:.3g} ms of lag, known to {1e3 * share_s:.2g} ms, and {1e3 * delay:.3g} ms of "
            f"delay, known to {1e3 * slack:.3g} ms, are counted with; the log shows {1e3 * best[1]:.3g} and "
            f"{1e3 * best[2]:.3g} ms"
        )
    return f"lag and delay: {1e3 * best[1]:.3g} and {1e3 * best[2]:.3g} ms explain the log best, within their doubts"


def _fast(values: F64, dt_s: F64) -> F64:
    """(n, k) without what is slower than 0.1 s."""
    mean, out = np.zeros(values.shape[1]), np.empty(values.shape)
    share = 1.0 - np.exp(-dt_s / _SLOW_S)
    for i in range(len(values)):
        mean = mean + share[i] * (values[i] - mean)
        out[i] = values[i] - mean
    return out


def _check_itself(ticks: Ticks, estimate: dict[str, Any]) -> str:
    """Rates against attitude, force against velocity, over spans of 1 s."""
    turn, t = matrices(ticks.tick["q_ned_frd"]), ticks.t_us * 1e-6
    rate, vel = ticks.tick["rate_frd_radps"], ticks.tick["vel_ned_mps"]
    dt = np.diff(t, append=t[-1])
    gained = np.einsum("nij,nj->ni", turn, ticks.tick["specific_force_frd_mps2"]) * dt[:, None]
    gained[:, 2] += 9.80665 * dt
    total = np.concatenate([np.zeros((1, 3)), np.cumsum(gained, axis=0)])
    first = np.searchsorted(t, np.arange(t[0], t[-1] - 1.0))
    last = np.searchsorted(t, t[first] + 1.0)
    apart = np.abs(vel[last] - vel[first] - (total[last] - total[first])).max(axis=1)
    steps = _turns_of(rate * dt[:, None])
    off = np.empty(len(first))
    for k, (i, j) in enumerate(zip(first, last, strict=True)):
        q = turn[i]
        for step in steps[i:j]:
            q = q @ step
        off[k] = math.acos(min(max(0.5 * (float(np.trace(q.T @ turn[j])) - 1.0), -1.0), 1.0))
    vel_mps, acc_mps2 = max(estimate["vel_mps"]), max(estimate["acc_mps2"])
    wrong = int(np.sum((apart > 2.0 * vel_mps + acc_mps2 + 0.15) | (off > 3.0 * acc_mps2 / 9.80665 + 0.05)))
    if wrong > max(1, len(first) // 1000):
        raise Refused(f"log: in {wrong} of {len(first)} spans of 1 s its rates or forces do not explain its motion")
    return f"log: rates and forces explain attitude and velocity in {len(first) - wrong} of {len(first)} spans of 1 s"


def _turns_of(angle: F64) -> F64:
    """(n, 3, 3) turns by small rotation vectors, to second order."""
    cross = np.zeros((len(angle), 3, 3))
    cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = -angle[:, 2], angle[:, 1], -angle[:, 0]
    cross -= np.swapaxes(cross, 1, 2)
    out: F64 = np.eye(3) + cross + 0.5 * cross @ cross
    return out
