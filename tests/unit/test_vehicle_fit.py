"""`vehicle fit`: the numbers of a rough file against those of the vehicle that flew; scale, ranges, bad input."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest

from flightstack.cli.main import main
from flightstack.file_numbers import file_numbers, with_numbers
from flightstack.gap.compare import residual
from flightstack.gap.number_fit import NumberFit, fit_numbers
from flightstack.gap.pooled import split
from flightstack.gap.records import Samples
from flightstack.vehicle import Vehicle, parse_vehicle, vehicle_to_toml, with_effects
from tests import gap_batch as batch
from tests.flown import flown, write_csv
from tests.gap_flights import quad

WRONG = {
    "body.mass_kg": 1.2,
    "body.inertia_kgm2": 0.8,
    "rotors.max_thrust_n": 0.9,
    "rotors.time_constant_s": 1.25,
}
DRAG = {"rotor_drag": {"k_d_kg_per_rad": 1.6e-4}}


def rough(*, known: tuple[str, ...] = ()) -> Vehicle:
    """The default vehicle with every number of `WRONG` off and known within a third; the curve not known at all."""
    numbers = {n.name: n for n in file_numbers(quad())}
    off = {n: n.value * WRONG[n.key] for n in numbers.values() if n.key in WRONG and n.key not in known}
    off[numbers["rotors.thrust_model_factor"]] = 0.6
    wrong = with_numbers(quad(), off)
    ranges = {"rotors.thrust_model_factor": np.array([0.0, 1.0])}
    for key in set(WRONG) - set(known):
        value = np.array([n.value for n in file_numbers(wrong) if n.key == key])
        pairs = np.stack([value / 1.34, value * 1.34], axis=-1)
        ranges[key] = pairs if key == "body.inertia_kgm2" else pairs[0]
    return replace(wrong, ranges=MappingProxyType(ranges))


@pytest.fixture(scope="module")
def flights() -> list[Samples]:
    return batch.fly(quad(), [{}, DRAG])


@pytest.fixture(scope="module")
def guessed(flights: list[Samples]) -> NumberFit:
    return fit_numbers(rough(), split(flights[:1], []))


def test_mass_thrust_inertia_and_drag_times_the_same_fly_alike(flights: list[Samples]) -> None:
    """What the scale class rests on: the measured residual of a vehicle with all of them times 1.3 is the same."""
    light = with_effects(quad(), DRAG)
    heavy = with_numbers(light, {n: 1.3 * n.value for n in file_numbers(light) if n.is_of_mass})
    assert heavy.mass_kg == pytest.approx(1.3 * light.mass_kg)
    assert heavy.effects["rotor_drag"]["k_d_kg_per_rad"] == pytest.approx(1.3 * 1.6e-4)
    one, other = (residual(v, flights[0]).y for v in (light, heavy))
    np.testing.assert_allclose(np.nan_to_num(one), np.nan_to_num(other), atol=1e-6)


def test_all_numbers_guessed_are_found_up_to_their_common_scale(guessed: NumberFit) -> None:
    truth = {n.name: n.value for n in file_numbers(quad())}
    for row in guessed.numbers:
        assert row.number.low <= row.low <= truth[row.number.name] <= row.high <= row.number.high, row
    own = {row.number.name: row for row in guessed.numbers}
    assert own["body.mass_kg"].high / own["body.mass_kg"].low > 1.1  # no log weighs
    assert {own[f"body.inertia_kgm2[{i}]"].told_by for i in range(3)} == {"scale"}
    assert own["rotors.position_m[0][0]"].told_by == "file"
    ratio, low, high = guessed.scale.per_kg["rotors.max_thrust_n"]
    assert low <= quad().rotors.max_thrust_n / quad().mass_kg <= high
    assert high - low < 0.02 * ratio
    assert guessed.scale.known_by == ""
    assert guessed.missing == {}
    assert not guessed.unexplained.significant


def test_the_fitted_file_reads_back_and_its_ranges_lie_within_those_before(guessed: NumberFit) -> None:
    again = parse_vehicle(vehicle_to_toml(guessed.vehicle), "fitted")
    for key, pairs in rough().ranges.items():
        assert np.all(again.ranges[key][..., 0] >= pairs[..., 0] - 1e-12)
        assert np.all(again.ranges[key][..., 1] <= pairs[..., 1] + 1e-12)


def test_a_weighed_mass_fixes_the_scale_and_a_drag_that_nobody_wrote_down_bends_nothing(flights: list[Samples]) -> None:
    done = fit_numbers(rough(known=("body.mass_kg",)), split(flights[1:], []))
    assert done.scale.known_by == "body.mass_kg"
    assert set(done.missing) == {"rotor_drag"}
    assert done.missing["rotor_drag"]["k_d_kg_per_rad"] == pytest.approx(1.6e-4, rel=0.03)
    assert done.vehicle.rotors.max_thrust_n == pytest.approx(quad().rotors.max_thrust_n, rel=0.01)
    np.testing.assert_allclose(done.vehicle.inertia_kgm2, quad().inertia_kgm2, rtol=0.03)
    assert done.vehicle.rotors.time_constant_s == pytest.approx(quad().rotors.time_constant_s, abs=2e-3)


def test_a_known_mass_that_is_wrong_is_said(flights: list[Samples]) -> None:
    """Mass and thrust stand as known, the mass 20 % off: no curve, lag or inertia makes up for it."""
    wrong = replace(
        rough(known=tuple(WRONG)),
        mass_kg=1.2 * quad().mass_kg,
        ranges={"rotors.time_constant_s": np.array([0.01, 0.05])},
    )
    done = fit_numbers(wrong, split(flights[:1], []))
    assert done.contradicted or done.unexplained.significant


def run(*words: object) -> int:
    """The verb's exit code."""
    with pytest.raises(SystemExit) as ended:
        main(["vehicle", "fit", *map(str, words)])
    return int(str(ended.value.code))


