"""The process that workers are forked from: all is imported and warm before the first one, so each starts at once.

    python -m flightstack.cli.campaign.nursery FD

FD is a socket to the campaign, which sends one byte and a worker's socket for each worker it wants; the nursery answers
with lines {"pid"} and, once a worker has ended, {"ended", "how"}.  When the campaign is gone the nursery ends, and its
workers with it.
"""

from __future__ import annotations

import os
import select
import signal
import socket
import sys
from contextlib import suppress
from pathlib import Path

from flightstack.cli.campaign.wire import Lines
from mavlink_bridge.transport.machine import die_with_parent

_TICK_S = 0.1


def warm() -> None:
    """Import and call once whatever a flight needs."""
    from flightstack.cli import files  # noqa: F401
    from flightstack.cli.campaign import single  # noqa: F401
    from flightstack.cli.flight import FlyOptions, prepare, warm_up_all

    with suppress(Exception):  # a flight says better what is wrong
        warm_up_all(prepare(FlyOptions(scenario="paper-tracking")))


def serve_worker(end: socket.socket) -> None:
    """A worker: fly what comes until the campaign's end of the socket is closed."""
    from flightstack.cli.campaign.single import fly_text

    lines = Lines(end)
    told = [0.0]

    def on_progress(share: float) -> None:
        if lines.ready(0.0):  # nothing is sent to a worker that flies: the campaign is gone
            os._exit(1)
        if share - told[0] > 0.05:
            told[0] = share
            lines.send({"share": share})

    while True:
        job = lines.receive()
        told[0] = 0.0
        row = fly_text(job["text"], Path(job["folder"]), keep=job["keep"], kept=job["kept"], on_progress=on_progress)
        lines.send({"row": row})


def _fork(end: socket.socket, control: socket.socket) -> int:
    parent = os.getpid()
    pid = os.fork()
    if pid:
        return pid
    status = 1
    try:
        control.close()
        die_with_parent(parent)
        serve_worker(end)
    except EOFError:
        status = 0
    finally:
        os._exit(status)


def _how(status: int) -> str:
    if os.WIFSIGNALED(status):
        number = os.WTERMSIG(status)
        return f"signal {number} ({signal.Signals(number).name})"
    return f"exit code {os.waitstatus_to_exitcode(status)}"


def main() -> None:
    """Serve until the campaign is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the campaign's
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    control = socket.socket(fileno=int(sys.argv[1]))
    lines = Lines(control)
    warm()
    lines.send({"warm": True})
    while True:
        with suppress(ChildProcessError):
            while (ended := os.waitpid(-1, os.WNOHANG))[0]:
                lines.send({"ended": ended[0], "how": _how(ended[1])})
        if not select.select([control], [], [], _TICK_S)[0]:
            continue
        wanted, handles, _, _ = socket.recv_fds(control, 1, 1)
        if not wanted:
            return
        end = socket.socket(fileno=handles[0])
        lines.send({"pid": _fork(end, control)})
        end.close()


if __name__ == "__main__":
    with suppress(EOFError):
        main()
