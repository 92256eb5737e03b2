"""The blind harness itself: flights that are what their answers say, files without a trace, a judge that can say no."""

from __future__ import annotations

import dataclasses
import json
import math
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from shipped import load_vehicle

from benchmarks import campaign, gap_draw
from benchmarks.gap_cases import HEADER, as_csv, kinds, make, write
from benchmarks.gap_flights import (
    L_FORCE,
    L_POS,
    L_Q,
    L_RATE,
    L_VEL,
    L_VOLTAGE,
    X_JET,
    X_SIZE,
    X_TETHER,
    Senses,
    fly,
    fly_plant,
)
from benchmarks.gap_judge import confusion, judge, summary
from benchmarks.gap_pilot import Plan
from benchmarks.gap_rules import meaning, rules
from benchmarks.gap_tables import BEGIN, END, present, tables
from flightstack.cli.campaign.design import Design
from flightstack.cli.campaign.spec import load_spec
from flightstack.effects import EFFECTS
from flightstack.types import F64
from flightstack.vehicle import parse_vehicle, with_effects
from flightstack_sim.plant import NativePlant

QUAD = load_vehicle("quad-x")
NOTHING = np.zeros(X_SIZE)


def hover(seconds: float) -> F64:
    plan = Plan()
    plan.hold(0.5, idle=True)
    plan.go(np.array([0.0, 0.0, -2.0]), 1.5)
    plan.hold(seconds)
    return plan.reference()


def test_every_effect_of_the_table_can_be_drawn_and_is_not_null_on_any_vehicle() -> None:
    assert list(gap_draw.EFFECTS) == list(EFFECTS)
    for seed in range(20):
        rng = np.random.default_rng(seed)
        vehicle = gap_draw.vehicle(rng, drag=False)
        for name, draw in gap_draw.EFFECTS.items():
            if name in gap_draw.NEEDS_BATTERY and vehicle.battery is None:
                continue
            values = draw(rng, vehicle)
            with_effects(vehicle, {name: values})  # in range
            assert not EFFECTS[name].is_null(values)


def test_the_pilot_hovers_where_it_should_and_carries_what_its_model_lacks() -> None:
    """In steady hover specific force is 1 g upwards, whatever the mass: the pilot's integral holds the height."""
    heavy = with_effects(QUAD, {"payload": {"mass_kg": 0.3}})
    rows = fly(QUAD, heavy, hover(8.0), NOTHING, seed=1).rows[-2000:]
    np.testing.assert_allclose(rows[:, L_POS : L_POS + 3].mean(axis=0), [0.0, 0.0, -2.0], atol=0.08)
    np.testing.assert_allclose(rows[:, L_FORCE : L_FORCE + 3].mean(axis=0), [0.0, 0.0, -9.80665], atol=0.03)


def test_what_is_outside_the_table_pushes_as_it_says() -> None:
    """A jet over the hover pushes the vehicle; its pilot leans against it until m g tan(tilt) is the force."""
    jet = NOTHING.copy()
    jet[X_JET : X_JET + 6] = (0.0, 0.0, 50.0, 1.0, 0.0, 0.0)  # wide: 1 N north everywhere
    rows = fly(QUAD, QUAD, hover(12.0), jet, seed=2).rows[-2000:]
    q = rows[:, L_Q : L_Q + 4]
    pitch = np.arcsin(2.0 * (q[:, 0] * q[:, 2] - q[:, 3] * q[:, 1])).mean()
    assert math.tan(pitch) == pytest.approx(1.0 / QUAD.weight_n, rel=0.05)  # nose up: thrust to the south


