"""Whatever bytes a log holds, reading and checking it gives samples, a refusal or one InputError; nothing else."""

from __future__ import annotations

import struct
import sys
import zlib
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from flightstack.cli import files
from flightstack.gap.check import check
from flightstack.gap.read import flight
from flightstack.types import InputError
from flightstack.vehicle import Vehicle
from tests.flown import flown, write_csv
from tests.ulog_bytes import px4_flight


@cache
def vehicle() -> Vehicle:
    return files.load_vehicle("quad-x")[0]


@cache
def sound(kind: str, folder: Path) -> bytes:
    """A short flight as a file of this kind."""
    log = flown(vehicle(), seconds=6.0, hz=50.0, seed=2)
    if kind == "csv":
        return write_csv(folder / "a.csv", log).read_bytes()
    t_s = log.signals["motor"].t_s
    values = {name: each.value for name, each in log.signals.items()}
    if kind == "ulog":
        names = {"q": "q_ned_frd", "gyro": "rate_frd_radps", "accel": "accel_frd_mps2", "pos": "pos_ned_m",
                 "vel": "vel_ned_mps", "control": "motor"}  # fmt: skip
        return px4_flight({key: values[name] for key, name in names.items()}, 1e6 + 1e6 * t_s, {"THR_MDL_FAC": 0.3})
    head = struct.pack("<BHH", 0xBC, 2, 1) + struct.pack("<H", 0xFFFF) + b"fixedFrequency\0" + struct.pack("<H", 10)
    for name in ("acc.x", "acc.y", "acc.z", "gyro.x", "gyro.y", "gyro.z"):
        head += f"{name}(f)\0".encode()
    head += b"".join(f"motor.m{k}(H)\0".encode() for k in (1, 2, 3, 4))
    body = b""
    for k, t in enumerate(t_s.tolist()):
        accel, gyro = values["accel_frd_mps2"][k] / 9.80665, np.degrees(values["rate_frd_radps"][k])
        motor = (65535 * values["motor"][k, [0, 3, 1, 2]]).astype(int).tolist()
        body += struct.pack(
            "<HQ6f4H", 0xFFFF, int(t * 1e6), accel[0], -accel[1], -accel[2], gyro[0], -gyro[1], -gyro[2], *motor
        )
    return head + body + struct.pack("<I", zlib.crc32(head + body))


KINDS = ("csv", "ulog", "cfusdlog")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("logs")


def outcome(path: Path) -> str:
    """ok, refused or the error's text."""
    refused = ""
    try:
        checked = check(flight(path, vehicle()), vehicle())
    except InputError as error:
        refused = str(error)
    if refused:
        assert "\n" not in refused
        assert refused.startswith("log ")
        return refused
    if checked.samples is None:
        assert any(each.level == "refused" for each in checked.findings)
        return "refused"
    for column in ("t_s", "pos_ned_m", "accel_frd_mps2", "motor"):
        assert len(getattr(checked.samples, column)) == len(checked.samples.valid)
    return "ok"


@pytest.mark.parametrize("kind", KINDS)
def test_the_sound_file_is_usable(kind: str, folder: Path) -> None:
    path = folder / f"sound-{kind}"
    path.write_bytes(sound(kind, folder))
    assert outcome(path) == "ok"


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=30, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_mutated_files_never_raise_anything_else(kind: str, folder: Path, data: st.DataObject) -> None:
    """Bytes flipped, cut out, doubled, put in anywhere; most of them near the beginning, where the format is."""
    whole = sound(kind, folder)
    broken = bytearray(whole)
    for _ in range(data.draw(st.integers(1, 6))):
        most = data.draw(st.sampled_from([60, 400, len(broken)]))
        at = data.draw(st.integers(0, max(0, min(most, len(broken)) - 1)))
        how = data.draw(st.sampled_from(["flip", "cut", "double", "insert", "zero", "end"]))
        size = data.draw(st.integers(1, 300))
        if how == "flip" and broken:
            broken[at] ^= 1 << data.draw(st.integers(0, 7))
        elif how == "cut":
            del broken[at : at + size]
        elif how == "double":
            broken[at:at] = broken[at : at + size]
        elif how == "insert":
            broken[at:at] = data.draw(st.binary(max_size=20))
        elif how == "zero":
            broken[at : at + size] = bytes(len(broken[at : at + size]))
        else:
            del broken[at + 1 :]
    path = folder / f"broken-{kind}"
    path.write_bytes(bytes(broken))
    outcome(path)


@pytest.mark.parametrize("kind", KINDS)
def test_every_beginning_of_a_file_is_read_or_refused(kind: str, folder: Path) -> None:
    whole = sound(kind, folder)
    path = folder / f"cut-{kind}"
    for size in [*range(40), *range(40, 1200, 61), len(whole) // 2, len(whole) - 1]:
        path.write_bytes(whole[:size])
        assert outcome(path)


@settings(max_examples=60, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    content=st.binary(max_size=400),
    start=st.sampled_from(
        [b"", b"ULog\x01\x12\x35\x01", b"\xbc\x02\x00\x01\x00", b"\x1f\x8b\x08", b"time_s,vel_n_mps\n"]
    ),
)
def test_noise_is_no_log(folder: Path, content: bytes, start: bytes) -> None:
    path = folder / "noise"
    path.write_bytes(start + content)
    assert outcome(path) != "ok"


@pytest.mark.parametrize("share", [0.02, 0.3, 0.9, 1.0])
def test_cells_that_are_not_there_cost_rows_not_the_run(share: float, folder: Path) -> None:
    """NaN, inf, empty, words and huge numbers in a CSV: what is left decides."""
    rng = np.random.default_rng(0)
    lines = sound("csv", folder).decode().splitlines()
    words = ["nan", "inf", "-inf", "", "null", "1e308", "-1e300", "true"]
    rows = [line.split(",") for line in lines[1:]]
    for row in rows:
        for column in range(1, len(row)):
            if rng.random() < share:
                row[column] = words[rng.integers(len(words))]
    path = folder / "nan.csv"
    path.write_text("\n".join([lines[0], *(",".join(row) for row in rows)]))
    result = outcome(path)
    assert result if share < 0.5 else result != "ok"


def test_numbers_beyond_measure_are_refused_quietly(folder: Path) -> None:
    lines = sound("csv", folder).decode().splitlines()
    for value in ("1e300", "-1e200", "1e18"):
        rows = [",".join([line.split(",")[0], *([value] * 21)]) for line in lines[1:]]
        path = folder / "huge.csv"
        path.write_text("\n".join([lines[0], *rows]))
        assert outcome(path) != "ok"
    assert sys.float_info.max > 1e300
