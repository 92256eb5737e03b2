"""What an outsider does while the vehicle leaves the ground: load, wind, battery, GPS, pilots; low and high climbs."""

from __future__ import annotations

import time
from collections.abc import Callable

from benchmarks.px4.companion import MASS_KG, light_vehicle, start
from benchmarks.px4.deeds import ARM, HOLD, LAND, RETURN, Attack, flown
from benchmarks.px4.records import Bench, Row
from benchmarks.px4.scene import LIMIT_S, OFFBOARD, Scene
from benchmarks.px4.subjects.shield import SITE

ASKED = (
    "An outsider interferes with a take-off: whoever takes the vehicle keeps it, one line says why, nothing raises, "
    "the exit code is 0 where the flight was completed, 1 or 2 where it was not; the ground is met at 1.5 m/s at most."
)
RUNS = 1
_HOVER = """schema = "flightstack.scenario/1"
name = "climb"
description = "a hover {height:g} m up"
duration_s = 8.0

[trajectory]
kind = "hover"
position_m = [0.0, 0.0, -{height:g}]
"""
_WIND = """
[truth.effects.steady_wind]
north_mps = 5.657
east_mps = 5.657

[truth.effects.rotor_drag]
k_d_kg_per_rad = 1.6e-4

[truth.effects.translational_lift]
k_h_kg_per_m = 4.0e-3
"""
_INJECT_FAILURE, _GPS, _OFF = 420.0, 4.0, 1.0
_FLOWN_S = 150.0
_POSITION = (3.0, 0.0)
_STICK_S = 0.04
_TAKEN_S = 6.0
_OFF_THE_GROUND_M = 0.03


def run(bench: Bench, runs: int) -> list[Row]:
    """Every one `runs` times."""
    return flown(bench, runs, ATTACKS)


def _begin(scene: Scene, height_m: float, *more: str, beside: str = "") -> None:
    file = scene.folder / "climb.toml"
    file.write_text(_HOVER.format(height=height_m) + beside)
    scene.began_s = time.monotonic()
    scene.process = start(scene.px4, scene.folder, str(file), *more)


def _climbed(height_m: float, beside: str = "") -> Callable[[Scene], None]:
    """A hover at this height, to its end."""

    def deed(scene: Scene) -> None:
        _begin(scene, height_m, beside=beside)
        scene.wait(lambda: _lifting(scene), LIMIT_S)
        scene.began_s = time.monotonic()
        scene.wait(lambda: scene.ended, _FLOWN_S)
        if max(each.up_m for each in scene.px4.truth) < 0.8 * height_m:
            scene.notes.append("did not climb")

    return deed


def _lifting(scene: Scene) -> bool:
    """The motors turn (PX4 tells 50 times a second), or it is off the ground."""
    return scene.ended or scene.px4.spins or scene.px4.height_m > _OFF_THE_GROUND_M


def _as_it_lifts(
    deed: Callable[[Scene], None], *, height_m: float = 0.0, goal_m: float = 2.0, watched_s: float = _TAKEN_S
) -> Callable[[Scene], None]:
    """Something happens as the motors begin to turn, or at a height of the climb."""

    def whole(scene: Scene) -> None:
        _begin(scene, goal_m)
        rising = lambda: scene.ended or scene.px4.height_m > height_m  # noqa: E731
        if not scene.wait((lambda: _lifting(scene)) if height_m <= 0.0 else rising, LIMIT_S):
            scene.notes.append("did not take off")
        scene.began_s = time.monotonic()
        deed(scene)
        scene.wait(lambda: scene.ended, watched_s)

    return whole


def _commanded(number: float, *params: float) -> Callable[[Scene], None]:
    return lambda scene: scene.px4.command(int(number), *params)


def _chosen(mode: tuple[float, float]) -> Callable[[Scene], None]:
    return lambda scene: scene.mode(*mode)


def _set(name: str, value: float) -> Callable[[Scene], None]:
    return lambda scene: scene.px4.set_param(name, value)


def _sticks(scene: Scene) -> None:
    """The pilot takes Position, with sticks in their middle, and goes on holding them."""
    for count in range(round(_TAKEN_S / _STICK_S)):
        scene.px4.link.mav.manual_control_send(scene.px4.instance + 1, 0, 0, 500, 0, 0)
        if count in (5, 10):
            scene.mode(*_POSITION)
        time.sleep(_STICK_S)
    if scene.px4.mode >> 16 & 0xFF != _POSITION[0]:
        scene.notes.append("Position was not kept")


