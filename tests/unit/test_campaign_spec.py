"""The campaign file: what it says becomes flights, and each mistake is one line that names the nearest known word."""

from __future__ import annotations

import math
import tomllib
from pathlib import Path

import numpy as np
import pytest

from flightstack.cli.campaign.adversary import Adversary
from flightstack.cli.campaign.design import Design
from flightstack.cli.campaign.plan import Planner, parsed
from flightstack.cli.campaign.spec import CampaignSpec, load_spec, parse_spec
from flightstack.dotted import changed, changed_vehicle
from flightstack.errors import InputError
from flightstack.toml_text import toml_text
from flightstack.vehicle import Vehicle, parse_vehicle
from flightstack_sim.grade import changed_grade, load_grade

HEAD = 'schema = "flightstack.campaign/1"\nscenario = "hover"\nseeds = {from = 3, count = 4}\n'
QUAD = Path(__file__).resolve().parents[2] / "flightstack/data/vehicles/quad-x.toml"


def _spec(text: str) -> CampaignSpec:
    return parse_spec(HEAD + text, Path("c.toml"))


def _quad() -> Vehicle:
    return parse_vehicle(QUAD.read_text(), "quad-x")


def test_a_grid_is_every_combination_with_every_seed() -> None:
    spec = _spec('design = "grid"\n[vary]\n"body.mass_kg" = [1.0, 1.2]\n"effects.payload.mass_kg" = [0.0, 0.1, 0.2]\n')
    assert spec.count == 4 * 6
    design = Design(spec)
    rows = [(tuple(design.values(i).values()), spec.seed_of(i)) for i in range(spec.count)]
    assert len(set(rows)) == 24
    assert {seed for _, seed in rows} == {3, 4, 5, 6}
    assert rows[0] == ((1.0, 0.0), 3)
    assert rows[4][0] == (1.0, 0.1)


@pytest.mark.parametrize("kind", ["random", "sobol"])
def test_draws_are_the_flights_own_and_fill_the_range(kind: str) -> None:
    text = '[vary]\n"body.mass_kg" = {low = 1.0, high = 2.0}\n"fly.fault" = ["none", "link-degraded"]\n'
    small, large = (Design(_spec(f'design = "{kind}"\ncount = {n}\n{text}')) for n in (64, 512))
    assert [small.values(i) for i in range(64)] == [large.values(i) for i in range(64)]
    masses = np.array([large.values(i)["body.mass_kg"] for i in range(512)])
    assert masses.min() >= 1.0
    assert masses.max() < 2.0
    assert abs(masses.mean() - 1.5) < 0.06
    faults = [large.values(i)["fly.fault"] for i in range(512)]
    assert 0.4 < faults.count("none") / 512 < 0.6
    if kind == "sobol":  # 64 points in a base-2 net of 64 cells of one factor: one each
        cells = np.floor(64.0 * (masses[:64] - 1.0))
        assert sorted(cells) == list(range(64))


