"""`--site` from the command line's side: what is refused, what is flown, and what the JSON says of it."""

from __future__ import annotations

import json
import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "unit"))
from log_samples import proto_class

from flightstack.cli import files
from flightstack.cli.flight import FlyOptions, fly, prepare
from flightstack.cli.home import parse_home
from flightstack.cli.main import main
from flightstack.cli.result import FlightResult
from flightstack.cli.site import SitePlan
from flightstack.mission import plan
from flightstack.scenario import Scenario
from flightstack.site import backup as b
from flightstack.site.clearance import clear_of, packed
from flightstack.types import InputError
from flightstack_logs.reader import read

HEAD = 'schema = "flightstack.site/1"\nfloor_m = 0.3\nceiling_m = 3.3\n'
BOX = f"{HEAD}inside = [[-6.0, -5.0], [6.0, -5.0], [6.0, 5.0], [-6.0, 5.0]]\n"
WALL = f"{HEAD}inside = [[-6.0, -5.0], [2.2, -5.0], [2.2, 5.0], [-6.0, 5.0]]\n"


def _site(folder: Path, text: str, name: str = "site.toml") -> Path:
    path = folder / name
    path.write_text(text)
    return path


def _fly(folder: Path, text: str, scenario: str, **more: object) -> FlightResult:
    options = FlyOptions(scenario=scenario, out=folder, site=_site(folder, text), **more)  # type: ignore[arg-type]
    return fly(options, report_wanted=lambda result: False)


@pytest.fixture(scope="module")
def free(tmp_path_factory: pytest.TempPathFactory) -> FlightResult:
    """A lap of the figure of eight deep inside a box."""
    return _fly(tmp_path_factory.mktemp("free"), BOX, "figure8", duration_s=8.0)


@pytest.fixture(scope="module")
def walled(tmp_path_factory: pytest.TempPathFactory) -> FlightResult:
    """The same with a wall through its northern lobe."""
    return _fly(tmp_path_factory.mktemp("walled"), WALL, "figure8", duration_s=6.0)


def test_nothing_near_changes_nothing(free: FlightResult) -> None:
    """The box of the figure of eight: commands unchanged, the error of the unfiltered flight (1.4 cm)."""
    barrier = free.as_json()["barrier"]
    assert free.passed, free.failure()
    assert free.protection == "held"
    assert barrier["changed_share"] <= 0.05
    assert barrier["exits"] == 0
    assert barrier["bent"] == []
    assert free.tracking["rmse_m"] < 0.017
    assert barrier["engaged_share"] >= 0.95


def test_a_mission_through_a_wall_is_flown_along_it_and_told_so(walled: FlightResult) -> None:
    barrier = walled.as_json()["barrier"]
    assert walled.protection == "held", walled.failure()
    assert barrier["exits"] == 0
    assert barrier["premises_broken"] == 0
    assert {each["edge"] for each in barrier["bent"]} == {"edge 1"}
    assert all(each["from_s"] <= each["to_s"] for each in barrier["bent"])
    assert barrier["changed_share"] > 0.0
    assert json.dumps(walled.as_json())


def test_the_view_shows_the_site_and_a_way_to_a_stop_within_it(walled: FlightResult) -> None:
    """ENU: x is east, y is north.  Every way begins where the vehicle is and keeps clear of the wall at 2.2 m north."""
    assert walled.log is not None
    (site,) = _points(Path(walled.log), "/outline/site")
    for corner in ((-5.0, -6.0, 0.3), (-5.0, -6.0, 3.3), (5.0, 2.2, 0.3), (5.0, 2.2, 3.3)):
        assert np.linalg.norm(site - corner, axis=1).min() < 0.02  # the place of arming, as estimated
    ways = _points(Path(walled.log), "/outline/way")
    assert len(ways) > 10
    assert max(way[:, 1].max() for way in ways) < 2.2
    assert max(np.ptp(way, axis=0).max() for way in ways) > 0.5
    flown = read(Path(walled.log)).tables["/tick"]
    starts = np.array([way[0] for way in ways])[:, [1, 0, 2]] * [1.0, 1.0, -1.0]
    assert max(np.linalg.norm(flown["pos_ned_m"] - start, axis=1).min() for start in starts) < 0.3


