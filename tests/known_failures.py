# ruff: noqa: E501
"""Tests that fail today, each with what is open; they run, and the list must shrink (docs/limits.md, "Open")."""

OPEN = {
    "loopback/test_safety.py::test_both_dead_only_a_short_loss_time_keeps_the_vehicle_upright[1.0-None]": "open: the simulator does not tilt as far as a real PX4 there",
}
