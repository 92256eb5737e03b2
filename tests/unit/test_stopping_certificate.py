"""Certificates of a stop: what the independent checker passes and refuses, and for whom a file holds."""

from __future__ import annotations

import dataclasses
import json
import pickle
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from typing import Any

import numpy as np
import pytest

from flightstack.barrier.estimate_bounds import estimate_bounds
from flightstack.certificate_check import check, left
from flightstack.certificate_check import stopping as stopping_check
from flightstack.cli import files
from flightstack.cli.certify_site import narrowed
from flightstack.cli.checking import check_text
from flightstack.cli.protection import governor_for
from flightstack.cli.sensors import error_statistics
from flightstack.model import Limits, Model
from flightstack.rows import ACC_E, ACC_N, JERK_E, JERK_N, VEL_N, WAY_RADIUS
from flightstack.site import backup
from flightstack.site.certificate import _WAY, as_json, prior_of, require_same
from flightstack.site.law import led_lags
from flightstack.site.stopping import Prior, StoppingCertificate, stopping
from flightstack.site.tube import of_gains
from flightstack.types import F64, STANDARD_GRAVITY_MPS2, InputError
from flightstack.vehicle import Vehicle
from flightstack_sim.grade import load_grade
from tests.thorough import THOROUGH, thorough

LEARNED = {"gain": 0.995, "gain_sigma": 0.008, "force_mps2": 0.3, "flight_s": 60.0, "speed_mps": 5.0}
"""What a flight would have to show for the prior below."""


@cache
def _of_prior(prior: Prior, grade: str = "mocap", vehicle: str | None = None) -> StoppingCertificate:
    believed, _ = files.load_vehicle(vehicle)
    model = Model.from_vehicle(believed)
    estimate = estimate_bounds(error_statistics(load_grade(grade)))
    return stopping(believed, model, Limits(), estimate, governor_for(believed, model, Limits(), grade), prior)


@pytest.fixture(scope="module", autouse=True)
def searched_once() -> Iterator[None]:
    """What the checker finds of the same loop, or the same ways, is kept: the search takes nearly all of its time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(stopping_check, "_radius", _once(stopping_check._radius))
        patch.setattr(stopping_check, "left", _once(stopping_check.left))
        yield


@pytest.fixture(scope="module")
def made() -> StoppingCertificate:
    return _of_prior(Prior(0.94, 1.08, 0.05, 6.0))


@pytest.fixture(scope="module")
def text(made: StoppingCertificate) -> str:
    return as_json(made, "quad-x", "hash", "mocap", LEARNED)


def test_an_honest_file_is_valid_and_stops_as_is_asked(made: StoppingCertificate, text: str) -> None:
    verdict = check_text(text, "stopping.json")  # within the memory and the time that a user's check has
    assert verdict.valid, verdict.lines
    assert made.stopping_way_m(5.0, 0.0) < 4.2
    assert made.radius_m < 0.35


LEANT = [
    (4.5 + 0j, -5 + 0j), (3.5 + 0j, -3.5 + 2j), (2.5 + 0j, 4j), (1.5 + 0j, 2 + 1j), (5.5 + 0j, -5.5 + 1j),
    (1 + 0j, 6 + 0j),
    (1.2 + 0j, 4 + 0j), (2.2 + 0j, 1 + 5.8j), (0.8 + 0j, -4 + 4j), (2.8 + 0j, -4 + 4j), (0.2j, 5 + 0j),
]  # fmt: skip


def _turning(count: int) -> list[tuple[complex, complex, complex]]:
    """Drawn motions: up to 6 m/s and a lean of 7 m/s^2 in any direction, which turns in any direction."""
    rng = np.random.default_rng(5)
    speed, lean, turns = rng.uniform((0.0, 0.0, 2.0), (6.0, 7.0, 24.0), (count, 3)).T
    ways = np.exp(2j * np.pi * rng.uniform(size=(2, count)))
    return list(zip((speed + 0j).tolist(), (lean * ways[0]).tolist(), (turns * ways[1]).tolist(), strict=True))


def _left_and_claimed(made: StoppingCertificate, row: F64, motions: Sequence[tuple[complex, ...]]) -> tuple[F64, F64]:
    """How far ways are left by the checker's own search, and the product's radius."""
    across = made.across.gains
    way = left.Way(*(float(row[at]) for at in _WAY.values()))
    loop = left.ClosedLoop(
        *across, *made.lags_s[0], made.turning.sure_mps4, way.lean_mps2,
        min(made.turning.rate_radps * STANDARD_GRAVITY_MPS2, 2.0 * way.jerk_mps3),
    )  # fmt: skip
    force = np.hypot(*(line.across_mps2 for line in made.ledger[:2]))
    found = left.left(
        [left.laid_out(way, loop, *motion) for motion in motions], loop, np.array([force, *made.doubts[0][1:]])
    )
    return found, _claimed(row, motions)


def _claimed(row: F64, motions: Sequence[tuple[complex, ...]]) -> F64:
    """Radii by a row of the product; infinite where there is no way."""
    claimed, points, laid = [], np.zeros((backup.STEPS, backup.ROW)), np.zeros((backup.STEPS, 5))
    for speed, lean, *turns in motions:
        start = np.zeros(backup.ROW)
        start[VEL_N : VEL_N + 2] = speed.real, speed.imag
        start[ACC_N], start[ACC_E] = lean.real, lean.imag
        if turns:
            start[JERK_N : JERK_E + 1] = start[backup.ASKED_N : backup.ASKED_N + 2] = turns[0].real, turns[0].imag
        count = backup.roll(start, row, np.zeros(backup.STEPS), points, laid)
        claimed.append(float(np.min(laid[:count, WAY_RADIUS])) if count else np.inf)
    return np.array(claimed)


KINDS = [(Prior(), 0), (Prior(), 4), (Prior(), -1), (Prior(0.94, 1.08, 0.05, 6.0), 0)]


@pytest.mark.parametrize(("prior", "at"), [thorough(*kind) for kind in KINDS])
def test_a_way_that_begins_leaning_far_keeps_its_tube(prior: Prior, at: int) -> None:
    """Motions that none is searched for, driven by the checker's own search: where only speed and what lean adds to it
    counted, the prior's ways were left by up to 2.4 m of 1.1 m claimed (braking), by 1.5 of 0.8 m (sideways)."""
    made = _of_prior(prior)
    found, claimed = _left_and_claimed(made, made.rows[at], LEANT)
    assert np.isfinite(claimed).all()
    assert np.all(found < claimed), (found, claimed)


