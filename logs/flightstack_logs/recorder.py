"""What a flight may call to be recorded, whoever keeps it, and shows it; and who keeps nothing."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from flightstack.barrier.records import Certificate
    from flightstack.types import TickRecord
    from flightstack_logs import scene as viewer
    from flightstack_logs.topics import Attachment


class Recorder(Protocol):
    """What a flight may call, whether the log is written at once (`FlightLog`) or by a thread (`ThreadedLog`)."""

    @property
    def failed(self) -> str | None:
        """The first thing that went wrong, one line."""

    @property
    def keeps_wire(self) -> bool:
        """Whether `mavlink` keeps anything; a tick that knows need not call it for each datagram."""

    def write(self, topic: str, t_us: int, record: object) -> None:
        """One message of a topic of the table."""

    def mavlink(self, direction: str, t_us: int, data: bytes) -> None:
        """One datagram as it was on the wire; direction rx or tx, seen from the companion."""

    def tick(self, record: TickRecord, t_us: int | None = None) -> None:
        """One tick of the stack; `t_us`: log time, where it is not the vehicle's."""

    def truth(self, t_us: int, truth: object) -> None:
        """The simulator's truth."""

    def event(self, t_us: int, name: str, text: str, severity: str = "info") -> None:
        """Something that happened."""

    def statustext(self, t_us: int, severity: int, text: str) -> None:
        """A line that the vehicle said, with its MAV_SEVERITY."""

    def location(self, t_us: int, latitude_deg: float, longitude_deg: float, altitude_m: float) -> None:
        """Where the vehicle is on the map."""

    def scene(self, t_us: int, view: viewer.Shown) -> None:
        """What the 3-D view shows; again whenever it changes."""

    def certificate(self, t_us: int, certificate: Certificate) -> None:
        """What the filter keeps to from now on; the last one becomes an attachment when the log is closed."""

    def result(self, attachment: Attachment) -> None:
        """What the flight came to; written when the log is closed."""

    def meanwhile(self, until_us: int) -> None:
        """The loop sleeps until then, by time.monotonic."""

    def close(self) -> None:
        """Finish the file; again does nothing."""


class NoLog:
    """The recorder of a flight whose log nobody wants: what is made for a log alone need not be made."""

    path = failed = None
    keeps_wire = False

    def _not_kept(self, *call: object, **named: object) -> None:
        pass

    def tick(self, record: TickRecord, t_us: int | None = None) -> None:
        """One tick of the stack."""

    def truth(self, t_us: int, truth: object) -> None:
        """The simulator's truth."""

    write = mavlink = event = statustext = location = scene = certificate = result = meanwhile = close = _not_kept
