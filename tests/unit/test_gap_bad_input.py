"""What `flightstack gap` says of files that it can't use: exit code 2, one line that says why, and no coefficients.

The log is a good one, spoilt in one way each; unspoilt it is read.
"""

from __future__ import annotations

import gzip
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from shipped import load_vehicle

from flightstack.cli.main import main
from flightstack.gap.check import check
from flightstack.gap.checks.motion import LEAST_ROWS
from flightstack.gap.read import flight
from flightstack.gap.records import Checked
from flightstack.types import F64
from flightstack.vehicle import vehicle_to_toml
from tests.flown import HEADER
from tests.gap_batch import fly
from tests.thorough import thorough

QUAD = load_vehicle("quad-x")
COLUMNS = HEADER.split(",")
MOTORS = [COLUMNS.index(f"motor_{i}") for i in range(1, 5)]
SECONDS = 14.0
SAMPLED = ("pos_ned_m", "vel_ned_mps", "q_ned_frd", "rate_frd_radps", "accel_frd_mps2", "motor")
_ROWS_A_SECOND = 125


@cache
def good() -> F64:
    """(N, 22) a flight in the columns of the header."""
    (s,) = fly(QUAD, [{}], seconds=SECONDS)
    parts = [s.t_s[:, None], s.pos_ned_m, s.vel_ned_mps, s.q_ned_frd, s.rate_frd_radps, s.accel_frd_mps2, s.motor]
    return np.hstack([*parts, s.battery_v[:, None]])


def csv(rows: F64, header: str = HEADER) -> bytes:
    lines = [",".join(f"{x:.6f}" if i == 0 else f"{x:.7g}" for i, x in enumerate(row)) for row in rows.tolist()]
    return "\n".join([header, *lines, ""]).encode()


def changed(change: Callable[[F64], None]) -> Callable[[], bytes]:
    def spoil() -> bytes:
        rows = good().copy()
        change(rows)
        return csv(rows)

    return spoil


def _set(columns: list[int] | slice, value: float, rows: slice = slice(None)) -> Callable[[F64], None]:
    def change(table: F64) -> None:
        table[rows, columns] = value

    return change


def _other_clock(table: F64) -> None:
    table[800:, 0] += 1e6


def _back_in_time(table: F64) -> None:
    table[800:, 0] -= 5.0


def _full_of_nan(table: F64) -> None:
    table[:, 1:][np.random.default_rng(0).random((len(table), table.shape[1] - 1)) < 0.5] = np.nan


def _other_order(table: F64) -> None:
    table[:, MOTORS] = table[:, [MOTORS[i] for i in (1, 2, 0, 3)]]


def _still(table: F64) -> None:
    table[:, 1:] = table[0, 1:]


BAD: dict[str, tuple[Callable[[], bytes], str]] = {
    "empty": (lambda: b"", "is empty"),
    "header only": (lambda: (HEADER + "\n").encode(), "no rows"),
    "foreign columns": (lambda: b"a,b,c\n1,2,3\n4,5,6\n", "--columns"),
    "foreign kind": (lambda: b"\x89PNG\r\n\x1a\n" + bytes(range(256)) * 8, "no known kind"),
    "cut before the first second": (lambda: csv(good())[:9000], "log"),
    "cut gzip": (lambda: gzip.compress(csv(good()))[:60], "log"),
    "no number at all": (changed(_set(slice(1, None), np.nan)), "no signal of a flight"),
    "half of all numbers missing": (changed(_full_of_nan), "in the air"),
    "no time": (changed(_set([0], np.nan)), "time column holds no numbers"),
    "one time": (changed(_set([0], 5.0)), "clock stands still"),
    "too short": (lambda: csv(good()[400 : 400 + 4 * _ROWS_A_SECOND]), "in the air"),
    "too slow": (lambda: csv(good()[::40]), "too slow"),
    "motors off": (changed(_set(MOTORS, 0.0)), "flight"),
    "nothing moves": (changed(_still), "not a flight"),
    "a motor without numbers": (changed(_set(MOTORS[:1], np.nan)), "no motor commands"),
    "no motors": (lambda: csv(np.delete(good(), MOTORS, axis=1), ",".join(np.delete(COLUMNS, MOTORS))), "no motor"),
    "five motors": (lambda: csv(np.hstack([good(), good()[:, MOTORS[:1]]]), HEADER + ",motor_5"), "5 motors"),
    "motors in another order": (changed(_other_order), "another order"),
    "another clock half way": (changed(_other_clock), "mixes clocks"),
    "back in time": (changed(_back_in_time), "mixes clocks"),
}


