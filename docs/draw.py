"""Draws the diagrams of docs/architecture.md from the tables in the code: `python docs/draw.py` rewrites them.

Each stands between `<!-- drawn: NAME -->` and `<!-- end -->` as a Mermaid block; a test compares them with the tables.
"""

from __future__ import annotations

import re
from collections import defaultdict
from pathlib import Path

from flightstack_logs.topics import TOPICS
from mavlink_bridge.handshake import FINAL, TRANSITIONS

PAGE = Path(__file__).resolve().parent / "architecture.md"
_BLOCK = re.compile(r"(<!-- drawn: (\w+) -->\n).*?(<!-- end -->)", re.DOTALL)


def handshake() -> str:
    """The companion's states; events that lead from one state to the same other share an arrow."""
    lines = ["stateDiagram-v2", "    [*] --> disconnected"]
    for state, ways in TRANSITIONS.items():
        by_target: dict[str, list[str]] = defaultdict(list)
        for event, target in ways.items():
            by_target[target.value].append(event.name)
        lines += [f"    {state.value} --> {target}: {', '.join(events)}" for target, events in by_target.items()]
    lines += [f"    {state.value} --> [*]" for state in sorted(FINAL, key=lambda s: s.value)]
    return "\n".join(lines)


def topics() -> str:
    """Every topic of a log, with its rate and source."""
    rows = []
    for topic in TOPICS.values():
        rate = f"{topic.rate_hz:g}" if topic.rate_hz else "as it happens"
        rows.append(f"| `{topic.name}` | {rate} | {topic.source} | {topic.text} |")
    return "\n".join(["| topic | Hz | from | what it holds |", "| --- | --- | --- | --- |", *rows])


DRAWN = {"handshake": lambda: f"```mermaid\n{handshake()}\n```", "topics": topics}


def redrawn(text: str) -> str:
    """The page's text with every drawn block made anew."""
    return _BLOCK.sub(lambda m: f"{m.group(1)}{DRAWN[m.group(2)]()}\n{m.group(3)}", text)


if __name__ == "__main__":
    PAGE.write_text(redrawn(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
