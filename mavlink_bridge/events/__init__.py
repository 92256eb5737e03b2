"""The events: one NamedTuple per MAVLink message, in SI units, and the parameter union's two helpers."""

from mavlink_bridge.events.information import *  # noqa: F403
from mavlink_bridge.events.on_request import *  # noqa: F403
from mavlink_bridge.events.protocol import *  # noqa: F403
from mavlink_bridge.events.telemetry import *  # noqa: F403
