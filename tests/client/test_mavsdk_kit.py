"""MAVSDK against the fixture: mission, geofence, failure injection and manual control, time under the test's hand."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncGenerator, Callable
from typing import Any

import pytest

from flightstack.testkit import Px4Sim

pytest.importorskip("mavsdk")
pytestmark = pytest.mark.client
STEP_S = 0.02
HOME_LAT, HOME_LON = 47.397742, 8.545594
NAN = math.nan


async def until(stream: AsyncGenerator[Any, None], wanted: Callable[[Any], bool]) -> Any:
    async for value in stream:
        if wanted(value):
            await stream.aclose()
            return value
    raise AssertionError("the stream ended")


def fly(px4: Px4Sim, script: Callable[[Any], Any]) -> None:
    """Connect, wait for health, run the script with MAVSDK's system."""
    from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
    from mavsdk.asyncio.plugins.telemetry import TelemetryAsync

    async def run() -> None:
        async with Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION)) as mavsdk:
            await mavsdk.add_any_connection(px4.mavsdk_address)
            system = await px4.call(mavsdk.first_autopilot(20.0), STEP_S)
            assert system is not None
            telemetry = TelemetryAsync(system)
            await asyncio.wait_for(px4.call(until(telemetry.subscribe_health_all_ok(), bool), STEP_S), 20.0)
            await script(system)

    asyncio.run(asyncio.wait_for(run(), 60.0))


def test_a_mission_of_mavsdk_is_flown(px4_sim: Px4Sim) -> None:
    from mavsdk.asyncio.plugins.action import ActionAsync
    from mavsdk.asyncio.plugins.mission import MissionAsync
    from mavsdk.plugins.mission import MissionItem, MissionPlan

    def item(north_e5: int) -> Any:
        return MissionItem(
            HOME_LAT + north_e5 * 1e-5, HOME_LON, 5.0, 5.0, True, NAN, NAN, MissionItem.CameraAction.NONE, NAN, NAN,
            1.0, NAN, NAN, MissionItem.VehicleAction.NONE,
        )  # fmt: skip

    async def script(system: Any) -> None:
        mission = MissionAsync(system)
        await px4_sim.call(mission.set_return_to_launch_after_mission(True))
        await px4_sim.call(mission.upload_mission(MissionPlan([item(5), item(10)])))
        assert len((await px4_sim.call(mission.download_mission())).mission_items) == 2
        await px4_sim.call(ActionAsync(system).arm())
        await px4_sim.call(mission.start_mission())
        assert px4_sim.step_until(lambda: float(px4_sim.truth.pos_ned_m[0]) > 8.0, 40.0)
        assert px4_sim.step_until(lambda: not px4_sim.armed, 120.0)

    fly(px4_sim, script)
    assert abs(px4_sim.truth.pos_ned_m[0]) < 1.5


def test_a_fence_sticks_and_an_injected_failure_of_mavsdk(px4_sim: Px4Sim) -> None:
    from mavsdk.asyncio.plugins.action import ActionAsync
    from mavsdk.asyncio.plugins.failure import FailureAsync
    from mavsdk.asyncio.plugins.geofence import GeofenceAsync
    from mavsdk.asyncio.plugins.manual_control import ManualControlAsync
    from mavsdk.plugins.failure import FailureType, FailureUnit
    from mavsdk.plugins.geofence import FenceType, GeofenceData, Point, Polygon

    async def script(system: Any) -> None:
        corners = [Point(HOME_LAT + a * 1e-3, HOME_LON + b * 1e-3) for a, b in ((-1, -1), (-1, 1), (1, 1), (1, -1))]
        fence = GeofenceData([Polygon(corners, FenceType.INCLUSION)], [])
        await px4_sim.call(GeofenceAsync(system).upload_geofence(fence))
        px4_sim.step(0.2)
        assert len(px4_sim.server.fence.shapes) == 1
        manual, action = ManualControlAsync(system), ActionAsync(system)
        for _ in range(10):
            await px4_sim.call(manual.set_manual_control_input(0.0, 0.0, 0.5, 0.0), STEP_S)
        assert px4_sim.server.commander.state.checks.conditions.sticks
        px4_sim.step(1.0)  # let go before it is armed: nobody counts on them
        await px4_sim.call(action.arm())
        await px4_sim.call(action.takeoff())
        assert px4_sim.step_until(lambda: px4_sim.mode.title == "Hold", 20.0)
        assert px4_sim.truth.pos_ned_m[2] < -2.0
        px4_sim.param("SYS_FAILURE_EN", 1)  # MAVSDK asks it
        await px4_sim.call(FailureAsync(system).inject(FailureUnit.SYSTEM_MOTOR, FailureType.OFF, 1))
        assert px4_sim.step_until(lambda: px4_sim.server.detector.failed, 3.0)

    fly(px4_sim, script)
