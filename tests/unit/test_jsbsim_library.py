"""JSBSim as a library: what is missing, foreign or misspelled is said in one line, before the flight."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

import numpy as np
import pytest
from shipped import ROOT, load_vehicle

from flightstack.cli.flight import FlyOptions, prepare
from flightstack.cli.main import main
from flightstack.types import InputError
from flightstack.vehicle import vehicle_to_toml, with_effects
from flightstack_sim.jsbsim import aircraft
from flightstack_sim.jsbsim.library import Fdm, library
from flightstack_sim.jsbsim.plant import JsbsimPlant

jsbsim = pytest.importorskip("jsbsim", reason="no JSBSim here (wheels exist for x86-64 only)")

pytestmark = pytest.mark.jsbsim
QUAD = load_vehicle("quad-x")
LOAD = {"slung_load": {"mass_kg": 0.25, "length_m": 0.8}}


def written() -> aircraft.Aircraft:
    return aircraft.write(QUAD, dt_us=1000, gravity_mps2=9.81, seed=0)


def one_line(error: pytest.ExceptionInfo[InputError]) -> str:
    text = str(error.value)
    assert "\n" not in text.strip()
    assert len(text) < 400
    return text


def test_without_jsbsim_the_error_says_how_to_get_it_or_do_without(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "jsbsim", None)
    with pytest.raises(InputError, match=r"not installed.*pip install.*--plant native") as error:
        library()
    one_line(error)


@pytest.mark.parametrize("version", ["1.2.1", "2.0.0", "0.9", "unknown"])
def test_a_version_that_was_not_checked_is_refused_by_its_number(monkeypatch: pytest.MonkeyPatch, version: str) -> None:
    monkeypatch.setattr(jsbsim, "__version__", version)
    with pytest.raises(InputError, match=rf"JSBSim {version} is installed.*1\.3") as error:
        JsbsimPlant(QUAD, seed=0)
    one_line(error)


def test_a_property_that_does_not_exist_is_an_error_where_jsbsim_would_make_it() -> None:
    fdm = Fdm(written(), {"ic/h-agl-ft": 0.0}, dt_s=0.001)
    with pytest.raises(InputError, match="no property velocities/v-nort-fps"):
        fdm.get("velocities/v-nort-fps")
    with pytest.raises(InputError, match="no property atmosphere/wind-north"):
        fdm.write({"atmosphere/wind-north": 1.0})
    with pytest.raises(InputError, match="no property ic/altitude"):
        Fdm(written(), {"ic/altitude": 0.0}, dt_s=0.001)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("rotor/share-1</property>", "rotor/shara-1</property>"),
        ("<product>", "<prodct>"),
        ("</fdm_config>", ""),
        ("<emptywt", "<emptwt"),
    ],
)
def test_an_aircraft_that_jsbsim_refuses_is_one_line_too(old: str, new: str) -> None:
    good = written()
    text = good.files["vehicle.xml"]
    assert old in text
    bad = dataclasses.replace(good, files={"vehicle.xml": text.replace(old, new)})
    with pytest.raises(InputError, match="--plant jsbsim") as error:
        Fdm(bad, {"ic/h-agl-ft": 0.0}, dt_s=0.001)
    one_line(error)


def test_nothing_is_printed_from_loading_through_take_off_to_a_hard_landing(capfd: pytest.CaptureFixture[str]) -> None:
    plant = JsbsimPlant(QUAD, seed=0)
    plant.run(np.full(4, 0.9), 1500)
    plant.place(pos_ned_m=(0.0, 0.0, -40.0), euler_rad=(0.3, 0.2, 0.0))
    plant.run(np.zeros(4), 6000)
    said = capfd.readouterr()
    assert (said.out, said.err) == ("", "")
    assert plant.on_ground
    assert np.isfinite(plant.pos_ned_m).all()


def test_it_flies_on_after_a_fall_at_28_metres_a_second() -> None:
    """JSBSim may call that a crash and stand still: a simulated autopilot would wait for ever."""
    plant = JsbsimPlant(QUAD, seed=0)
    plant.place(pos_ned_m=(0.0, 0.0, -40.0))
    plant.run(np.zeros(4), 6000)
    plant.run(np.full(4, 0.8), 1500)
    assert plant.pos_ned_m[2] < -1.0


def test_the_shipped_f450_takes_what_acts_from_outside_and_refuses_the_rest_by_name() -> None:
    vehicle = load_vehicle("f450")
    JsbsimPlant(with_effects(vehicle, {"payload": {"mass_kg": 0.3}, "steady_wind": {"north_mps": 3.0}}), seed=0)
    with pytest.raises(InputError, match=r"effects\.rotor_drag cannot be added to JSBSim's own F450") as error:
        JsbsimPlant(with_effects(vehicle, {"rotor_drag": {"k_d_kg_per_rad": 1e-4}}), seed=0)
    one_line(error)


def test_an_f450_with_other_rotors_is_not_jsbsim_s_and_is_refused() -> None:
    shipped = load_vehicle("f450")
    rotors = dataclasses.replace(shipped.rotors, position_m=1.1 * shipped.rotors.position_m)
    with pytest.raises(InputError, match="not where JSBSim's own F450 has them") as error:
        JsbsimPlant(dataclasses.replace(shipped, rotors=rotors), seed=0)
    one_line(error)


@pytest.mark.parametrize("verb", [["fly", "hover"], ["certify"], ["sim", "--duration", "1"]], ids=lambda verb: verb[0])
@pytest.mark.parametrize(
    ("version", "words"), [(None, "JSBSim is not installed"), ("1.2.1", "JSBSim 1.2.1 is installed")]
)
def test_every_verb_that_flies_says_in_one_line_what_is_wrong_with_the_library(
    verb: list[str], version: str | None, words: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    if version is None:
        monkeypatch.setitem(sys.modules, "jsbsim", None)
    else:
        monkeypatch.setattr(jsbsim, "__version__", version)
    out = [] if verb[0] == "sim" else ["--out", str(tmp_path / "out")]
    with pytest.raises(SystemExit) as ended:
        main([*verb, "--plant", "jsbsim", *out])
    said = capsys.readouterr().err
    assert ended.value.code == 2
    assert said.startswith("error: --plant jsbsim: ")
    assert words in said
    assert said.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_fly_refuses_a_hidden_slung_load_before_it_flies(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    truth = tmp_path / "truth.toml"
    truth.write_text(vehicle_to_toml(with_effects(QUAD, LOAD)))
    with pytest.raises(SystemExit) as ended:
        main(["fly", "hover", "--plant", "jsbsim", "--truth", str(truth), "--out", str(tmp_path / "out")])
    assert ended.value.code == 2
    said = capsys.readouterr()
    assert said.err.startswith("error: ")
    assert said.err.count("\n") == 1
    assert "effects.slung_load" in said.err
    assert not (tmp_path / "out").exists()


def test_an_event_that_jsbsim_cannot_follow_is_refused_before_the_flight(tmp_path: Path) -> None:
    text = (ROOT / "flightstack/data/scenarios" / "hover.toml").read_text()
    scenario = tmp_path / "late.toml"
    event = '\n[[events]]\ntime_s = 2.0\neffect = "slung_load"\nvalues = { mass_kg = 0.2, length_m = 1.0 }\n'
    scenario.write_text(text + event)
    with pytest.raises(InputError, match=r"effects\.slung_load"):
        prepare(FlyOptions(scenario=str(scenario), plant="jsbsim"))
    assert prepare(FlyOptions(scenario=str(scenario))).plant == "native"


def test_the_log_says_which_plant_flew_and_carries_its_aircraft() -> None:
    setup = prepare(FlyOptions(scenario="hover", plant="jsbsim"))
    assert setup.flight.settings["plant"] == "jsbsim"
    assert setup.flight.settings["jsbsim"] == jsbsim.__version__
    assert setup.flight.carried["aircraft.xml"].startswith("<?xml")
    assert "aircraft.xml" not in prepare(FlyOptions(scenario="hover")).flight.carried
