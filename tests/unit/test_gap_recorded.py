"""Others' simulators and real vehicles: what is refused, what is read, and effects whose size is known.

The whole workflow on all of them takes minutes: `make gap-recorded`.
"""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest

from benchmarks.gap_recorded import ROWS, lateral, run
from flightstack.cli.gap import GapOptions, find_gap
from flightstack.gap.check import check
from flightstack.gap.compare import figures, noise_floor, residual
from flightstack.gap.read import flight
from flightstack.gap.records import Samples
from flightstack.gap.refine import refine
from flightstack.gap.track import track
from flightstack.gap.workflow import analyse
from flightstack.types import InputError
from flightstack.vehicle import Vehicle, parse_vehicle, with_effects

VEHICLES = Path(__file__).resolve().parents[2] / "benchmarks" / "vehicles"
DRAG = 1.75e-4
"""Of its model file: rotorDragCoefficient."""
pytestmark = pytest.mark.recorded


def own(name: str) -> Vehicle:
    return parse_vehicle((VEHICLES / f"{name}.toml").read_text("utf-8"), name)


def usable(path: Path, vehicle: Vehicle, columns: str | None = None) -> Samples:
    samples = check(flight(path, vehicle, columns), vehicle).samples
    assert samples is not None
    return samples


def test_px4_s_own_simulator_and_its_vehicle_file_agree(recorded: Path) -> None:
    vehicle = parse_vehicle((recorded / "px4_sih.toml").read_text("utf-8"), "px4_sih.toml")
    samples = usable(recorded / "px4_sih_flight.ulg.gz", vehicle)
    mask = track(samples).usable
    before, floor = figures(vehicle, samples, mask), noise_floor(vehicle, samples, mask)
    assert before.one_step_mps2 is not None
    assert floor.one_step_mps2 is not None
    assert before.one_step_mps2 < 1.2 * floor.one_step_mps2
    assert before.one_step_radps2 is not None
    assert floor.one_step_radps2 is not None
    assert before.one_step_radps2 < 1.2 * floor.one_step_radps2
    heavier = with_effects(vehicle, {"payload": {"mass_kg": 0.15}})
    wrong = figures(heavier, samples, mask).one_step_mps2
    assert wrong is not None
    assert wrong > 1.2 * floor.one_step_mps2


@pytest.mark.parametrize(("file_kg", "payload_kg"), [(1.0, None), (0.87, 0.13)])
def test_px4_s_telemetry_log_tells_a_payload_and_no_more(
    recorded: Path, file_kg: float, payload_kg: float | None
) -> None:
    """SIH weighs 1 kg; motors at 50 Hz say nothing of inertia, which was named as 1.7 times the true one."""
    text = (recorded / "px4_sih.toml").read_text("utf-8").replace("mass_kg = 1.0", f"mass_kg = {file_kg}")
    result = analyse([recorded / "px4_sih_offboard.tlog"], parse_vehicle(text, "px4_sih.toml"))
    assert [found.name for found in result.found] == ([] if payload_kg is None else ["payload"])
    assert not result.unexplained.significant
    for found in result.found:
        mass = found.parameters["mass_kg"]
        assert mass.low <= payload_kg <= mass.high


def test_gazebo_s_rotor_drag_is_the_simulator_s(recorded: Path) -> None:
    believed = own("gazebo-iris")
    samples = usable(recorded / "gazebo_iris_sitl_56s.csv.gz", believed, "gazebo_iris")
    mask = track(samples).usable
    dragged = with_effects(believed, {"rotor_drag": {"k_d_kg_per_rad": DRAG}})
    before, after = (np.std(residual(v, samples).y[mask, :2], axis=0) for v in (believed, dragged))
    assert np.all(after < 0.06 * before)
    start = with_effects(believed, {"rotor_drag": {"k_d_kg_per_rad": 1e-4}})
    got = refine(believed, start, [samples], [mask], ["rotor_drag"])
    assert got is not None
    assert got.parameters["rotor_drag"]["k_d_kg_per_rad"].estimate == pytest.approx(DRAG, rel=0.05)