def test_the_verb_writes_file_and_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = write_csv(tmp_path / "flight.csv", flown(quad(), seconds=20.0))
    file, out, told = tmp_path / "rough.toml", tmp_path / "fitted.toml", tmp_path / "fit.json"
    file.write_text(vehicle_to_toml(rough(known=("body.mass_kg",))))
    assert run(log, "--vehicle", file, "--out", out, "--json", told) == 0
    parse_vehicle(out.read_text(), "fitted")
    said = json.loads(told.read_text())
    assert said["schema"] == "flightstack.vehicle-fit/1"
    assert {row["name"] for row in said["numbers"]} == {n.name for n in file_numbers(quad())}
    assert said["scale_class"]["known_by"] == "body.mass_kg"
    printed = capsys.readouterr().out
    assert "is fixed by body.mass_kg" in printed
    assert "rotors.time_constant_s stands at the end of its range" in printed  # this flight's rotors have no lag


@pytest.mark.parametrize("wrong", ["log", "vehicle", "text", "out"])
def test_bad_input_is_one_line(wrong: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log, file, out = tmp_path / "flight.csv", tmp_path / "quad.toml", tmp_path / "out.toml"
    file.write_text(vehicle_to_toml(quad()))
    log.write_text("a log\n" if wrong == "text" else "")
    if wrong == "log":
        log.unlink()
    elif wrong == "vehicle":
        file.write_text(vehicle_to_toml(quad()).replace("mass_kg = 1.2", "mass_kg = {value = 1.2, range = [1.3, 1.4]}"))
    elif wrong == "out":
        write_csv(log, flown(quad(), seconds=12.0))
        out = tmp_path / "none" / "out.toml"
        (tmp_path / "none").write_text("a file, no folder")
    assert run(log, "--vehicle", file, "--out", out) == 2
    said = capsys.readouterr().err.strip()
    assert said.startswith("error:")
    assert "\n" not in said