@pytest.mark.parametrize(("prior", "at"), [KINDS[0], thorough(*KINDS[2]), thorough(*KINDS[3])])
def test_a_way_that_begins_turning_keeps_its_tube(prior: Prior, at: int) -> None:
    """As above: without what turning adds, ways were left by up to 3.2 times the claim."""
    made, motions = _of_prior(prior), _turning(16)
    found, claimed = _left_and_claimed(made, made.rows[at], motions)
    is_way = np.isfinite(claimed)
    assert is_way.sum() >= 12
    assert np.all(found[is_way] < claimed[is_way]), (found, claimed)
    row = made.rows[at].copy()
    row[backup.PER_TURN] = 0.0
    before = _claimed(row, motions)
    assert np.array_equal(np.isfinite(before), is_way)
    assert np.any(found[is_way] > before[is_way])


@pytest.mark.parametrize(
    ("grade", "vehicle", "motion", "driven_m"),
    [
        ("gps", None, (0j, -5.43979 + 2.96471j, -2.50079 - 18.53281j), 21.73),
        thorough("mocap", "px4-sihsim-quadx", (2 + 0j, 5.73 - 3.6j, -22.06 - 2.05j), 15.35),
        thorough("mocap", "px4-sihsim-quadx", (0j, -3.04 + 5.68j, 19.2 - 2.14j), 13.27),
        thorough("mocap", "px4-sihsim-quadx", (0.5 + 0j, 3.18 + 4.11j, 9.12 - 13.39j), 8.83),
    ],
)
def test_a_way_of_the_lightest_that_was_drawn_afterwards_keeps_its_tube(
    grade: str, vehicle: str | None, motion: tuple[complex, ...], driven_m: float
) -> None:
    """So far the product's search drives the model; 20.4, 12.8, 10.6 and 8.5 m were claimed by what the lightest's own
    ways need."""
    made = _of_prior(Prior(), grade, vehicle)
    found, claimed = _left_and_claimed(made, made.rows[-1], [motion])
    assert max(float(found[0]), driven_m) < claimed[0] < np.inf


