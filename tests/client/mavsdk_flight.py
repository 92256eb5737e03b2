"""A whole flight by MAVSDK-Python, as a user of MAVSDK writes it: `python mavsdk_flight.py udpin://127.0.0.1:14540`.

Prints a line of JSON for every step done: {"step": ..., "saw": ...}.  Waits on telemetry alone; what doesn't come
within PATIENCE_S ends the flight with a traceback that names the step.
"""

from __future__ import annotations

import asyncio
import json
import math
import sys
from collections.abc import AsyncGenerator, Callable
from typing import Any, TypeVar

from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync, ActionError, OrbitYawBehavior
from mavsdk.asyncio.plugins.info import InfoAsync
from mavsdk.asyncio.plugins.offboard import (
    AttitudeRate,
    OffboardAsync,
    PositionNedYaw,
    VelocityNedYaw,
)
from mavsdk.asyncio.plugins.param import ParamAsync, ParamError
from mavsdk.asyncio.plugins.telemetry import FlightMode, LandedState, TelemetryAsync

PATIENCE_S = 20.0
METRE_DEG = 1.0 / 111_194.9
"""A metre north, on a sphere of 6371 km."""
RATE_WINDOW_US = 8_000_000
RATES_HZ = {
    "attitude_quaternion": 50.0,
    "attitude_euler": 25.0,
    "position_velocity_ned": 25.0,
    "position": 20.0,
    "imu": 50.0,
    "scaled_imu": 20.0,
    "odometry": 10.0,
    "ground_truth": 10.0,
    "actuator_output_status": 10.0,
    "fixedwing_metrics": 8.0,
    "altitude": 5.0,
    "distance_sensor": 5.0,
    "raw_gps": 4.0,
    "landed_state": 4.0,
    "battery": 4.0,
    "home": 2.0,
    "unix_epoch_time": 2.0,
}
"""Every telemetry stream with a message of its own, and the rate to ask for."""
T = TypeVar("T")


def done(step: str, saw: Any = None) -> None:
    """One step has been done."""
    print(json.dumps({"step": step, "saw": saw}), flush=True)


async def see(samples: AsyncGenerator[T, None], wanted: Callable[[T], bool] = lambda value: True) -> T:
    """Wait for telemetry that is as wanted."""
    async with asyncio.timeout(PATIENCE_S):
        async for value in samples:
            if wanted(value):
                return value
    raise EOFError("the telemetry ended")


