"""One real PX4 as a process, and a ground station on its GCS link: ground truth, modes, texts, parameters.

The station speaks first from a port of its own, so PX4 sends everything of that link there.  Ground truth is
HIL_STATE_QUATERNION, which SIH and a HIL simulator both publish; its stamps are 0, so samples carry the local time of
receipt.  pymavlink is the codec here: another one than flightstack's.
"""

from __future__ import annotations

import math
import os
import signal
import struct
import subprocess
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, Self

from pymavlink import mavutil

from benchmarks.px4.records import Bench

GCS_PORT, OFFBOARD_PORT, HIL_PORT = 18570, 14540, 4560
BOOT_LIMIT_S = 60.0
TRUTH_HZ = 100
ANSWER_S = 5.0
_HIL_STATE = 115
_INT32, _REAL32 = 6, 9
_IDLE_US = 1000
"""Disarmed it is 900."""
_EARTH_M_PER_DEG = 111_194.9
"""A metre north, on a sphere of 6371 km; over the few metres of a flight the error is below 1 mm."""


class Truth(NamedTuple):
    """Ground truth at a local time: position from the first sample, north, east, up; velocity north, east, down."""

    at_s: float
    north_m: float
    east_m: float
    up_m: float
    vel_n_mps: float
    vel_e_mps: float
    vel_d_mps: float
    tilt_rad: float