def test_a_slack_tether_does_nothing_and_a_tight_one_pulls_to_its_anchor() -> None:
    tether = NOTHING.copy()
    tether[X_TETHER : X_TETHER + 5] = (0.0, 0.0, 0.0, 5.0, 3.0)
    slack = fly(QUAD, QUAD, hover(4.0), tether, seed=3).rows
    np.testing.assert_array_equal(slack, fly(QUAD, QUAD, hover(4.0), NOTHING, seed=3).rows)
    tether[X_TETHER + 3] = 1.0
    rows = fly(QUAD, QUAD, hover(10.0), tether, seed=3).rows[-2000:]
    up = -rows[:, L_FORCE + 2].mean() * QUAD.mass_kg  # the tether's pull is a specific force too
    assert up == pytest.approx(QUAD.weight_n, rel=0.01)
    assert -rows[:, L_POS + 2].mean() == pytest.approx(2.0, abs=0.15)


def test_a_call_a_step_on_any_plant_flies_as_the_compiled_loop_does() -> None:
    """The native plant both ways; the rest is the other plant's business."""
    reference, senses = hover(3.0), Senses()
    whole = fly(QUAD, QUAD, reference, NOTHING, seed=4, senses=senses, hold_ms=4).rows
    plant = NativePlant(QUAD, seed=4, dt_us=1000)
    called = fly_plant(plant, QUAD, QUAD, reference, seed=4, senses=senses, hold_ms=4).rows
    np.testing.assert_allclose(called[:, : L_VOLTAGE + 1], whole[:, : L_VOLTAGE + 1], atol=1e-9)


def test_the_rows_of_a_flight_fit_each_other() -> None:
    """Velocity is the position's slope, specific force the velocity's less gravity turned into the body."""
    case = make("one:rotor_drag", 5)
    rows = case.flown.rows[3000:20000]
    slope = (rows[2:, L_POS : L_POS + 3] - rows[:-2, L_POS : L_POS + 3]) / 0.002
    np.testing.assert_allclose(slope, rows[1:-1, L_VEL : L_VEL + 3], atol=2e-3)
    half = rows[1:, L_RATE : L_RATE + 3] + rows[:-1, L_RATE : L_RATE + 3]
    turned = np.linalg.norm(np.diff(rows[:, L_Q : L_Q + 4], axis=0), axis=1) / 0.001
    np.testing.assert_allclose(turned, 0.25 * np.linalg.norm(half, axis=1), atol=2e-3)


def test_the_files_of_a_case_hold_no_trace_of_its_answer(tmp_path: Path) -> None:
    """The believed vehicle knows nothing of the hidden effect, the log nothing but the contract's columns."""
    case = make("one:payload", 7)
    log, vehicle, sealed = write(case, tmp_path, "case-1")
    assert "payload" not in vehicle.read_text()
    assert log.read_text().splitlines()[0] in (HEADER, HEADER.removesuffix(",battery_v"))
    assert parse_vehicle(vehicle.read_text(), "case").effects.get("payload") is None
    hidden = json.loads(sealed.read_text())["effects"]
    assert hidden == {"payload": {"mass_kg": pytest.approx(case.truth.effects["payload"]["mass_kg"])}}
    assert sealed.parent != log.parent


def test_the_same_seed_makes_the_same_case_and_another_another() -> None:
    first, again, other = make("two", 3), make("two", 3), make("two", 4)
    assert as_csv(first.table) == as_csv(again.table)
    assert first.answer == again.answer
    assert as_csv(first.table) != as_csv(other.table)


def test_the_campaign_has_300_clean_cases_and_some_of_all_kinds() -> None:
    spec = load_spec(campaign.ROOT / "campaigns/gap-blind.toml")
    design = Design(spec)
    drawn = [design.values(flight) for flight in range(spec.count)]
    count = Counter(values["kind"] for values in drawn)
    assert set(count) == set(kinds())
    assert 300 <= count["clean"] <= 340
    assert 80 <= sum(n for kind, n in count.items() if kind.startswith("outside:")) <= 112
    assert 0.2 < sum(values["form"] == "mcap" for values in drawn) / len(drawn) < 0.3