def _clearance_m(made: SitePlan, scenario: Scenario, lower_m: float) -> float:
    """What is left between the certified ways from every point of a track and floor or ceiling, the chute shut."""
    flat, points, way = packed(made.site, made.chutes, -1.0), np.zeros((b.STEPS, b.ROW)), np.zeros((b.STEPS, 5))
    start, least = np.zeros(b.ROW), math.inf
    for t_s in np.arange(0.0, 8.0, 0.2):
        start[:11] = scenario.trajectory.at(t_s).row[:11]
        start[2] += lower_m
        count = b.roll(
            start, made.certificate.rows[made.certificate.row_of(1.0)], made.certificate.halves()[1], points, way
        )
        assert count
        least = min(least, clear_of(flat, way, count, 1.0)[0])
    return least


@pytest.mark.parametrize(("sensors", "is_low"), [("gps", True), ("mocap", False)])
def test_a_track_lower_than_its_vehicle_can_stop_above_the_floor_is_flown_higher_and_told_so(
    tmp_path: Path, sensors: str, is_low: bool
) -> None:
    """In the chute the floor does not bind: figure8, 2 m up, never left it with GPS.  From every point of what is flown
    the certified way to a stop is clear of the floor with the chute shut."""
    field = HEAD.replace("3.3", "20.0").replace("0.3", "0.6")
    field += "inside = [[-40.0, -40.0], [40.0, -40.0], [40.0, 40.0], [-40.0, 40.0]]\n"
    prepared = prepare(FlyOptions(scenario="figure8", site=_site(tmp_path, field), sensors=sensors)).flight
    made = prepared.protection.site
    assert made is not None
    assert _clearance_m(made, prepared.scenario, 0.0) > 0.0
    assert (_clearance_m(made, prepared.scenario, made.track.raised_m) < 0.0) is is_low
    assert (made.track.raised_m > 0.0) is is_low
    assert ("higher" in made.words) is is_low
    assert prepared.scenario.trajectory.at(0.0).pos_ned_m[2] == pytest.approx(-2.0 - made.track.raised_m)


def test_where_floor_and_ceiling_are_both_near_a_low_track_is_flown_between_them(tmp_path: Path) -> None:
    """Raised by as much as the ceiling spared it lay where the floor changed two commands of five."""
    field = HEAD.replace("3.3", "5.0") + "inside = [[-40.0, -40.0], [40.0, -40.0], [40.0, 40.0], [-40.0, 40.0]]\n"
    prepared = prepare(FlyOptions(scenario="figure8", site=_site(tmp_path, field), sensors="gps")).flight
    made = prepared.protection.site
    assert made is not None
    left_m = _clearance_m(made, prepared.scenario, 0.0)
    others = [_clearance_m(made, prepared.scenario, lower_m) for lower_m in (-0.4, -0.2, -0.1, 0.1, 0.2, 0.4)]
    assert left_m > max(others)


