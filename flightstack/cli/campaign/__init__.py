"""Many flights from one file: what is varied, how they are flown, kept and counted."""
