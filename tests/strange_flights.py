"""A nursery whose flights crash, stand still or end at once, as their text says: no simulator, no warm-up."""

from __future__ import annotations

import os
import signal
import sys
import threading
from contextlib import suppress
from pathlib import Path
from typing import Any

from flightstack.cli.campaign import nursery, single


def fly_text(text: str, folder: Path, **_: Any) -> dict[str, Any]:
    """What the text says."""
    folder.mkdir(parents=True, exist_ok=True)
    if "once" in text and (marker := folder.parent / "once").exists() is False:
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    if "segfault" in text:
        os.kill(os.getpid(), signal.SIGSEGV)
    if "exit" in text:
        os._exit(7)
    if "slow" in text:
        threading.Event().wait(0.15)
    if "hang" in text:
        threading.Event().wait()
    return {"outcome": "completed", "reason": "", "result": {"text": text}, "wall_s": 0.0}


if __name__ == "__main__":
    single.fly_text = fly_text
    nursery.warm = lambda: None
    sys.modules["flightstack.cli.campaign.nursery"] = nursery
    with suppress(EOFError):
        nursery.main()
