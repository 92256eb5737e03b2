"""The command line as a user meets it: results, exit codes, one clear line for each mistake."""

from __future__ import annotations

import contextlib
import io
import itertools
import json
import os
import re
import select
import signal
import socket
import subprocess
import sys
import time
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

from flightstack.cli import main as cli
from flightstack.cli.controllers import CONTROLLERS
from flightstack_logs.info import info
from flightstack_logs.reader import read
from tests.simulator import bare_loop, free_tcp_pair, skip_where_too_busy, watching

ROOT = Path(__file__).resolve().parents[2]


def _run(*arguments: object) -> int:
    with pytest.raises(SystemExit) as stop:
        cli.main([str(argument) for argument in arguments])
    return int(stop.value.code or 0)


def _start(*arguments: object, cwd: Path) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "flightstack", *(str(argument) for argument in arguments)]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "PYTHONUNBUFFERED": "1"}
    return subprocess.Popen(
        command, cwd=cwd, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def _free_port() -> int:
    """A port whose neighbour 40 above is free too."""
    while True:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as first:
            first.bind(("127.0.0.1", 0))
            port = int(first.getsockname()[1])
            if port + 40 > 65_535:
                continue
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as second:
                try:
                    second.bind(("127.0.0.1", port + 40))
                except OSError:
                    continue
                return port


def _start_sim(tmp_path: Path, *arguments: object) -> tuple[subprocess.Popen[str], int]:
    port = _free_port()
    sim = _start("sim", "--port", port, "--gcs-port", _free_port(), *arguments, cwd=tmp_path)
    assert sim.stdout is not None
    assert "is up" in sim.stdout.readline()
    return sim, port


GP_FIELDS = {
    "enabled", "points", "fed", "step_us", "coverage_3sigma", "coverage_3sigma_axes", "coverage_simultaneous",
    "conformal", "thrust_gain", "thrust_gain_sigma", "latency_s", "refused", "changes",
}  # fmt: skip


PLAIN = ("fly", "hover", "--duration", 5, "--seed", 5, "--no-learning")


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The folder of a flight that does not learn, its JSON in `r.json`; and what was printed."""
    folder, printed = tmp_path_factory.mktemp("plain"), io.StringIO()
    with contextlib.redirect_stdout(printed):
        assert _run(*PLAIN, "--out", folder / "out", "--json", folder / "r.json") == 0
    return folder, printed.getvalue()


def test_fly_writes_the_contracts_json_and_says_where_everything_is(plain: tuple[Path, str]) -> None:
    out, printed = plain[0] / "out", plain[1]
    result = json.loads((plain[0] / "r.json").read_text())
    assert result["schema"] == "flightstack.flight/1"
    assert set(result) >= {
        "scenario", "seed", "log", "completed", "flight_time_s", "wall_time_s", "realtime_factor", "plant",
        "controller", "tracking", "barrier", "gp", "qp", "loop",
    }  # fmt: skip
    assert (result["scenario"], result["seed"], result["completed"]) == ("hover", 5, True)
    assert set(result["tracking"]) == {"of", "rmse_m", "max_m", "rmse_settled_m"}
    assert result["barrier"] == dict.fromkeys(result["barrier"]) | {"enabled": False}
    assert result["gp"] == dict.fromkeys(GP_FIELDS) | {
        "enabled": False, "step_us": {"p50": None, "p99": None, "max": None},
    }  # fmt: skip
    assert result["loop"] == {
        "rate_hz": None, "lateness_us": {"p50": None, "p99": None, "max": None}, "missed": None,
    }  # fmt: skip
    assert Path(result["log"]).is_file()
    assert "</html>" in (out / "report.html").read_text()
    assert "completed" in printed
    assert "flight.mcap" in printed.replace("\n", "")
    log = read(out / "flight.mcap")
    assert "/learner" not in log.tables
    assert log.metadata["settings"]["learning"] == "off"


def test_learning_is_on_unless_it_is_switched_off_and_says_what_it_reached(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _run("fly", "hover", "--duration", 4, "--out", tmp_path, "--json", tmp_path / "r.json") == 0
    gp = json.loads((tmp_path / "r.json").read_text())["gp"]
    assert set(gp) == GP_FIELDS
    assert gp["enabled"] is True
    assert 0 < gp["points"] < gp["fed"]
    assert gp["step_us"]["max"] >= gp["step_us"]["p99"] >= gp["step_us"]["p50"] > 0.0
    assert 0.9 < gp["coverage_3sigma"] <= 1.0
    printed = capsys.readouterr().out
    assert f"{gp['points']} points of" in " ".join(printed.split())


@pytest.mark.parametrize("verb", ["fly", "offboard"])
def test_help_names_every_controller_and_the_options_that_all_flights_have(
    verb: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _run(verb, "--help") == 0
    printed = capsys.readouterr().out
    for name in CONTROLLERS:
        assert f"\n  {name} " in printed
    shared = "vehicle duration controller no-learning learned no-filter as-published certificate log out json"
    for option in shared.split():
        assert f"  --{option} " in printed


def test_a_named_controller_flies_and_is_named_in_result_and_log(tmp_path: Path) -> None:
    """With the log in one new folder and the report in another."""
    log, out = tmp_path / "logs" / "a.mcap", tmp_path / "new" / "out"
    arguments = ("--controller", "pd", "--duration", 1, "--log", log, "--out", out, "--json", tmp_path / "r.json")
    assert _run("fly", "hover", *arguments) == 0
    result = json.loads((tmp_path / "r.json").read_text())
    assert result["controller"] == "pd"
    assert result["gp"]["enabled"] is False
    assert (result["log"], result["report"]) == (str(log), str(out / "report.html"))
    assert "</html>" in (out / "report.html").read_text()
    assert read(log).metadata["settings"]["controller"] == "pd"


def test_a_page_made_from_the_log_alone_says_what_the_flights_own_page_says(
    plain: tuple[Path, str], tmp_path: Path
) -> None:
    """The verdict and its figures are in the log, and nothing that a clock measured: the same flight, the same log."""

    def head(page: Path) -> str:
        found = re.search(r"<header.*?</header>", page.read_text(), re.DOTALL)
        assert found is not None
        return found.group()

    assert _run(*PLAIN, "--out", tmp_path / "two") == 0
    logs = [folder / "flight.mcap" for folder in (plain[0] / "out", tmp_path / "two")]
    kept = [read(log).attachment("result.json") for log in logs]
    assert kept[0] == kept[1]
    assert kept[0] is not None
    assert json.loads(kept[0])["completed"] is True
    assert _run("log", "report", logs[0], "--out", tmp_path / "again") == 0
    own = head(plain[0] / "out" / "report.html")
    assert "hover completed" in own
    assert head(tmp_path / "again" / "report.html") == own


def test_log_info_reads_what_fly_wrote(
    plain: tuple[Path, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _run("log", "info", plain[0] / "out" / "flight.mcap", "--json", tmp_path / "i.json") == 0
    assert "/truth" in capsys.readouterr().out
    assert json.loads((tmp_path / "i.json").read_text())["complete"] is True


def test_hyper_parameters_fitted_to_a_flight_begin_the_next_one(plain: tuple[Path, str], tmp_path: Path) -> None:
    learned = tmp_path / "kept" / "learned.json"
    assert _run("learn", plain[0] / "out" / "flight.mcap", "--out", learned, "--json", tmp_path / "l.json") == 0
    result = json.loads((tmp_path / "l.json").read_text())
    assert result["schema"] == "flightstack.learn/1"
    assert result["windows"] >= 100
    assert len(result["data_hash"]) == len(result["vehicle_hash"]) == 64
    assert _run("fly", "hover", "--duration", 2, "--learned", learned, "--out", tmp_path) == 0
    assert read(tmp_path / "flight.mcap").attachment("learned.json") == learned.read_bytes()


def test_scenarios_lists_the_contracts_names(capsys: pytest.CaptureFixture[str]) -> None:
    assert _run("scenarios") == 0
    printed = capsys.readouterr().out
    for name in ("hover", "paper-tracking", "paper-barrier", "figure8", "waypoints"):
        assert name in printed


@pytest.mark.parametrize(
    "verb", [(), ("fly",), ("sim",), ("offboard",), ("learn",), ("scenarios",), ("log",), ("log", "info")]
)
def test_every_verb_has_help(verb: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    assert _run(*verb, "--help") == 0
    assert "Usage" in capsys.readouterr().out


def _vehicle(tmp_path: Path, old: str, new: str) -> Path:
    text = (ROOT / "flightstack/data/vehicles" / "quad-x.toml").read_text()
    assert old in text
    path = tmp_path / "bad.toml"
    path.write_text(text.replace(old, new, 1))
    return path


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ("mass_kg", "mas_kg", "mas_kg"),
        ("mass_kg = 1.2", "mass_kg = -1.2", "mass_kg"),
        ("mass_kg = 1.2", 'mass_kg = "heavy"', "mass_kg"),
        ("max_thrust_n = 6.6", "max_thrust_n = 1.0", "max_thrust_n"),
        ("[rotors]", "[rotor]", "rotor"),
        ("mass_kg = 1.2", "mass_kg = ", "bad.toml"),
    ],
)
def test_a_bad_vehicle_file_is_one_line_that_names_the_key(
    old: str, new: str, named: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code = _run("fly", "hover", "--vehicle", _vehicle(tmp_path, old, new), "--out", tmp_path / "out")
    _assert_one_error_line(capsys, code, named)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (("fly", "--json", "--no-learning"), "a file is expected, not --no-learning"),
        (("fly", "--scenario", "nowhere"), "no scenario named 'nowhere'"),
        (("fly", "nowhere"), "nowhere"),
        (("fly", "hover", "--vehicle", "no-such.toml"), "no-such.toml"),
        (("fly", "hover", "--plant", "gazebo"), "gazebo"),
        (("fly", "hover", "--duration", "-3"), "duration"),
        (("fly", "hover", "--duration", "nan"), "duration"),
        (("fly", "hover", "--seed", "-1"), "seed"),
        (("fly", "hover", "extra.csv"), "waypoints"),
        (("fly", "waypoints"), "waypoints"),
        (("fly", "hover", "--wings"), "--wings"),
        (("fly", "hover", "--controller", "bang-bang"), "bang-bang"),
        (("fly", "hover", "--learned", "absent.json"), "absent.json"),
        (("offboard", "--connect", "udpin:127.0.0.1:0", "--controller", "bang-bang"), "bang-bang"),
        (("offboard", "--connect", "tcp:1.2.3.4:5"), "tcp"),
        (("offboard",), "--connect"),
        (("offboard", "--connect", "serial:/dev/ttyACM0:57600"), "921600"),
        (("offboard", "--connect", "udpin:127.0.0.1:14999", "--signing-key", "absent.key"), "absent.key"),
        (("log", "info", "absent.mcap"), "absent.mcap"),
        (("learn", "absent.mcap"), "absent.mcap"),
        (("explode",), "explode"),
    ],
)
def test_a_mistake_on_the_command_line_is_one_line(
    arguments: tuple[str, ...],
    named: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    _assert_one_error_line(capsys, _run(*arguments), named)


def _assert_one_error_line(capsys: pytest.CaptureFixture[str], code: int, named: str) -> None:
    lines = capsys.readouterr().err.strip().splitlines()
    assert code == 2
    assert len(lines) == 1, lines
    assert lines[0].startswith("error: ")
    assert named in lines[0]


def test_a_scenario_with_a_typo_names_the_key(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = (ROOT / "flightstack/data/scenarios" / "paper-tracking.toml").read_text()
    path = tmp_path / "mine.toml"
    path.write_text(text.replace("mass_ratio", "mass_ration"))
    _assert_one_error_line(capsys, _run("fly", path, "--out", tmp_path / "out"), "mass_ration")


def test_a_port_in_use_is_said_and_never_shared(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        code = _run("offboard", "--connect", f"udpin:127.0.0.1:{port}", "--out", tmp_path)
        _assert_one_error_line(capsys, code, str(port))
        if port > 40:
            _assert_one_error_line(capsys, _run("sim", "--port", port - 40, "--duration", 1), str(port))


def test_a_log_that_cannot_be_written_stops_the_flight_before_it_begins(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    os.mkfifo(tmp_path / "pipe")  # that nobody reads: opening it waits for ever
    flight, simulator = ("fly", "hover", "--duration", 2, "--out", tmp_path), ("sim", "--port", _free_port())
    for place in ("/dev/full", "/dev/null", "/dev/stdout", tmp_path / "pipe"):
        for verb in (flight, (*simulator, "--duration", 1)):
            code = _run(*verb, "--log", place)
            _assert_one_error_line(capsys, code, f"log {place}")


def test_no_heartbeat_is_said_with_exit_code_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code = _run("offboard", "--connect", f"udpin:127.0.0.1:{_free_port()}", "--timeout", 0.5, "--out", tmp_path)
    error = capsys.readouterr().err.strip()
    assert code == 1
    assert error.startswith("error: no heartbeat")
    assert "\n" not in error


def assert_one_clock(path: Path, result: dict[str, Any], sim_started_s: float) -> None:
    """From 0, never back in the order of the file, as long as the flight, the date beside it."""
    with path.open("rb") as file:
        times = [message.log_time for _, _, message in make_reader(file).iter_messages(log_time_order=False)]
    assert times[0] == 0
    assert all(after >= before for before, after in itertools.pairwise(times))
    assert result["flight_time_s"] < times[-1] * 1e-9 < result["wall_time_s"] + 1.0
    log = read(path)
    assert info(log).duration_s == pytest.approx(times[-1] * 1e-9, abs=0.1)
    clock, attitude = log.tables["/clock"], log.tables["/vehicle/attitude"]
    age_us = attitude.t_us - attitude["t_boot_us"]
    assert -20_000 < float(np.median(age_us)) < 50_000
    began = datetime.fromisoformat(log.metadata["clock"]["utc_start"]).timestamp()
    assert sim_started_s < began < time.time()
    assert clock["utc_us"][-1] * 1e-6 - began == pytest.approx(clock.t_us[-1] * 1e-6, abs=0.2)
    assert log.metadata["clock"]["utc"] == "wall clock"


def test_two_processes_fly_a_scenario_and_are_watched(tmp_path: Path) -> None:
    started_s = time.time()
    pages = free_tcp_pair(), free_tcp_pair()
    sim, port = _start_sim(tmp_path, f"--live={pages[0]}")
    try:
        arguments = ("--arm", "--scenario", "hover", "--duration", 4, "--out", tmp_path, "--json", tmp_path / "r.json")
        with watching(pages[0], 0.3) as simulated, watching(pages[1], 0.3) as flown, bare_loop() as bare_s:
            flight = _start(
                "offboard", "--connect", f"udpin:127.0.0.1:{port}", f"--live={pages[1]}", *arguments, cwd=tmp_path
            )
            _, errors = flight.communicate(timeout=120)
        assert flight.returncode in (0, 1), errors  # 1: a busy machine may fail the scenario's own accuracy check
        result = json.loads((tmp_path / "r.json").read_text())
        if not result["completed"]:
            skip_where_too_busy(result["reason"], bare_s)
        assert result["completed"], result["reason"]
        assert result["tracking"]["of"] == "estimate"
        assert result["tracking"]["rmse_m"] < 0.3
        assert result["loop"]["rate_hz"] == 250
        assert result["gp"]["enabled"] is True
        assert result["gp"]["fed"] > 500
        assert result["gp"]["coverage_3sigma"] is None  # nobody knows the truth
        log = read(tmp_path / "flight.mcap")
        assert log.complete
        assert -log.tables["/vehicle/local_position"]["pos_ned_m"][:, 2].min() > 1.0
        assert_one_clock(tmp_path / "flight.mcap", result, sim_started_s=started_s)
        for states, position in ((simulated, "true_ned_m"), (flown, "pos_ned_m")):
            assert "OFFBOARD" in {state["now"].get("mode") for state in states}
            assert max(-state["now"][position][2] for state in states if position in state["now"]) > 1.0
    finally:
        sim.send_signal(signal.SIGINT)
        sim.communicate(timeout=20)
    assert sim.returncode == 130


def test_real_time_is_paced_and_its_lateness_reported(tmp_path: Path) -> None:
    arguments = ("--realtime", "--duration", 1, "--unprotected-ok", "--out", tmp_path, "--json", tmp_path / "r.json")
    code = _run("fly", "paper-barrier", *arguments)
    result = json.loads((tmp_path / "r.json").read_text())
    assert code == 0, result["reason"]
    assert result["loop"]["rate_hz"] == 250
    assert result["loop"]["lateness_us"]["p50"] >= 0.0
    assert 0.5 < result["realtime_factor"] <= 1.05  # paced: never faster than real time
    log = read(tmp_path / "flight.mcap")
    assert len(log.tables["/timing"]) > 1000
    # Certificates come from a process of its own; how soon is the machine's business.
    assert result["barrier"]["enabled"]
    assert log.metadata["settings"]["filter"] == "sound, certified in flight"
    assert not [text for text in log.tables["/events"]["text"].tolist() if "certifies nothing more" in text]


def test_a_killed_flight_leaves_a_readable_log(tmp_path: Path) -> None:
    flight = _start("fly", "figure8", "--no-learning", "--duration", 300, "--out", tmp_path, cwd=tmp_path)
    log_file = tmp_path / "flight.mcap"
    deadline = time.monotonic() + 120.0
    while time.monotonic() < deadline and not (log_file.exists() and log_file.stat().st_size > 1_000_000):
        assert flight.poll() is None
        select.select([], [], [], 0.02)
    flight.kill()
    flight.communicate(timeout=20)
    log = read(log_file)
    assert not log.complete
    assert len(log.tables["/truth"]) > 200
    assert log.metadata["settings"]["scenario"] == "figure8"
    assert log.attachment("vehicle.toml")
    assert _run("log", "info", log_file) == 0


def test_a_flight_that_asked_for_protection_and_had_none_has_failed_unless_that_is_allowed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two seconds of track are too short for anything to be learned that could be certified."""
    arguments = ("fly", "paper-tracking", "--duration", 2, "--out", tmp_path, "--json", tmp_path / "r.json")
    assert _run(*arguments) == 1
    said = capsys.readouterr()
    assert said.err.startswith("error: not protected: ")
    assert "not protected" in said.out
    result = json.loads((tmp_path / "r.json").read_text())
    assert (result["completed"], result["passed"], result["protection"]) == (True, False, "none")
    assert result["barrier"]["protected"] == []
    assert '<header class="bad">' in (tmp_path / "report.html").read_text()
    assert _run(*arguments, "--unprotected-ok") == 0
    assert json.loads((tmp_path / "r.json").read_text())["protection"] == "none"
    assert _run(*arguments, "--no-learning") == 0
    result = json.loads((tmp_path / "r.json").read_text())
    assert (result["protection"], result["protection_words"][:4]) == ("off", "off:")
    assert "off: nothing is certified without the learner" in " ".join(capsys.readouterr().out.split())