@pytest.mark.parametrize(("lap_s", "is_slowed"), [(8.0, True), (13.0, False), (20.0, False)])
def test_a_track_that_turns_faster_than_a_slow_vehicle_can_stop_from_is_flown_slower_and_told_so(
    tmp_path: Path, lap_s: float, is_slowed: bool
) -> None:
    """At 8 s a lap it was flown up to 2.5 m off, leaning by 45 degrees, on a real PX4 as well; at 13 s its run-up led
    up to 7.6 m astray; at 20 s 0.26 m off."""
    vehicle, lap = tmp_path / "light.toml", tmp_path / "lap.toml"
    text = files.load_vehicle("px4-sihsim-quadx")[1].text
    vehicle.write_text(text.replace("mass_kg = 1.0 ", "mass_kg = 0.7 "))
    text = files.load_scenario("figure8")[1].text
    lap.write_text(text.replace("period_s = 8.0", f"period_s = {lap_s}"))
    field = HEAD.replace("3.3", "60.0") + "inside = [[-90.0, -90.0], [90.0, -90.0], [90.0, 90.0], [-90.0, 90.0]]\n"
    options = {"vehicle": str(vehicle), "sensors": "gps", "site": _site(tmp_path, field)}
    flight = prepare(FlyOptions(scenario=str(lap), **options)).flight  # type: ignore[arg-type]
    made = flight.protection.site
    assert made is not None
    asked, flown = files.load_scenario(str(lap))[0].trajectory, flight.scenario.trajectory
    share = made.track.speed_share
    assert (share < 1.0) is is_slowed
    assert ("of its speed, from which the vehicle can stop" in made.words) is is_slowed
    mission = plan(flight.scenario, np.zeros(3))
    for t_s in np.linspace(mission.takeoff_end_s, mission.track_end_s, 151).tolist():
        row, half = made.certificate.rows[made.certificate.row_of(1.0)], made.certificate.halves()[1]
        start, point = np.zeros(b.ROW), mission.reference(t_s)
        start[: b.ASKED_N] = point.row[: b.ASKED_N]
        start[b.ASKED_N : b.SNAP_N] = point.jerk_ned_mps3[:2]
        assert b.roll(start, row, half, np.zeros((b.STEPS, b.ROW)), np.zeros((b.STEPS, 5))), mission.phase(t_s)
    for t_s in np.linspace(0.0, 30.0, 61).tolist():
        point, there = flown.at(t_s), asked.at(share * t_s)
        assert point.pos_ned_m[:2] == pytest.approx(there.pos_ned_m[:2], abs=1e-9)
        assert point.vel_ned_mps == pytest.approx(share * there.vel_ned_mps, abs=1e-9)


def test_the_control_error_is_from_the_reference_that_was_followed(walled: FlightResult) -> None:
    """As the tracking error is: the wall took more than half a metre of what was asked for."""
    estimator = walled.as_json()["estimator"]
    assert estimator["control_rmse_m"] == pytest.approx(walled.tracking["rmse_m"], abs=0.02)


