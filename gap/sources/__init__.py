"""What each kind of log calls the signals of a flight."""
