"""Algorithm 1 over UDP: a short exploration that really flies, learns, grows and comes out with a file that holds; the
honest certificate is derived from the log of its flight, every forgery is refused.

The flight is real (simulator, companion, UDP, log); the forger has the maker's code, the seal and the log's own copy.
"""

from __future__ import annotations

import copy
import json
import os
import sys
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "unit"))
from certificate_oracle import CHANGES, leaves
from certificates import resealed, tables_kept

from flightstack.barrier.provenance import Provenance
from flightstack.certificate_check import DERIVED, SELF_CONSISTENT, check
from flightstack.certificate_check.log import FlightRecording, read_log
from flightstack.certificate_check.samples import WANTED
from flightstack.cli.certify import CertifyResult, certify
from flightstack.cli.flight import FlyOptions, prepare
from flightstack.cli.main import main
from flightstack.cli.replay import replay
from flightstack.explore import ExploreConfig
from flightstack.types import InputError
from flightstack_logs.reader import Log, read
from tests.simulator import free_tcp_pair, watching
from tests.thorough import THOROUGH

FINAL = "certificate-final.json"
FORGERIES = int(os.environ.get("FLIGHTSTACK_FORGERIES", "60"))
"""Every kind of number once; `make attack` makes 200."""
APART = 1 if "FLIGHTSTACK_FORGERIES" in os.environ else 2 if THOROUGH else 4
"""Every kind is changed in `test_certificate_check.py`, without a log; with it every fourth one is enough here."""


class Flown(NamedTuple):
    """A flight and what came of it."""

    text: str
    certificate: Path
    log: Path
    recording: FlightRecording
    json: dict[str, Any]
    result: CertifyResult
    flight: Log
    seen: list[dict[str, Any]]
    """What the live page showed of it."""


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Flown]:
    out, port = tmp_path_factory.mktemp("provenance"), free_tcp_pair()
    options = FlyOptions(scenario="paper-barrier", seed=22, duration_s=30.0, out=out, live=port)
    with watching(port, 0.3) as seen:  # a flight of half a minute: looked at often, it takes twice as long
        result = certify(options, stop_requested=lambda: "", config=ExploreConfig(axes=(2,), rounds_max=2))
    assert result.certificate is not None
    assert result.flight.log is not None
    path, log = Path(result.certificate), Path(result.flight.log)
    with log.open("rb") as file, tables_kept():
        recording = read_log(file, WANTED)
        yield Flown(path.read_text(), path, log, recording, result.as_json(), result, read(log), seen)


def test_it_is_watched_while_it_grows(flown: Flown) -> None:
    seen = flown.seen
    assert any(state["scene"].get("certified") for state in seen)
    assert any(state["now"].get("h") is not None for state in seen)


def test_it_really_flew_and_was_filtered_and_fed(flown: Flown) -> None:
    result, log = flown.result, flown.flight
    assert result.flight.completed, result.flight.reason
    truth = log.tables["/truth"]
    height = -truth["pos_ned_m"][:, 2]
    assert height.max() > 0.7
    exploring = (height > 0.3) & (truth.t_us > truth.t_us[0] + 5_000_000)
    assert np.ptp(truth["vel_ned_mps"][exploring, 2]) > 0.5  # it went up and down
    assert result.flight.gp["fed"] > 1000
    status = log.tables["/filter"]["status"]
    assert (status >= 2.0).sum() > 100  # engaged: passed or changed


def test_the_region_grew_and_was_never_left(flown: Flown) -> None:
    result = flown.result
    assert result.state is not None
    areas = [row.area_m2ps for row in result.state.rounds]
    assert len(areas) >= 2
    assert areas[-1] > 1.02 * areas[0] or result.figures.area_m2ps > 1.2 * result.figures.area_initial_m2ps  # type: ignore[union-attr, operator]
    assert result.flight.barrier["violations"] == 0
    assert result.flight.qp["infeasible"] == 0
    found = result.as_json()
    assert found["mu_final"] >= found["mu_physics"]
    assert found["area_m2ps"] < found["area_kernel_m2ps"]
    assert found["samples"] < found["samples_uniform"]


