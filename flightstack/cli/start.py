"""Where the program `flightstack` begins: signals are heard before anything else is imported."""

from __future__ import annotations

import gc
import signal
import sys

_ENDS_IN_THE_BACKGROUND = ("sim", "warmup")
"""Verbs that nothing has to land from: Ctrl-C ends them also where a shell's script had it ignored."""
_COLLECTED_AFTER = 50_000, 20, 20
"""Imports make a million objects, none of which goes: looking through them as often as Python does is a tenth of it."""


def main() -> None:
    """The command line; until it is imported a signal ends the program without words."""
    gc.set_threshold(*_COLLECTED_AFTER)
    ignored = signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    if not ignored or (sys.argv[1:2] and sys.argv[1] in _ENDS_IN_THE_BACKGROUND):
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from flightstack.cli.main import main as run

    if not ignored:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        run()
    finally:
        # Compiled modules leave a million objects in cycles, which the interpreter would look through one last time:
        # 0.6 s of processor time between the last line and the end.  Files are closed by name, so nothing needs it.
        gc.freeze()
        gc.disable()
