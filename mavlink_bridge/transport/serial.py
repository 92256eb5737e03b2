"""A serial line with the same calls as a UDP socket.  Needs pyserial, which is asked for only here."""

from __future__ import annotations

import importlib
import time
from typing import Any, final

from flightstack.types import InputError

_CHUNK = 4096


@final
class SerialPort:
    """A serial line; frames on it span what `receive` returns (use `StreamFraming`)."""

    def __init__(self, port: Any) -> None:
        self._port = port
        self.other = 0
        """Of nobody else; as of a UDP port."""
        self.send_errors = 0
        """Writes that failed or were cut short."""
        self.receive_errors = 0
        """Reads that failed, as when the line is unplugged."""

    @classmethod
    def open(cls, device: str, baud: int) -> SerialPort:
        """Open `device`; InputError where that can't be."""
        try:
            serial = importlib.import_module("serial")
        except ImportError as error:
            raise InputError(f"serial line {device} needs pyserial: install it with pip install pyserial") from error
        try:
            return cls(serial.Serial(device, baud, timeout=0, write_timeout=0, exclusive=True))
        except (OSError, ValueError) as error:
            raise InputError(f"serial line {device} can't be opened at {baud} baud: {error}") from error

    def fileno(self) -> int:
        """The file descriptor."""
        return int(self._port.fileno())

    def receive(self) -> bytes | None:
        """What has arrived (any piece of the stream), None where nothing has."""
        try:
            data: bytes = self._port.read(_CHUNK)
        except OSError:
            self.receive_errors += 1
            return None
        return data or None

    def receive_all(self) -> list[bytes]:
        """Everything that has arrived, in order."""
        chunks = []
        while (data := self.receive()) is not None:
            chunks.append(data)
        return chunks

    def wait(self, timeout_s: float) -> bool:
        """Wait until something can be received, at most `timeout_s`; whether it can."""
        deadline = time.monotonic() + timeout_s
        while time.monotonic() < deadline:
            try:
                if self._port.in_waiting:
                    return True
            except OSError:
                self.receive_errors += 1
                return False
            time.sleep(0.001)
        return False

    def send(self, data: bytes) -> bool:
        """Write a frame; False (and counted) where not all of it could go."""
        try:
            written = self._port.write(data)
        except OSError:
            written = 0
        if written != len(data):
            self.send_errors += 1
            return False
        return True

    def close(self) -> None:
        """Give the line back."""
        self._port.close()
