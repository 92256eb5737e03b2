"""Inject a fault and see what the autopilot does: `pytest examples/test_fault.py`."""

import math

ARM, TAKEOFF = 400, 22


def test_an_empty_battery_ends_in_a_landing(px4_sim):
    client = px4_sim.connect()
    px4_sim.step(5.0)
    for number, first in ((TAKEOFF, math.nan), (ARM, 1.0)):
        client.mav.command_long_send(1, 1, number, 0, first, *(math.nan,) * 6)
    assert px4_sim.step_until(lambda: px4_sim.mode.title == "Hold", timeout_s=15.0)

    px4_sim.fault("low-battery:0.04")  # 4 % left: an emergency
    began_s = px4_sim.now_s
    assert px4_sim.step_until(lambda: px4_sim.mode.title == "Land", timeout_s=10.0)
    assert 4.9 < px4_sim.now_s - began_s < 5.3  # Hold for COM_FAIL_ACT_T first
    assert px4_sim.step_until(lambda: not px4_sim.armed, timeout_s=20.0)


def test_wind_is_leaned_against(px4_sim):
    client = px4_sim.connect()
    px4_sim.set_effect("linear_drag", d_x_kgps=0.4, d_y_kgps=0.4, d_z_kgps=0.4)
    px4_sim.step(5.0)
    for number, first in ((TAKEOFF, math.nan), (ARM, 1.0)):
        client.mav.command_long_send(1, 1, number, 0, first, *(math.nan,) * 6)
    assert px4_sim.step_until(lambda: px4_sim.mode.title == "Hold", timeout_s=15.0)

    px4_sim.wind(north_mps=5.0, east_mps=0.0)  # from the south
    px4_sim.step(10.0)
    north_m, _, _ = px4_sim.truth.pos_ned_m
    assert abs(north_m) < 1.0