def test_no_way_begins_with_more_turning_than_is_searched(made: StoppingCertificate) -> None:
    start, points, way = np.zeros(backup.ROW), np.zeros((backup.STEPS, backup.ROW)), np.zeros((backup.STEPS, 5))
    for turning, snap, is_way in ((24.0, 0.0, True), (26.0, 0.0, False), (20.0, 1000.0, False)):
        start[JERK_N] = start[backup.ASKED_N] = turning
        start[backup.SNAP_N] = snap
        assert (backup.roll(start, made.rows[0], np.zeros(backup.STEPS), points, way) > 0) is is_way


def _set(*path: object, to: object) -> Callable[[dict[str, Any]], None]:
    def change(said: Any) -> None:
        for key in path[:-1]:
            said = said[key]
        said[path[-1]] = to

    return change


def _times(*path: object, by: float) -> Callable[[dict[str, Any]], None]:
    def change(said: Any) -> None:
        for key in path[:-1]:
            said = said[key]
        said[path[-1]] *= by

    return change


@pytest.mark.parametrize(
    ("forge", "said"),
    [
        (_times("across", "radius_m", by=0.7), "across: the tube reaches"),
        (_times("across", "radius_m", by=0.95), "at rest is the widest"),
        (_times("way_least", "rest_radius_m", by=0.85), "little motion) are left by"),
        thorough(_times("way_least", "most_radius_m", by=0.9), "much motion) are left by"),
        (_times("way_least", "per_lean_s2", by=0.75), "leaning"),
        (_set("way_least", "per_turn_s6pm", to=0.0), "turning"),
        (_times("way_least", "slow_mps4", by=9.0), "no more than all of the snap"),
        (_times("way_most", "lean_mps2", by=0.9), "less than that of the least gain"),
        (_set("way_most", "ease", to=0.0), "nothing of it may be 0"),
        (_times("along", "radius_m", by=0.9), "along: the tube reaches"),
        (_times("across", "force_mps2", by=0.5), "less than its lines"),
        (_times("along", "rest_mps2", by=0.5), "less than its lines"),
        (_times("ledger", 0, "across_mps2", by=0.5), "less than the prior's"),
        (_set("ledger", 3, "name", to="luck"), "torque is expected"),
        (_times("ledger", 2, "across_mps2", by=-1.0), "negative"),
        thorough(_times("across", "lag_s", by=2.5), "across"),
        (_times("across", "lag_s", by=6.0), "settle"),
        (_set("across", "rotors_s", to=0.0), "rotors"),
        (_set("along", "rotors_s", to=0.02), "rotors"),
        (_times("turning", "snap_mps4", by=0.3), "no more than all of the snap"),
        (_set("turning", "snap_mps4", to=0.0), "turning: nothing"),
        (_times("turning", "lean_mps2", by=4.0), "turning: a lean"),
        (_set("across", "pos_ps3", to=0.0), "does not settle"),
        (_times("braking", "across_mps2", by=3.0), "braking"),
        (_set("prior", "mass_high", to=1.8), "takes more than the least thrust"),
        (_set("prior", "force_g", to=0.3), "less than the prior's"),
        (_set("across", "radius_m", to=float("nan")), "number"),
        (_set("across", "more", to=1.0), "not known"),
        (_set("prior", "mass_high", to=1.0), "learned"),
        (_set("prior", "mass_low", to=1.0), "learned"),
        (_set("learned", "gain", to=0.9), "learned"),
        (_set("learned", "gain_sigma", to=0.1), "learned"),
        (_set("learned", "force_mps2", to=0.9), "learned"),
        (_set("learned", "force_mps2", to=1.6), "held against"),
        (_set("learned", "speed_mps", to=4.8), "learned.speed_mps"),
        (_set("prior", "speed_mps", to=6.2), "learned.speed_mps"),
        (_set("stops_within_m", "5 m/s", to=2.2), "stops_within_m"),
        (_set("stops_within_m", "3 m/s", to=9.0), "stops_within_m"),
    ],
)
def test_a_forged_file_is_refused(text: str, forge: Callable[[dict[str, Any]], None], said: str) -> None:
    table = json.loads(text)
    forge(table)
    verdict = check(json.dumps(table))
    assert not verdict.valid
    assert said in verdict.lines[-1]


