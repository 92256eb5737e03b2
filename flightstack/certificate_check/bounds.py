"""How large a certificate may be: looked at before anything is made of it, so that no file takes memory or time.

    file        10 MB, nested at most 40 deep
    store       400 points of 7 numbers; its kernel 16 nodes, with at most 7 columns and length scales each
    axes        3, each with 64 nodes of its authority, 6,000 cells, 16 margins
    queries     4,096 posteriors in all, and (N^3 / 3 + Q N^2) below 10^9 for all N points and Q queries

Every one of them holds several times what a flight makes (300 points, 8 nodes, some 600 cells).
"""

from __future__ import annotations

from typing import Any

FILE_BYTES = 10_000_000
POINTS, NODES, CELLS, QUERIES = 400, 64, 6_000, 4_096
KERNEL_NODES, COLUMNS = 16, 7
WORK = 10**9
_DEPTH, _AXES, _MARGINS, _WORDS = 40, 3, 16, 2_000
_QUERIES_A_NODE = 34
"""17 at either end of the command."""


def beyond(data: dict[str, Any]) -> str:
    """What of a file's table is larger than any certificate, in words; empty where nothing is.

    Only lengths are looked at: what is no list or table at all is for whoever reads it.
    """
    return _deep(data) or _axes(data.get("axes")) or _knowledge(data.get("knowledge"))


def _deep(data: Any) -> str:
    """Whether it is nested too deep or says too much in words; without recursion."""
    level = [data]
    for _ in range(_DEPTH):
        inner: list[Any] = []
        for part in level:
            values = part.values() if isinstance(part, dict) else part
            inner += (value for value in values if isinstance(value, dict | list) and value)
            if any(isinstance(value, str) and len(value) > _WORDS for value in values):
                return f"a text has more than {_WORDS} characters"
        if not inner:
            return ""
        level = inner
    return f"nested deeper than {_DEPTH}"


def _axes(axes: Any) -> str:
    if _length(axes) > _AXES:
        return f"axes: {_length(axes)}, at most {_AXES} are looked at"
    for axis in axes if isinstance(axes, list) else ():
        if not isinstance(axis, dict):
            continue
        name = str(axis.get("axis"))[:40]
        if _length(axis.get("cells")) > CELLS:
            return f"{name}.cells: {_length(axis['cells'])}, at most {CELLS} are looked at"
        if _length(axis.get("margins")) > _MARGINS:
            return f"{name}.margins: {_length(axis['margins'])}, at most {_MARGINS} are looked at"
        authority = axis.get("authority")
        for key, column in authority.items() if isinstance(authority, dict) else ():
            if _length(column) > NODES:
                return f"{name}.authority.{key[:40]}: {_length(column)} nodes, at most {NODES} are looked at"
    return ""


def _knowledge(known: Any) -> str:
    if not isinstance(known, dict):
        return ""
    nodes = known.get("nodes")
    if isinstance(nodes, int) and nodes > NODES:
        return f"knowledge.nodes: {nodes:.6g}, at most {NODES} are looked at"
    asked = _length(known.get("axes"))
    if asked > _AXES:
        return f"knowledge.axes: {asked}, at most {_AXES} are looked at"
    vertical = isinstance(known.get("axes"), list) and 2 not in known["axes"]  # which is always asked
    rounds = asked + vertical + (known.get("last") is True)
    queries = rounds * _QUERIES_A_NODE * nodes if isinstance(nodes, int) else 0
    if queries > QUERIES:
        return f"knowledge: {queries} queries, at most {QUERIES} are looked at"
    work = 0.0
    for name in ("lateral", "vertical"):
        store = known.get(name)
        if not isinstance(store, dict):
            continue
        points = max(_length(store.get("x")), _length(store.get("y")))
        if points > POINTS:
            return f"knowledge.{name}: {points} points, at most {POINTS} are looked at"
        if found := _kernel(store.get("kernel"), f"knowledge.{name}.kernel"):
            return found
        work += points**3 / 3.0 + queries * points**2
    return f"knowledge: {work:.3g} steps of work, at most {WORK:.3g} are done" if work > WORK else ""


def _kernel(spec: Any, where: str) -> str:
    """A kernel's tree, looked at without recursion."""
    todo, seen = [spec], 0
    while todo:
        one = todo.pop()
        seen += 1
        if seen > KERNEL_NODES:
            return f"{where}: more than {KERNEL_NODES} nodes"
        if not isinstance(one, dict):
            continue
        for key in ("columns", "lengthscales"):
            if _length(one.get(key)) > COLUMNS:
                return f"{where}.{key}: {_length(one[key])}, at most {COLUMNS} are looked at"
        todo += [one[side] for side in ("left", "right") if side in one]
    return ""


def _length(value: Any) -> int:
    return len(value) if isinstance(value, list | dict | str) else 0