class Px4:
    """A PX4 that runs while the `with` block does, ready to arm when it begins."""

    def __init__(
        self, bench: Bench, kind: str = "sih", *, offset: int = 0, params: Mapping[str, float] | None = None,
        env: Mapping[str, str] | None = None,
    ) -> None:  # fmt: skip
        self.instance = bench.instance + offset
        self.kind = kind
        self.truth: list[Truth] = []
        self.modes: list[tuple[float, int, bool]] = []
        """(local time, custom_mode, armed) of every HEARTBEAT that differs from the one before."""
        self.texts: list[tuple[float, str]] = []
        self.spins = False
        """The first motor turns, by SERVO_OUTPUT_RAW: told 50 times a second, where HEARTBEAT comes once."""
        self.silent = False
        """No heartbeat is sent: PX4 loses its ground station."""
        self.version = ""
        self.bench, self._params, self._env = bench, params or {}, env or {}
        self._values: dict[str, float] = {}
        self._types: dict[str, int] = {}
        self._origin: tuple[float, float, float] | None = None
        self._stop = threading.Event()
        self._ready = threading.Event()

    @property
    def address(self) -> str:
        """For `--connect`."""
        return f"udpin:127.0.0.1:{OFFBOARD_PORT + self.instance}"

    @property
    def hil_port(self) -> int:
        """For `--hil-port`."""
        return HIL_PORT + self.instance

    def __enter__(self) -> Self:
        self.bench.out.mkdir(parents=True, exist_ok=True)
        self._log = (self.bench.out / f"px4-{self.instance}.log").open("wb")
        self._process = self._started()
        try:
            self.link = mavutil.mavlink_connection(
                f"udpout:127.0.0.1:{GCS_PORT + self.instance}", source_system=255, dialect="common"
            )
            self._reader = threading.Thread(target=self._listen, daemon=True)
            self._reader.start()
            if self.kind == "sih":  # behind a HIL simulator nothing moves before that has started
                self.wait_ready()
        except BaseException:
            self.close()
            raise
        return self

    def _started(self) -> subprocess.Popen[bytes]:
        command = [*self.bench.px4_prefix, str(self.bench.home / "run.sh"), str(self.instance), self.kind]
        env = {**os.environ, "FRESH": "1", **self._env}
        return subprocess.Popen(command, env=env, stdout=self._log, stderr=self._log, stdin=subprocess.DEVNULL)

    def signal(self, number: int) -> None:
        """A signal to PX4's process."""
        self._process.send_signal(number)

    def restart(self) -> None:
        """Start it anew, at once, after it has ended; ready to arm when this returns."""
        self._process.wait(10.0)
        self._ready.clear()
        self.truth, self._origin = [], None
        self._process = self._started()
        self.wait_ready()

    def wait_ready(self) -> None:
        """Until PX4 is ready to arm and has taken the parameters asked for."""
        if not self._ready.wait(BOOT_LIMIT_S):
            raise RuntimeError(f"PX4 was not ready within {BOOT_LIMIT_S:g} s: see {self._log.name}")
        for name, value in self._params.items():
            self.set_param(name, value)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """End PX4 and the station."""
        self._stop.set()
        self._process.send_signal(signal.SIGTERM)
        try:
            self._process.wait(10.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        if hasattr(self, "_reader"):
            self._reader.join(2.0)
            self.link.close()
        self._log.close()

    # ---------------------------------------------------------------- parameters

    def param(self, name: str) -> float:
        """The value of a parameter; KeyError where PX4 does not tell it."""
        self._values.pop(name, None)
        deadline = time.monotonic() + ANSWER_S
        while name not in self._values:
            if time.monotonic() > deadline:
                raise KeyError(name)
            self.link.mav.param_request_read_send(self.instance + 1, 1, name.encode(), -1)
            time.sleep(0.1)
        return self._values[name]

    def set_param(self, name: str, value: float) -> None:
        """Set a parameter and see it taken; RuntimeError where it is not.

        A busy machine loses a PARAM_SET, and answers to earlier requests come after it: neither is PX4's last word.
        """
        self.param(name)
        kind = self._types[name]
        sent = struct.unpack("<f", struct.pack("<i", int(value)))[0] if kind == _INT32 else float(value)
        deadline = time.monotonic() + ANSWER_S
        while True:
            self.link.mav.param_set_send(self.instance + 1, 1, name.encode(), sent, kind)
            time.sleep(0.1)
            if math.isclose(self.param(name), value, rel_tol=1e-6):
                return
            if time.monotonic() > deadline:
                raise RuntimeError(f"{name} is {self._values[name]:g}, not {value:g}")

    # ---------------------------------------------------------------- what is heard

    def wait(self, wanted: Callable[[], bool], limit_s: float) -> bool:
        """Whether it came true in time."""
        deadline = time.monotonic() + limit_s
        while not wanted():
            if time.monotonic() > deadline:
                return False
            time.sleep(0.005)
        return True

    @property
    def height_m(self) -> float:
        """True height above the first sample."""
        return self.truth[-1].up_m if self.truth else 0.0

    @property
    def armed(self) -> bool:
        """By the last HEARTBEAT."""
        return bool(self.modes) and self.modes[-1][2]

    @property
    def mode(self) -> int:
        """custom_mode of the last HEARTBEAT."""
        return self.modes[-1][1] if self.modes else 0

    def command(self, number: int, *params: float) -> None:
        """Send a COMMAND_LONG; unset parameters are NaN."""
        filled = (*params, *(math.nan,) * (7 - len(params)))
        self.link.mav.command_long_send(self.instance + 1, 1, number, 0, *filled)

    def _listen(self) -> None:
        asked_s = 0.0
        while not self._stop.is_set():
            now_s = time.monotonic()
            if now_s - asked_s > 1.0:
                asked_s = now_s
                if not self.silent:
                    self.link.mav.heartbeat_send(6, 8, 0, 0, 4)
                if not self.truth:
                    self.command(511, _HIL_STATE, 1e6 / TRUTH_HZ)
                if not self.version:
                    self.command(512, 148.0)
            try:
                message = self.link.recv_match(blocking=True, timeout=0.1)
            except (ConnectionRefusedError, OSError):  # PX4 has not bound its port yet
                time.sleep(0.05)
                continue
            if message is not None:
                self._take(message.get_type(), message, time.monotonic())

    def _take(self, kind: str, message: Any, at_s: float) -> None:
        if kind == "HIL_STATE_QUATERNION":
            self.truth.append(self._truth(message, at_s))
        elif kind == "HEARTBEAT" and message.get_srcComponent() == 1:
            now = (int(message.custom_mode), bool(message.base_mode & 0x80))
            if not self.modes or self.modes[-1][1:] != now:
                self.modes.append((at_s, *now))
            if message.system_status == 3 and self.truth:
                self._ready.set()
        elif kind == "SERVO_OUTPUT_RAW":
            self.spins = message.servo1_raw >= _IDLE_US
        elif kind == "STATUSTEXT":
            self.texts.append((at_s, message.text.strip()))
        elif kind == "AUTOPILOT_VERSION":
            v = message.flight_sw_version
            words = {0: "dev", 64: "alpha", 128: "beta", 192: "rc", 255: ""}.get(v & 0xFF, "")
            git = bytes(message.flight_custom_version[::-1]).hex()[:8]
            self.version = f"v{v >> 24}.{v >> 16 & 0xFF}.{v >> 8 & 0xFF}{words} ({git})"
        elif kind == "PARAM_VALUE":
            value = message.param_value
            if message.param_type == _INT32:
                value = struct.unpack("<i", struct.pack("<f", value))[0]
            self._types[message.param_id], self._values[message.param_id] = message.param_type, float(value)

    def _truth(self, message: Any, at_s: float) -> Truth:
        place = (message.lat * 1e-7, message.lon * 1e-7, message.alt * 1e-3)
        self._origin = self._origin or place
        lat0, lon0, alt0 = self._origin
        _, x, y, _ = message.attitude_quaternion
        return Truth(
            at_s,
            (place[0] - lat0) * _EARTH_M_PER_DEG,
            (place[1] - lon0) * _EARTH_M_PER_DEG * math.cos(math.radians(lat0)),
            place[2] - alt0,
            0.01 * message.vx, 0.01 * message.vy, 0.01 * message.vz,
            math.acos(max(-1.0, min(1.0, 1.0 - 2.0 * (x * x + y * y)))),
        )  # fmt: skip


def log_folder(bench: Bench, name: str) -> Path:
    """A fresh folder for a flight's files."""
    for attempt in range(10_000):
        folder = bench.out / f"{name}-{attempt:03d}"
        if not folder.exists():
            folder.mkdir(parents=True)
            return folder
    raise RuntimeError(f"{bench.out}: too many flights of {name}")
