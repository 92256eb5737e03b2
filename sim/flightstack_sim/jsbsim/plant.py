"""The JSBSim plant: one vehicle, flown by JSBSim over its round, turning earth, shown as the flat one of the logs.

A step is: commands into JSBSim's properties, one frame of JSBSim, its numbers read into a row.  Within a frame JSBSim
first moves the state with the last accelerations (Adams-Bashforth of second order) and then computes the forces at
the new one.  An effect that changes makes a new aircraft, which takes over state, motors, gusts and battery.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import repeat
from pathlib import Path
from typing import Any

import numpy as np

from flightstack.effects import accelerometer_bias, attitude_misalignment, gyro_bias
from flightstack.types import F64, InputError
from flightstack.vehicle import Vehicle, with_effects
from flightstack_sim.jsbsim import f450
from flightstack_sim.jsbsim.aircraft import Aircraft, write
from flightstack_sim.jsbsim.earth import ALTITUDE_M, LATITUDE_RAD, LONGITUDE_RAD, TURNING, Earth
from flightstack_sim.jsbsim.library import Fdm, library
from flightstack_sim.jsbsim.readings import (
    F_PER_POUND,
    F_RADII,
    R_ANGULAR,
    R_FORCE,
    R_LAST_FORCE,
    R_POS,
    R_Q,
    R_RATE,
    R_VEL,
    READ,
    READINGS,
)
from flightstack_sim.jsbsim.text import FOOT_M, POUND_N, SLUG_KG
from flightstack_sim.parameters import parameter_row
from flightstack_sim.plant import Truth

_ECEF = tuple(f"position/ecef-{axis}-ft" for axis in "xyz")
_VELOCITY = tuple(f"velocities/v-{name}-fps" for name in ("north", "east", "down"))
_EULER = tuple(f"attitude/{name}-rad" for name in ("phi", "theta", "psi"))
_RATES = tuple(f"velocities/{name}-rad_sec" for name in "pqr")
_FORCES = tuple(f"forces/fb{axis}-total-lbs" for axis in "xyz")
_GROUND = tuple(f"forces/fb{axis}-gear-lbs" for axis in "xyz")
_WIND = tuple(f"atmosphere/total-wind-{name}-fps" for name in ("north", "east", "down"))
_SHOWN_PLACE = ("position/lat-geod-rad", "position/long-gc-rad", "position/h-agl-ft")
_PLACE = ("ic/lat-geod-rad", "ic/long-gc-rad", "ic/h-agl-ft")
_START_EULER = tuple(f"ic/{name}-rad" for name in ("phi", "theta", "psi-true"))
_START_VELOCITY = tuple(f"ic/{name}-fps" for name in ("vn", "ve", "vd"))
_START_RATES = tuple(f"ic/{name}-rad_sec" for name in "pqr")
_ONCE: tuple[tuple[()]] = ((),)
E_ACCEL, E_GYRO, E_TURN = 0, 3, 6
"""Places in `JsbsimPlant.sensor_errors`."""
_GROUND_MARGIN_M = 1.0
"""Height over a vehicle's reach from which it can't come down in a step."""


class JsbsimPlant:
    """One vehicle in JSBSim; a `Plant`.  Same vehicle, seed and commands give the same flight.

    It starts at rest on the ground at the origin, facing north.  Its arrays are shown, not listened to: `place` puts
    the vehicle somewhere else.
    """

    def __init__(
        self, vehicle: Vehicle, *, seed: int, dt_us: int = 1000, ground: bool = True, earth: Earth = TURNING
    ) -> None:
        if not 100 <= dt_us <= 10_000:
            raise InputError(f"plant: dt_us = {dt_us} is not allowed; it must be 100 to 10000 us")
        self.dt_us = dt_us
        self.t_us = 0
        self._ground = ground
        self._earth = earth
        self._seeds = np.random.SeedSequence(seed)
        row = self._row = np.zeros(READINGS)
        row[R_Q] = 1.0
        self.pos_ned_m = row[R_POS : R_POS + 3]
        self.vel_ned_mps = row[R_VEL : R_VEL + 3]
        self.q_ned_frd = row[R_Q : R_Q + 4]
        self.rate_frd_radps = row[R_RATE : R_RATE + 3]
        self.specific_force_frd_mps2 = row[R_FORCE : R_FORCE + 3]
        self.angular_acceleration_frd_radps2 = row[R_ANGULAR : R_ANGULAR + 3]
        errors = self.sensor_errors = np.zeros(10)
        """The next three side by side: biases (3,) each, misalignment (4,)."""
        self.accel_bias_frd_mps2 = errors[E_ACCEL : E_ACCEL + 3]
        self.gyro_bias_frd_radps = errors[E_GYRO : E_GYRO + 3]
        self.misalignment_q = errors[E_TURN : E_TURN + 4]
        self._frame = np.zeros(0)
        self._load(vehicle, {_PLACE[0]: LATITUDE_RAD, _PLACE[1]: LONGITUDE_RAD, _PLACE[2]: 0.0}, {}, [0.0] * 4)
        self._rest()

    @property
    def battery_v(self) -> float:
        """Voltage at the battery's terminals; 0 where the vehicle has no [battery]."""
        return self._get_shown[-1]()

    @property
    def on_ground(self) -> bool:
        """Whether the ground pushed during the last step."""
        return self._ground_works and any(get() != 0.0 for get in self._get_ground)

    @property
    def aircraft_xml(self) -> str:
        """The aircraft file that JSBSim loaded."""
        return self._aircraft.files[f"{self._aircraft.name}.xml"]

    def step(self, motor_command: F64) -> None:
        """Advance by dt_us with these commands (4,), normalised 0..1, held; what is not a number stops its motor."""
        self.fly(motor_command, READ.call, _ONCE)

    def run(self, motor_command: F64, steps: int) -> None:
        """`steps` steps with the same commands."""
        self.fly(motor_command, READ.call, repeat((), steps))

    def fly(self, motor_command: F64, look: Callable[..., float], each: Iterable[tuple[Any, ...]]) -> None:
        """`step` for each item with `look(row, frame, numbers, *item)` in `read`'s place: it gives the height.

        `look` may change the commands (4,) and see more than the plant; `numbers` are those that `read` takes.
        """
        one, two, three, four, x, y, z, vn, ve, vd, phi, theta, psi, p, q, r, fx, fy, fz = self._wires
        row, frame, low_m, dt_us, commands = self._row, self._frame, self._ground_below_m, self.dt_us, motor_command
        for item in each:
            a, b, c, d = commands.tolist()
            one(a if 0.0 <= a <= 1.0 else _within(a))
            two(b if 0.0 <= b <= 1.0 else _within(b))
            three(c if 0.0 <= c <= 1.0 else _within(c))
            four(d if 0.0 <= d <= 1.0 else _within(d))
            self._run()
            height_m = look(
                row, frame,
                (x(), y(), z(), vn(), ve(), vd(), phi(), theta(), psi(), p(), q(), r(), fx(), fy(), fz()), *item,
            )  # fmt: skip
            if (height_m < low_m) is not self._ground_works:
                self._toggle_ground()
            self.t_us += dt_us

    def truth(self) -> Truth:
        """A snapshot."""
        row: Any = tuple(self._row.tolist())
        u1, u2, u3, u4, t1, t2, t3, t4, north, east, down, voltage = self._get_shown
        speed, thrust_n = self._units
        return Truth(
            self.t_us,
            row[R_POS : R_POS + 3],
            row[R_VEL : R_VEL + 3],
            row[R_Q : R_Q + 4],
            row[R_RATE : R_RATE + 3],
            row[R_FORCE : R_FORCE + 3],
            row[R_ANGULAR : R_ANGULAR + 3],
            (u1() * speed, u2() * speed, u3() * speed, u4() * speed),
            (t1() * thrust_n, t2() * thrust_n, t3() * thrust_n, t4() * thrust_n),
            (north() * FOOT_M, east() * FOOT_M, down() * FOOT_M),
            voltage(),
            self._ground_works and self.on_ground,
        )

    def set_effect(self, name: str, values: Mapping[str, float]) -> None:
        """From now on the effect has these values (absent ones: null); InputError where they are not allowed.

        The state stays; commands on their way through a transport delay give way to the motors' present ones.
        """
        changed = with_effects(self.vehicle, {name: values}, source="event")
        fdm, shown = self._fdm, self._row.copy()
        where = dict(zip(_PLACE, (fdm.get(name)() for name in _SHOWN_PLACE), strict=True))
        where[_PLACE[2]] -= self._aircraft.rest_height_m / FOOT_M
        turning = zip(_START_EULER, (fdm.get(name)() for name in _EULER), strict=True)
        moving = zip(_START_VELOCITY, (fdm.get(name)() for name in _VELOCITY), strict=True)
        rates = zip(_START_RATES, (fdm.get(name)() for name in _RATES), strict=True)
        carried = fdm.read(self._aircraft.states)
        named = self._aircraft.speeds if self._aircraft.speeds[0] in carried else self._aircraft.commands
        commands = [fdm.get(name)() for name in named]
        self._load(changed, {**where, **dict(turning), **dict(moving), **dict(rates)}, carried, commands)
        self._row[:R_LAST_FORCE] = shown[:R_LAST_FORCE]  # no time has passed

    def place(
        self,
        *,
        pos_ned_m: Sequence[float] = (0.0, 0.0, 0.0),
        vel_ned_mps: Sequence[float] = (0.0, 0.0, 0.0),
        euler_rad: Sequence[float] = (0.0, 0.0, 0.0),
        rate_frd_radps: Sequence[float] = (0.0, 0.0, 0.0),
        motor_u: Sequence[float] = (0.0, 0.0, 0.0, 0.0),
    ) -> None:
        """Put the vehicle near the origin in this state, its battery full; Euler angles: roll, pitch, yaw."""
        north, east, down = pos_ned_m
        radius_n, radius_e = self._frame[F_RADII : F_RADII + 2].tolist()
        where = (
            LATITUDE_RAD + north / radius_n,
            LONGITUDE_RAD + east / (radius_e * math.cos(LATITUDE_RAD)),
            -down / FOOT_M,
        )
        state = dict(zip(_PLACE, where, strict=True)) | dict(zip(_START_EULER, euler_rad, strict=True))
        state |= {name: value / FOOT_M for name, value in zip(_START_VELOCITY, vel_ned_mps, strict=True)}
        state |= dict(zip(_START_RATES, rate_frd_radps, strict=True))
        self._load(self.vehicle, state, dict(zip(self._aircraft.speeds, motor_u, strict=True)), motor_u)
        self._rest()

    def _load(
        self, vehicle: Vehicle, state: dict[str, float], carried: Mapping[str, float], commands: Sequence[float]
    ) -> None:
        """A fresh aircraft in this state (JSBSim's `ic` properties), its motors, gusts and battery as carried over."""
        seed = int(self._seeds.spawn(1)[0].generate_state(1)[0])
        aircraft = self._aircraft_of(vehicle, seed)
        ground_m = ALTITUDE_M - aircraft.rest_height_m
        initial = {"ic/terrain-elevation-ft": ground_m / FOOT_M, **state}
        initial[_PLACE[2]] += aircraft.rest_height_m / FOOT_M
        fdm = Fdm(aircraft, initial, dt_s=1e-6 * self.dt_us, planet=self._earth.planet)
        fdm.settle(aircraft, {name: value for name, value in carried.items() if name in aircraft.states}, commands)
        self.vehicle, self._aircraft, self._fdm = vehicle, aircraft, fdm
        self._take_over_names()
        row = parameter_row(vehicle, dt_us=self.dt_us)
        self.accel_bias_frd_mps2[:] = accelerometer_bias.bias(row)
        self.gyro_bias_frd_radps[:] = gyro_bias.bias(row)
        self.misalignment_q[:] = attitude_misalignment.rotation(row)
        self._show()

    def _aircraft_of(self, vehicle: Vehicle, seed: int) -> Aircraft:
        if vehicle.name == f450.NAME:
            shipped = Path(library().get_default_root_dir())
            return f450.write(
                vehicle, shipped, dt_s=1e-6 * self.dt_us, gravity_mps2=self._earth.gravity_mps2, seed=seed
            )
        return write(vehicle, dt_us=self.dt_us, gravity_mps2=self._earth.gravity_mps2, seed=seed, ground=self._ground)

    def _take_over_names(self) -> None:
        """Every property that a step or a snapshot touches, found once."""
        fdm, aircraft = self._fdm, self._aircraft
        self._run = fdm.first_run(self._use)
        self._get_state = tuple(map(fdm.get, (*_ECEF, *_VELOCITY, *_EULER, *_RATES, *_FORCES)))
        self._wires: tuple[Any, ...] = (*map(fdm.set, aircraft.commands), *self._get_state)
        voltage = fdm.get(aircraft.voltage) if aircraft.voltage is not None else float
        self._get_shown = (*map(fdm.get, (*aircraft.speeds, *aircraft.thrusts, *_WIND)), voltage)
        self._units = aircraft.speed_unit, aircraft.thrust_unit_n
        self._get_ground = tuple(fdm.get(name) for name in _GROUND)
        if not self._frame.size:
            origin = np.array([fdm.get(name)() for name in _ECEF])
            self._frame = self._earth.frame(origin, 1e-6 * self.dt_us)
        self._ground_works = True
        self._ground_below_m = _GROUND_MARGIN_M + float(np.max(np.linalg.norm(self.vehicle.rotors.position_m, axis=1)))
        self._frame[F_PER_POUND] = POUND_N / (SLUG_KG * fdm.get("inertia/mass-slugs")())

    def _use(self, run: Callable[[], bool]) -> None:
        self._run = run

    def _show(self) -> None:
        """Read JSBSim's present numbers into the row."""
        READ.call(self._row, self._frame, tuple(get() for get in self._get_state))

    def _toggle_ground(self) -> None:
        """JSBSim looks for contacts only where there can be some: a sixth of a step's time."""
        self._ground_works = not self._ground_works
        self._fdm.write({"simulation/models/FGGroundReactions/enabled": float(self._ground_works)})

    def _rest(self) -> None:
        """Means over a step that has not been: as if all had been as it is."""
        self._show()
        self._row[R_FORCE : R_FORCE + 3] = self._row[R_LAST_FORCE : R_LAST_FORCE + 3]
        self._row[R_ANGULAR : R_ANGULAR + 3] = 0.0


def _within(value: float) -> float:
    """A command that lies outside 0..1 or is no number."""
    return 1.0 if value > 1.0 else 0.0
