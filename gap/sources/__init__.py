"""What each kind of log calls the signals of a flight."""

DERIVED = "derived from"
"""How the source of a signal begins that no sensor or estimator gave."""
