"""`flightstack learn`: fit the learner's hyper-parameters to recorded flights, between flights."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from flightstack.cli import files
from flightstack.learning.stored import StoredPriors, fit_priors, to_json
from flightstack.learning.windows import SampleWindows, windows
from flightstack.model import Model
from flightstack.types import Command, InputError, Measurement
from flightstack.vehicle import Vehicle, parse_vehicle
from flightstack_logs.reader import Log, read

_PARTS = ("pos_ned_m", "vel_ned_mps", "q_ned_frd", "rate_frd_radps", "specific_force_frd_mps2", "motor_command")


def recorded_ticks(log: Log) -> Iterator[tuple[Measurement, Command]]:
    """Each tick of a flight's log: the measurement, and the command sent in the tick before."""
    for name in ("/tick", "/command"):
        if name not in log.tables:
            raise InputError(f"{log.path}: has no {name}; a log of `flightstack fly` or `offboard` is needed")
    tick, sent = log.tables["/tick"], log.tables["/command"]
    rows = np.concatenate([tick[part] for part in _PARTS], axis=1)
    count = min(len(tick), len(sent))
    for i in range(1, count):
        before = i - 1
        command = Command(
            int(sent.t_us[before]),
            float(sent["thrust_n"][before]),
            float(sent["thrust_norm"][before]),
            sent["rate_frd_radps"][before],
        )
        position, attitude, imu = (int(tick[name][i]) for name in ("position_age_us", "attitude_age_us", "imu_age_us"))
        yield Measurement(int(tick.t_us[i]), rows[i], position, attitude, imu), command


def learn(logs: list[Path], vehicle: str | None, out: Path) -> StoredPriors:
    """Fit to these flights together and write the file; `vehicle` None: the one that the first log carries."""
    flights = [read(path) for path in logs]
    believed = files.load_vehicle(vehicle)[0] if vehicle is not None else _vehicle_of(flights[0])
    model = Model.from_vehicle(believed)
    parts = [windows(model, recorded_ticks(flight)) for flight in flights]
    stored = fit_priors(believed, SampleWindows(*(np.concatenate(same) for same in zip(*parts, strict=True))))
    files.write_text(out, to_json(stored))
    return stored


def _vehicle_of(log: Log) -> Vehicle:
    """The believed vehicle that a log carries."""
    for attachment in log.attachments:
        if attachment.name == "vehicle.toml":
            return parse_vehicle(attachment.data.decode(), f"{log.path}: vehicle.toml")
    raise InputError(f"{log.path}: carries no vehicle.toml; say which with --vehicle")