@pytest.mark.parametrize("schema", ["flightstack.stopping/3", "flightstack.stopping/60", "flightstack.stopping/"])
def test_one_of_another_version_is_told_which_is_read(text: str, schema: str) -> None:
    verdict = check(text.replace("flightstack.stopping/6", schema))
    assert not verdict.valid
    assert not verdict.readable
    assert verdict.lines == [
        f'schema is "{schema}", not "flightstack.stopping/6": make the certificate of a stop anew with certify --site'
    ]


def leaves(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[tuple[Any, ...], float]]:
    """Every number of a file and its place."""
    parts = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, part in parts:
        yield from leaves(part, (*path, key))
    if isinstance(value, int | float):
        yield path, float(value)


@pytest.fixture
def first_ways_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """What the checker finds of ways is that of the honest file: a number that it would refuse has to be found by who
    flies by it as well."""
    monkeypatch.setattr(stopping_check, "left", _once(stopping_check.left, is_first_only=True))


def _once(work: Callable[..., Any], *, is_first_only: bool = False) -> Callable[..., Any]:
    kept: dict[bytes, Any] = {}

    def once(*given: Any) -> Any:
        key = b"" if is_first_only else pickle.dumps(given)
        if key not in kept:
            kept[key] = work(*given)
        return kept[key]

    return once


@pytest.mark.usefixtures("first_ways_kept")
def test_no_number_that_a_flight_uses_can_be_changed(made: StoppingCertificate, text: str) -> None:
    """What the checker cannot know (vehicle, sensors) is compared with what follows from the file's own prior."""
    assert check(text).valid
    count = 0
    for at, (path, value) in enumerate(leaves(json.loads(text))):
        if path[0] == "learned":  # it is where the prior comes from; what it must not say is above
            continue
        if at % 2 and not THOROUGH:
            continue
        for factor in (0.99, 1.01) if THOROUGH else (0.99 + 0.01 * (at % 4),):
            table = json.loads(text)
            _set(*path, to=value * factor if value else 0.01)(table)
            changed = json.dumps(table)
            again = made if path[0] != "prior" else None
            if not check(changed).valid or again is None:
                continue
            with pytest.raises(InputError, match="does not follow"):
                require_same(changed, "a.json", again)
            count += 1
    assert count > (20 if THOROUGH else 10)


def test_for_whom_it_holds(made: StoppingCertificate, text: str) -> None:
    assert prior_of(text, "a.json", "hash", "mocap") == made.prior
    require_same(text, "a.json", made)
    for other in (("another", "mocap"), ("hash", "gps")):
        with pytest.raises(InputError, match="made for"):
            prior_of(text, "a.json", *other)
    with pytest.raises(InputError, match="certify --site"):
        prior_of('{"schema": "flightstack.certificate/6"}', "a.json", "hash", "mocap")
    table = json.loads(text)
    table["across"]["acc_ps"] *= 1.1
    with pytest.raises(InputError, match="does not follow"):
        require_same(json.dumps(table), "a.json", made)


def test_what_a_flight_leaves_open_stays_within_the_prior() -> None:
    calm = narrowed(1.0, 0.01, 0.2, 0.1, 4.0)
    assert calm.mass_low < 1.0 < calm.mass_high
    assert calm.force_g == pytest.approx((1.5 * 0.2 + 0.1) / 9.80665)
    assert calm.speed_mps == pytest.approx(4.0 * 1.5**0.5)  # what was felt grows with the square of the speed
    wild = narrowed(0.7, 0.2, 9.0, 0.1, 4.0)
    assert wild.mass_low >= 0.8
    assert wild.mass_high <= 1.5
    assert wild.force_g == 0.15


def _powerful(weights: float) -> tuple[Vehicle, Model]:
    """A vehicle with rotors whose thrust is linear in the command, as PX4's internal simulator has them."""
    believed, _ = files.load_vehicle("px4-sihsim-quadx")
    most_n = weights * believed.mass_kg * STANDARD_GRAVITY_MPS2 / 4.0
    rotors = dataclasses.replace(believed.rotors, max_thrust_n=most_n)
    vehicle = dataclasses.replace(believed, rotors=rotors)
    return vehicle, Model.from_vehicle(vehicle)


