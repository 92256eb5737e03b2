"""`certify --site`: faster and faster in all directions, and a certificate that is flown by."""

from __future__ import annotations

import json
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from flightstack.certificate_check import check
from flightstack.cli import protection
from flightstack.cli.certify_site import EXPLORED, SiteCertified, certify_site
from flightstack.cli.flight import FlyOptions, fly, prepare
from flightstack.cli.replay import replay
from flightstack.types import InputError
from flightstack_logs.reader import read
from tests.thorough import ONLY_THEN

BOX = """schema = "flightstack.site/1"
floor_m = 0.3
ceiling_m = 5.0
inside = [[-6.0, -5.0], [6.0, -5.0], [6.0, 5.0], [-6.0, 5.0]]
"""


@dataclass(frozen=True)
class Learnt:
    """What came of it, and where the site's file lies."""

    result: SiteCertified
    site: Path


def certified(folder: Path, scenario: str = EXPLORED, *, explores: bool = True, **more: object) -> SiteCertified:
    (folder / "box.toml").write_text(BOX)
    options = FlyOptions(scenario=scenario, out=folder, site=folder / "box.toml", **more)  # type: ignore[arg-type]
    return certify_site(options, explores=explores, stop_requested=lambda: "", on_progress=lambda share, phase: None)


@pytest.fixture(scope="module")
def learnt(tmp_path_factory: pytest.TempPathFactory) -> Learnt:
    folder = tmp_path_factory.mktemp("learnt")
    return Learnt(certified(folder), folder / "box.toml")


def test_it_goes_faster_and_faster_in_all_directions(learnt: Learnt) -> None:
    result = learnt.result
    assert result.passed, result.failure()
    assert result.flight.flight_time_s < 180.0
    assert result.flight.barrier["exits"] == 0
    flown = [each.flown_mps for each in result.rounds]
    assert len(flown) >= 3
    assert all(later > 1.1 * earlier for earlier, later in pairwise(flown))
    assert all(each.asked_mps <= 1.5 * before + 1e-9 for each, before in zip(result.rounds[1:], flown, strict=False))
    assert "room for" in result.ended
    assert result.flight.log is not None
    truth = read(Path(result.flight.log)).tables["/truth"]["vel_ned_mps"]
    ways = np.deg2rad(45.0 * np.arange(8))
    reached = np.stack([truth[:, 0] * np.cos(way) + truth[:, 1] * np.sin(way) for way in ways]).max(axis=1)
    assert reached.min() == pytest.approx(result.learned["speed_mps"], rel=0.02)
    assert reached.min() > 3.0
    assert result.flight.barrier["changed_share"] < 0.01  # it flies what fits
    assert json.dumps(result.as_json())


@ONLY_THEN
def test_its_log_is_replayed_with_the_certificates_that_were_learned(tmp_path: Path) -> None:
    """Each round's is made again, and the next round follows from it: any other would part the ticks."""
    result = certified(tmp_path, duration_s=32.0)
    assert result.rounds
    assert result.rounds[0].prior is not None
    assert replay(tmp_path / "flight.mcap").same


def test_its_certificate_stops_as_is_asked_and_is_flown_by(
    learnt: Learnt, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    result = learnt.result
    assert result.certificate is not None
    text = result.certificate.read_text()
    verdict = check(text)
    assert verdict.valid, verdict.lines
    assert json.loads(text)["stops_within_m"]["5 m/s"] < 4.2
    monkeypatch.setattr(protection, "require_checked", lambda file: None)  # it just was
    flown = fly(
        FlyOptions(scenario="figure8", out=tmp_path, site=learnt.site, certificate=result.certificate, duration_s=8.0),
        report_wanted=lambda result: False,
    )
    assert flown.passed, flown.failure()
    assert (flown.barrier["exits"], flown.barrier["premises_broken"], flown.barrier["changed_share"]) == (0, 0, 0.0)


def test_in_more_wind_than_is_held_against_nothing_is_certified(tmp_path: Path) -> None:
    result = certified(tmp_path, "steady-wind", duration_s=12.0)
    assert not result.passed
    assert "felt beyond the model" in result.failure()
    assert not (tmp_path / "stopping.json").exists()


def test_along_a_scenario_it_holds_as_fast_as_every_direction_was_flown(tmp_path: Path) -> None:
    """A hover flies in none."""
    result = certified(tmp_path, "hover", explores=False, duration_s=6.0)
    assert result.passed, result.failure()
    assert result.made is not None
    assert result.made.prior.speed_mps < 0.1


def slower(learnt: Learnt, folder: Path, speed_mps: float) -> Path:
    """The certificate, said to hold up to that speed only."""
    assert learnt.result.certificate is not None
    said = json.loads(learnt.result.certificate.read_text())
    said["prior"]["speed_mps"] = speed_mps
    (folder / "slower.json").write_text(json.dumps(said))
    return folder / "slower.json"


def test_a_track_that_is_faster_than_it_holds_is_refused(learnt: Learnt, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"flown at up to 3\.3 m/s, and the certificate holds up to 2\.0 m/s"):
        prepare(FlyOptions(scenario="figure8", site=learnt.site, certificate=slower(learnt, tmp_path, 2.0)))


@pytest.mark.parametrize(("speed_mps", "is_broken"), [(0.4, True), (4.0, False)])
def test_one_that_is_flown_faster_than_it_holds_ends(
    learnt: Learnt, tmp_path: Path, speed_mps: float, is_broken: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The climb rises by some 1 m/s; from then on the prior's is kept to, and the site with it."""
    monkeypatch.setattr(protection, "require_checked", lambda file: None)
    slow = slower(learnt, tmp_path, speed_mps)
    options = FlyOptions(scenario="hover", out=tmp_path, site=learnt.site, certificate=slow, duration_s=3.0)
    flown = fly(options, report_wanted=lambda result: False)
    assert (flown.barrier["premises_broken"] > 0) == is_broken
    assert flown.barrier["exits"] == 0
    assert flown.completed
