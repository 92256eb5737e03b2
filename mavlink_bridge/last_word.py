"""What the companion leaves behind with every tick, for the dead-man; and the state from which a flight goes on."""

from __future__ import annotations

import numpy as np

from flightstack.types import FlatOutput, Measurement
from mavlink_bridge.dead_man_frames import ACTIVE, IN_OFFBOARD, CompanionRecord
from mavlink_bridge.decide import Situation
from mavlink_bridge.handshake import State
from mavlink_bridge.link import Link
from mavlink_bridge.voice import Voice, yaw_of

_STREAMING = frozenset({State.STREAMING, State.OFFBOARD, State.RETAKING, State.LANDING, State.HOLDING})
_LEVEL = (1.0, 0.0, 0.0, 0.0)


def companion_record(
    now: Situation, voice: Voice, link: Link, measurement: Measurement | None, thrust_norm: float, sent: tuple[int, int]
) -> CompanionRecord:
    """The record of a tick; `thrust_norm` carries the vehicle, `sent`: local and vehicle time of the last setpoint.

    Silence is to be answered while setpoints are streamed to a vehicle that is in OFFBOARD or about to be.
    """
    view = now.view
    flying = now.state in _STREAMING and not now.config.dry_run
    about_to = now.state is State.RETAKING or (now.state is State.STREAMING and now.config.arm)
    active = flying and (view.in_offboard or about_to)
    flags = ACTIVE * active | IN_OFFBOARD * (active and view.in_offboard)
    return record_of(voice, link, measurement, 0.0 if view.on_ground else thrust_norm, flags, sent)


def record_of(
    voice: Voice, link: Link, measurement: Measurement | None, thrust_norm: float, flags: int, sent: tuple[int, int]
) -> CompanionRecord:
    """The record of whoever speaks by `voice` over `link`."""
    w, x, y, z = _LEVEL if measurement is None else measurement.q_ned_frd.tolist()
    factor = voice.thrust_model_factor
    sequence = link.next_sequence(link.component)
    return CompanionRecord(
        0, sent[0] * 1000, sent[1], 0, 0, w, x, y, z, thrust_norm, factor, flags,
        voice.system, link.system, link.component, sequence, 0, 0,
    )  # fmt: skip


def state_now(measurement: Measurement) -> FlatOutput:
    """The flat outputs of a vehicle as far as they are known: no acceleration, no jerk.

    An accelerometer's noise is many times larger, and the tilt is drag's as much as acceleration's: at 3 m/s a vehicle
    taken for accelerating was tilted by 47 degrees.
    """
    zero = np.zeros(3)
    return FlatOutput.of(
        measurement.pos_ned_m, measurement.vel_ned_mps, zero, zero, zero, yaw_of(measurement.q_ned_frd)
    )


def hover_at(measurement: Measurement) -> FlatOutput:
    """Standing still where the vehicle is, at its heading."""
    zero = np.zeros(3)
    return FlatOutput.of(measurement.pos_ned_m, zero, zero, zero, zero, yaw_of(measurement.q_ned_frd))
