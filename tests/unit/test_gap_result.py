"""gap.json, the sentence, held-out figures: what they say of given results; and what the verb says of bad input."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from shipped import load_vehicle

from flightstack.cli.main import main
from flightstack.gap.decisions import GUARD_S
from flightstack.gap.gather import limits
from flightstack.gap.identify import Identifiable
from flightstack.gap.pooled import split
from flightstack.gap.records import Estimate, Figures, Gap, IdentifiedEffect, Samples, Unexplained
from flightstack.gap.report import tables, words
from flightstack.gap.report.page import panels, render_report
from flightstack.gap.report.record import GapReport, Trace
from flightstack.gap.verdict import closed

QUAD = load_vehicle("quad-x")
NOTHING = Unexplained(False)


def figures(force: float | None, turning: float | None) -> Figures:
    return Figures(force, turning, 0.1)


@pytest.mark.parametrize(
    ("before", "after", "floor", "expected"),
    [
        ((1.9, 3.0), (0.16, 1.1), (0.15, 1.0), 0.95),  # the worse of (1.9-0.16)/(1.9-0.15) and (3-1.1)/(3-1)
        ((1.0, 1.1), (0.55, 1.1), (0.1, 1.0), 0.5),  # no gap in torque: 1.1 < 1.2 floors
        ((0.11, 1.1), (0.11, 1.1), (0.1, 1.0), None),  # no gap at all
        ((1.0, None), (0.1, None), (0.1, None), 1.0),
        ((1.0, None), (1.2, None), (0.5, None), -0.4),  # worse than before is said, not hidden
    ],
)
def test_closed_is_the_worse_share_of_the_channels_that_have_a_gap(
    before: tuple, after: tuple, floor: tuple, expected: float | None
) -> None:
    value = closed(figures(*before), figures(*after), figures(*floor))
    assert value == (expected if expected is None else pytest.approx(expected, abs=1e-6))


def found(name: str, twins: tuple[str, ...] = (), **parameters: tuple[float, float, float]) -> IdentifiedEffect:
    values = {p: Estimate(0.0, *numbers) for p, numbers in parameters.items()}
    return IdentifiedEffect(name, values, -100.0, 0.9, 1e-9, twins, "fly a circle" if twins else "")


GAP = Gap(figures(1.0, None), figures(0.1, None), figures(0.09, None), 0.98)


def test_held_out_data_that_hardly_hold_an_effect_are_said_to_say_nothing() -> None:
    mute = dataclasses.replace(found("ground_effect"), holdout_gain=float("nan"))
    assert words.held_out(mute).endswith("say nothing for or against")
    assert words.held_out(found("payload")) == (
        "without it 90 % of what can be explained of held-out data (noise-weighted) is lost"
    )


@pytest.mark.parametrize("only", ["", words.SIDE_FORCE, words.SIDE_AND_LIFT])
def test_the_headline_has_names_and_what_was_closed_but_no_numbers_of_an_effect(only: str) -> None:
    four = (
        found("payload", mass_kg=(0.21, 0.2, 0.22)), found("constant_force", north_n=(1.649, 1.6, 1.7)),
        found("rotor_drag", ("linear_drag",), k_d_kg_per_rad=(1e-4, 9e-5, 2e-4)), found("motor_lag"),
    )  # fmt: skip
    left = Unexplained(True, ("height",), 0.06)
    sentence = words.sentence(four, GAP, left, only=only)
    told = words.headline(GapReport(sentence, "quad-x", GAP, four, (), left, ()))
    lag = " and another motor lag; with them 98 % of the gap on data not used before is closed; 6 % of the gap is left"
    assert told.startswith(f"The model lacks a payload, a constant force, rotor drag or linear drag{lag}")
    assert ("too slowly" in told) is bool(only)
    assert words.headline(GapReport("Nothing.", "quad-x", GAP, (), (), left, ())) == "Nothing."


def test_a_force_that_is_closed_is_not_called_open_for_what_turning_leaves() -> None:
    gap = Gap(figures(1.13, 1.36), figures(0.239, 1.36), figures(0.0163, 0.085), 0.0)
    said = words.sentence((found("payload", mass_kg=(0.2, 0.1, 0.3)),), gap, Unexplained(True, ("airspeed",), 1.0))
    assert "with it 80 % of the gap in force and 0 % of the gap in turning are closed" in said  # 0.891 of 1.1137
    assert "100 % of the gap in turning is left that no effect explains" in said


def test_the_sentence_says_what_how_sure_how_much_and_what_would_settle_it() -> None:
    said = words.sentence((found("payload", mass_kg=(0.216, 0.21, 0.222)),), GAP, NOTHING)
    assert said == (
        "The model lacks a payload (mass_kg 0.216 kg (0.210 to 0.222)); "
        "with it 98 % of the gap on data not used before is closed."
    )
    twin = words.sentence((found("payload", ("thrust_scale",), mass_kg=(0.2, 0.1, 0.3)),), GAP, NOTHING)
    assert "or a thrust scale, which these logs can't tell apart" in twin
    assert "to settle which: fly a circle" in twin


def test_many_effects_are_said_by_their_sizes_alone() -> None:
    many = (
        found("payload", ("thrust_scale", "thrust_curve"), mass_kg=(0.2, 0.1, 0.3)),
        found("linear_drag", ("rotor_drag",), d_x_kgps=(0.3, 0.29, 0.31), d_y_kgps=(0.4, 0.39, 0.41)),
        found("rotor_fault", rotor=(3.0, 3.0, 3.0), effectiveness=(0.85, 0.84, 0.86)),
    )
    assert words.sentence(many, GAP, NOTHING) == (
        "The model lacks a payload 0.20 kg or a thrust scale or 1 more, linear drag 0.300, 0.400 kg/s or rotor drag "
        "and a weak rotor 3, 0.850 (what stands after an or these logs can't tell apart); with them 98 % of the gap on "
        "data not used before is closed; to settle which: fly a circle."
    )


def test_nothing_is_invented_where_nothing_is_found() -> None:
    assert "agree within the noise" in words.sentence((), GAP, NOTHING)
    rest = words.sentence((), GAP, Unexplained(True, ("position",), 0.8))
    assert "no effect of the table explains; it depends on position" in rest


@pytest.mark.parametrize(
    ("before", "only", "part"),
    [
        (figures(0.0153, None), "side force", "side force"),  # motors at 10 Hz: 0.8 kg too much stood beside "no gap"
        (figures(0.0153, None), "", "force"),
        (figures(None, 0.1), "", "turning"),
        (figures(0.0153, 0.1), "", ""),
    ],
)
def test_no_gap_is_said_of_what_was_compared_only(before: Figures, only: str, part: str) -> None:
    gap = Gap(before, before, before, None)
    said = words.sentence((), gap, NOTHING, only=only)
    state, word = words.verdict((), gap, NOTHING, only=only)
    assert said.startswith("Model and measurement agree within the noise")
    assert (f"in {part}, all that was compared" in said) is bool(part)
    assert (state, word) == (("plain", f"no gap in {part}") if part else ("good", "no gap"))
    page = tables.effects(GapReport(said, "quad-x", gap, (), (), NOTHING, ()))
    assert (f"in {part}, all that was compared" in page) is bool(part)


def test_where_a_force_is_not_told_no_part_of_the_page_says_plainly_that_there_is_no_gap() -> None:
    """The sentence had it; badge, tile and table said "no gap", "nothing significant" and "agree within the noise"."""
    gap = Gap(figures(0.05, 0.1), figures(0.05, 0.1), figures(0.05, 0.1), None)
    untold = "a level force of 0.22 m/s² is the autopilot's own estimate or a constant force"
    said = words.sentence((), gap, NOTHING, untold=untold)
    report = GapReport(said, "quad-x", gap, (), (), NOTHING, (), untold=untold)
    page = render_report(report)
    assert "no gap but a force untold" in page
    assert ">no gap<" not in page
    assert "nothing significant" not in page
    assert "but for a level force that is not told" in page
    assert "a level force of 0.22" in tables.effects(report)


def flight(seconds: float) -> Samples:
    n = round(seconds * 100)
    three, four = np.zeros((n, 3)), np.zeros((n, 4))
    t = 0.01 * np.arange(n)
    return Samples("f", t, 0.01, three, three, four, three, three, four, np.zeros(n), np.zeros(n), np.ones(n, np.bool_))


def test_the_last_third_is_held_out_behind_a_guard() -> None:
    whole = flight(60.0)
    of = split([whole], [])
    fit, held = of.flights[0].t_s[of.fit[0]], of.flights[0].t_s[of.holdout[0]]
    assert held[0] == pytest.approx(40.0, abs=0.02)
    assert held[-1] == whole.t_s[-1]
    assert held[0] - fit[-1] == pytest.approx(GUARD_S, abs=0.02)
    assert fit[0] == 0.0


def test_what_shows_only_where_was_learned_from_is_said_to() -> None:
    """Beside "not explained" stood "no gap to close" and figures as small as the noise."""
    gap = Gap(figures(0.05, 0.1), figures(0.05, 0.1), figures(0.05, 0.1), None)
    left = Unexplained(True, (), 1.0)
    said = words.sentence((), gap, left)
    assert said.endswith("it shows in the part that was learned from only.")
    assert "learned from" not in words.sentence((), GAP, left)
    page = render_report(GapReport(said, "quad-x", gap, (), (), left, ()))
    assert ">no gap there<" in page
    assert ">in the part that was learned from<" in page
    assert "no gap to close" not in page


@pytest.mark.parametrize(
    ("after_m", "says"),
    [(0.1, "2.0 times smaller"), (0.2, "as it was"), (0.201, "as it was"), (0.4, "2.0 times larger")],
)
def test_a_path_that_is_as_it_was_is_not_called_smaller(after_m: float, says: str) -> None:
    assert words.ratio(Figures(None, None, 0.2), Figures(None, None, after_m)) == says


def test_a_flight_that_was_kept_is_never_learned_from() -> None:
    of = split([flight(20.0)], [flight(10.0)])
    assert [int(m.sum()) for m in of.fit] == [2000, 0]
    assert [int(m.sum()) for m in of.holdout] == [0, 1000]


def test_the_gap_closes_to_the_noise_only_where_something_was_left_to_close() -> None:
    rejected = dataclasses.replace(GAP, closed=None)
    assert "0 %" not in words.sentence((found("payload", mass_kg=(0.2, 0.1, 0.3)),), rejected, NOTHING)


HEADER = "time_s,vel_n_mps,vel_e_mps,vel_d_mps,q_w,q_x,q_y,q_z,motor_1,motor_2,motor_3,motor_4"
ROW = "{t:.3f},0,0,0,1,0,0,0,0.6,0.6,0.6,0.6"


def still(rows: int) -> str:
    return "\n".join([HEADER, *(ROW.format(t=0.01 * k) for k in range(rows))]) + "\n"


@pytest.mark.parametrize(
    ("name", "content", "complaint"),
    [
        ("empty.csv", b"", "empty"),
        ("foreign.csv", b"a,b,c\n1,2,3\n", "column"),
        ("binary.ulg", b"\x00\x01\x02" * 100, "log"),
        ("cut.ulg", b"ULog\x01\x12\x35\x01" + b"\x00" * 8, "log"),
        ("nan.csv", (HEADER + "\n" + "nan," * 11 + "nan\n").encode() * 3, "log"),
        ("short.csv", still(100).encode(), "log"),
        ("still.csv", still(3000).encode(), "not a flight"),
        ("motorless.csv", b"time_s,vel_n_mps,vel_e_mps,vel_d_mps\n" + b"0,1,2,3\n1,2,3,4\n" * 50, "log"),
    ],
)
def test_what_is_no_usable_flight_ends_in_one_line_and_no_coefficients(
    name: str, content: bytes, complaint: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, out = tmp_path / name, tmp_path / "out"
    log.write_bytes(content)
    with pytest.raises(SystemExit) as ended:
        main(["gap", str(log), "--vehicle", "quad-x", "--out", str(out)])
    said = capsys.readouterr()
    assert ended.value.code == 2
    lines = said.err.strip().splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("error: ")
    assert complaint in lines[0]
    assert not list(out.glob("gap.json*"))
    assert not list(out.glob("vehicle.toml*"))


def test_a_missing_log_and_a_missing_vehicle_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for arguments, name in (
        (["gap", str(tmp_path / "no.csv"), "--vehicle", "quad-x"], "no.csv"),
        (["gap", str(tmp_path / "no.csv"), "--vehicle", str(tmp_path / "no.toml")], "no.toml"),
    ):
        with pytest.raises(SystemExit) as ended:
            main([*arguments, "--out", str(tmp_path / "out")])
        assert ended.value.code == 2
        assert name in capsys.readouterr().err


def test_an_earlier_result_is_gone_when_a_run_fails(tmp_path: Path) -> None:
    """Whoever finds a gap.json finds the one of this run."""
    out = tmp_path / "out"
    out.mkdir()
    (out / "gap.json").write_text(json.dumps({"schema": "flightstack.gap/1"}))
    log = tmp_path / "still.csv"
    log.write_text(still(3000))
    with pytest.raises(SystemExit):
        main(["gap", str(log), "--vehicle", "quad-x", "--out", str(out)])
    assert not (out / "gap.json").exists()


def test_what_was_simulated_before_is_within_its_chart_however_far_off() -> None:
    t = np.linspace(0.0, 10.0, 2001)
    measured = np.zeros((len(t), 6))
    before, after = measured.copy(), measured.copy()
    before[:, 0], before[:, 2], before[:, 3] = 0.98, -4.0, np.nan
    drawn = {each.key: each for each in panels((Trace("a.csv", t, measured, before, after, np.ones(6), ()),))}
    for key, value in (("specific-force-x", 0.98), ("specific-force-z", -4.0), ("angular-acceleration-x", 0.0)):
        cut = drawn[f"trace-{key}"].cut
        assert cut is not None
        assert cut[0] < value < cut[1]


def test_what_would_have_been_named_is_said_where_nothing_is() -> None:
    def row(effect: str, parameter: str, smallest: float) -> Identifiable:
        return Identifiable(effect, parameter, smallest / 7.0, smallest, 1.0, smallest < 1.0, "", 0.0, "")

    inf = float("inf")
    rows = (row("payload", "mass_kg", 0.083), row("linear_drag", "d_x_kgps", 0.2), row("linear_drag", "", 0.14))
    told = limits((*rows, row("angular_damping", "", inf)))
    assert "linear drag off by 14 %" in told
    assert "payload of 0.083 kg" in told
    assert told.endswith("nothing can be told of the file's angular damping")
    assert told in words.sentence((), GAP, NOTHING, limits=told)
    assert told not in words.sentence((found("payload", mass_kg=(0.2, 0.1, 0.3)),), GAP, NOTHING, limits=told)
