"""What each kind of log calls the signals of a flight."""

DERIVED = "derived from"
"""How the source of a signal begins that no sensor or estimator gave."""
FREED = "freed of bias"
"""How the source of a signal ends from which an estimator's idea of the bias was subtracted."""
DERIVED_HZ = 4.0
"""Up to here a derived signal says what a measured one would."""
