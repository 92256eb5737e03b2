"""`make same BASE=COMMIT`: short flights by two commits on this machine, which must write the same bytes.

    python -m benchmarks.same COMMIT

The working tree and COMMIT (in a work tree of its own, with this environment's libraries) fly the same flights in
lockstep.  Compared are the results but for measured times, and every topic of the logs, message for message; exit code
1 where anything differs.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from flightstack.cli.result import steady
from flightstack_logs.mcap_file import McapChannel, scan

ROOT = Path(__file__).resolve().parents[1]
FLIGHTS: dict[str, tuple[str, ...]] = {
    "hover": ("hover", "--duration", "2", "--no-learning"),
    "tracking": ("paper-tracking", "--duration", "9"),
    "figure8": ("figure8", "--duration", "4", "--sensors", "gps"),
    "published": ("paper-barrier", "--duration", "4", "--as-published"),
}


def fly(tree: Path, out: Path, name: str) -> None:
    """One flight by the sources in `tree`; its log and result lie in `out`."""
    paths = [str(tree / part) for part in (".", "sim", "logs", "paper")]
    command = [sys.executable, "-m", "flightstack", "fly", *FLIGHTS[name], "--seed", "1"]
    command += ["--out", str(out), "--log", str(out / f"{name}.mcap"), "--json", str(out / f"{name}.json")]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}
    done = subprocess.run(command, cwd=tree, env=environment, capture_output=True, text=True, check=False)
    if not (out / f"{name}.json").exists():
        sys.exit(f"error: {name} did not fly in {tree}: {done.stderr.strip().splitlines()[-1:]}")


def different(then: Path, now: Path, name: str) -> list[str]:
    """What differs between two flights, in words."""
    results = [steady(json.loads((folder / f"{name}.json").read_text())) for folder in (then, now)]
    found = [f"result: {key}" for key in results[0].keys() | results[1].keys() if _unlike(results, key)]
    logs = [_topics(folder / f"{name}.mcap") for folder in (then, now)]
    for topic in sorted(logs[0].keys() | logs[1].keys()):
        channels = [log.get(topic) for log in logs]
        if None in channels:
            found.append(f"{topic}: only {'then' if channels[1] is None else 'now'}")
        elif words := _compared(*channels):  # type: ignore[arg-type]
            found.append(f"{topic}: {words}")
    return found


def _unlike(results: list[dict[str, Any]], key: str) -> bool:
    return json.dumps(results[0].get(key)) != json.dumps(results[1].get(key))


def _topics(path: Path) -> dict[str, McapChannel]:
    return {channel.topic: channel for channel in scan(path.read_bytes(), str(path)).channels.values()}


def _compared(then: McapChannel, now: McapChannel) -> str:
    if then.schema != now.schema:
        return "another schema"
    for k, pair in enumerate(zip(then.messages, now.messages, strict=False)):
        if pair[0] != pair[1] or then.times_ns[k] != now.times_ns[k]:
            return f"from {1e-9 * now.times_ns[k]:.3f} s on"
    if len(then.messages) != len(now.messages):
        return f"{len(then.messages)} messages then, {len(now.messages)} now"
    return ""


def main() -> None:
    """Compare."""
    if len(sys.argv) != 2 or sys.argv[1].startswith("-"):
        sys.exit("error: say which commit: make same BASE=COMMIT")
    base, apart = sys.argv[1], False
    with tempfile.TemporaryDirectory() as folder:
        tree, then, now = (Path(folder) / part for part in ("tree", "then", "now"))
        added = ["git", "-C", str(ROOT), "worktree", "add", "--detach", str(tree), base]
        if subprocess.run(added, capture_output=True, check=False).returncode:
            sys.exit(f"error: {base} is no commit of this repository")
        try:
            for name in FLIGHTS:
                fly(tree, then, name)
                fly(ROOT, now, name)
                words = different(then, now, name)
                apart = apart or bool(words)
                print(f"{name}: {'the same bytes' if not words else '; '.join(words)}", flush=True)
        finally:
            subprocess.run(["git", "-C", str(ROOT), "worktree", "remove", "--force", str(tree)], check=False)
    sys.exit(1 if apart else 0)


if __name__ == "__main__":
    main()
