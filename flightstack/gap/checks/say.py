"""The three kinds of a finding."""

from __future__ import annotations

from flightstack.gap.records import Finding

_PX4, _ARDUPILOT = "PX4: SDLOG_MODE 0, SDLOG_PROFILE 25", "ArduPilot: LOG_BITMASK with fast attitude and fast IMU"
_ON_BOARD = f"on board, a telemetry log is too slow. {_PX4}; {_ARDUPILOT}"


def how_to_record(kind: str) -> str:
    """Which settings record what is needed, for the autopilots that write this kind of log."""
    return {"dataflash": _ARDUPILOT, "tlog": _ON_BOARD}.get(kind, _PX4)


def ok(name: str, text: str) -> Finding:
    """Nothing to do."""
    return Finding(name, "ok", text)


def warning(name: str, text: str) -> Finding:
    """Mended, or worth knowing."""
    return Finding(name, "warning", text)


def refused(name: str, text: str) -> Finding:
    """The log can't be used; `text` says why and what to do instead."""
    return Finding(name, "refused", text)
