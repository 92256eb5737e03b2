"""The three kinds of a finding."""

from __future__ import annotations

from flightstack.gap.records import Finding


def ok(name: str, text: str) -> Finding:
    """Nothing to do."""
    return Finding(name, "ok", text)


def warning(name: str, text: str) -> Finding:
    """Mended, or worth knowing."""
    return Finding(name, "warning", text)


def refused(name: str, text: str) -> Finding:
    """The log can't be used; `text` says why and what to do instead."""
    return Finding(name, "refused", text)
