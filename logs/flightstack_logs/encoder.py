"""How a record becomes a message of its TABLE topic: generated source, as `namedtuple` does it.

The form of the messages is that of `logs.wire`: every value has a fixed place.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import cache
from types import CodeType
from typing import Any

import numpy as np

from flightstack.types import F64, U8, Element, Part
from flightstack_logs.topics import Field, Topic
from flightstack_logs.wire import BYTES, SCALARS, varint

Encoder = Callable[[Any], bytes]


def _prefix(number: int, field: Field) -> bytes:
    """Tag (and length) before a field's bytes."""
    scalar = SCALARS[field.type]
    if field.size == 0:
        return varint(number << 3 | scalar.wire)
    return varint(number << 3 | BYTES) + varint(field.size * struct.calcsize("<" + scalar.code))


def _text_field(prefix: bytes, text: str) -> bytes:
    data = text.encode()
    return prefix + varint(len(data)) + data


def _follow(record: object, path: str) -> object:
    for name in path.split("."):
        record = getattr(record, name)
    return record


def _owner(sample: object, owner: str) -> Any:
    """What `owner` (r, or r.a.b) stands for."""
    return sample if owner == "r" else _follow(sample, owner[2:])


def _is_block(value: object, field: Field) -> bool:
    """Whether an array's own bytes are the field's bytes."""
    if not isinstance(value, np.ndarray):
        return False
    return bool(value.shape == (field.size,) and value.dtype is _block_dtype(field) and value.flags.c_contiguous)


def _block_dtype(field: Field) -> np.dtype[Any]:
    return np.dtype(SCALARS[field.type].code)


def _place_in_row(owner: object, name: str, field: Field) -> slice | None:
    """Which numbers of its owner's row a field is, if it is a named part of one (`flightstack.types`)."""
    part = getattr(type(owner), name, None)
    if field.type not in ("double", "float"):
        return None
    if isinstance(part, Element) and field.size == 0:
        return slice(part.place, part.place + 1)
    if isinstance(part, Part) and part.place.stop - part.place.start == field.size:
        return part.place
    return None


def _not_a_block(value: np.ndarray) -> bytes:
    raise TypeError(f"an array of {value.dtype} came where another type came before")


