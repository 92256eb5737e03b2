"""Fly a script against the fixture: `pytest examples/test_script.py`.

One thread, pymavlink, no sleeping: waiting for a message moves the vehicle's time, and so does `step`.
"""

import math

ARM, TAKEOFF, LAND = 400, 22, 21


def command(client, number, *params):
    """Send a command; its result."""
    client.mav.command_long_send(1, 1, number, 0, *params, *(math.nan,) * (7 - len(params)))
    ack = client.recv_match(type="COMMAND_ACK", blocking=True, timeout=1.0)
    assert ack is not None
    assert ack.command == number
    return ack.result


def test_it_takes_off_and_lands(px4_sim):
    client = px4_sim.connect()
    px4_sim.step(5.0)  # PX4 can be armed some 4 s after it was started
    px4_sim.param("MIS_TAKEOFF_ALT", 3.0)
    while client.recv_match() is not None:
        pass  # what was said meanwhile
    assert command(client, TAKEOFF) == 0
    assert command(client, ARM, 1.0) == 0
    assert px4_sim.step_until(lambda: px4_sim.mode.title == "Hold", timeout_s=15.0)
    assert abs(px4_sim.truth.pos_ned_m[2] + 3.0) < 0.5
    assert command(client, LAND) == 0
    assert px4_sim.step_until(lambda: not px4_sim.armed, timeout_s=20.0)
