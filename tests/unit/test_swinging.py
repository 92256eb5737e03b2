"""What counts as swinging: a vehicle that turns otherwise than it was sent, whatever the controller would have asked.

The vehicles are a rate loop of first order and one that turns slower than it is told, in closed form.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from log_samples import tick_record

from mavlink_bridge.notes import Swinging

STEP_US = 4_000
RATE_LAG_S = 0.05
"""Of quad-x on a real PX4, some 30 ms; slower ones 50."""


def _flown(asked_rad: float, sent_radps: float, most_radps: float, seconds: float = 20.0) -> str:
    """The reason to end, if any: rolls sent at 0.5 Hz, followed with the lag up to the vehicle's fastest turn."""
    swinging, base = Swinging(), tick_record(0)
    measured, said = 0.0, ""
    for n in range(1, round(1e6 * seconds / STEP_US)):
        sent = sent_radps * math.sin(math.pi * 1e-6 * n * STEP_US)
        row = base.measurement.row.copy()
        row[10:13] = (measured, 0.0, 0.0)
        proposal = replace(base.proposal, thrust_n=9.0, row=base.proposal.row.copy())
        proposal.attitude_error_rad[:] = (asked_rad, 0.0, 0.0)
        record = base._replace(
            t_us=n * STEP_US,
            measurement=replace(base.measurement, t_us=n * STEP_US, row=row),
            proposal=proposal,
            command=base.command._replace(t_us=n * STEP_US, rate_frd_radps=np.array((sent, 0.0, 0.0))),
        )
        said = said or swinging.take(record)
        told = min(max(sent, -most_radps), most_radps)
        measured += (told - measured) * 1e-6 * STEP_US / RATE_LAG_S
    return said


def test_a_vehicle_that_follows_what_a_filter_sent_instead_does_not_swing() -> None:
    """On a real PX4 a site's filter sent 0.7 rad/s where the controller asked for 4.2; both were called swinging."""
    assert _flown(asked_rad=1.0, sent_radps=0.7, most_radps=10.0) == ""


@pytest.mark.parametrize("asked_rad", [0.0, 1.0])
def test_one_that_turns_at_a_fraction_of_what_is_sent_does(asked_rad: float) -> None:
    """Limited to 40 deg/s: at 0.5 Hz up to (3 - 0.7) / pi = 0.7 rad behind, rms 0.5; 0.4 counts."""
    said = _flown(asked_rad, sent_radps=3.0, most_radps=0.7)
    assert said.startswith("swinging: ")
    assert "MC_*RATE_MAX" in said, "gains are not the only cause: such limits were set in flight"


def test_one_that_turns_fast_but_as_sent_does_not() -> None:
    """4 rad/s to and fro: 0.05 s behind them are 0.2 rad."""
    assert _flown(asked_rad=0.0, sent_radps=4.0, most_radps=10.0) == ""
