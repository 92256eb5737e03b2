"""The flight's log: an MCAP file that is never in the flight's way.

Written by foxglove-sdk: on this project's messages it takes 1.3 us each, everything included, where `mcap.Writer` takes
6, gives the same bytes for the same input, and touches the file only when told to flush (`chunk_size=None`), so that
every write error shows up in one place.  What the file promises:

* Metadata and attachments come first and are on disk before the first message.
* A chunk is closed after 64 KiB or 0.2 s of the vehicle's time (`compact`: 256 KiB or 0.5 s) and handed to the
  operating system in one go, without seeking back: a killed process loses less than that.
* A `compact` log, which is what flights write, has its fast tables in blocks (`rows`) and is a fifth as large.  What
  explains a tick and is not needed to fly it again (`_EXPLAINING_US`) is in it 25 times a second, /filter also wherever
  it says something else; each tick's digest tells whether the rest was the same.
* Nothing here reads a clock: the same calls give the same bytes.
* Nothing raises in flight.  A full disk or a record that doesn't fit sets `failed`, one line for the user; after a
  write error the log is silent and the file ends with its last complete chunk.
* The file is a plain `io.FileIO`, C without a line of Python, so that Ctrl-C can't strike halfway through a chunk.
"""

from __future__ import annotations

import contextlib
import io
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import foxglove
import numpy as np
from foxglove.mcap import MCAPCompression, MCAPWriteOptions, MCAPWriter

from flightstack.barrier.file import certificate_to_json
from flightstack.barrier.records import Certificate
from flightstack.rows import F_STATUS, L_STAGE
from flightstack.types import F64, InputError, TickRecord
from flightstack_logs import scene as viewer
from flightstack_logs.channels import Channel, block_channel
from flightstack_logs.recorder import Recorder as Recorder
from flightstack_logs.rows import RowBlocks
from flightstack_logs.topics import FINAL_CERTIFICATE, LEVELS, SEVERITIES, TOPICS, Attachment, Topic, severity_names

FORMAT = "flightstack.log/1"
CHUNK_BYTES, COMPACT_CHUNK_BYTES = 64 * 1024, 256 * 1024
FLUSH_PERIOD_US, COMPACT_FLUSH_PERIOD_US = 200_000, 500_000
_ZSTD_LEVEL = 3
"""Of 1.38 MB at 5, a third of whose time it takes, it makes 1.39; of a compact log."""
_EXPLAINING_US = 40_000
_COPY_US = 200_000
"""A thinned copy of a packed topic has a message so often."""
_ARROWS_US = 100_000
_CHANGED = 3.0
"""From this status of the filter on each tick is logged."""
_MESSAGE_OVERHEAD = 31
"""Bytes of a message's record besides its data (mcap.dev/spec)."""
_ABOUT = {
    "format": FORMAT,
    "time": "log times count from 0 at the log's start; /clock has UTC and the vehicle's time since boot",
    "frames": "NED world, FRD body, quaternions w x y z body to world; viewer topics are ENU and FLU",
}


def _options(compact: bool) -> MCAPWriteOptions:
    """LZ4 takes half the time of zstd and gives a file 8 % larger, in a compact log a third larger."""
    return MCAPWriteOptions(
        chunk_size=None,
        disable_seeking=True,
        compression=MCAPCompression.Zstd if compact else MCAPCompression.Lz4,
        compression_level=_ZSTD_LEVEL if compact else 0,
        compression_threads=0,
    )