class _Source:
    """Python source of an encoder while it grows: runs of `struct.pack` and bytes that go in as they are.

    Where parts of rows go in, the rows, the runs and what never changes lie side by side in one piece of memory, and
    the message is gathered from there in one go: a third of what slicing and joining takes.
    """

    def __init__(self) -> None:
        self.names: dict[str, Any] = {
            "join": b"".join, "text": _text_field, "other": _not_a_block, "single": np.float32
        }  # fmt: skip
        self.size = 0
        self._parts: list[str] = []
        self._fills: list[str] = []
        self._kept: list[tuple[int, bytes]] = []
        self._index: list[int] = []
        self._room = 0
        self._has_blocks = False
        self._layout = "<"
        self._arguments: list[str] = []
        self._fixed = b""
        self._rows: dict[tuple[str, bool], int] = {}

    def constant(self, value: object) -> str:
        name = f"c{len(self.names)}"
        self.names[name] = value
        return name

    def pack(self, layout: str, argument: str) -> None:
        """One more value, or several (`*...`), for the current run."""
        self._end_fixed()
        self._layout += layout
        self._arguments.append(argument)

    def fixed(self, data: bytes) -> None:
        """Bytes that are the same in every message."""
        self._fixed += data

    def part(self, row: str, count: int, place: slice, *, single: bool) -> None:
        """Numbers of a row (of `count` doubles) that is fetched once, whatever number of its parts is used.

        `single`: in single precision, so turned all at once.
        """
        self._end_run()
        size, memory = (4, "singles") if single else (8, "memory")
        if (row, single) not in self._rows:
            start = self._rows[row, single] = self._take_room(size * count)
            self._fills.append(f"{memory}[{start // size}:{start // size + count}] = {row}")
        start = self._rows[row, single]
        self._index += range(start + size * place.start, start + size * place.stop)
        turned = ".astype(single)" if single else ""
        self._parts.append(f"{row}[{place.start}:{place.stop}]{turned}.tobytes()")
        self.size += size * (place.stop - place.start)

    def _take_room(self, size: int) -> int:
        start, self._room = self._room, self._room + -(-size // 8) * 8
        return start

    def block(self, value: str, dtype: np.dtype[Any], size: int) -> None:
        self._end_run()
        self._has_blocks = True
        self._parts.append(f"(v if (v := {value}).dtype is {self.constant(dtype)} else other(v))")
        self.size += size * dtype.itemsize

    def _end_fixed(self) -> None:
        """What is the same in every message becomes part of the current run."""
        if self._fixed:
            self._layout += f"{len(self._fixed)}s"
            self._arguments.append(self.constant(self._fixed))
            self._fixed = b""

    def _end_run(self) -> None:
        if self._fixed and not self._arguments:
            self._parts.append(self.constant(self._fixed))
            start = self._take_room(len(self._fixed))
            self._kept.append((start, self._fixed))
            self._index += range(start, start + len(self._fixed))
            self.size += len(self._fixed)
            self._fixed = b""
        self._end_fixed()
        if not self._arguments:
            return
        run = struct.Struct(self._layout)
        arguments, start = ", ".join(self._arguments), self._take_room(run.size)
        self._parts.append(f"{self.constant(run.pack)}({arguments})")
        self._fills.append(f"{self.constant(run.pack_into)}(bytes_of, {start}, {arguments})")
        self._index += range(start, start + run.size)
        self.size += run.size
        self._layout, self._arguments = "<", []

    def compile(self, tail: str) -> Encoder:
        self._end_run()
        if self._rows and not self._has_blocks:
            lines = ["def encode(r):", *(f"    {fill}" for fill in self._fills)]
            lines += [f"    return take(index).tobytes(){tail}"]
            memory = np.zeros(self._room // 8)
            held = self.names["bytes_of"] = memory.data.cast("B")
            for start, data in self._kept:
                held[start : start + len(data)] = data
            take = memory.view(np.uint8).take
            self.names |= {
                "memory": memory,
                "singles": memory.view(np.float32),
                "take": take,
                "index": np.array(self._index, dtype=np.intp),
            }
        else:
            parts = f"join(({', '.join(self._parts)},))" if len(self._parts) > 1 else "".join(self._parts) or "b''"
            lines = ["def encode(r):", f"    data = {parts}", f"    if len(data) != {self.size}:"]
            lines += ["        raise ValueError('an array is of another length than its field')"]
            lines += [f"    return data{tail}"]
        exec(_code("\n".join(lines)), self.names)
        encoder: Encoder = self.names["encode"]
        return encoder


@cache
def _code(source: str) -> CodeType:
    """Compiled once a process: a millisecond each, too long for a flight's first ticks."""
    return compile(source, "<encoder>", "exec")


def make_encoder(topic: Topic, sample: object, *, blocks: bool = True) -> Encoder:
    """An encoder for records like `sample`: a plain tuple in field order, or any object with the fields' attributes.

    Generated source, as `namedtuple` does it: every part is fetched in place, three times faster than a loop over the
    fields.  With `blocks`, arrays of the field's own type and parts of rows go in as they are; the encoder raises where
    a later record's aren't.  Without, any sequence of the right length will do.
    """
    by_place = type(sample) is tuple
    source = _Source()
    tail = ""
    for place, field in enumerate(topic.fields):
        path = field.path or field.name
        value = f"r[{place}]" if by_place else f"r.{path}"
        if field.type == "string":
            prefix = source.constant(varint((place + 1) << 3 | BYTES))
            tail += f" + (text({prefix}, {value}) if {value} else b'')"
            continue
        source.fixed(_prefix(place + 1, field))
        code = SCALARS[field.type].code
        owner, _, name = ("r." + path).rpartition(".")
        stretch = None
        if blocks and not by_place:
            stretch = _place_in_row(_owner(sample, owner), name, field)
        if stretch is not None:
            source.part(f"{owner}.row", len(_owner(sample, owner).row), stretch, single=field.type == "float")
        elif not field.size:
            source.pack(code, value)
        elif blocks and not by_place and _is_block(_follow(sample, path), field):
            source.block(value, _block_dtype(field), field.size)
        else:
            source.pack(f"{field.size}{code}", f"*{value}")
    return source.compile(tail)


class NumbersEncoder:
    """Many messages of a topic at once, of rows of numbers in its fields' order; none of the fields is a text."""

    def __init__(self, topic: Topic) -> None:
        names: list[str] = []
        formats: list[tuple[str, int]] = []
        offsets: list[int] = []
        self._template, self._columns, at = b"", list[tuple[str, int, int]](), 0
        for place, field in enumerate(topic.fields):
            self._template += _prefix(place + 1, field)
            code, count = SCALARS[field.type].code, max(field.size, 1)
            names.append(field.name)
            formats.append(("<" + code, count))
            offsets.append(len(self._template))
            self._template += bytes(count * struct.calcsize("<" + code))
            self._columns.append((field.name, at, at + count))
            at += count
        self.count = at
        """Numbers of a row."""
        self.size = len(self._template)
        """Bytes of a message."""
        self._type = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": self.size})

    def encode(self, rows: F64) -> U8:
        """(n, k) numbers -> (n, size) bytes."""
        table = np.frombuffer(bytearray(self._template * len(rows)), self._type)
        for name, begin, end in self._columns:
            table[name] = rows[:, begin:end]
        return table.view(np.uint8).reshape(len(rows), self.size)
