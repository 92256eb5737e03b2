"""`python -m flightstack`: the command line of exactly this interpreter's environment."""

from __future__ import annotations

from flightstack.cli.start import main

if __name__ == "__main__":
    main()