def _taken_and_given_back(scene: Scene) -> None:
    """Hold, and 0.2 s later OFFBOARD again, while it still climbs."""
    scene.mode(*HOLD)
    time.sleep(0.2)
    scene.mode(float(OFFBOARD))


def _in_a_site(mass_kg: float) -> Callable[[Scene], None]:
    """gps-barrier with a site round it."""

    def deed(scene: Scene) -> None:
        site = scene.folder / "field.toml"
        site.write_text(SITE.replace("ceiling_m = 20.0", "ceiling_m = 60.0"))
        scene.began_s = time.monotonic()
        file = str(light_vehicle(scene.folder)) if mass_kg < 1.0 else "px4-sihsim-quadx"
        more = ("--site", str(site), "--vehicle", file, "--sensors", "px4-sih-ekf", "--duration", "20")
        scene.process = start(scene.px4, scene.folder, "gps-barrier", *more)
        scene.wait(lambda: scene.ended, _FLOWN_S)

    return deed


ATTACKS: dict[str, Attack] = {
    "1 m up": Attack(_climbed(1.0), codes=(0,)),
    "20 m up": Attack(_climbed(20.0), codes=(0,)),
    "SIH_MASS 1.4, 2 m up": Attack(_climbed(2.0), codes=(0,), params=(("SIH_MASS", 1.4),)),
    "SIH_MASS 1.4, 20 m up": Attack(_climbed(20.0), codes=(0,), params=(("SIH_MASS", 1.4),)),
    "8 m/s of wind (our plant)": Attack(_climbed(2.0, _WIND), codes=(0,), kind="hil"),
    "8 m/s of wind, 20 m up (our plant)": Attack(_climbed(20.0, _WIND), codes=(0,), kind="hil"),
    "battery empty as the motors turn, COM_LOW_BAT_ACT 3": Attack(
        _as_it_lifts(_set("SIM_BAT_MIN_PCT", 3.0), goal_m=20.0, watched_s=_FLOWN_S), codes=(0, 1),
        params=(("SIM_BAT_DRAIN", 4.0), ("COM_LOW_BAT_ACT", 3.0)),
    ),
    "GPS off as the motors turn (our plant)": Attack(
        _as_it_lifts(_commanded(_INJECT_FAILURE, _GPS, _OFF, 0.0), watched_s=30.0), kind="hil"
    ),
    "GPS off at 0.5 m (our plant)": Attack(
        _as_it_lifts(_commanded(_INJECT_FAILURE, _GPS, _OFF, 0.0), height_m=0.5, watched_s=30.0), kind="hil"
    ),
    "no GPS as the motors turn (SIM_GPS_USED 0)": Attack(
        _as_it_lifts(_set("SIM_GPS_USED", 0.0), watched_s=60.0), codes=(0, 1)
    ),
    "Hold as the motors turn": Attack(_as_it_lifts(_chosen(HOLD))),
    "Hold at 0.05 m": Attack(_as_it_lifts(_chosen(HOLD), height_m=0.05)),
    "Land at 0.05 m": Attack(_as_it_lifts(_chosen(LAND), height_m=0.05)),
    "Return at 1 m": Attack(_as_it_lifts(_chosen(RETURN), height_m=1.0)),
    "Hold at 10 m of 20": Attack(_as_it_lifts(_chosen(HOLD), height_m=10.0, goal_m=20.0)),
    "disarmed as the motors turn": Attack(_as_it_lifts(_commanded(float(ARM), 0.0, 0.0)), codes=(0, 1)),
    "Position by sticks as the motors turn": Attack(_as_it_lifts(_sticks)),
    "Position by sticks at 0.1 m": Attack(_as_it_lifts(_sticks, height_m=0.1)),
    "Position by sticks at 1 m": Attack(_as_it_lifts(_sticks, height_m=1.0)),
    "Hold at 0.3 m, 0.2 s later OFFBOARD": Attack(
        _as_it_lifts(_taken_and_given_back, height_m=0.3), codes=(0, 1), keeps=False
    ),
    "gps-barrier with a site": Attack(_in_a_site(1.0), codes=(0, 1, 2)),
    "gps-barrier with a site, SIH_MASS 0.7": Attack(_in_a_site(MASS_KG), codes=(0, 1), params=(("SIH_MASS", MASS_KG),)),
}  # fmt: skip
