"""What was learned is judged on other data: true sizes hold there, wrong ones and trifles do not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from benchmarks.gap_cases import make, write
from flightstack.gap import pooled
from flightstack.gap.classes import confused_with, doubled, poorly_told
from flightstack.gap.decisions import CLEARLY
from flightstack.gap.held import (
    fails_holdout,
    far_from_noise,
    interval_contains_nominal,
    mass_for_thrust,
    slope,
    surrogate_terms,
)
from flightstack.gap.judge import gain
from flightstack.gap.naming.bench import simulator_bench
from flightstack.gap.naming.candidates import plausible
from flightstack.gap.naming.design import linearise
from flightstack.gap.naming.estimate import Estimates, estimate
from flightstack.gap.naming.joining import forward_selection_step
from flightstack.gap.naming.metric import metric_of
from flightstack.gap.naming.search import SelectionState
from flightstack.gap.naming.trifles import mse_increase, trifles
from flightstack.gap.pooled import FitHoldoutSplit
from flightstack.gap.records import Estimate, Figures, Gap, IdentifiedEffect
from flightstack.gap.simulate import prediction_error
from flightstack.gap.workflow import analyse
from flightstack.types import F64
from flightstack.vehicle import Vehicle, with_effects
from tests.gap_flights import as_samples, fly, hidden, hover, quad, wander
from tests.thorough import ONLY_THEN, thorough

HIDDEN = {"payload": {"mass_kg": 0.2}, "rotor_drag": {"k_d_kg_per_rad": 2e-4}}
POOR = Gap(Figures(1.0, 1.0, None), Figures(0.9, 0.9, None), Figures(0.1, 0.1, None), 0.1)


@pytest.fixture(scope="module")
def flown() -> FitHoldoutSplit:
    return pooled.split([as_samples(fly(hidden(quad(), HIDDEN), quad(), wander(), seconds=30.0, seed=21))], [])


def found(name: str, times: float = 1.0) -> IdentifiedEffect:
    values = {p: Estimate(0.0, times * x, 0.0, 1.0) for p, x in HIDDEN[name].items()}
    return IdentifiedEffect(name, values, -100.0, 0.5, 1e-9)


def with_drag(times: float) -> Vehicle:
    return hidden(quad(), HIDDEN | {"rotor_drag": {"k_d_kg_per_rad": times * 2e-4}})


@pytest.mark.parametrize(("times", "expected"), [(1.0, 1.0), (2.0, 0.5), (0.5, 2.0)])
def test_the_slope_is_the_true_size_over_the_found_one(flown: FitHoldoutSplit, times: float, expected: float) -> None:
    without = hidden(quad(), {"payload": HIDDEN["payload"]})
    got = slope(without, with_drag(times), flown)
    assert got.value == pytest.approx(expected, rel=0.05)
    assert got.holds(beside=True) == (times == 1.0)


def test_true_effects_hold_and_a_size_of_the_wrong_sign_does_not(flown: FitHoldoutSplit) -> None:
    assert fails_holdout(quad(), [found("payload"), found("rotor_drag")], flown, beside=True) == ()
    assert fails_holdout(quad(), [found("payload", -1.0)], flown, beside=False) == ("payload",)


def test_nothing_held_out_nothing_is_doubted(flown: FitHoldoutSplit) -> None:
    nothing = replace(flown, holdout=tuple(np.zeros_like(m) for m in flown.holdout))
    assert fails_holdout(quad(), [found("payload", -1.0)], nothing, beside=True) == ()


def test_far_from_the_noise_is_where_half_of_what_is_left_is_not_noise() -> None:
    def gap(floor: float) -> Gap:
        return replace(POOR, noise_floor=Figures(floor, floor, None))

    assert far_from_noise(gap(0.9 * 0.70))
    assert not far_from_noise(gap(0.9 * 0.71))


def test_an_estimate_at_the_end_of_its_range_stands_for_something_else() -> None:
    edge = IdentifiedEffect("vortex_ring", {"strength": Estimate(0.0, 1.0, 0.4, 1.0)}, -50.0, 0.1, 1e-9)
    assert surrogate_terms(quad(), [found("payload"), edge], {}) == ("vortex_ring",)


def test_an_inertia_that_no_body_of_that_size_has_stands_for_torques_that_do_not_come() -> None:
    scales = {f"scale_{axis}": Estimate(1.0, x, 1.0, 3.0) for axis, x in zip("xyz", (1.2, 3.0, 1.1), strict=True)}
    assert surrogate_terms(quad(), [IdentifiedEffect("inertia", scales, -50.0, 0.1, 1e-9)], {}) == ("inertia",)


@pytest.mark.parametrize(("down_mps", "proxy"), [(-2.2, True), (0.2, False)])
def test_no_steady_wind_goes_through_the_ground(down_mps: float, proxy: bool) -> None:
    air_mps = {"north_mps": 0.2, "east_mps": -0.2, "down_mps": down_mps}
    blows = {name: Estimate(0.0, x, x, x) for name, x in air_mps.items()}
    wind = IdentifiedEffect("steady_wind", blows, -50.0, 0.1, 1e-9)
    assert surrogate_terms(quad(), [wind, found("payload")], {}) == (("steady_wind",) if proxy else ())


def test_a_wind_beside_a_constant_force_stands_for_something_else_far_from_the_noise() -> None:
    """On an indoor flight they undid each other: 0.0107 N by the drag north, and -0.0098 N; left is their torque."""
    blows = {"north_mps": Estimate(0.0, 1.03, 0.96, 1.10), "east_mps": Estimate(0.0, -0.55, -0.58, -0.51)}
    pushes = {"north_n": Estimate(0.0, -0.0097, -0.0107, -0.0087), "east_n": Estimate(0.0, 0.0064, 0.0059, 0.007)}
    wind = IdentifiedEffect("steady_wind", blows | {"down_mps": Estimate(0.0, 0.0, 0.0, 0.0)}, -64.0, 0.2, 1e-9)
    force = IdentifiedEffect("constant_force", pushes | {"down_n": Estimate(0.0, 0.01, 0.0, 0.02)}, -85.0, 0.1, 1e-9)
    assert surrogate_terms(quad(), [force, wind], {}) == ("steady_wind",)
    assert surrogate_terms(quad(), [wind], {}) == ()


@pytest.mark.parametrize(("mass_kg", "down_n", "gone"), [(0.47, -3.4, True), (0.47, 3.4, False), (-0.2, 1.5, True)])
def test_a_force_that_holds_up_what_was_named_as_weight_is_none(mass_kg: float, down_n: float, gone: bool) -> None:
    """Seen on a 50 Hz log: noise on commands looks like a weight of 4.6 N and a force of 3.4 N that holds it up."""
    values = {"north_n": 0.0, "east_n": 0.0, "down_n": down_n}
    force = {p: Estimate(0.0, x, x - 0.1, x + 0.1) for p, x in values.items()}
    weight = {"mass_kg": Estimate(0.0, mass_kg, mass_kg - 0.1, mass_kg + 0.1)}
    names = [
        IdentifiedEffect("payload", weight, -50.0, 0.1, 1e-9),
        IdentifiedEffect("constant_force", force, -50.0, 0.1, 1e-9),
    ]
    assert doubled(names, quad()) == (("constant_force",) if gone else ())
    assert doubled(names[1:], quad()) == ()


@pytest.mark.parametrize(("scale", "down_n", "gone"), [(0.7, -7.6, True), (0.7, 7.6, False), (1.3, 7.6, True)])
def test_a_force_that_holds_up_what_a_thrust_scale_takes_is_none(scale: float, down_n: float, gone: bool) -> None:
    """Seen on a hover whose thrust fades, 2.87 kg: commands rise, thrust does not; 0.70 of it and 7.6 N from below."""
    values = {"north_n": 0.0, "east_n": 0.0, "down_n": down_n}
    force = {p: Estimate(0.0, x, x - 0.1, x + 0.1) for p, x in values.items()}
    lost = IdentifiedEffect(
        "thrust_scale", {"scale": Estimate(1.0, scale, scale - 0.1, scale + 0.1)}, -136.0, 1.0, 1e-9
    )
    heavy = replace(quad(), mass_kg=2.87)
    assert doubled([lost, IdentifiedEffect("constant_force", force, -77.0, 1.0, 1e-9)], heavy) == (
        ("constant_force",) if gone else ()
    )


def test_a_rotor_beyond_a_whole_one_is_not_weak() -> None:
    """Another order of motors was named a weak rotor of 1.02."""
    assert plausible(quad(), "rotor_fault", "effectiveness") == (0.0, 1.0)
    assert plausible(quad(), "rotor_fault", "rotor") == (1.0, 4.0)


def test_of_two_names_that_are_each_other_s_twin_the_stronger_stays() -> None:
    fault, shift = found("payload"), found("rotor_drag")
    twins = [
        replace(fault, indistinguishable_from=("rotor_drag",)),
        replace(shift, indistinguishable_from=("payload",)),
    ]
    assert doubled(twins, quad()) == ("rotor_drag",)
    assert doubled([twins[0], shift], quad()) == ()


def test_what_changes_from_stretch_to_stretch_is_no_effect_beside_a_poor_model() -> None:
    named = [found("payload"), found("rotor_drag")]
    assert surrogate_terms(quad(), named, {"payload": 1e-12, "rotor_drag": 0.5}) == ("payload",)


def test_what_only_trims_is_taken_back_and_what_is_there_stays(flown: FitHoldoutSplit) -> None:
    masks = [[m & s.valid for m, s in zip(part, flown.flights, strict=True)] for part in (flown.fit, flown.holdout)]
    bench = simulator_bench(quad(), flown.flights, *masks)
    state = SelectionState(bench, quad(), point := linearise(bench, with_drag(1.0), quad()), metric_of(point))
    made = estimate(state, HIDDEN | {"blade_flapping": {"k_flap_nms2_per_rad_m": 0.0}})
    assert trifles(state, made, ["blade_flapping", "payload", "rotor_drag"]) == ("blade_flapping",)


def _drag_named(flown: FitHoldoutSplit) -> tuple[SelectionState, Estimates]:
    masks = [[m & s.valid for m, s in zip(part, flown.flights, strict=True)] for part in (flown.fit, flown.holdout)]
    bench = simulator_bench(quad(), flown.flights, *masks)
    drag = {"rotor_drag": HIDDEN["rotor_drag"]}
    state = SelectionState(bench, quad(), point := linearise(bench, hidden(quad(), drag), quad()), metric_of(point))
    return state, estimate(state, drag)


def test_what_is_there_joins_the_names_and_of_what_is_not_nothing_does(flown: FitHoldoutSplit) -> None:
    state, made = _drag_named(flown)
    drag = {"rotor_drag": HIDDEN["rotor_drag"]}
    joins = forward_selection_step(state, made, drag, ("payload", "accelerometer_bias", "gyro_bias"))
    assert joins is not None
    assert set(joins[1].effects) == {"rotor_drag", "payload"}
    assert joins[1].effects["payload"]["mass_kg"] == pytest.approx(0.2, rel=0.05)
    assert forward_selection_step(state, made, drag, ()) is None
    whole = estimate(state, HIDDEN)
    assert (
        forward_selection_step(state, whole, HIDDEN, ("gyro_bias", "motor_lag", "accelerometer_bias", "com_offset"))
        is None
    )


def test_what_joins_must_be_worth_it_on_rows_to_learn_from_and_on_held_out_ones(flown: FitHoldoutSplit) -> None:
    state, _ = _drag_named(flown)
    made = estimate(state, HIDDEN | {"blade_flapping": {"k_flap_nms2_per_rad_m": 0.0}})
    names = ["blade_flapping", "payload", "rotor_drag"]
    assert min(mse_increase(state, made, names, "payload")) > 1.0  # a sixth of the weight
    assert max(mse_increase(state, made, names, "blade_flapping")) < CLEARLY


def test_what_a_name_may_have_stood_for_is_its_class_and_what_the_same_manoeuvre_splits_from_it() -> None:
    wind = IdentifiedEffect("steady_wind", {}, -20.0, 0.1, 1e-9, ("vortex_ring",))
    open_ = confused_with([wind])
    assert {"accelerometer_bias", "constant_force", "vortex_ring"} <= open_
    assert not {"steady_wind", "payload", "motor_lag"} & open_


@pytest.mark.parametrize(
    ("named", "closed_to"),
    [("com_offset", "rotor_fault"), ("thrust_scale", "payload"), ("motor_lag", "transport_delay")],
)
def test_beside_a_poor_model_no_two_of_a_class_are_named(named: str, closed_to: str) -> None:
    assert poorly_told([named]) == {closed_to}


def test_held_out_data_speak_for_what_acts_in_them_and_not_of_the_ground_far_below(flown: FitHoldoutSplit) -> None:
    masks = [[m & s.valid for m, s in zip(part, flown.flights, strict=True)] for part in (flown.fit, flown.holdout)]
    bench = simulator_bench(quad(), flown.flights, *masks)
    near = hidden(with_drag(1.0), {"ground_effect": {"strength": 1.0}})
    state = SelectionState(bench, quad(), point := linearise(bench, near, quad()), metric_of(point))
    made = estimate(state, HIDDEN | {"ground_effect": {"strength": 1.0}})
    assert 0.1 < gain(state, made, "payload") < 1.0  # the drag has the rest
    assert np.isnan(gain(state, made, "ground_effect"))  # 8 m up


def test_a_residual_that_is_known_is_the_one_computed_anew_however_many_vehicles_came_between(
    flown: FitHoldoutSplit,
) -> None:
    masks = [[m & s.valid for m, s in zip(part, flown.flights, strict=True)] for part in (flown.fit, flown.holdout)]
    bench = simulator_bench(quad(), flown.flights, *masks)
    first = bench.residual(vehicle := with_drag(1.0))
    assert bench.residual(vehicle) is first
    with pytest.raises(ValueError, match="read-only"):
        first[0][0, 0] = 0.0
    for k in range(70):  # each gone before the next is made: numbers of vehicles that are no more come again
        shown = bench.residual(with_drag(0.5 + 0.01 * k))[0]
        if k % 30 == 0:
            anew = prediction_error(with_drag(0.5 + 0.01 * k), flown.flights[0])[0][:: bench.every[0]]
            seen = np.isfinite(shown)
            assert np.array_equal(shown[seen], anew[seen])
    assert np.array_equal(bench.residual(vehicle)[0], first[0], equal_nan=True)


@pytest.mark.parametrize(
    ("kind", "seed", "plant", "form"),
    [
        pytest.param(
            "one:transport_delay", 100005, "jsbsim", "csv", marks=[pytest.mark.jsbsim, ONLY_THEN]
        ),  # like a lag
        thorough("one:inertia", 100004, "native", "mcap"),  # a mass and a thrust scale together do the same
        ("one:slung_load", 100003, "native", "mcap"),  # its weight looks like a payload's at first
    ],
)
def test_of_explanations_that_look_alike_the_true_one_is_named_alone(
    kind: str, seed: int, plant: str, form: str, tmp_path: Path
) -> None:
    case = make(kind, seed, plant=plant)
    log, _, _ = write(case, tmp_path, "case", form)
    said = analyse([log], case.believed)
    assert [found.name for found in said.found] == [kind.removeprefix("one:")]
    assert not said.unexplained.significant
    assert said.gap.closed == pytest.approx(1.0, abs=0.1)


def test_a_load_on_a_rope_is_hung_in_the_place_of_a_payload_that_leaves_half_of_the_gap(tmp_path: Path) -> None:
    case = make(
        "three", 720026
    )  # beside a thrust curve and rotor drag; by straight lines a rope adds nothing to a payload
    log, _, _ = write(case, tmp_path, "case", "mcap")
    said = analyse([log], case.believed)
    named = {found.name: found.parameters for found in said.found}
    assert set(named) == set(case.answer.effects)
    rope, true_m = named["slung_load"]["length_m"], case.answer.effects["slung_load"]["length_m"]
    assert rope.low <= true_m <= rope.high
    assert not said.unexplained.significant


def test_no_disk_flaps_into_the_wind() -> None:
    """What swings sideways (a sloshing tank) was a flapping of the wrong sign beside a raised mass."""
    assert plausible(quad(), "blade_flapping", "k_flap_nms2_per_rad_m")[0] == 0.0


def test_a_name_that_refinement_leaves_nothing_of_has_vanished() -> None:
    nothing = IdentifiedEffect("payload", {"mass_kg": Estimate(0.0, -0.001, -0.004, 0.002)}, -50.0, 0.1, 1e-9)
    some = IdentifiedEffect(
        "com_offset",
        {"x_m": Estimate(0.0, 1e-3, 9e-4, 1.1e-3), "y_m": Estimate(0.0, 0.0, -1e-4, 1e-4)},
        -50.0,
        0.1,
        1e-9,
    )
    rope = IdentifiedEffect(
        "slung_load",
        {"mass_kg": Estimate(0.0, 0.1, 0.09, 0.11), "length_m": Estimate(np.nan, 1.0, 0.9, 1.1)},
        -50.0,
        0.1,
        1e-9,
    )
    fixed = IdentifiedEffect(
        "inertia", {"scale_x": Estimate(np.nan, 1.2, 1.1, 1.3)}, -50.0, 0.1, 1e-9
    )  # nothing to compare with
    assert interval_contains_nominal([nothing, some, rope, fixed]) == ("payload",)


@ONLY_THEN
def test_a_drag_that_shows_in_the_last_third_only_is_named_beside_what_always_shows(tmp_path: Path) -> None:
    case = make("three", 4620011)  # hovers for 24 of 38 s with a shifted mass, then moves; its drag was "unexplained"
    log, _, _ = write(case, tmp_path, "case")
    said = analyse([log], case.believed)
    assert {found.name for found in said.found} >= {"com_offset", "parasitic_drag"}
    assert not said.unexplained.significant
    drag = next(found for found in said.found if found.name == "parasitic_drag").parameters
    for name in ("c_x_kg_per_m", "c_y_kg_per_m"):
        assert drag[name].low <= case.answer.effects["parasitic_drag"][name] <= drag[name].high


@ONLY_THEN
def test_a_jet_of_air_is_no_force_that_is_the_same_everywhere(tmp_path: Path) -> None:
    case = make("outside:jet", 90003)  # beside a constant force a twelfth of what it explains would depend on the place
    log, _, _ = write(case, tmp_path, "jet")
    said = analyse([log], case.believed)
    assert said.found == ()
    assert said.unexplained.significant
    assert "position" in said.unexplained.depends_on


def test_a_drag_is_not_looked_for_where_the_velocity_is_error_rather_than_motion() -> None:
    """In a hover a filter's slow error passes for speed without force: a drag that the file has "is not there"."""
    still, moving = (as_samples(fly(quad(), quad(), at, seconds=30.0, seed=4)) for at in (hover(), wander()))
    rng = np.random.default_rng(4)

    def wandering(std: float, tau_s: float) -> F64:
        keep = float(np.exp(-still.dt_s / tau_s))
        steps = std * np.sqrt(1.0 - keep**2) * rng.standard_normal(still.vel_ned_mps.shape)
        return np.asarray(lfilter([1.0], [1.0, -keep], steps, axis=0))

    erring = replace(
        still,
        vel_ned_mps=still.vel_ned_mps + wandering(0.06, 12.0),
        pos_ned_m=still.pos_ned_m + wandering(0.15, 30.0),
    )
    for samples, muted in ((erring, True), (still, False), (moving, False)):
        masks = [samples.valid]
        mute = simulator_bench(quad(), [samples], masks, masks).mute
        assert ({"linear_drag", "rotor_drag", "parasitic_drag"} <= mute) is muted