class Flight:
    """One vehicle and the steps of its flight, in their order."""

    def __init__(self, system: Any) -> None:
        self.telemetry = TelemetryAsync(system)
        self.action = ActionAsync(system)
        self.offboard = OffboardAsync(system)
        self.param = ParamAsync(system)
        self.info = InfoAsync(system)

    async def mode(self, wanted: FlightMode) -> None:
        """Wait for a flight mode."""
        await see(self.telemetry.subscribe_flight_mode(), lambda mode: mode == wanted)

    async def healthy(self) -> None:
        """Every check of MAVSDK passes."""
        await see(self.telemetry.subscribe_health_all_ok(), bool)
        done("health", await see(self.telemetry.subscribe_health_all_ok()))

    async def known(self) -> None:
        """Version and identification."""
        version, who = await self.info.get_version(), await self.info.get_identification()
        numbers = [version.flight_sw_major, version.flight_sw_minor, version.flight_sw_patch]
        done("version", {"flight": numbers, "uid": who.legacy_uid})

    async def parameters(self) -> None:
        """Read, written, listed and refused."""
        param = self.param
        await param.set_param_float("COM_OF_LOSS_T", 5.0)
        await param.set_param_int("COM_OBL_RC_ACT", 5)
        everything = await param.get_all_params()
        refused = []
        for ask in (param.get_param_float("NO_SUCH_PARAM"), param.set_param_int("MPC_XY_VEL_MAX", 3)):
            try:
                await ask
            except ParamError as error:
                refused.append(error.result.name)
        saw = {
            "MPC_XY_VEL_MAX": await param.get_param_float("MPC_XY_VEL_MAX"),
            "NAV_DLL_ACT": await param.get_param_int("NAV_DLL_ACT"),
            "COM_OF_LOSS_T": await param.get_param_float("COM_OF_LOSS_T"),
            "COM_OBL_RC_ACT": await param.get_param_int("COM_OBL_RC_ACT"),
            "listed": len(everything.int_params) + len(everything.float_params),
            "refused": refused,
        }
        done("parameters", saw)

    async def streams(self) -> None:
        """Ask for rates, then count all streams over a window of the autopilot's own clock."""
        for name, rate_hz in RATES_HZ.items():
            await getattr(self.telemetry, f"set_rate_{name}")(rate_hz)
        counts, heard = dict.fromkeys(RATES_HZ, 0), asyncio.Event()

        async def count(name: str) -> None:
            async for _ in getattr(self.telemetry, f"subscribe_{name}")():
                counts[name] += 1
                if all(counts.values()):
                    heard.set()

        counting = [asyncio.create_task(count(name)) for name in RATES_HZ]
        async with asyncio.timeout(PATIENCE_S):
            await heard.wait()  # a busy machine subscribes late
        first, before = await see(self.telemetry.subscribe_attitude_quaternion()), dict(counts)
        end_us = first.timestamp_us + RATE_WINDOW_US
        last = await see(self.telemetry.subscribe_attitude_quaternion(), lambda q: q.timestamp_us >= end_us)
        came = {name: number - before[name] for name, number in counts.items()}
        for task in counting:
            task.cancel()
        await asyncio.gather(*counting, return_exceptions=True)
        seconds = (last.timestamp_us - first.timestamp_us) * 1e-6
        done("streams", {"asked_hz": RATES_HZ, "came_hz": {name: number / seconds for name, number in came.items()}})

    async def takes_off(self) -> None:
        """Arms, climbs to the height asked for and holds it."""
        await self.action.set_takeoff_altitude(5.0)
        await self.action.arm()
        await see(self.telemetry.subscribe_armed(), bool)
        done("armed")
        await self.action.takeoff()
        await self.mode(FlightMode.TAKEOFF)
        await self.mode(FlightMode.HOLD)
        position = await see(self.telemetry.subscribe_position())
        await see(self.telemetry.subscribe_landed_state(), lambda state: state == LandedState.IN_AIR)
        done("takeoff", position.relative_altitude_m)
        try:
            await self.action.disarm()
        except ActionError as error:
            done("disarm in the air", error.result.name)

    async def flies_offboard(self) -> None:
        """Position, velocity and body rates, each told by what the vehicle does."""
        offboard, telemetry = self.offboard, self.telemetry
        await offboard.set_position_ned(PositionNedYaw(5.0, 3.0, -8.0, 90.0))
        await offboard.start()
        await self.mode(FlightMode.OFFBOARD)
        place = await see(telemetry.subscribe_position_velocity_ned(), _near(5.0, 3.0, -8.0))
        heading = await see(telemetry.subscribe_heading(), lambda h: abs(h.heading_deg - 90.0) < 5.0)
        p = place.position
        done("offboard position", [p.north_m, p.east_m, p.down_m, heading.heading_deg])
        await offboard.set_velocity_ned(VelocityNedYaw(-2.0, 1.0, 0.0, 90.0))
        v = await see(telemetry.subscribe_velocity_ned(), lambda v: v.north_m_s < -1.8 and v.east_m_s > 0.8)
        done("offboard velocity", [v.north_m_s, v.east_m_s, v.down_m_s])
        await offboard.set_position_ned(PositionNedYaw(6.0, 0.0, -8.0, 90.0))
        await see(telemetry.subscribe_position_velocity_ned(), _near(6.0, 0.0, -8.0))
        await offboard.set_attitude_rate(
            AttitudeRate(0.0, 0.0, 40.0, await self.param.get_param_float("MPC_THR_HOVER"))
        )
        rates = telemetry.subscribe_attitude_angular_velocity_body()
        turning = await see(rates, lambda w: abs(math.degrees(w.yaw_rad_s) - 40.0) < 6.0)
        done("offboard rate", math.degrees(turning.yaw_rad_s))
        await offboard.stop()
        await self.mode(FlightMode.HOLD)
        done("hold", await offboard.is_active())

    async def goes_places(self) -> None:
        """Flies to a place on the globe, circles it, and takes another home."""
        action, telemetry = self.action, self.telemetry
        start = await see(telemetry.subscribe_home())
        here = await see(telemetry.subscribe_position())
        lat, lon, alt = here.latitude_deg + 8.0 * METRE_DEG, here.longitude_deg, here.absolute_altitude_m + 2.0
        await action.set_current_speed(4.0)
        await action.goto_location(lat, lon, alt, 45.0)

        def there(p: Any) -> bool:
            north_m, up_m = (p.latitude_deg - lat) / METRE_DEG, p.absolute_altitude_m - alt
            return abs(north_m) < 0.5 and abs(up_m) < 0.5 and abs(p.longitude_deg - lon) < METRE_DEG

        p = await see(telemetry.subscribe_position(), there)
        heading = await see(telemetry.subscribe_heading(), lambda h: abs(h.heading_deg - 45.0) < 5.0)
        done("goto", [(p.latitude_deg - lat) / METRE_DEG, p.absolute_altitude_m - alt, heading.heading_deg])
        await action.do_orbit(4.0, 2.0, OrbitYawBehavior.HOLD_FRONT_TO_CIRCLE_CENTER, lat, lon, alt)
        v = await see(telemetry.subscribe_velocity_ned(), lambda v: math.hypot(v.north_m_s, v.east_m_s) > 1.6)
        done("orbit", math.hypot(v.north_m_s, v.east_m_s))
        await action.hold()
        await self.mode(FlightMode.HOLD)
        await action.set_home(False, here.latitude_deg, here.longitude_deg, here.absolute_altitude_m - 5.0)
        home = await see(telemetry.subscribe_home(), lambda h: abs(h.latitude_deg - here.latitude_deg) < 1e-6)
        done("set home", [home.absolute_altitude_m - here.absolute_altitude_m])
        await action.set_home(False, start.latitude_deg, start.longitude_deg, start.absolute_altitude_m)

    async def comes_home(self) -> None:
        """Holds, returns until it is above home, lands and disarms."""
        await self.action.hold()
        await self.mode(FlightMode.HOLD)
        await self.action.return_to_launch()
        await self.mode(FlightMode.RETURN_TO_LAUNCH)

        def above_home(sample: Any) -> bool:
            return math.hypot(sample.position.north_m, sample.position.east_m) < 1.0

        p = (await see(self.telemetry.subscribe_position_velocity_ned(), above_home)).position
        done("return", [p.north_m, p.east_m])
        await self.action.land()
        await self.mode(FlightMode.LAND)
        await see(self.telemetry.subscribe_landed_state(), lambda state: state == LandedState.ON_GROUND)
        position = await see(self.telemetry.subscribe_position())
        done("landed", position.relative_altitude_m)
        await self.action.disarm()
        await see(self.telemetry.subscribe_armed(), lambda armed: not armed)
        done("disarmed")


def _near(north_m: float, east_m: float, down_m: float) -> Callable[[Any], bool]:
    def near(sample: Any) -> bool:
        p, v = sample.position, sample.velocity
        speed = math.hypot(v.north_m_s, v.east_m_s, v.down_m_s)
        return math.dist((p.north_m, p.east_m, p.down_m), (north_m, east_m, down_m)) < 0.5 and speed < 0.5

    return near


async def main(url: str, *, places: bool = True) -> None:
    """Connect and fly; without `places` no COMMAND_INT is sent, whose frames not every PX4 takes."""
    async with Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION)) as mavsdk:
        await mavsdk.add_any_connection(url)
        system = await mavsdk.first_autopilot(PATIENCE_S)
        if system is None:
            raise TimeoutError("no autopilot")
        done("connected", {"sdk": await mavsdk.version(), "system": await system.get_system_id()})
        flight = Flight(system)
        await flight.healthy()
        await flight.known()
        await flight.parameters()
        await flight.streams()
        await flight.takes_off()
        await flight.flies_offboard()
        if places:
            await flight.goes_places()
        await flight.comes_home()


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1], places="--without-places" not in sys.argv))
