"""What a flight of the test kit was: kept in memory, written as a log and a page when somebody wants them."""

from __future__ import annotations

from pathlib import Path

from flightstack_sim.plant import Truth
from flightstack_sim.shell import ONBOARD

UNIX_AT_BOOT_US = 1_767_225_600_000_000
"""The log's UTC: the simulated clock's, so that equal flights give equal logs."""


class Recording:
    """Truth every 4 ms and every datagram, in order."""

    __slots__ = ("_datagrams", "_truths")

    def __init__(self) -> None:
        self._truths: list[Truth] = []
        self._datagrams: list[tuple[str, int, int, bytes]] = []

    def truth(self, truth: Truth) -> None:
        """One tick."""
        self._truths.append(truth)

    def datagram(self, direction: str, t_us: int, link: int, data: bytes) -> None:
        """One datagram; direction rx or tx as the client sees it."""
        self._datagrams.append((direction, t_us, link, data))

    def bytes_of(self, link: int = ONBOARD) -> bytes:
        """Everything that the vehicle has sent on a link."""
        return b"".join(data for direction, _, index, data in self._datagrams if direction == "rx" and index == link)

    def write(self, path: Path, settings: dict[str, str], vehicle_text: str) -> Path:
        """The log: truth, what the offboard link carried, what came on any.  InputError where it can't be written."""
        # half a second of imports, for a flight whose log is wanted
        from flightstack.cli.versions import versions
        from flightstack_logs.log_clock import clock_metadata
        from flightstack_logs.topics import Attachment
        from flightstack_logs.writer import FlightLog

        clock = clock_metadata(UNIX_AT_BOOT_US, simulated=True)
        metadata = {"settings": settings, "versions": versions(), "clock": clock}
        path.parent.mkdir(parents=True, exist_ok=True)
        truth = Attachment.of_text("truth.toml", vehicle_text)
        log = FlightLog.open(path, metadata=metadata, attachments=(truth,), overwrite=True)
        wire = [one for one in self._datagrams if one[2] == ONBOARD or one[0] == "tx"]
        waiting = 0
        for state in self._truths:
            while waiting < len(wire) and wire[waiting][1] <= state.t_us:
                direction, t_us, _, data = wire[waiting]
                log.mavlink(direction, t_us, data)
                waiting += 1
            log.truth(state.t_us, state)
        for direction, t_us, _, data in wire[waiting:]:
            log.mavlink(direction, t_us, data)
        log.close()
        return path

    def report(self, log: Path, page: Path) -> Path:
        """The page of a log that was written."""
        from flightstack_logs.reader import read
        from flightstack_logs.report.log_input import from_log
        from flightstack_logs.report.page import write_report

        return write_report(from_log(read(log)), page)