def test_only_cases_of_the_same_rules_are_counted_together(tmp_path: Path) -> None:
    """Campaigns outlive changes of the workflow; what older rules judged is left out, a line cut off does not count."""
    for name, made in (("first", "a"), ("second", rules())):
        folder = tmp_path / name
        folder.mkdir()
        lines = [{"version": f"1 {name}"}, *({"flight": k, "reason": "", "result": {"rules": made}} for k in range(2))]
        text = "".join(json.dumps(line) + "\n" for line in lines)
        (folder / "journal.jsonl").write_text(text + '{"flight": 9, "resu')
    entries = campaign.flown([tmp_path / "first", tmp_path / "second"])
    assert [entry["version"] for entry in entries] == ["1 first"] * 2 + ["1 second"] * 2
    assert present([*entries, {"reason": "its process ended", "result": None}]) == [
        {"rules": rules()}, {"rules": rules()}, {"lost": "its process ended"},
    ]  # fmt: skip


def test_rules_change_with_the_code_and_not_with_its_comments() -> None:
    said = '"""Text."""\n\ndef f(x):\n    """What."""\n    return x + 1  # why\n'
    assert meaning(said) == meaning("def f(x):\n    return (x + 1)\n")
    assert meaning(said) != meaning("def f(x):\n    return x + 2\n")


def said(*effects: dict, closed: float | None = None, unexplained: bool = False, depends: tuple[str, ...] = ()) -> dict:
    return {
        "effects": list(effects),
        "gap": {"closed": closed},
        "unexplained": {"significant": unexplained, "depends_on": list(depends), "fraction": 0.0},
    }


def effect(name: str, twins: tuple[str, ...] = (), **parameters: tuple[float, float, float]) -> dict:
    return {
        "name": name,
        "indistinguishable_from": list(twins),
        "parameters": {p: {"estimate": e, "ci95": [low, high]} for p, (e, low, high) in parameters.items()},
    }


ANSWER = {"effects": {"payload": {"mass_kg": 0.2}}, "outside": "", "depends_on": [], "rich": True}
CLEAN = {"effects": {}, "outside": "", "depends_on": [], "rich": True}
TETHER = {"effects": {}, "outside": "tether", "depends_on": ["position"], "rich": True}


def test_the_judge_tells_exact_from_twin_from_wrong_and_missed() -> None:
    exact = judge(ANSWER, said(effect("payload", mass_kg=(0.21, 0.19, 0.23))), QUAD)
    assert (exact["names"][0]["exact"], exact["missed"]) == (True, [])
    assert exact["names"][0]["error"] == pytest.approx(0.05)
    assert exact["names"][0]["within"] == [True]
    outside = judge(ANSWER, said(effect("payload", mass_kg=(0.21, 0.205, 0.23))), QUAD)
    assert outside["names"][0]["within"] == [False]
    twin = judge(ANSWER, said(effect("thrust_scale", ("payload",), scale=(0.9, 0.8, 1.0))), QUAD)
    assert (twin["names"][0]["exact"], twin["names"][0]["class"], twin["missed"]) == (False, True, [])
    wrong = judge(ANSWER, said(effect("thrust_scale", scale=(0.9, 0.8, 1.0))), QUAD)
    assert (wrong["names"][0]["class"], wrong["missed"]) == (False, ["payload"])


def test_errors_are_of_the_change_and_of_all_the_effects_parameters_together() -> None:
    """motor_lag from 0.02 s to 0.04 s, found 0.05 s: half the change off; the wrong rotor is no estimate at all."""
    lag = {**ANSWER, "effects": {"motor_lag": {"time_constant_s": 0.04}}}
    row = judge(lag, said(effect("motor_lag", time_constant_s=(0.05, 0.045, 0.055))), QUAD)
    assert row["names"][0]["error"] == pytest.approx(0.5)
    fault = {**ANSWER, "effects": {"rotor_fault": {"rotor": 2.0, "effectiveness": 0.8}}}
    named = effect("rotor_fault", rotor=(3.0, 3.0, 3.0), effectiveness=(0.8, 0.7, 0.9))
    assert judge(fault, said(named), QUAD)["names"][0]["error"] == math.inf