def _points(path: Path, topic: str) -> list[np.ndarray]:
    with path.open("rb") as file:
        found = list(make_reader(file).iter_messages(topics=[topic]))
    clouds = [proto_class(schema.data, schema.name).FromString(message.data) for schema, _, message in found if schema]
    return [np.frombuffer(cloud.data, "<f4").reshape(-1, 3) for cloud in clouds]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (f"{HEAD}inside = [[3.0, 3.0], [9.0, 3.0], [9.0, 9.0]]\n", "the start"),
        (f"{HEAD}inside = [[-0.2, -5.0], [6.0, -5.0], [6.0, 5.0], [-0.2, 5.0]]\n", "the start"),
        (f"{BOX}[[keep_out]]\ncentre = [0.2, 0.2]\nradius_m = 0.1\nfloor_m = 1.0\n", "the way to the track"),
        (BOX.replace("3.3", "1.5"), "ceiling"),
        (BOX.replace("3.3", "0.4"), "between floor and ceiling"),
        (f"{BOX}[chute]\nradius_m = 0.2\n", "chute.radius_m"),
        (f"{HEAD}inside = [[0.0, 0.0], [4.0, 4.0], [4.0, 0.0], [0.0, 4.0]]", "edges 0 and 2"),
        (f'{HEAD}frame = "global"\ninside = [[8.54, 47.39], [8.56, 47.39], [8.56, 47.41]]', "swapped"),
        (f'{HEAD}frame = "global"\ninside = [[40.0, 8.0], [40.1, 8.0], [40.1, 8.1]]', "km from the vehicle"),
    ],
)
def test_refused_before_take_off(tmp_path: Path, text: str, said: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(["fly", "figure8", "--site", str(_site(tmp_path, text)), "--out", str(tmp_path / "out")])
    error = capsys.readouterr().err.strip().splitlines()
    assert end.value.code == 2
    assert len(error) == 1
    assert error[0].startswith("error: ")
    assert said in error[0]
    assert not (tmp_path / "out").exists()


FIELD = (-33.8568, 151.2153)


def _plan(folder: Path) -> Path:
    """A field of 50 x 40 m in Sydney as QGroundControl saves it, with a shed in it."""

    def corners(*places_m: tuple[float, float]) -> list[list[float]]:
        lat, lon = FIELD
        per_deg = math.radians(6_371_000.0)  # a sphere's, as PX4's
        return [[lat + n / per_deg, lon + e / (per_deg * math.cos(math.radians(lat)))] for n, e in places_m]

    field = corners((-25.0, -20.0), (25.0, -20.0), (25.0, 20.0), (-25.0, 20.0))
    shed = corners((8.0, 8.0), (14.0, 8.0), (14.0, 14.0), (8.0, 14.0))
    polygons = [{"inclusion": kept, "polygon": each, "version": 1} for kept, each in ((True, field), (False, shed))]
    fence = {"circles": [], "polygons": polygons, "version": 2}
    return _site(folder, json.dumps({"fileType": "Plan", "geoFence": fence, "version": 1}), "field.plan")


def test_ones_own_field_is_flown_where_it_lies(tmp_path: Path) -> None:
    """Its fence is laid out about where the vehicle begins: refused from the simulator's own place, flown from home."""
    options = FlyOptions(scenario="hover", out=tmp_path, site=_plan(tmp_path), duration_s=2.0)
    with pytest.raises(InputError, match="km from the vehicle"):
        prepare(options)
    home = parse_home(f"{FIELD[0]},{FIELD[1]},40,90")
    result = fly(replace(options, home=home), report_wanted=lambda result: False)
    assert result.passed, result.failure()
    assert (result.protection, result.as_json()["barrier"]["exits"]) == ("held", 0)
    truth = read(tmp_path / "flight.mcap").tables["/truth"]
    assert truth["pos_ned_m"][:, 2].min() < -0.5  # it did fly
    w, x, y, z = truth["q_ned_frd"][0]
    assert math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)) == pytest.approx(math.pi / 2.0, abs=0.02)
    with pytest.raises(InputError, match="fence polygon 1"):  # 11 m north-east of there stands the shed
        fly(replace(options, home=parse_home(f"{FIELD[0] + 1e-4},{FIELD[1] + 1.17e-4},40,0")))


@pytest.mark.parametrize("more", [{"filtering": False}, {"as_published": True}])
def test_what_contradicts_a_site_is_named(tmp_path: Path, more: dict[str, object]) -> None:
    with pytest.raises(InputError, match="leave out --"):
        prepare(FlyOptions(scenario="figure8", site=_site(tmp_path, BOX), **more))  # type: ignore[arg-type]


def test_a_certificate_of_something_else_is_refused(tmp_path: Path) -> None:
    for text in ('{"schema": "flightstack.certificate/6"}', "nonsense", "[]"):
        with pytest.raises(InputError, match=r"JSON|certify --site"):
            prepare(
                FlyOptions(scenario="figure8", site=_site(tmp_path, BOX), certificate=_site(tmp_path, text, "c.json"))
            )


def test_a_missing_file_and_a_huge_one_are_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="No such file"):
        prepare(FlyOptions(scenario="figure8", site=tmp_path / "none.toml"))
    corners = ", ".join(f"[{i}.0, 0.0]" for i in range(1_000_000))
    with pytest.raises(InputError, match="more than 1000 edges"):
        prepare(FlyOptions(scenario="figure8", site=_site(tmp_path, f"{HEAD}inside = [{corners}]")))
