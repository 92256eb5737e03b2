"""The signing key's file, and the stamps that survive a restart, in a file beside it.

The key may be read by its owner alone, and used by one program at a time.  Stamps are written ahead: what stands in the
state file always lies beyond what has been sent or taken, so that a program that is killed never uses a stamp twice and
never takes an old frame for new; for that it may be deaf for some seconds to a peer it heard just before.  A clean end
writes what was really used.
"""

from __future__ import annotations

import fcntl
import json
import os
import stat
import threading
from pathlib import Path
from typing import Any, final

from flightstack.types import InputError
from mavlink_bridge.signing import STAMPS_PER_SECOND, SecretKey, Signer, Stream, parse_key
from mavlink_bridge.transport.clock import signing_stamp

SCHEMA = "flightstack.signing/1"
AHEAD = 5 * STAMPS_PER_SECOND
_PERIOD_S = 2.0
_KEY_MAX_BYTES = 128


@final
class KeyFile:
    """A key in use: `signer` signs and judges; `close` at the end."""

    def __init__(self, path: Path, signer: Signer, lock: int) -> None:
        self.signer = signer
        self.problem = ""
        """Why the state could not be kept in flight; empty where it is."""
        self._state = state_path(path)
        self._lock = lock
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._keep, name="signing-state", daemon=True)

    @classmethod
    def open(cls, path: Path, *, link_id: int = 0) -> KeyFile:
        """Read and lock the key, continue its stamps; InputError in one line where that may not or can't be."""
        lock = _open_private(path)
        try:
            key = parse_key(os.read(lock, _KEY_MAX_BYTES), str(path))
            _lock(lock, path)
            next_stamp, seen = _read_state(state_path(path))
            file = cls(path, _signer(key, link_id, next_stamp, seen), lock)
            file._write(AHEAD)
        except OSError as error:
            os.close(lock)
            raise InputError(
                f"signing state {state_path(path)} can't be written ({error.strerror}): "
                "put the key where this user may write beside it"
            ) from error
        except InputError:
            os.close(lock)
            raise
        file._thread.start()
        return file

    def close(self) -> None:
        """Write what was used and let others have the key."""
        self._ended.set()
        if self._thread.is_alive():
            self._thread.join()
        self._try_to_write(0)
        os.close(self._lock)

    def _keep(self) -> None:
        while not self._ended.wait(_PERIOD_S):
            self._try_to_write(AHEAD)

    def _try_to_write(self, ahead: int) -> None:
        try:
            self._write(ahead)
        except OSError as error:  # in flight nothing raises
            self.problem = f"signing state {self._state} can't be written: {error.strerror}"

    def _write(self, ahead: int) -> None:
        signer = self.signer
        signer.next_stamp = max(signer.next_stamp, signing_stamp()) if ahead else signer.next_stamp
        streams = {".".join(map(str, stream)): stamp + ahead for stream, stamp in dict(signer.seen).items()}
        text = json.dumps({"schema": SCHEMA, "next_stamp": signer.next_stamp + ahead, "streams": streams})
        beside = self._state.with_name(self._state.name + ".new")
        with os.fdopen(os.open(beside, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), "w") as out:
            out.write(text)
            out.flush()
            os.fsync(out.fileno())
        os.replace(beside, self._state)
        folder = os.open(self._state.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


def state_path(path: Path) -> Path:
    """Where the stamps of a key are kept."""
    return path.with_name(path.name + ".state")


def _signer(key: SecretKey, link_id: int, next_stamp: int, seen: dict[Stream, int]) -> Signer:
    return Signer(key, signing_stamp, link_id=link_id, next_stamp=next_stamp, seen=seen)


def _open_private(path: Path) -> int:
    """The key file, open for reading; InputError where others than its owner may read or change it."""
    try:
        handle = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
    except OSError as error:
        raise InputError(f"signing key {path} can't be read: {error.strerror}") from error
    info = os.fstat(handle)
    problem = ""
    if not stat.S_ISREG(info.st_mode):
        problem = "is no file"
    elif info.st_uid not in (os.geteuid(), 0):
        problem = "belongs to another user: make it your own (chown)"
    elif info.st_mode & 0o177:
        problem = f"may be used by others than its owner (mode {info.st_mode & 0o777:04o}): chmod 600 {path}"
    if problem:
        os.close(handle)
        raise InputError(f"signing key {path} {problem}")
    return handle


def _lock(handle: int, path: Path) -> None:
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise InputError(f"signing key {path} is in use by another program: stop it first") from error


def _read_state(path: Path) -> tuple[int, dict[Stream, int]]:
    try:
        text = path.read_text()
    except FileNotFoundError:
        return 0, {}
    try:
        found: Any = json.loads(text)
        if found["schema"] != SCHEMA:
            raise ValueError("schema")
        seen: dict[Stream, int] = {}
        for name, stamp in found["streams"].items():
            system, component, link = (int(part) for part in name.split("."))
            seen[system, component, link] = _stamp(stamp)
        return _stamp(found["next_stamp"]), seen
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(
            f"signing state {path} is damaged: if no frame was signed ahead of the present time, delete it"
        ) from error


def _stamp(value: object) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < 1 << 48:
        raise ValueError("stamp")
    return value
