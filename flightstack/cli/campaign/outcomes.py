"""What can come of a flight."""

COMPLETED, FAILED, REFUSED, CRASHED, TIMED_OUT = "completed", "failed", "refused", "crashed", "timed-out"
OUTCOMES = (COMPLETED, FAILED, REFUSED, CRASHED, TIMED_OUT)
