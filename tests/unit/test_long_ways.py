"""A certificate of a stop with GPS: its ways are long, and the checker has to hold them within its memory."""

from __future__ import annotations

import io
import json
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from flightstack.barrier.estimate_bounds import estimate_bounds
from flightstack.certificate_check import check, left
from flightstack.cli import files
from flightstack.cli.checking import MEMORY_BYTES
from flightstack.cli.given_certificate import require_checked
from flightstack.cli.protection import governor_for
from flightstack.cli.sensors import error_statistics
from flightstack.model import Limits, Model
from flightstack.site.certificate import as_json
from flightstack.site.stopping import Prior, stopping
from flightstack_sim.grade import load_grade
from tests.thorough import ONLY_THEN

LOOP = left.ClosedLoop(3.0, 6.0, 4.0, 0.03, 0.03, 20.0, 6.0, 12.0)


def _ways(count: int, steps: int) -> list[np.ndarray]:
    """Straight lines from 5 m/s on, braking evenly: as long as those of a vehicle with GPS."""
    t_s = 0.01 * np.arange(steps)
    rest_s = t_s[-1]
    way = np.zeros((steps, 5), dtype=np.complex128)
    way[:, 0], way[:, 1], way[:, 2] = 5.0 * t_s * (1.0 - 0.5 * t_s / rest_s), 5.0 * (1.0 - t_s / rest_s), -5.0 / rest_s
    return [way * np.exp(1j * k) for k in range(count)]


def test_many_long_ways_fit_into_the_checkers_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """A certificate has 26; 815 steps each took 650 MB side by side: "not to be read as a certificate: MemoryError".
    The most that are looked at side by side are the dearest: a little longer ones are halved."""
    monkeypatch.setattr(left, "_ROUNDS", 1)
    monkeypatch.setattr(left, "_PASSED_ON", 0)
    tracemalloc.start()
    found = left.left(_ways(26, left._SIDE_BY_SIDE // 26), LOOP, np.array((0.5, 0.1, 0.3, 0.2)))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 0.8 * MEMORY_BYTES
    assert found.shape == (26,)
    assert np.allclose(found, found[0], rtol=0.05)  # the same way turned: left as far
    assert found.min() > 0.3


def test_no_way_at_all_is_left_nowhere() -> None:
    none = np.zeros((0, 5), dtype=np.complex128)
    assert left.left([], LOOP, np.ones(4)).shape == (0,)
    assert left.left([none, none], LOOP, np.ones(4)).tolist() == [0.0, 0.0]


@ONLY_THEN
def test_a_certificate_of_a_vehicle_with_gps_is_valid_and_may_be_flown(tmp_path: Path) -> None:
    believed, _ = files.load_vehicle(None)
    model = Model.from_vehicle(believed)
    estimate = estimate_bounds(error_statistics(load_grade("gps")))
    made = stopping(
        believed,
        model,
        Limits(),
        estimate,
        governor_for(believed, model, Limits(), "gps"),
        Prior(0.94, 1.08, 0.05, 5.0),
    )
    learned = {"gain": 0.995, "gain_sigma": 0.008, "force_mps2": 0.3, "flight_s": 60.0, "speed_mps": 5.0}
    path = tmp_path / "stopping.json"
    path.write_text(as_json(made, "quad-x", "hash", "gps", learned))
    require_checked(files.read_text(path))
    assert json.loads(path.read_text())["sensors"] == "gps"


def test_a_certificate_of_a_stop_beside_a_log_is_a_wrong_question_and_not_an_invalid_file() -> None:
    verdict = check('{"schema": "flightstack.stopping/4"}', io.BytesIO(b""))
    assert not verdict.readable
    assert verdict.lines == ["a certificate of a stop is not derived from a log: leave out --log"]