@pytest.mark.parametrize(("share", "proxy"), [(0.75, True), (-0.75, True), (0.25, False)])
def test_a_payload_of_half_the_vehicle_stands_for_rotors_that_are_no_stronger(share: float, proxy: bool) -> None:
    """A Crazyflie of 27 g was told 20 g more on one of its flights and 0.55 of its thrust on the others, so that its
    drag was 16 g/s there and 11 elsewhere."""
    load = IdentifiedEffect("payload", {"mass_kg": Estimate(0.0, share * quad().mass_kg, 0.0, 2.0)}, -50.0, 0.1, 1e-9)
    assert surrogate_terms(quad(), [load], {}) == (("payload",) if proxy else ())


@pytest.mark.parametrize(("pitch_rad", "proxy"), [(-0.24, True), (0.16, True), (-0.12, False)])
def test_a_tilt_that_anybody_would_see_stands_for_a_push(pitch_rad: float, proxy: bool) -> None:
    """In front of fans that blow at 8.5 m/s a sensor's tilt of 14 degrees was named, alone."""
    tilt = {"roll_rad": Estimate(0.0, -0.02, -0.03, -0.01), "pitch_rad": Estimate(0.0, pitch_rad, -0.3, 0.2)}
    tilt["yaw_rad"] = Estimate(0.0, 0.3, 0.2, 0.4)
    named = IdentifiedEffect("attitude_misalignment", tilt, -50.0, 0.1, 1e-9)
    assert surrogate_terms(quad(), [named], {}) == (("attitude_misalignment",) if proxy else ())