@pytest.mark.parametrize("weights", [thorough(2.9), 4.0, thorough(5.0)])
def test_a_powerful_vehicle_is_let_down(weights: float) -> None:
    """The lightest of the prior beside its force upwards: what thrust at D leaves of the weight brakes a climb."""
    vehicle, model = _powerful(weights)
    governor = governor_for(vehicle, model, Limits(), "mocap")
    estimate = estimate_bounds(error_statistics(load_grade("mocap")))
    prior = Prior()
    least_mps2 = weights * STANDARD_GRAVITY_MPS2 * governor.margin  # linear: thrust by command
    left = STANDARD_GRAVITY_MPS2 * (1.0 - prior.force_g) - least_mps2 / prior.mass_low
    made = stopping(vehicle, model, Limits(), estimate, governor)
    text = as_json(made, vehicle.name, "hash", "mocap", {**LEARNED, "gain_sigma": 1.0, "force_mps2": 1.4})
    assert 0.4 < json.loads(text)["braking"]["down_mps2"] < left
    assert not THOROUGH or check(text).valid, check(text).lines
    forged = json.loads(text)
    forged["braking"]["least_thrust_mps2"] = prior.mass_low * STANDARD_GRAVITY_MPS2
    verdict = check(json.dumps(forged))
    assert not verdict.valid
    assert "the least thrust and the force leave" in verdict.lines[-1]


def test_one_that_can_not_come_down_is_refused() -> None:
    """At ten weights and with a noisy gyro what rotors need to turn it carries the lightest vehicle of the prior."""
    vehicle, model = _powerful(10.0)
    governor = governor_for(vehicle, model, Limits(), "px4-sih-ekf")
    assert 10.0 * governor.margin > 0.7
    with pytest.raises(InputError, match="a climb is not braked"):
        stopping(vehicle, model, Limits(), estimate_bounds(error_statistics(load_grade("mocap"))), governor)


def test_a_refusal_says_what_is_missing() -> None:
    estimate = estimate_bounds(error_statistics(load_grade("mocap")))
    vehicle, model = _powerful(1.7)
    with pytest.raises(InputError, match=r"its rotors give 1\.70.* 0\.15 g take 1\.72: .*a certificate of less mass"):
        stopping(vehicle, model, Limits(), estimate, governor_for(vehicle, model, Limits(), "mocap"))
    vehicle, model = _powerful(4.0)
    governor = governor_for(vehicle, model, Limits(), "mocap")
    ringing = dataclasses.replace(governor, chi=90.0, margin=0.49)
    with pytest.raises(InputError, match=r"torque up to 90 times what is modelled.*MC_ROLLRATE_K"):
        stopping(vehicle, model, Limits(), estimate, ringing)


def test_a_way_out_does_not_turn_back_where_little_snap_takes_lean_back() -> None:
    """5 kg that turn slowly stopped from 2 m/s by flying back at 0.9: the nominal way alone, without any doubt."""
    believed, _ = files.load_vehicle(None)
    heavy = dataclasses.replace(
        believed, mass_kg=5.0, inertia_kgm2=np.array([0.2, 0.21, 0.34]),
        rotors=dataclasses.replace(
            believed.rotors, position_m=believed.rotors.position_m * 0.4 / np.hypot(*believed.rotors.position_m[0, :2]),
            max_thrust_n=2.0 * 5.0 * STANDARD_GRAVITY_MPS2 / 4.0, time_constant_s=0.06,
        ),
    )  # fmt: skip
    model, estimate = Model.from_vehicle(heavy), estimate_bounds(error_statistics(load_grade("mocap")))
    made = stopping(heavy, model, Limits(), estimate, governor_for(heavy, model, Limits(), "mocap"))
    # and is driven further than a loop that turns as fast as it likes
    linear = of_gains(made.across.gains, led_lags(*made.lags_s[0]), made.doubts[0])
    assert linear is not None
    assert made.radius_m > 1.5 * linear.radius_m[-1]
    if THOROUGH:
        verdict = check(as_json(made, "heavy", "hash", "mocap", {**LEARNED, "gain_sigma": 1.0, "force_mps2": 1.4}))
        assert verdict.valid, verdict.lines
    start, points, way = np.zeros(backup.ROW), np.zeros((backup.STEPS, backup.ROW)), np.zeros((backup.STEPS, 5))
    for speed in (1.5, 2.5, 4.0):
        start[VEL_N] = speed
        count = backup.roll(start, made.rows[8], made.halves()[1], points, way)
        assert count > 0
        assert points[:count, VEL_N].min() > -0.12 * speed
