"""What a dry run says of the streams that it counted."""

from __future__ import annotations

import pytest
from companions import MODEL, flying

from flightstack.stack import Stack
from mavlink_bridge import messages as m
from mavlink_bridge.checklist import ChecklistEntry, Inspection, checklist
from mavlink_bridge.companion import CompanionConfig
from mavlink_bridge.requests import STREAMS

ASKED_HZ = {message: 1e6 / interval_us for message, interval_us in STREAMS if interval_us > 0}


def _said_of(name: str, rates_hz: dict[type, float]) -> ChecklistEntry:
    view = flying().companion.view
    found = Inspection(rates_hz, (), "", "")
    entries = {entry.check: entry for entry in checklist(view, found, CompanionConfig(), Stack(MODEL).limits)}
    return entries[name]


@pytest.mark.parametrize(("hz", "good"), [(5.0, True), (2.5, True), (2.0, False), (0.0, True)])
def test_a_vehicle_without_a_receiver_lacks_no_stream_one_whose_fixes_come_seldom_does(hz: float, good: bool) -> None:
    """MAVLink's GPS_RAW_INT comes from a receiver; with motion capture there need be none."""
    entry = _said_of("GPS_RAW_INT", ASKED_HZ | {m.GpsRawInt: hz})
    assert entry.ok is good
    assert ("no receiver" in entry.said) is (hz == 0.0)


def test_any_other_stream_that_does_not_come_is_wrong() -> None:
    for message in ASKED_HZ:
        if message is not m.GpsRawInt:
            assert not _said_of(m.BY_EVENT[message].name, ASKED_HZ | {message: 0.0}).ok
