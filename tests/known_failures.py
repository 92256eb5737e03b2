"""Tests that fail today, each with what is open; they run, and the list must shrink.  None does."""

OPEN: dict[str, str] = {}
