"""`flightstack certify --check`: the independent checker in a process of its own, with limits that no file gets past.

500 MB of memory and less than 30 s of a processor, or 120 s with a log.  The file is read once and its text handed to
the child, so that what is flown is what was checked, whoever changes the file meanwhile.  What the child finds comes
back as one line of JSON; a child that is stopped, runs out of memory or dies says so in one line too.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import stat
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from flightstack.certificate_check import Verdict, check
from flightstack.certificate_check.bounds import FILE_BYTES
from flightstack.types import InputError

MEMORY_BYTES = 430_000_000
"""Of data; with the code itself, some 60 MB, it stays below 500 MB resident."""
CPU_LIMIT_S, LOG_CPU_LIMIT_S = 27, 110
"""Of processor time: a verdict is not a matter of what else runs.  Alone on a core that is 30 s and 120 s."""
_SHARED = 3.0
"""By so much longer it may take beside others."""
LOG_BYTES = 1_000_000_000
_ONE_THREAD = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")
"""Threads of a linear algebra library reserve memory, each."""


def check_file(path: Path, log: Path | None = None, vehicle: Path | None = None) -> Verdict:
    """The checker's word on a file, and against the log of its flight where one is given.

    InputError, one line, where one of the files can't be read or no verdict was reached.  `vehicle`: the vehicle file;
    without it the one that the log carries.
    """
    if vehicle is not None and log is None:
        raise InputError("--vehicle belongs to --log: without the log nothing is derived from it")
    text = read_bounded(path)
    for one, most_bytes in ((log, LOG_BYTES), (vehicle, FILE_BYTES)):
        if one is not None:
            _readable(one, most_bytes)
    return check_text(text, str(path), [str(one) for one in (log, vehicle) if one is not None])


def check_text(text: str, name: str, beside: Sequence[str] = ()) -> Verdict:
    """The same of a text that was read already; `name` says whose it is, `beside` are paths of log and vehicle file."""
    found = _in_child(text, list(beside), LOG_CPU_LIMIT_S if beside else CPU_LIMIT_S, name)
    if not found["readable"]:
        raise InputError(f"{name}: {found['lines'][-1]}")
    return Verdict(found["valid"], found["lines"], level=found["level"])


def read_bounded(path: Path) -> str:
    """The text of a file that may be one to check; InputError, one line, where it is none, too large or no text."""
    _readable(path, FILE_BYTES)
    try:
        with open(os.open(path, os.O_RDONLY | os.O_NONBLOCK), "rb") as file:  # not for ever, should it be a pipe by now
            data = file.read(FILE_BYTES + 1) or b""
        if len(data) > FILE_BYTES:
            raise InputError(f"{path}: is larger than the {FILE_BYTES / 1e6:.0f} MB looked at")
        return data.decode("utf-8")
    except UnicodeDecodeError:
        raise InputError(f"{path}: not a text file (UTF-8 expected)") from None
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}") from None


def _readable(path: Path, most_bytes: int) -> None:
    """InputError where a path is no file that may be opened, or a larger one than is looked at."""
    try:
        about = path.stat()
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}") from None
    if not stat.S_ISREG(about.st_mode):
        raise InputError(f"{path}: is no file")
    if about.st_size > most_bytes:
        raise InputError(f"{path}: {about.st_size / 1e6:.0f} MB are more than the {most_bytes / 1e6:.0f} MB looked at")


def _in_child(text: str, arguments: list[str], limit_s: int, name: str) -> dict[str, Any]:
    # -P: no imports from where we are
    command = [sys.executable, "-P", "-m", "flightstack.cli.checking", str(limit_s), *arguments]
    quiet, environment = subprocess.DEVNULL, os.environ | _ONE_THREAD
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=quiet, env=environment
    ) as child:  # fmt: skip
        try:
            said, _ = child.communicate(text.encode("utf-8"), timeout=_SHARED * limit_s)
        except subprocess.TimeoutExpired:
            child.kill()
            raise InputError(f"{name}: no verdict within {_SHARED * limit_s:g} s; it is not to be relied on") from None
        finally:
            child.kill()  # whatever interrupted this, no child is left behind
    if child.returncode == -signal.SIGXCPU:
        raise InputError(f"{name}: no verdict within {limit_s} s of processor time; it is not to be relied on")
    try:
        found: dict[str, Any] = json.loads(said)
    except ValueError:
        raise InputError(f"{name}: the checker ended without a verdict; it is not to be relied on") from None
    return found


def main(arguments: list[str]) -> None:
    """The child: the certificate's text comes in, one line of JSON goes out; `arguments`: seconds of processor time,
    log, vehicle file."""
    _limit(int(arguments[0]))
    try:
        text = sys.stdin.buffer.read(FILE_BYTES + 1).decode("utf-8")
        if len(arguments) == 1:
            verdict = check(text)
        else:
            vehicle = Path(arguments[2]).read_bytes() if len(arguments) > 2 else None
            with Path(arguments[1]).open("rb") as log:
                verdict = check(text, log, vehicle)
    except OSError as error:
        verdict = Verdict(False, [error.strerror or str(error)], readable=False)
    print(json.dumps(asdict(verdict)))


def _limit(cpu_s: int) -> None:
    """Whatever asks for more memory gets a MemoryError, for more time is ended; where the system has no such limits,
    `bounds` and the parent's patience hold."""
    with contextlib.suppress(ImportError, ValueError, OSError):
        import resource

        resource.setrlimit(resource.RLIMIT_CPU, (cpu_s, cpu_s + 1))
        resource.setrlimit(resource.RLIMIT_DATA, (MEMORY_BYTES, MEMORY_BYTES))


if __name__ == "__main__":
    main(sys.argv[1:])