class FlightLog:
    """A log that is being written; `open` makes one.  Every method but `open` is safe in flight: it never raises."""

    def __init__(self, path: Path, file: io.RawIOBase, *, compact: bool = False) -> None:
        self.path = path
        self.failed: str | None = None
        """The first thing that went wrong, one line."""
        self.messages = 0
        self.rejected = 0
        """Records that didn't fit their topic."""
        self.between_pieces: Callable[[], None] = lambda: None
        """Called before each piece of a chunk that is closed, which takes a fraction of a millisecond."""
        self._file = file
        self._context = foxglove.Context()
        raw: Any = file
        self._sink: MCAPWriter = foxglove.open_mcap(raw, context=self._context, writer_options=_options(compact))
        self._wire = True
        self._blocks = RowBlocks() if compact else None
        self._block_channels: dict[str, foxglove.Channel] = {}
        self._chunk_bytes = COMPACT_CHUNK_BYTES if compact else CHUNK_BYTES
        self._flush_period_us = COMPACT_FLUSH_PERIOD_US if compact else FLUSH_PERIOD_US
        self._explained_us = self._truth_due_us = 0
        self._status = math.nan
        self._last_us = self._arrows_us = 0
        self._channels: dict[str, Channel] = {}
        self._declared: dict[str, Topic] = {}
        self._certificate: tuple[int, Certificate] | None = None
        self._result: Attachment | None = None
        self._silent = False
        self._closed = False
        self._pending = 0
        self._due_us = 0
        self._good_bytes = 0
        self._trail = viewer.VehicleTrail(truth=False)
        self._true_trail = viewer.VehicleTrail(truth=True)

    @property
    def keeps_wire(self) -> bool:
        """Whether datagrams are kept."""
        return self._wire

    @property
    def context(self) -> foxglove.Context:
        """Where its channels are: another sink beside the file sees what is written."""
        return self._context

    @classmethod
    def open(
        cls,
        path: Path | str,
        *,
        metadata: Mapping[str, Mapping[str, str]],
        attachments: Sequence[Attachment] = (),
        overwrite: bool = False,
        compact: bool = False,
        wire: bool = True,
    ) -> FlightLog:
        """Begin a log with what it is about; folders are made.

        `metadata`: name -> (key -> value), such as versions, git commit and seed.  `compact`: fast tables in blocks.
        `wire`: whether datagrams are kept.  InputError, one line, if the file exists already (unless `overwrite`) or
        can't be written.
        """
        path = Path(path)
        try:
            if not path.parent.is_dir():
                path.parent.mkdir(parents=True)
            file = io.FileIO(path, "w" if overwrite else "x")
        except FileExistsError:
            reason = "exists already; choose another name or remove it"
            if path.parent.is_file():
                reason = f"can't be written ({path.parent} is a file); choose another place"
            raise InputError(f"log {path}: {reason}") from None
        except OSError as error:
            raise InputError(f"log {path}: can't be written ({error.strerror}); choose another place") from None
        log = cls(path, file, compact=compact)
        log._wire = wire
        log._begin(metadata, attachments)
        if log.failed is not None:
            log.close()
            if not overwrite:
                path.unlink(missing_ok=True)
            raise InputError(log.failed)
        return log

    def _begin(self, metadata: Mapping[str, Mapping[str, str]], attachments: Sequence[Attachment]) -> None:
        def begin() -> None:
            for name, entries in {"log": _ABOUT, **metadata}.items():
                self._sink.write_metadata(name, dict(entries))
            for item in attachments:
                self._attach(item, 0)

        self._guarded(begin)
        self.flush()

    def _attach(self, item: Attachment, t_ns: int) -> None:
        self._sink.attach(log_time=t_ns, create_time=t_ns, name=item.name, media_type=item.media_type, data=item.data)

    def write(self, topic: str, t_us: int, record: object) -> None:
        """One message: `record` is a plain tuple in the order of the topic's fields, an object with their attributes
        or an array of all their numbers in that order, to which nobody writes any more.

        For RAW and VIEW topics it is the encoded message, for LOG topics (level, name, text).  `t_us`: the log's time.
        A record that doesn't fit is dropped, counted in `rejected` and named in `failed`.
        """
        if self._silent:
            return
        try:
            channel = self._channels.get(topic) or self._open_channel(topic)
            if type(record) is np.ndarray and channel.packed:
                size = self._pack_numbers(channel, topic, t_us, record)
            else:
                if channel.is_log:
                    record = viewer.log_line(t_us, *record)  # type: ignore[misc]
                try:
                    data = channel.encoders[type(record)](record)
                except Exception:  # the first record of its type, or one with other arrays than the first
                    data = channel.encode(record)
                size = len(data)
                if channel.packed:
                    self._pack(channel, topic, t_us, data)
                else:
                    channel.log(data, t_us * 1000)
        except Exception as error:
            self.rejected += 1
            self.failed = self.failed or f"log {self.path}: a record for {topic} doesn't fit ({error})"
            return
        self.messages += 1
        self._pending += size + _MESSAGE_OVERHEAD
        self._last_us = t_us
        if self._pending >= self._chunk_bytes or t_us >= self._due_us:
            self._due_us = t_us + self._flush_period_us
            self.flush()

    def _pack_numbers(self, channel: Channel, topic: str, t_us: int, numbers: F64) -> int:
        """Bytes of the message that will be."""
        encoder, blocks = channel.numbers or channel.open_numbers(), self._blocks
        if numbers.shape != (encoder.count,):
            raise ValueError(f"{numbers.shape} numbers where {encoder.count} belong")
        assert blocks is not None
        if channel.held is None:
            channel.held = blocks.hold(topic, encoder)
        blocks.add_numbers(t_us, numbers, channel.held)
        if t_us >= channel.copy_due_us and channel.is_shown:
            self._copy(channel, t_us, channel.encoders[np.ndarray](numbers))
        return encoder.size

    def _copy(self, channel: Channel, t_us: int, data: bytes) -> None:
        """Of a packed topic for viewers."""
        channel.copy_due_us = t_us - t_us % _COPY_US + _COPY_US
        channel.log(data, t_us * 1000)

    def _pack(self, channel: Channel, topic: str, t_us: int, data: bytes) -> None:
        assert self._blocks is not None
        self._blocks.add(topic, t_us, data)
        if t_us >= channel.copy_due_us and channel.is_shown:
            self._copy(channel, t_us, data)

    def declare(self, topic: Topic) -> None:
        """A topic that is not in the table: what another log calls its own."""
        self._declared[topic.name] = topic

    def _open_channel(self, topic: str) -> Channel:
        said = self._declared.get(topic)
        about = TOPICS[topic] if said is None else said
        packed = self._blocks is not None and about.packed
        channel = self._channels[topic] = Channel(about, self._context, packed=packed)
        return channel

    def mavlink(self, direction: str, t_us: int, data: bytes) -> None:
        """One datagram as it was on the wire; direction rx or tx, seen from the companion."""
        if self._wire:
            self.write("/mavlink/rx" if direction == "rx" else "/mavlink/tx", t_us, data)

    def tick(self, record: TickRecord, t_us: int | None = None) -> None:
        """One tick: /command, /tick; at their own rates /setpoint, /control, /learner, /filter and the views."""
        t_us, write, status = record.t_us if t_us is None else t_us, self.write, record.filtered.row.item(F_STATUS)
        write("/command", t_us, record.command)
        write("/tick", t_us, record)
        explained = self._blocks is None or not self._explained_us - _EXPLAINING_US <= t_us < self._explained_us
        if explained:
            self._explained_us = t_us - t_us % _EXPLAINING_US + _EXPLAINING_US
            write("/setpoint", t_us, record.reference)
            write("/control", t_us, record)
            if record.learned.row.item(L_STAGE) >= 0.0:
                write("/learner", t_us, record.learned)
        if status >= 0.0 and (explained or status != self._status or status >= _CHANGED):
            write("/filter", t_us, record.filtered)
        self._status = status
        if self._trail.is_due(t_us):
            if status >= viewer.ENGAGED and t_us >= self._arrows_us:
                self._arrows_us = t_us + _ARROWS_US
                self._views(t_us, viewer.arrow_views, record)
            self._views(t_us, self._trail.poses, record.measurement)

    def truth(self, t_us: int, truth: object) -> None:
        """The simulator's truth (an object with the fields of /truth); at their own rates, the true pose and path."""
        if self._blocks is None or not self._truth_due_us - _EXPLAINING_US <= t_us < self._truth_due_us:
            self._truth_due_us = t_us - t_us % _EXPLAINING_US + _EXPLAINING_US
            self.write("/truth", t_us, truth)
        if self._true_trail.is_due(t_us):
            self._views(t_us, self._true_trail.poses, truth)

    def scene(self, t_us: int, view: viewer.Shown) -> None:
        """What the 3-D view shows; again whenever it changes."""
        self._views(t_us, viewer.views_of, view)

    def certificate(self, t_us: int, certificate: Certificate) -> None:
        """What the filter keeps to from now on; the last one becomes an attachment when the log is closed."""
        self._certificate = (t_us, certificate)

    def result(self, attachment: Attachment) -> None:
        """What the flight came to; written when the log is closed."""
        self._result = attachment

    def _attach_last(self) -> None:
        if self._result is not None and not self._silent:
            item = self._result
            self._guarded(lambda: self._attach(item, 0))
        if self._certificate is None or self._silent:
            return
        t_us, certificate = self._certificate
        try:
            text = certificate_to_json(certificate)
        except InputError as error:
            self.failed = self.failed or f"log {self.path}: {error}"
            return
        item = Attachment(FINAL_CERTIFICATE, "application/json", text.encode())
        self._guarded(lambda: self._attach(item, t_us * 1000))

    def _views(self, t_us: int, make: Callable[[int, Any], list[viewer.View]], of: object) -> None:
        if self._silent:
            return
        try:
            views = make(t_us, of)
        except Exception as error:
            self.rejected += 1
            self.failed = self.failed or f"log {self.path}: the 3-D view can't be made ({error})"
            return
        for topic, data in views:
            self.write(topic, t_us, data)

    def event(self, t_us: int, name: str, text: str, severity: str = "info") -> None:
        """Something that happened; severity is a level of LEVELS or one of MAVLink's names."""
        level = severity if severity in LEVELS else severity_names(_number_of(severity))[0]
        self.write("/events", t_us, (level, name, text))

    def statustext(self, t_us: int, severity: int, text: str) -> None:
        """A line that the vehicle said, with its MAV_SEVERITY."""
        level, name = severity_names(severity)
        self.write("/vehicle/statustext", t_us, (level, name, text))

    def location(self, t_us: int, latitude_deg: float, longitude_deg: float, altitude_m: float) -> None:
        """Where the vehicle is on the map (altitude above the ellipsoid or mean sea level, as reported)."""
        self.write("/vehicle/location", t_us, viewer.location(t_us, latitude_deg, longitude_deg, altitude_m))

    def flush(self) -> None:
        """Close the chunk and hand it to the operating system: from here on a kill can't lose it."""
        self._pending = 0
        if not self._silent:
            self._guarded(self._flush)

    def _flush(self) -> None:
        for topic, data in () if self._blocks is None else self._blocks.take():
            self.between_pieces()
            channel = self._block_channels.get(topic)
            if channel is None:
                channel = self._block_channels[topic] = block_channel(topic, self._context)
            channel.log(data, log_time=self._last_us * 1000)
        self.between_pieces()
        self._sink.flush()
        self._good_bytes = self._file.tell()

    def meanwhile(self, until_us: int) -> None:
        """Everything is written at once: nothing is left to do."""

    def close(self) -> None:
        """Write the index and close the file; again does nothing."""
        if self._closed:
            return
        self._closed = True
        self._attach_last()
        if not self._silent:
            self._guarded(self._end)
        self._silent = True
        for channel in self._channels.values():
            channel.base.close()
        for block in self._block_channels.values():
            block.close()
        self._channels.clear()
        with contextlib.suppress(OSError):
            self._file.close()

    def _end(self) -> None:
        self._flush()
        self._sink.close()

    def _guarded(self, action: Callable[[], None]) -> None:
        """Do what writes to the file; on an error keep its reason, cut off the torn end and be silent from now on.

        The writer's own panics are BaseExceptions; only a wish to stop the program passes through.
        """
        try:
            action()
        except (KeyboardInterrupt, SystemExit):
            raise
        except BaseException as error:
            self._silent = True
            self.failed = f"log {self.path}: {self._reason(error)}; the log ends here"
            with contextlib.suppress(BaseException):
                self._sink.close()
            with contextlib.suppress(OSError, ValueError):
                self._file.truncate(self._good_bytes)

    def _reason(self, error: BaseException) -> str:
        """Why the file can't be written: the writer's error doesn't carry the system's, so ask once more."""
        try:
            self._file.write(b"\0")
        except OSError as reason:
            return reason.strerror or str(reason)
        except ValueError as reason:
            return str(reason)
        return " ".join(str(error).split())


def _number_of(severity: str) -> int:
    return SEVERITIES.index(severity) if severity in SEVERITIES else SEVERITIES.index("info")
