"""A file whose mass, thrust and inertia are only guessed: the common scale is a class, and its intervals say so."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest

from benchmarks.gap_cases import make, write
from benchmarks.gap_rough import spoilt
from flightstack.gap.name import Selection, name
from flightstack.gap.naming.ranged import WEIGH
from flightstack.gap.records import Samples
from flightstack.gap.workflow import analyse
from flightstack.vehicle import Vehicle, with_effects
from tests import gap_batch as batch
from tests.gap_flights import quad
from tests.thorough import ONLY_THEN, thorough

MASS, THRUST = 1.2, 0.85


def guessed() -> Vehicle:
    """The default vehicle with its mass 20 % too great and its thrust 15 % too small, both known within 30 %."""
    true = quad()
    mass, thrust = MASS * true.mass_kg, THRUST * true.rotors.max_thrust_n
    ranges = {
        "body.mass_kg": np.array([mass / 1.3, mass * 1.3]),
        "rotors.max_thrust_n": np.array([thrust / 1.3, thrust * 1.3]),
        "body.inertia_kgm2": np.stack([true.inertia_kgm2 / 1.5, true.inertia_kgm2 * 1.5], axis=-1),
    }
    rotors = replace(true.rotors, max_thrust_n=thrust)
    return replace(true, mass_kg=mass, rotors=rotors, ranges=MappingProxyType(ranges))


@cache
def flown() -> Samples:
    return batch.fly(quad(), [{}])[0]


def verdict(believed: Vehicle) -> Selection:
    samples = flown()
    at = samples.t_s - samples.t_s[0]
    return name(believed, [samples], [at < 18.0], [at > 20.0])


@ONLY_THEN
def test_guessed_numbers_are_corrected_with_intervals_as_wide_as_their_common_scale_is_unknown() -> None:
    believed = guessed()
    before = verdict(believed)
    told = before.with_guessed_numbers()
    found = {each.name: each for each in told.found}
    true = {
        "payload": {"mass_kg": quad().mass_kg - believed.mass_kg},
        "thrust_scale": {"scale": 1.0 / THRUST},
        "inertia": {f"scale_{axis}": 1.0 for axis in "xyz"},
    }
    assert found
    assert set(found) <= set(true)
    for effect, each in found.items():
        for parameter, value in true[effect].items():
            got = each.parameters[parameter]
            assert got.low <= value <= got.high
            assert got.high - got.low > 0.1 * abs(got.estimate)  # no log weighs
    # the mean thrust over the mass is what flew, wherever on the common scale the answer stands
    scale = told.vehicle.effects.get("thrust_scale", {}).get("scale", 1.0)
    flown = quad().rotors.max_thrust_n / quad().mass_kg
    assert believed.rotors.max_thrust_n * scale / told.vehicle.total_mass_kg == pytest.approx(flown, rel=0.01)
    slot = (told.found[0].name, next(iter(told.found[0].parameters)))
    hidden = before.without_telling([slot]).with_guessed_numbers().found[0].parameters[slot[1]]
    assert not hidden.told  # what the logs don't tell, no guess tells either
    assert hidden.estimate == hidden.before


@pytest.mark.parametrize(("inertia", "thrust"), [thorough(1.16, 1.16), (1.16, 1.13)])
def test_drags_of_the_file_weigh_the_vehicle_where_its_mass_and_thrust_are_guessed(
    inertia: float, thrust: float
) -> None:
    """Mass and thrust about as much too great, drags in the file became false names (blind cases 5052100, 5070021)."""
    drags = {"parasitic_drag": dict.fromkeys(("c_x_kg_per_m", "c_y_kg_per_m", "c_z_kg_per_m"), 0.05)}
    true = with_effects(quad(), drags | {"rotor_drag": {"k_d_kg_per_rad": 2e-4}})
    wrong = {"body.mass_kg": 1.16 * true.mass_kg, "rotors.max_thrust_n": thrust * true.rotors.max_thrust_n}
    ranges = {key: value * np.array([1.0 / 1.3, 1.3]) for key, value in wrong.items()}
    ranges["body.inertia_kgm2"] = np.stack([true.inertia_kgm2 / 1.5, true.inertia_kgm2 * 1.5], axis=-1) * inertia
    believed = replace(
        true,
        mass_kg=wrong["body.mass_kg"],
        inertia_kgm2=inertia * true.inertia_kgm2,
        rotors=replace(true.rotors, max_thrust_n=wrong["rotors.max_thrust_n"]),
        ranges=MappingProxyType(ranges),
    )
    hidden = {"linear_drag": {"d_x_kgps": 0.2, "d_y_kgps": 0.25, "d_z_kgps": 0.2}}
    samples = batch.fly(true, [hidden])[0]
    at = samples.t_s - samples.t_s[0]
    told = name(believed, [samples], [at < 18.0], [at > 20.0]).with_guessed_numbers()
    answer = hidden | {"payload": {"mass_kg": true.mass_kg - believed.mass_kg}, "thrust_scale": {"scale": 1.0 / thrust}}
    if inertia != 1.0:
        answer["inertia"] = {f"scale_{axis}": 1.0 / inertia for axis in "xyz"}
    assert {each.name for each in told.found} == set(answer)
    for each in told.found:
        for parameter, value in answer[each.name].items():
            got = each.parameters[parameter]
            assert got.low <= value <= got.high
            assert got.high - got.low < 0.15 * abs(value)  # the drags weigh


def test_a_plain_file_s_single_wrong_number_keeps_its_narrow_interval() -> None:
    heavy = replace(quad(), mass_kg=MASS * quad().mass_kg)
    told = verdict(heavy).with_guessed_numbers()
    assert [each.name for each in told.found] == ["payload"]
    got = told.found[0].parameters["mass_kg"]
    assert got.estimate == pytest.approx(quad().mass_kg - heavy.mass_kg, rel=0.02)
    assert got.high - got.low < 0.02
    assert told.found[0].manoeuvre != WEIGH


@ONLY_THEN
def test_too_much_thrust_in_the_file_is_no_damping_and_no_rotor_s_inertia(tmp_path: Path) -> None:
    """Five wrong numbers, a delay: load and inertia came out 1.17 times too large, and dampings with them."""
    case = make("one:transport_delay", 5052011)
    log, _, _ = write(case, tmp_path, "case")
    believed = spoilt(case.believed, "all", True, np.random.default_rng([5052011, 7]))
    found = {each.name: each for each in analyse([log], believed).found}
    assert set(found) == {"payload", "thrust_scale", "inertia", "thrust_curve", "transport_delay"}
    true = case.truth
    scale = found["thrust_scale"].parameters["scale"]
    assert scale.low <= true.rotors.max_thrust_n / believed.rotors.max_thrust_n <= scale.high
    for i, axis in enumerate("xyz"):
        inertia = found["inertia"].parameters[f"scale_{axis}"]
        assert inertia.low <= true.inertia_kgm2[i] / believed.inertia_kgm2[i] <= inertia.high
    assert believed.mass_kg + found["payload"].parameters["mass_kg"].estimate == pytest.approx(true.mass_kg, rel=0.01)
