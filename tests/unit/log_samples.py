"""Records for the log tests: seeded values for any topic of the table, and a few objects as a flight has them."""

from __future__ import annotations

import random
from dataclasses import dataclass
from typing import Any

import numpy as np
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from measured import measured

from flightstack.types import Command, FlatOutput, Learned, Proposal, TickRecord
from flightstack_logs.topics import Field, Kind, Topic


def _value(field: Field, rng: random.Random) -> Any:
    if field.type == "string":
        return rng.choice(["", "hold", "tilt limit", "grün", "x" * 200])
    if field.type == "bool":
        return rng.random() < 0.5
    if field.type == "int64":
        return rng.choice([0, -1, rng.randrange(-(2**63), 2**63)])
    if field.type == "int32":
        return rng.choice([0, -1, rng.randrange(-(2**31), 2**31)])
    value = rng.choice([0.0, rng.gauss(0.0, 1.0), rng.gauss(0.0, 1e6), -1e-30])
    return float(np.float32(value)) if field.type == "float" else value


def sample_record(topic: Topic, rng: random.Random) -> Any:
    """A record of the topic: plain tuple, and bytes where the topic carries bytes."""
    if topic.kind in (Kind.RAW, Kind.VIEW):
        return rng.randbytes(rng.randrange(1, 60))
    if topic.kind is Kind.LOG:
        return rng.choice(["debug", "info", "warning", "error", "fatal"]), rng.choice(["arm", "ok"]), "grün, 100 %"
    return tuple(
        tuple(_value(field, rng) for _ in range(field.size)) if field.size else _value(field, rng)
        for field in topic.fields
    )


def proto_class(descriptor_set: bytes, name: str) -> Any:
    """The message class that Google's own protobuf library makes of a schema found in a log."""
    files = descriptor_pb2.FileDescriptorSet.FromString(descriptor_set)
    pool = descriptor_pool.DescriptorPool()
    pending = list(files.file)
    while pending:
        ready = next(f for f in pending if not any(d in {p.name for p in pending} for d in f.dependency))
        pool.Add(ready)
        pending.remove(ready)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(name))


def tick_record(t_us: int, pos_ned_m: tuple[float, float, float] = (0.0, 0.0, 0.0), guard: str = "") -> TickRecord:
    """A tick whose every number is different (seeded by its time)."""
    rng = np.random.default_rng(t_us)
    three = [rng.normal(size=3) for _ in range(16)]
    reference = FlatOutput.of(three[0], three[1], three[2], three[3], three[4], 0.1, 0.2)
    measurement = measured(
        t_us, np.array(pos_ned_m), three[5], np.array([1.0, 0.0, 0.0, 0.0]), three[6], three[7], rng.uniform(size=4),
        4000, 8000, 0,
    )  # fmt: skip
    command = Command(t_us, 11.0, 0.44, three[8])
    return TickRecord(
        t_us=t_us,
        reference=reference,
        measurement=measurement,
        proposal=Proposal(11.0, np.concatenate([(11.5, -0.5), *three[11:14], *three[9:11], three[14]])),
        learned=Learned(rng.uniform(size=33)),
        command=command,
        thrust_saturated=True,
        guard=guard,
    )


@dataclass(frozen=True, slots=True)
class Truth:
    """What the simulator gives."""

    t_us: int
    pos_ned_m: tuple[float, float, float]
    q_ned_frd: tuple[float, float, float, float]
    vel_ned_mps: tuple[float, float, float] = (0.1, 0.2, 0.3)
    rate_frd_radps: tuple[float, float, float] = (0.4, 0.5, 0.6)
    specific_force_frd_mps2: tuple[float, float, float] = (0.7, 0.8, -9.8)
    angular_acceleration_frd_radps2: tuple[float, float, float] = (1.0, 2.0, 3.0)
    motor_u: tuple[float, float, float, float] = (0.4, 0.5, 0.6, 0.7)
    rotor_thrust_n: tuple[float, float, float, float] = (3.0, 3.1, 3.2, 3.3)
    wind_ned_mps: tuple[float, float, float] = (1.0, 0.0, 0.0)
    battery_v: float = 16.1
    on_ground: bool = False
