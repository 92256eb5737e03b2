"""controllers/gains.toml: whole, checked, and the same after writing and reading."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping

import pytest
from shipped import ROOT

from flightstack.cli.controllers import CONTROLLERS, load_gains
from flightstack.control.gains import GAINS, FlatnessGains, Tuned, gains_to_toml, parse_gains
from flightstack.types import InputError

PATH = ROOT / "flightstack/data/controllers" / "gains.toml"
TEXT = PATH.read_text(encoding="utf-8")


def test_every_controller_has_its_gains_in_the_file() -> None:
    gains = load_gains()
    assert {row.gains for row in CONTROLLERS.values()} == set(GAINS) == set(gains)
    for name, tuned in gains.items():
        assert tuple(type(group) for group in tuned.groups) == GAINS[name]
        assert 0.0 < tuned.score_m < 1.0, "the tuning's own figure"


def test_pd_laws_have_no_integral() -> None:
    data = tomllib.loads(TEXT)
    for name in ("pd", "indi"):
        assert data[name]["integral_xy"] == data[name]["integral_z"] == 0.0
    assert data["pid"]["integral_xy"] > 0.0


def test_writing_and_reading_gives_the_same_gains() -> None:
    tuned = load_gains()
    again = parse_gains(gains_to_toml(tuned, "one\n\ntwo"), "again")
    assert again == tuned


def test_the_flat_table_of_the_flatness_controller_is_its_record() -> None:
    gains = FlatnessGains(1.0, 2.0, 3.0, 4.0, 5.0)
    tuned: Mapping[str, Tuned] = load_gains()
    record = gains.with_attitude(tuned["flatness"].groups[0])  # type: ignore[arg-type]
    assert record.nominal.pole_radps == (1.0, 1.0, 2.0)
    assert (record.thrust_p_ps2, record.thrust_d_ps, record.position_rate_radpms) == (3.0, 4.0, 5.0)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('schema = "flightstack.gains/1"', 'schema = "gains"', "schema = 'gains' is not known"),
        ("[pid]", "[pie]", "unknown key pie"),
        ("cutoff_radps = ", "cutoff_hz = ", "unknown key cutoff_hz"),
        ("xy_p = ", "xy_p = -", "x: px4.xy_p = -"),
        ("score_m = ", 'score_m = "no" #', "score_m = 'no' is not allowed"),
        ("origin = ", "origin = 3 #", "origin = 3 must be a line of text"),
        ("attitude_p_ps = ", "#", "attitude_p_ps = missing is not allowed; it must be a number in 0 to 200"),
        ("rate_p = ", "rate_p = inf #", "rate_p = inf is not allowed"),
    ],
)
def test_a_wrong_file_is_one_line_that_names_the_place(old: str, new: str, words: str) -> None:
    assert old in TEXT
    with pytest.raises(InputError) as error:
        parse_gains(TEXT.replace(old, new, 1), "x")
    assert words in str(error.value)
    assert "\n" not in str(error.value)
    assert str(error.value).startswith("x")


def test_a_missing_table_is_named() -> None:
    start = TEXT.index("[px4]")
    with pytest.raises(InputError, match=r"x: the table \[px4\] is missing"):
        parse_gains(TEXT[:start], "x")