def refusal(arguments: list[str], out: Path, capsys: pytest.CaptureFixture[str]) -> str:
    with pytest.raises(SystemExit) as ended:
        main(["gap", *arguments, "--out", str(out)])
    said = capsys.readouterr().err.strip().splitlines()
    assert ended.value.code == 2
    assert len(said) == 1
    assert said[0].startswith("error: ")
    assert not [path.name for path in out.glob("*") if path.name.startswith(("gap.json", "vehicle.toml", "report"))]
    return said[0]


@pytest.mark.parametrize("case", BAD)
def test_a_log_of_no_use_ends_in_one_line(case: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    content, says = BAD[case]
    (tmp_path / "log.csv").write_bytes(content())
    assert says in refusal([str(tmp_path / "log.csv"), "--vehicle", "quad-x"], tmp_path / "out", capsys)


def test_the_log_that_was_spoilt_is_a_good_one(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_bytes(csv(good()))
    checked = check(flight(tmp_path / "log.csv", QUAD), QUAD)
    assert checked.samples is not None
    assert not [finding for finding in checked.findings if finding.level == "refused"]


def test_a_log_that_is_cut_off_is_used_up_to_the_cut(tmp_path: Path) -> None:
    text = csv(good())
    (tmp_path / "log.csv").write_bytes(text[: int(0.7 * len(text)) + 3])
    samples = check(flight(tmp_path / "log.csv", QUAD), QUAD).samples
    assert samples is not None
    assert samples.t_s[-1] == pytest.approx(0.7 * SECONDS, abs=0.1)


@pytest.mark.parametrize("rows", [1, 2, 8, 9])
@pytest.mark.parametrize("first", ["pos_n_m", "vel_n_mps", "q_w", "rate_x_radps", "accel_x_mps2"])
def test_a_signal_of_which_a_few_rows_are_left_is_not_there(first: str, rows: int, tmp_path: Path) -> None:
    """Of a damaged attitude a handful of rows had length one: what looks for late stamps ended in a traceback."""
    at, width = COLUMNS.index(first), 4 if first == "q_w" else 3
    table = good().copy()
    spoilt = np.ones(len(table), np.bool_)
    spoilt[len(table) // 2 :: 20][:rows] = False
    table[spoilt, at : at + width] = np.nan
    (tmp_path / "log.csv").write_bytes(csv(table))
    checked = check(flight(tmp_path / "log.csv", QUAD), QUAD)
    said = [finding.text for finding in checked.findings if f"only {rows} rows" in finding.text]
    assert bool(said) is (rows < LEAST_ROWS)
    if first in ("q_w", "rate_x_radps") and rows < LEAST_ROWS:
        assert checked.samples is not None


@pytest.mark.parametrize("value", [1e10, -9.96921e36, 1e300])
@pytest.mark.parametrize("first", ["pos_n_m", "vel_n_mps", "q_w", "rate_y_radps", "accel_x_mps2", "motor_2"])
def test_fill_values_of_a_stretch_are_left_out(first: str, value: float, tmp_path: Path) -> None:
    """A tenth of the samples, too many for spikes; squares of 1e300 ended in a traceback of LAPACK's."""
    table = good().copy()
    begin = len(table) // 2
    table[begin : begin + len(table) // 10, COLUMNS.index(first)] = value
    (tmp_path / "log.csv").write_bytes(csv(table))
    checked = check(flight(tmp_path / "log.csv", QUAD), QUAD)
    assert checked.samples is not None
    assert all(np.abs(np.nan_to_num(getattr(checked.samples, name))).max() < 1e3 for name in SAMPLED)


@pytest.mark.parametrize(("first", "times"), [("rate_x_radps", 1e5), ("accel_x_mps2", 1e5), ("vel_n_mps", 1e5)])
def test_a_signal_that_no_sensor_measures_is_left_out_whole(first: str, times: float, tmp_path: Path) -> None:
    """Rates of 18,000 rad/s: the vehicle that was fitted to them tumbled to infinity, which ended in a traceback."""
    table = good().copy()
    at = COLUMNS.index(first)
    table[:, at : at + 3] = times * (1.0 + np.abs(table[:, at : at + 3]))
    (tmp_path / "log.csv").write_bytes(csv(table))
    checked = check(flight(tmp_path / "log.csv", QUAD), QUAD)
    assert any("all of it is left out" in finding.text for finding in checked.findings)


def spoilt_axis(column: str, noise: float, tmp_path: Path) -> Checked:
    table = good().copy()
    table[:, COLUMNS.index(column)] = noise * np.random.default_rng(1).normal(size=len(table))
    (tmp_path / "log.csv").write_bytes(csv(table))
    return check(flight(tmp_path / "log.csv", QUAD), QUAD)


@pytest.mark.parametrize(
    ("axis", "noise"),
    [("x", 0.0), ("z", 0.3), ("x", 5.0), thorough("x", 0.3), thorough("z", 0.0), thorough("z", 5.0)],
)
def test_a_gyro_with_a_dead_or_noisy_axis_is_left_out(axis: str, noise: float, tmp_path: Path) -> None:
    """The motors push and nothing turns: an inertia of twice the file's was named, and nothing was unexplained."""
    checked = spoilt_axis(f"rate_{axis}_radps", noise, tmp_path)
    (said,) = (finding.text for finding in checked.findings if finding.name == "gyro")
    assert f"does not follow the attitude about {axis} (" in said
    assert checked.samples is not None
    known = checked.samples.valid
    (sound,) = fly(QUAD, [{}], seconds=SECONDS)
    wanted = np.column_stack([np.interp(checked.samples.t_s, sound.t_s, each) for each in sound.rate_frd_radps.T])
    assert np.std((checked.samples.rate_frd_radps - wanted)[known]) < 0.5 * np.std(wanted[known])


@pytest.mark.parametrize("noise", [0.0, 0.3])
def test_a_gyro_is_kept_where_the_attitude_is_the_one_that_is_dead_or_noise(noise: float, tmp_path: Path) -> None:
    checked = spoilt_axis("q_z", noise, tmp_path)
    assert "rate_frd_radps" in checked.flight.signals
    assert not [finding for finding in checked.findings if finding.name == "gyro"]


@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_a_motor_whose_command_was_not_logged_is_no_load_on_the_other_side(noise: float, tmp_path: Path) -> None:
    """The other three at the same thrust, a shifted mass: 93 % of the gap closed."""
    checked = spoilt_axis("motor_2", noise, tmp_path)
    assert checked.samples is None
    assert [f.text for f in checked.findings if f.level == "refused"] == [
        "motor 2 stands still while the vehicle flies: its command was not logged; log all four"
    ]


VEHICLES = {
    "six rotors": ("torque_ratio_m = [", "torque_ratio_m = [0.015, -0.015, ", "list of 4 numbers"),
    "no schema": ('schema = "flightstack.vehicle/1"', "", "schema"),
    "no mass": ("mass_kg", "mass_g", "mass_g"),
    "not TOML": ("[body]", "[body", "line"),
}


@pytest.mark.parametrize("case", VEHICLES)
def test_a_vehicle_file_of_no_use_ends_in_one_line(
    case: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    old, new, says = VEHICLES[case]
    (tmp_path / "log.csv").write_bytes(csv(good()))
    (tmp_path / "v.toml").write_text(vehicle_to_toml(QUAD).replace(old, new))
    arguments = [str(tmp_path / "log.csv"), "--vehicle", str(tmp_path / "v.toml")]
    assert says in refusal(arguments, tmp_path / "out", capsys)


def test_without_motors_sensor_effects_can_still_be_named(tmp_path: Path) -> None:
    """Gyro against attitude needs no simulation; forces and torques are not judged at all."""
    rows = np.delete(good(), MOTORS, axis=1)
    bias = (0.02, -0.03, 0.01)
    rows[:, COLUMNS.index("rate_x_radps") :][:, :3] += bias
    (tmp_path / "log.csv").write_bytes(csv(rows, ",".join(np.delete(COLUMNS, MOTORS))))
    from flightstack.cli.gap import GapOptions, find_gap

    result = find_gap(
        GapOptions(logs=(tmp_path / "log.csv",), vehicle="quad-x", out=tmp_path / "out", kinematics_only=True)
    )
    assert [found.name for found in result.found] == ["gyro_bias"]
    assert [p.estimate for p in result.found[0].parameters.values()] == pytest.approx(bias, abs=1e-3)
    assert result.gap.before.one_step_mps2 is None
    assert result.gap.before.rollout_1s_m is None