def test_a_flight_that_hovers_for_two_thirds_has_its_drag_named(recorded: Path, tmp_path: Path) -> None:
    """The first 60 % of Gazebo's flight hover for 24 of 34 s: what was learned from held no drag, so none was named."""
    with gzip.open(recorded / "gazebo_iris_sitl_56s.csv.gz", "rt") as file:
        lines = file.readlines()
    log = tmp_path / "first.csv"
    log.write_text("".join(lines[: int(0.6 * len(lines))]), "utf-8")
    result = analyse([log], own("gazebo-iris"), columns="gazebo_iris")
    drag = next(found for found in result.found if found.name == "rotor_drag").parameters["k_d_kg_per_rad"]
    assert drag.low <= DRAG <= drag.high
    assert drag.estimate == pytest.approx(DRAG, rel=0.15)
    assert {found.name for found in result.found} <= {"rotor_drag", "payload", "thrust_scale"}
    assert result.unexplained.significant  # most of its turning


@pytest.mark.parametrize(
    ("log", "reason"),
    [
        ("px4_real_bench_NOTFLYING_68s.ulg", "no part of the log is a flight"),
        ("px4_sitl_modern_topics_31s.ulg", "too little in one piece"),
    ],
)
def test_what_is_no_usable_flight_gives_one_line_and_no_coefficients(
    recorded: Path, tmp_path: Path, log: str, reason: str
) -> None:
    with pytest.raises(InputError, match=reason) as caught:
        find_gap(GapOptions(logs=(recorded / log,), vehicle=str(recorded / "px4_sih.toml"), out=tmp_path))
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "gap.json").exists()
    assert not (tmp_path / "vehicle.toml").exists()


@pytest.mark.parametrize("name", ["B2_circle_fast_rep1", "B6_linear_ramp_rep2"])
def test_a_crazyflie_s_own_order_of_motors_is_not_refused(recorded: Path, name: str) -> None:
    usable(recorded / f"nanobench_{name}.csv.gz", own("crazyflie-2.1"), "nanobench")


def test_a_derived_attitude_is_trusted_slowly(recorded: Path) -> None:
    """Pitch comes from an acceleration below 4 Hz: nothing faster can be compared."""
    samples = usable(recorded / "crazypad" / "normal_E8_log00", own("crazyflie-2.1"))
    assert "q_ned_frd" in samples.derived
    assert samples.bandwidth_hz == pytest.approx(4.0)


def test_a_hard_landing_is_no_flight(recorded: Path) -> None:
    """The figure 8 touches down at 0.86 m/s; its accelerometer reads 65 m/s^2 while the markers are 5.7 cm up.

    No rotor of the vehicle does that: at full command all four push with 23.7 m/s^2.
    """
    samples = usable(recorded / "nanobench_B3_figure8_fast_rep2.csv.gz", own("crazyflie-2.1"), "nanobench")
    felt = np.linalg.norm(samples.accel_frd_mps2, axis=1)
    assert felt.max() > 50.0
    assert felt[samples.valid].max() < 23.7


def test_the_figure_8_has_the_drag_that_others_measured_and_closes_its_side_force(recorded: Path) -> None:
    """0.37 to 0.42 1/s is what other tools fit to this flight; the firmware compensates the battery."""
    row = next(row for row in ROWS if row.key == "figure 8")
    result = run(row, recorded)
    found = {each.name: each for each in result.found}
    drag = [found["linear_drag"].parameters[f"d_{axis}_kgps"].estimate / own("crazyflie-2.1").mass_kg for axis in "xy"]
    assert min(drag) >= 0.37
    assert max(drag) <= 0.42
    assert not {"battery_sag", "rotor_fault", "steady_wind"} & set(found)
    assert float(lateral(result).removesuffix(" %")) >= 75.0