def test_the_summary_counts_what_its_words_say() -> None:
    rows = [
        judge(ANSWER, said(effect("payload", mass_kg=(0.2, 0.19, 0.21)), closed=0.95), QUAD),
        judge(ANSWER, said(effect("thrust_scale", ("payload",), scale=(0.9, 0.8, 1.0)), closed=0.8), QUAD),
        judge(ANSWER, said(), QUAD),
        judge(CLEAN, said(), QUAD),
        judge(CLEAN, said(effect("inertia", scale_x=(1.1, 1.05, 1.15))), QUAD),
        judge(TETHER, said(unexplained=True, depends=("position",)), QUAD),
        judge(TETHER, said(effect("constant_force", north_n=(1.0, 0.9, 1.1))), QUAD),
        {"lost": "an error"},
    ]
    figures = summary(rows)
    assert figures["lost"] == 1
    assert figures["false_names_clean"] == 0.5
    assert figures["right_class"] == 1.0
    assert figures["exact_alone"] == 1.0
    assert figures["found"] == pytest.approx(2 / 3)
    assert figures["closed_90"] == 0.5
    assert figures["outside_unnamed"] == 0.5
    assert figures["outside_noticed"] == 0.5
    assert figures["outside_driver"] == 1.0
    assert (figures["silent"], figures["silent_gaps"]) == (1, 0)
    lines = {line["hidden"]: line for line in confusion(rows)}
    assert lines["payload"] == {
        "hidden": "payload", "cases": 3, "exact": 1, "class": 1, "missed": 1, "wrong": {}, "unexplained": 0,
        "error": pytest.approx(0.0), "coverage": 1.0,
    }  # fmt: skip
    assert lines["nothing"]["wrong"] == {"inertia": 1}


def test_a_silent_verdict_counts_and_is_wrong_where_a_held_out_figure_is_far_above_its_floor() -> None:
    def silent(answer: dict, force: float, turning: float | None) -> dict:
        gap = {"before": {"one_step_mps2": force, "one_step_radps2": turning}, "closed": None}
        gap["noise_floor"] = {"one_step_mps2": 0.1, "one_step_radps2": 1.0}
        return judge(answer, {**said(), "gap": gap}, QUAD)

    told = judge(TETHER, said(unexplained=True), QUAD)
    quiet = [silent(ANSWER, 0.1, 1.19), told, silent(CLEAN, 0.3, 3.0), silent(TETHER, 0.11, None)]
    figures = summary(quiet)
    assert (figures["silent"], figures["silent_gaps"], figures["silent_most"]) == (2, 0, 1.19)
    wrong = [*quiet, silent(TETHER, 0.12, 1.0)]
    assert (summary(wrong)["silent"], summary(wrong)["silent_gaps"]) == (3, 1)
    page = tables(wrong, [{"version": "1 abc", "timing": {"wall_s": 2.0}}], "make gap-blind")
    assert "1.20 floors) | 3 | |" in page
    assert "at 1.2 floors or more | 1 **missed** | 0 |" in page


def test_the_tables_go_between_their_marks_and_leave_the_page_alone(tmp_path: Path) -> None:
    page = tmp_path / "gap.md"
    page.write_text(f"before\n{BEGIN}\nSTALE\n{END}\nafter\n")
    made = tables([judge(CLEAN, said(), QUAD)], [{"version": "1 abc", "timing": {"wall_s": 2.0}}], "make gap-blind")
    campaign.put(made, BEGIN, END, page)
    text = page.read_text()
    assert text.startswith("before\n")
    assert text.endswith("after\n")
    assert "STALE" not in text
    assert made.rstrip() in text


def test_a_believed_vehicle_survives_its_file(tmp_path: Path) -> None:
    case = make("clean", 11)
    _, vehicle, _ = write(case, tmp_path, "case-2")
    assert parse_vehicle(vehicle.read_text(), "case") == case.believed
    assert dataclasses.asdict(case.answer)["effects"] == {}
