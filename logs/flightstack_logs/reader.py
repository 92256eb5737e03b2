"""Logs in: `read(path)` gives any supported log as typed tables; the kind of file is told by its content.

A further kind is one row in `_KINDS`: how its files begin and the function that reads them.  A `.tlog` begins with a
date and a frame; what begins like none of them and is text is taken for CSV.  Any of them may be packed with gzip.
"""

from __future__ import annotations

import stat
import zlib
from collections.abc import Callable
from pathlib import Path

from flightstack.types import InputError
from flightstack_logs import mcap_file
from flightstack_logs.columns import ColumnMap
from flightstack_logs.readers import cfusdlog, csv_file, dataflash, tlog, ulog
from flightstack_logs.readers.mcap import read_mcap
from flightstack_logs.tables import About, Log, Messages, Table

__all__ = ["About", "Log", "Messages", "Table", "read"]

KNOWN = ".mcap, .ulg, .tlog, .BIN, .csv, Crazyflie .cfusdlog, each also as .gz"
_GZIP = b"\x1f\x8b"
_MOST_BYTES = 4 << 30
"""Of a log once unpacked: a day at full rate; what claims more is no log."""


def read(path: Path | str, columns: ColumnMap | None = None, *, as_logged: bool = False) -> Log:
    """Read a log, a cut-off one as far as it goes; InputError, one line, where there is none to read.

    `columns` says what the columns of a CSV mean that has not this project's header; `as_logged` leaves the vehicle's
    own stamps in a log of this project as they came, on its clock.
    """
    path = Path(path)
    data = bytes_of(path)
    if data.startswith(_GZIP):
        data = _unpacked(path, data)
    for beginning, reader in _KINDS:
        if data.startswith(beginning):
            return read_mcap(path, data, align=False) if as_logged and reader is read_mcap else reader(path, data)
        if beginning.startswith(data):
            raise InputError(f"log {path}: is cut off within its first bytes; there is nothing to read in it")
    if tlog.begins_like_a_tlog(data):
        return tlog.read_tlog(path, data)
    if csv_file.is_text_table(data):
        return csv_file.read_csv(path, data, columns)
    raise InputError(f"log {path}: is of no known kind (known: {KNOWN}); name a flight log")


def bytes_of(path: Path) -> bytes:
    """All of a log's file; InputError, one line, where it can't be read, is empty, no file or too large to be a log."""
    try:
        about = path.stat()
        if not stat.S_ISREG(about.st_mode):
            raise InputError(f"log {path}: is no file; name a flight log")
        if about.st_size > _MOST_BYTES:
            raise InputError(
                f"log {path}: has {about.st_size / 1e9:.0f} GB, more than {_MOST_BYTES >> 30} GB are not read"
            )
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"log {path}: can't be read ({error.strerror}); check the path") from None
    except MemoryError:
        raise InputError(f"log {path}: does not fit into this machine's memory; cut it") from None
    if not data:
        raise InputError(f"log {path}: is empty; nothing was ever written to it")
    return data


def _unpacked(path: Path, data: bytes) -> bytes:
    """What gzip packed, a cut-off file as far as it goes."""
    unpack = zlib.decompressobj(31)
    try:
        out = unpack.decompress(data, _MOST_BYTES)
    except zlib.error as error:
        raise InputError(f"log {path}: is a damaged gzip file ({error}); unpack or copy it again") from None
    if unpack.unconsumed_tail:
        raise InputError(f"log {path}: unpacks to more than {_MOST_BYTES >> 30} GB; that is no flight log")
    if not out:
        raise InputError(f"log {path}: is a gzip file with nothing in it; name a flight log")
    return out


_KINDS: tuple[tuple[bytes, Callable[[Path, bytes], Log]], ...] = (
    (mcap_file.MAGIC, read_mcap),
    (ulog.MAGIC, ulog.read_ulog),
    (dataflash.MAGIC, dataflash.read_dataflash),
    (cfusdlog.MAGIC, cfusdlog.read_cfusdlog),
)