def test_a_mass_in_place_of_a_thrust_scale_pulls_and_brakes_a_kilogram_as_hard() -> None:
    """s T / m and d / m are T / (m + p) and d' / (m + p); torques are the file's again."""
    mass_kg = quad().mass_kg
    thrust = IdentifiedEffect("thrust_scale", {"scale": Estimate(1.0, 1.25, 1.2, 1.3)}, -50.0, 0.1, 1e-9, ("payload",))
    drag = IdentifiedEffect("linear_drag", {"d_x_kgps": Estimate(0.0, 0.5, 0.4, 0.6)}, -50.0, 0.1, 1e-9)
    tilt = IdentifiedEffect("attitude_misalignment", {"pitch_rad": Estimate(0.0, 0.04, 0.03, 0.05)}, -50.0, 0.1, 1e-9)
    load, less, same = mass_for_thrust(quad(), [thrust, drag, tilt])
    heavier_kg = mass_kg + load.parameters["mass_kg"].estimate
    assert load.name == "payload"
    assert load.indistinguishable_from == ("thrust_scale",)
    assert 1.0 / heavier_kg == pytest.approx(1.25 / mass_kg)
    assert less.parameters["d_x_kgps"].estimate / heavier_kg == pytest.approx(0.5 / mass_kg)
    assert load.parameters["mass_kg"].low == pytest.approx(mass_kg / 1.3 - mass_kg)
    assert load.parameters["mass_kg"].high == pytest.approx(mass_kg / 1.2 - mass_kg)
    assert same == tilt


@pytest.mark.parametrize(
    ("scale", "effects"),
    [
        (Estimate(1.0, 0.9, 0.0, 1.8), {}),
        (Estimate(1.0, 0.55, 0.5, 0.6), {}),
        (Estimate(0.8, 1.1, 1.0, 1.2), {"thrust_scale": {"scale": 0.8}}),
        (Estimate(1.0, 1.1, 1.0, 1.2), {"payload": {"mass_kg": 0.1}}),
    ],
    ids=["perhaps no thrust at all", "half the vehicle", "file has a scale", "file has a payload"],
)
def test_no_mass_takes_the_place_of_a_thrust_that_none_could(
    scale: Estimate, effects: dict[str, dict[str, float]]
) -> None:
    thrust = IdentifiedEffect("thrust_scale", {"scale": scale}, -50.0, 0.1, 1e-9)
    assert mass_for_thrust(with_effects(quad(), effects), [thrust]) == ()