def test_the_file_convinces_the_checker_and_not_once_a_number_is_changed(
    flown: Flown, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    result = flown.result
    assert result.passed, result.failure()
    assert result.certificate is not None
    text = Path(result.certificate).read_text()
    assert check(text).valid
    with pytest.raises(SystemExit) as done:
        main(["certify", "--check", result.certificate])
    assert done.value.code == 0
    data = json.loads(text)
    data["axes"][0]["cells"][0][5] += 10.0
    changed = tmp_path / "changed.json"
    changed.write_text(json.dumps(data))
    with pytest.raises(SystemExit) as done:
        main(["certify", "--check", str(changed)])
    assert done.value.code == 1
    capsys.readouterr()
    with pytest.raises(SystemExit) as done:
        main(["certify", "--check", str(tmp_path / "missing.json")])
    assert done.value.code == 2
    assert capsys.readouterr().err.startswith("error:")


def test_what_came_out_may_be_flown_by_the_vehicle_and_sensors_that_it_names(flown: Flown, tmp_path: Path) -> None:
    """With the independent checker asked, as `fly --certificate` does."""
    certificate = flown.result.certificate
    assert certificate is not None
    ready = prepare(FlyOptions(scenario="paper-barrier", certificate=Path(certificate))).flight.protection
    assert ready.given is not None
    assert ready.words.startswith("sound, certificate ")
    with pytest.raises(InputError, match="holds with mocap sensors, this flight has px4-sih"):
        prepare(FlyOptions(scenario="paper-barrier", certificate=Path(certificate), sensors="px4-sih"))
    data = json.loads(Path(certificate).read_text())
    data["axes"][0]["margins"][0]["mps2"] *= 0.5
    other = tmp_path / "other.json"
    other.write_text(resealed(data))
    with pytest.raises(InputError, match="the independent checker refuses it: "):
        prepare(FlyOptions(scenario="paper-barrier", certificate=other))


def test_a_replay_refuses_rules_that_the_log_does_not_name(flown: Flown) -> None:
    with pytest.raises(InputError, match="rules that it does not name"):
        replay(flown.log)


def test_the_page_lies_beside_the_flights_own(flown: Flown) -> None:
    result = flown.result
    assert result.report is not None
    assert "<svg" in Path(result.report).read_text()
    assert Path(result.report).with_name("flight.html").exists()


def with_seal_of(recording: FlightRecording, text: str) -> FlightRecording:
    """The same log, but that it ends with this certificate: what a forger of both would make."""
    forged = copy.copy(recording)
    forged.attachments = {**recording.attachments, FINAL: text.encode()}
    return forged


def test_the_honest_certificate_is_derived_from_its_log(flown: Flown) -> None:
    alone = check(flown.text)
    assert alone.valid, alone.lines[-1]
    assert alone.level == SELF_CONSISTENT
    with flown.log.open("rb") as file:
        verdict = check(flown.text, file)
    assert verdict.valid, verdict.lines[-1]
    assert verdict.level == DERIVED
    assert any("derived anew from their windows" in line for line in verdict.lines)
    assert flown.json["log"] == str(flown.log)
    named = json.loads(flown.text)["provenance"]
    assert Provenance(**named).from_us < Provenance(**named).until_us


def test_the_verb_says_which(flown: Flown, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = tmp_path / "other.toml"
    other.write_bytes(flown.recording.attachments["vehicle.toml"] + b"\n# another\n")
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(flown.log.read_bytes()[:-300_000])
    log = ["--log", str(flown.log)]
    for more, code, words in (
        ([], 0, "valid, self-consistent, not tied to a flight"),
        (log, 0, "valid, derived from the log of its flight"),
        ([*log, "--vehicle", "quad-x"], 0, "valid, derived from the log of its flight"),
        ([*log, "--vehicle", str(other)], 1, "NOT valid"),
        (["--log", str(cut)], 2, "ends early"),
        (["--log", str(flown.certificate)], 2, "is no MCAP file"),
        (["--log", str(tmp_path / "none.mcap")], 2, "No such file"),
        (["--vehicle", "quad-x"], 2, "belongs to --log"),
    ):
        with pytest.raises(SystemExit) as done:
            main(["certify", "--check", str(flown.certificate), *more])
        said = capsys.readouterr()
        assert done.value.code == code, (more, said)
        last = (said.err if code == 2 else said.out).strip().splitlines()[-1]
        assert words in last, (more, last)
        if code == 2:
            assert said.err.startswith("error: ")
            assert said.err.count("\n") == 1


def kind_of(path: tuple[Any, ...]) -> tuple[Any, ...]:
    """What a number is, whichever of many alike."""
    return tuple("#" if isinstance(part, int) else part for part in path)


def tampered(
    text: str, count: int, wanted: Callable[[tuple[Any, ...]], bool] = lambda path: True
) -> Iterator[tuple[tuple[Any, ...], str, dict[str, Any]]]:
    """The file's table with one number changed, every kind of number among them, in turn until there are so many; each
    change is taken back before the next.  Those that are not wanted count."""
    data = json.loads(text)
    kinds: dict[tuple[Any, ...], list[tuple[Any, ...]]] = {}
    for path in leaves(data):
        kinds.setdefault(kind_of(path), []).append(path)
    rng = np.random.default_rng(3)
    made = 0
    while made < count:
        for paths in kinds.values():
            path = paths[int(rng.integers(len(paths)))]
            name = list(CHANGES)[int(rng.integers(len(CHANGES)))]
            inner = data
            for key in path[:-1]:
                inner = inner[key]
            before = inner[path[-1]]
            if (after := CHANGES[name](before)) != before:
                made += 1
                if wanted(path):
                    inner[path[-1]] = after
                    yield path, name, data
                    inner[path[-1]] = before


def test_any_number_changed_under_a_new_seal_is_refused_with_the_log(flown: Flown) -> None:
    kinds = set()
    for path, name, data in islice(tampered(flown.text, FORGERIES), 0, None, APART):
        kinds.add(kind_of(path))
        verdict = check(resealed(data), flown.recording)
        assert not verdict.valid, (path, name)
        assert verdict.readable, (path, name, verdict.lines)
    assert len(kinds) > 120 // APART


def test_what_ties_to_the_flight_is_derived_and_not_only_sealed(flown: Flown) -> None:
    """The forger has changed the log's own copy too: what the log's ticks tell is refused nevertheless."""
    told = ("x", "y", "windows_us", "drag_per_s", "rotor_radius_m", "provenance", "noise_var")
    seen = 0
    for path, name, data in tampered(flown.text, 5 * FORGERIES, lambda path: any(part in told for part in path)):
        knowledge = data["knowledge"]
        if path[1] in ("lateral", "vertical") and path[2] in ("x", "y"):
            knowledge = {**knowledge, "sha256": digest(knowledge)}
        text = resealed({**data, "knowledge": knowledge})
        verdict = check(text, with_seal_of(flown.recording, text))
        assert not verdict.valid, (path, name)
        seen += 1
    assert seen > 25


def digest(knowledge: dict[str, Any]) -> str:
    import hashlib

    parts = (knowledge[name][key] for name in ("lateral", "vertical") for key in ("x", "y"))
    return hashlib.sha256(b"".join(np.array(part, "<f8").tobytes() for part in parts)).hexdigest()


def nothing_doubted(knowledge: dict[str, Any]) -> None:
    knowledge["doubts"] = dict.fromkeys(knowledge["doubts"], 0.0)


def hardly_any_noise(knowledge: dict[str, Any]) -> None:
    for name in ("lateral", "vertical"):
        knowledge[name]["noise_var"] *= 1e-6
        scale(knowledge[name]["kernel"], 1e-6)


def scale(kernel: dict[str, Any], by: float) -> None:
    if "variance" in kernel:
        kernel["variance"] *= by
    for side in ("left", "right"):
        if side in kernel:
            scale(kernel[side], by)


def nothing_learned(knowledge: dict[str, Any]) -> None:
    for name in ("lateral", "vertical"):
        knowledge[name]["y"] = (0.0 * np.array(knowledge[name]["y"])).tolist()


def no_rotors(knowledge: dict[str, Any]) -> None:
    knowledge["rotor_radius_m"] = 1e-9


def quieter(knowledge: dict[str, Any]) -> None:
    knowledge["vertical"]["noise_var"] *= 0.25


def smaller_excess(knowledge: dict[str, Any]) -> None:
    knowledge["vertical"]["excess"] = [0.0]


def no_inflation(knowledge: dict[str, Any]) -> None:
    knowledge["vertical"]["inflation"] = [1.0]


FROM_THE_FILE: dict[str, Callable[[dict[str, Any]], None]] = {
    "doubts": nothing_doubted, "noise": hardly_any_noise, "variance": nothing_learned, "rotor_radius": no_rotors,
    "excess": smaller_excess, "inflation": no_inflation,
}  # fmt: skip


@pytest.mark.parametrize("why", FROM_THE_FILE)
def test_consistent_forgeries_are_refused_from_the_file_alone(flown: Flown, why: str) -> None:
    """Whatever else was made to agree with them is not even looked at: the knowledge is checked before it is used."""
    data = json.loads(flown.text)
    FROM_THE_FILE[why](data["knowledge"])
    data["knowledge"]["sha256"] = digest(data["knowledge"])
    if why == "doubts":
        estimate = data["premises"]["estimate"]
        for name in ("pos_m", "vel_mps", "acc_mps2"):
            estimate[name] = (0.0 * np.array(estimate[name])).tolist()
    verdict = check(resealed(data))
    assert not verdict.valid
    assert {"doubts": "finer than anything"}.get(why, why) in verdict.lines[-1], verdict.lines[-1]


def test_commands_held_for_no_time_are_refused(flown: Flown) -> None:
    data = json.loads(flown.text)
    data["axes"][0]["setting"]["dt_s"] = data["premises"]["command_interval_s"] = 0.0
    verdict = check(resealed(data))
    assert not verdict.valid
    assert "dt_s" in verdict.lines[-1]


def test_a_log_of_other_ticks_is_refused(flown: Flown) -> None:
    """One bit of one measurement, a tick left out, a command, a delay: each is another log."""
    for topic, column in (
        ("/tick", "vel_ned_mps"),
        ("/tick", "imu_age_us"),
        ("/command", "thrust_norm"),
        ("/tick", "delay_s"),
    ):
        forged = copy.deepcopy(flown.recording)
        values = forged.tables[topic][column] = np.array(forged.tables[topic][column])
        values[2000] = np.nextafter(values[2000], 1e9) if values.dtype.kind == "f" else values[2000] + 1
        verdict = check(flown.text, forged)
        assert not verdict.valid
        assert "hash" in verdict.lines[-1]
    forged = copy.deepcopy(flown.recording)
    for table in forged.tables.values():
        for name in table:
            table[name] = np.delete(table[name], 2000, axis=0)
    assert not check(flown.text, forged).valid


def test_a_vehicle_with_another_lag_is_refused_by_the_logs_own_forces(flown: Flown) -> None:
    """The forger also rewrites vehicle file and points; what thrust did to the force tells."""
    from flightstack.certificate_check import provenance as checker
    from flightstack.certificate_check.reading import Refused

    data = json.loads(flown.text)
    ticks = checker.Ticks.of(flown.recording, data["provenance"]["from_us"], data["provenance"]["until_us"])
    believed = checker.Believed.of(tomllib.loads(flown.recording.attachments["vehicle.toml"].decode()))
    found = checker.samples(ticks, believed, 0.1)

    class Known:
        data = json.loads(flown.text)["knowledge"]
        stores = (None, SimpleNamespace(inflation=data["vertical"]["inflation"]))

    assert "lag and delay" in checker._check_delay(data, Known, found, believed)  # type: ignore[arg-type]
    for lag_s, delay_s in ((0.006, 0.0), (0.006, 0.012), (0.05, 0.0), (0.006, 0.004), (0.04, 0.0))[
        : 5 if THOROUGH else 2
    ]:
        data["axes"][0]["response"] |= {"c1_s": lag_s, "delay_s": delay_s}  # of some, the sum is the true one
        with pytest.raises(Refused, match="the log shows"):
            checker._check_delay(data, Known, found, replace(believed, lag_s=lag_s))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("key", "share"), [("inertia_kgm2", 0.5), ("position_m", 1.2), ("mass_kg", 1.3), ("thrust_model_factor", 0.5)]
)
def test_a_governor_of_another_vehicle_is_refused(flown: Flown, key: str, share: float) -> None:
    """A vehicle that torque hardly disturbs; every figure of the governor may agree with it."""
    from flightstack.certificate_check import provenance as checker
    from flightstack.certificate_check.reading import Refused

    data = json.loads(flown.text)
    believed = checker.Believed.of(tomllib.loads(flown.recording.attachments["vehicle.toml"].decode()))
    stated, doubts = data["governor"]["vehicle"], data["knowledge"]["doubts"]
    checker._check_frame(stated, doubts, believed)
    with pytest.raises(Refused, match=key):
        checker._check_frame(stated | {key: (share * np.array(stated[key])).tolist()}, doubts, believed)
    with pytest.raises(Refused, match="rotor_lag_s"):
        checker._check_frame(stated, doubts | {"rotor_lag_s": 0.0}, believed)
    with pytest.raises(Refused, match="damping_nms"):
        checker._check_frame(stated | {"damping_nms": [1e-3, 1e-3, 1e-3]}, doubts, believed)


@pytest.mark.parametrize("name", ["quad-x", "px4-sihsim-quadx", "f450"])
@pytest.mark.parametrize(
    "effects",
    [{}, {"motor_lag": {"time_constant_s": 0.06}}, {"payload": {"mass_kg": 0.3}, "inertia": {"scale_x": 1.3}}],
    ids=["plain", "slow", "heavy"],
)
def test_an_autopilot_that_the_file_does_not_mean_is_refused(name: str, effects: dict[str, Any]) -> None:
    """Gentler gains, wider limits, a rate loop that answers at once: torque and turning count on them;
    the maker's own figures are the oracle of those that are accepted."""
    from flightstack.autopilot import autopilot_of
    from flightstack.certificate_check.autopilot import check_autopilot
    from flightstack.certificate_check.reading import Refused
    from flightstack.cli.files import load_vehicle
    from flightstack.model import Model
    from flightstack.vehicle import vehicle_to_toml, with_effects

    vehicle = with_effects(load_vehicle(name)[0], effects)
    file, gains, lag_s = (
        tomllib.loads(vehicle_to_toml(vehicle)),
        autopilot_of(vehicle),
        Model.from_vehicle(vehicle).rate_lag_s,
    )
    north = {"axis": "north", "response": {"c1_s": 0.15, "c2_s2": 0.15 * lag_s}}
    check_autopilot({"autopilot": gains}, [north], file)
    for key, value in gains.items():
        with pytest.raises(Refused, match=key):
            check_autopilot({"autopilot": gains | {key: 0.8 * value + 0.011}}, [north], file)
    north["response"] = {"c1_s": 0.15, "c2_s2": 0.14 * lag_s}
    with pytest.raises(Refused, match="c2_s2"):
        check_autopilot({"autopilot": gains}, [north], file)


def test_a_gyro_without_noise_is_refused_from_the_file_alone(flown: Flown) -> None:
    from flightstack.certificate_check.autopilot import check_gyro
    from flightstack.certificate_check.reading import Refused
    from flightstack_sim.grade import load_grade

    for grade in ("mocap", "gps", "px4-sih", "px4-sih-ekf"):
        density = load_grade(grade).imu.gyro_noise_radps_rthz
        check_gyro(density, grade)
        with pytest.raises(Refused, match="gyro_noise"):
            check_gyro((density[0], 0.9 * density[1], density[2]), grade)
    data = json.loads(flown.text)
    data["governor"]["vehicle"]["gyro_noise_radps_rthz"] = [0.0, 0.0, 0.0]  # stated noise may be more than its source
    verdict = check(resealed(data))
    assert not verdict.valid
    assert "gyro_noise" in verdict.lines[-1]


def test_a_log_whose_rates_do_not_turn_it_is_refused(flown: Flown) -> None:
    from flightstack.certificate_check import provenance as checker
    from flightstack.certificate_check.reading import Refused

    data = json.loads(flown.text)
    named, estimate = data["provenance"], data["premises"]["estimate"]
    for column, change in (("rate_frd_radps", 0.1), ("specific_force_frd_mps2", 0.6)):
        forged = copy.deepcopy(flown.recording)
        forged.tables["/tick"][column] = forged.tables["/tick"][column] + change
        ticks = checker.Ticks.of(forged, named["from_us"], named["until_us"])
        with pytest.raises(Refused, match="do not explain"):
            checker._check_itself(ticks, estimate)