def test_two_circles_of_one_vehicle_say_the_same_shifted_mass_and_neither_blames_the_battery(recorded: Path) -> None:
    """The firmware compensates the battery; where the mass sits is the vehicle's, not the flight's."""
    results = [run(next(row for row in ROWS if row.key == key), recorded) for key in ("circle fast", "circle medium")]
    places = []
    for result in results:
        found = {each.name: each for each in result.found}
        assert "battery_sag" not in found
        assert {"rotor_drag", "linear_drag"} & set(found)
        assert result.gap.closed is not None
        assert result.gap.closed > 0.85
        places.append([found["com_offset"].parameters[f"{axis}_m"].estimate for axis in "xy"])
    assert places[0] == pytest.approx(places[1], abs=4e-4)


def test_a_clipped_propeller_is_named_with_its_class_and_what_whole_ones_lack_too(
    recorded: Path, tmp_path: Path
) -> None:
    """M3 is the vehicle file's rotor 2; a hovering vehicle with a shifted mass looks nearly the same.  With whole
    propellers all four lift a sixth less than the file says."""
    logs = [recorded / "crazypad" / f"cut4mm_M3_E8_log0{k}" for k in range(2)]
    vehicle = str(VEHICLES / "crazyflie-2.1.toml")
    result = find_gap(GapOptions(logs=(logs[0],), holdout=(logs[1],), vehicle=vehicle, out=tmp_path))
    found = {each.name: each for each in result.found}
    assert found["rotor_fault"].parameters["rotor"].estimate == 2.0
    assert "com_offset" in found["rotor_fault"].indistinguishable_from
    assert set(found) <= {"rotor_fault", "com_offset", "thrust_scale", "payload"}
    assert result.gap.closed is not None
    assert result.gap.closed > 0.75  # a false sag that went took the load with it that told the rotor's size: 0.58


def test_of_a_whole_vehicle_s_load_no_weak_rotor_is_a_twin(recorded: Path) -> None:
    """All four rotors lift a sixth less than the file says (1.5 m/s^2): no single rotor does that, nor any damping."""
    (load,) = analyse([recorded / "crazypad" / "normal_E8_log00"], own("crazyflie-2.1")).found
    assert {load.name, *load.indistinguishable_from} == {"payload", "thrust_scale"}


def test_no_whole_propeller_is_named_weak_and_clipped_ones_agree_from_flight_to_flight(recorded: Path) -> None:
    """Without a gyro a weak rotor and a shifted mass beside it stand for a yaw trim: 0.47 was named on a whole one."""
    told = {}
    for log in ("normal_E8_log03", "cut4mm_M3_E8_log00", "cut4mm_M3_E8_log01"):
        found = analyse([recorded / "crazypad" / log], own("crazyflie-2.1")).found
        told[log] = [each.parameters["effectiveness"] for each in found if each.name == "rotor_fault"]
    assert told["normal_E8_log03"] == []
    ((first,), (second,)) = (told[f"cut4mm_M3_E8_log0{k}"] for k in range(2))
    assert 0.5 < first.estimate < 0.7
    assert first.low <= second.high
    assert second.low <= first.high


def test_the_clipped_propeller_s_rotor_works_hardest(recorded: Path) -> None:
    """M3 sits rear left, the vehicle file's rotor 2: clipped, it alone takes more than before for the same weight."""
    flown = {
        kind: usable(recorded / "crazypad" / f"{kind}_E8_log00", own("crazyflie-2.1"))
        for kind in ("normal", "cut4mm_M3")
    }
    mean = {kind: s.motor[s.valid].mean(axis=0) for kind, s in flown.items()}
    change = mean["cut4mm_M3"] / mean["normal"]
    assert change[1] > 1.2
    assert np.all(np.delete(change, 1) < 1.0)