def test_a_range_in_the_logarithm() -> None:
    spec = _spec('count = 400\n[vary]\n"effects.payload.mass_kg" = {low = 0.01, high = 1.0, scale = "log"}\n')
    drawn = [Design(spec).values(i)["effects.payload.mass_kg"] for i in range(400)]
    assert 0.4 < np.mean(np.array(drawn) < 0.1) < 0.6


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('count = 2\n[vary]\n"body.mas_kg" = [1.0]\n', "key body.mas_kg; the nearest known one is body.mass_kg"),
        ('count = 2\n[vary]\n"effects.wind.north_mps" = [1.0]\n', "effects.steady_wind.north_mps"),
        ('count = 2\n[vary]\n"fly.faults" = ["none"]\n', "nearest known one is fly.fault"),
        ('count = 2\n[vary]\n"imu.gyro_noise" = [1.0]\n', "imu.gyro_noise_radps_rthz"),
        ("cuont = 2\n", "unknown key cuont; the nearest known one is count"),
        ('design = "random"\n', "count is missing"),
        ('design = "latin"\ncount = 1\n', "known are grid, random, sobol"),
        ('design = "grid"\n[vary]\n"body.mass_kg" = {low = 1.0, high = 2.0}\n', "in a grid list its values"),
        ('count = 1\n[vary]\n"body.mass_kg" = {low = 2.0, high = 1.0}\n', "must lie below"),
        ('count = 1\n[vary]\n"fly.fault" = [3]\n', "must be a text"),
        ('count = 1\n[vary]\n"fly.plant" = {low = 1.0, high = 2.0}\n', "takes no range"),
        ('count = 1\n[vary]\n"body.mass_kg" = []\n', "at least one value"),
        ('count = 0\n', "a whole number from 1"),
        ('count = 1\n[keep]\nlogs = "some"\n', "known are failures, all, none"),
        ('count = 1\n[search]\nmethod = "annealing"\ntarget = "x"\n', "known are cross-entropy"),
        ('count = 1\n[search]\nmethd = "cma-es"\n', "the nearest known one is method"),
    ],
)  # fmt: skip
def test_bad_files_are_one_line(text: str, words: str) -> None:
    with pytest.raises(InputError) as caught:
        _spec(text)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_plan_is_a_scenario_that_says_it_all() -> None:
    spec = _spec(
        'count = 2\n[vary]\n"body.mass_kg" = 1.3\n"body.inertia_kgm2.1" = 0.02\n"effects.payload.mass_kg" = 0.1\n'
        '"sensors.imu.accel_bias_std_mps2" = 0.2\n"fly.fault" = "none"\n"fly.no_learning" = true\n'
    )
    plan = Planner(spec).plan(1, Design(spec).values(1), spec.seed_of(1))
    scenario = parsed(plan)
    truth = scenario.truth_vehicle(_quad())
    assert truth.mass_kg == 1.3
    assert truth.inertia_kgm2[1] == 0.02
    assert truth.effects["payload"]["mass_kg"] == 0.1
    assert changed_grade("mocap", scenario.grade_changes, "x").imu.accel_bias_std_mps2 == 0.2
    assert dict(scenario.flight) == {"fault": "none", "no-learning": True, "seed": 4}
    assert scenario.checks == ()  # those of the scenario as it is written


@pytest.mark.parametrize("path", sorted((QUAD.parents[3] / "campaigns").glob("*.toml")), ids=lambda each: each.stem)
def test_the_campaigns_that_come_along_can_be_flown(path: Path) -> None:
    spec = load_spec(path)
    planner = Planner(spec)
    values = Design(spec).values(0)
    plan = planner.plan(0, values, spec.seed_of(0))
    if spec.task:
        assert tomllib.loads(plan.text)["vary"] == {name: [value] for name, value in values.items()}
        return
    if spec.search is not None:
        adversary = Adversary(planner)
        for share in (0.0, 0.3, 1.0 - 1e-12):
            plan = adversary.against(plan, [share] * adversary.dimensions)
            truth = parsed(plan).truth_vehicle(_quad()).effects["constant_force"]
            most_n = max(0.15 * _quad().weight_n, math.hypot(*truth.values()))
            pushes = [math.hypot(*dict(event.values).values()) for event in parsed(plan).events]
            assert len(pushes) >= 4
            assert max(pushes) <= most_n + 1e-9
    assert changed_vehicle(_quad(), parsed(plan).truth.changes, "x").mass_kg == values["body.mass_kg"]


def test_what_makes_no_vehicle_and_no_grade_is_refused_in_one_line() -> None:
    with pytest.raises(InputError, match="mass_kg"):
        changed_vehicle(_quad(), {"body.mass_kg": -1.0}, "x")
    with pytest.raises(InputError, match="triangle"):
        changed_vehicle(_quad(), {"body.inertia_kgm2.0": 1.0}, "x")
    with pytest.raises(InputError, match="no place 7"):
        changed_vehicle(_quad(), {"rotors.position_m.7.0": 1.0}, "x")
    with pytest.raises(InputError, match="accel_bias_std_mps2"):
        changed_grade("mocap", {"imu.accel_bias_std_mps2": -1.0}, "x")
    assert changed_grade("gps", {}, "x") == load_grade("gps")


def test_toml_text_is_read_back_bit_for_bit() -> None:
    data = {
        "a": 0.1 + 0.2, "b": 'quote " back \\ \x7f \n', "c": [1, [2.5, True]], "empty": {},
        "t": {"x": {"dotted.key": 1e-300}, "rows": [{"time_s": 1.0, "values": {"v": -0.0}}]},
    }  # fmt: skip
    assert tomllib.loads(toml_text(data)) == data
    assert changed({"a": {"b": [1, 2]}}, {"a.b.1": 5, "c.d": 6}, "x") == {"a": {"b": [1, 5]}, "c": {"d": 6}}
