"""`flightstack gap` on this project's own logs: short flights with `fly`, an effect hidden in what really flies."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from benchmarks.close_gap import HIDDEN, close, hidden_truth, simulated
from flightstack.cli import files
from flightstack.cli.flight import FlyOptions, fly
from flightstack.cli.gap import GapOptions, find_gap
from flightstack.gap.result import GapResult
from flightstack.types import InputError
from flightstack.vehicle import Vehicle, vehicle_to_toml, with_effects
from flightstack_logs.reader import read
from flightstack_logs.turn import conjugate, multiply, rotation_vector
from tests.thorough import thorough

QUAD = files.load_vehicle("quad-x")[0]
SECONDS = 16.0
FLIGHTS: dict[str, tuple[str, dict[str, dict[str, float]]]] = {
    "nothing": ("excite-yaw-at-speed", {}),
    "rotor_drag": ("excite-yaw-at-speed", {"rotor_drag": {"k_d_kg_per_rad": 1.6e-4}}),
    "payload": ("paper-tracking", {"payload": {"mass_kg": 0.2}}),
    "motor_lag": ("excite-thrust-chirp", {"motor_lag": {"time_constant_s": 0.035}}),
}
"""Hidden -> scenario, effects."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("flights")


def flown(scenario: str, truth: Vehicle, folder: Path) -> Path:
    """Fly without learning; the log."""
    folder.mkdir()
    (folder / "truth.toml").write_text(vehicle_to_toml(truth))
    options = FlyOptions(
        scenario=scenario,
        truth=str(folder / "truth.toml"),
        duration_s=SECONDS,
        learning=False,
        out=folder,
    )
    fly(options, report_wanted=lambda result: False)
    return folder / "flight.mcap"


@cache
def log_of(hidden: str, folder: Path) -> Path:
    scenario, effects = FLIGHTS[hidden]
    return flown(scenario, with_effects(QUAD, effects), folder / hidden)


@cache
def said_of(hidden: str, folder: Path) -> GapResult:
    return find_gap(GapOptions(logs=(log_of(hidden, folder),), vehicle="quad-x", out=folder / f"gap-{hidden}"))


@pytest.mark.parametrize(
    "hidden",
    [
        "nothing",
        "rotor_drag",
        thorough("payload"),  # a load beside a drag is told below
        thorough("motor_lag"),  # the same, flown in memory, in test_gap_name_vehicle.py
    ],
)
def test_what_is_hidden_in_a_flight_is_named_and_nothing_else(hidden: str, folder: Path) -> None:
    result = said_of(hidden, folder)
    effects = FLIGHTS[hidden][1]
    assert [found.name for found in result.found] == list(effects)
    assert not result.unexplained.significant
    for found in result.found:
        for name, true in effects[found.name].items():
            assert found.parameters[name].estimate == pytest.approx(true, rel=0.05)
        assert result.gap.closed is not None
        assert result.gap.closed > 0.9


def test_the_corrected_vehicle_flies_and_leans_as_the_real_one_did(folder: Path) -> None:
    """The same flight again, by the simulator with the corrected file and by the one that was believed."""
    said_of("rotor_drag", folder)
    log = log_of("rotor_drag", folder)
    corrected = files.load_vehicle(str(folder / "gap-rotor_drag" / "vehicle.toml"))[0]
    again = flown(FLIGHTS["rotor_drag"][0], corrected, folder / "again")
    away = [_apart_rad(log, each) for each in (log_of("nothing", folder), again)]
    assert away[0] > 0.02
    assert away[1] < 0.1 * away[0]


def test_a_load_and_drag_are_told_and_flown_with(folder: Path) -> None:
    """End to end without a learner: what the file lacks is fed forward the second time."""
    out = folder / "closed"
    closed = close(simulated(hidden_truth(out), learning=False, duration_s=SECONDS), "quad-x", out)
    assert {found.name for found in closed.result.found} == set(HIDDEN)
    errors_m = [each["tracking"]["rmse_settled_m"] for each in (closed.before, closed.after)]
    assert errors_m[1] < 0.3 * errors_m[0]
    assert closed.result.sentence in closed.page.read_text("utf-8")


def _apart_rad(first: Path, second: Path) -> float:
    """Root mean square angle between the attitudes that two logs report at the same times."""
    tables = [read(path).tables["/vehicle/attitude"] for path in (first, second)]
    t_us = np.intersect1d(*(table["t_boot_us"] for table in tables))
    assert len(t_us) > 1000
    q = [table["q_ned_frd"][np.searchsorted(table["t_boot_us"], t_us)].astype(np.float64) for table in tables]
    angle = np.linalg.norm(rotation_vector(multiply(conjugate(q[0]), q[1])), axis=1)
    return float(np.sqrt(np.mean(angle**2)))


@pytest.mark.parametrize("share", [0.7, 0.03])
def test_a_log_that_is_cut_off_is_used_up_to_the_cut_or_refused_in_one_line(share: float, folder: Path) -> None:
    whole = log_of("rotor_drag", folder).read_bytes()
    cut, out = folder / f"cut-{share}.mcap", folder / f"gap-cut-{share}"
    cut.write_bytes(whole[: int(share * len(whole))])
    options = GapOptions(logs=(cut,), vehicle="quad-x", out=out)
    if share > 0.5:
        assert [found.name for found in find_gap(options).found] == ["rotor_drag"]
        return
    with pytest.raises(InputError) as refused:
        find_gap(options)
    assert "\n" not in str(refused.value)
    assert not list(out.glob("*"))
