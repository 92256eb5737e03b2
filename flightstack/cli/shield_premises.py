"""Whether the vehicle's gains are still what a site's certificate counts on: a station may change them in flight.

Sans-IO.  PX4 tells of each change on every link.  The shield goes on, for nobody flies better with other gains; what it
promised counted on the old ones, and that is said.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from mavlink_bridge.messages import ParamValue

_SAME = 1e-6


class ShieldPremises:
    """Takes every PARAM_VALUE of the vehicle."""

    def __init__(self, counted: Mapping[str, float]) -> None:
        """`counted`: what is counted on, by PX4's names."""
        self._counted = counted
        self._others: set[str] = set()
        self._lines: list[str] = []
        self.changed: set[str] = set()
        """Names that were ever told otherwise."""

    def take(self, message: ParamValue) -> None:
        """One of the vehicle's."""
        name, value = message.param_id, float(message.value)
        counted = self._counted.get(name)
        if counted is None:
            return
        same, before = math.isclose(value, counted, rel_tol=_SAME, abs_tol=1e-12), name not in self._others
        if same == before:
            return
        if same:
            self._others.discard(name)
            rest = f"; {', '.join(sorted(self._others))} still not" if self._others else ""
            self._lines.append(f"{name} is {value:g} again, as the site's certificate counts on{rest}")
            return
        self._others.add(name)
        self.changed.add(name)
        counts = f"the site's certificate counts on {counted:g}"
        self._lines.append(f"{name} is {value:g} now, {counts}: nothing is promised until it is that again")

    def look(self) -> list[str]:
        """What is to be said since the last look."""
        lines, self._lines = self._lines, []
        return lines
