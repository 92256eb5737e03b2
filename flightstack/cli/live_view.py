"""`--live`: the recorder of a flight with what shows it beside it, imported only where it is asked for."""

from __future__ import annotations

from typing import TypeVar

from flightstack.errors import InputError
from flightstack_logs.recorder import Recorder

R = TypeVar("R", Recorder, "Recorder | None")


def shown_live(recorder: R, port: int | None) -> R | Recorder:
    """`recorder`, shown on `port` and the next one; itself where there is none.  InputError where one is taken."""
    if port is None:
        return recorder
    from flightstack.cli.console import say
    from flightstack_logs.live.recorder import LiveRecorder

    try:
        live = LiveRecorder(recorder, port)
    except InputError:
        if recorder is not None:
            recorder.close()
        raise
    say(f"live: page http://127.0.0.1:{port + 1}/, Foxglove ws://127.0.0.1:{port}")
    return live
