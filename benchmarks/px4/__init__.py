"""What flightstack does on a real PX4: `make px4`, the table of docs/px4.md.

PX4 is not part of this repository.  `PX4_HOME` names a folder with an executable `run.sh INSTANCE [sih|hil]`, which
runs a PX4 (SITL) in the foreground until SIGTERM, with default parameters where FRESH=1 is set.

One file in `subjects/` is one subject.  It defines

    ASKED: str                                   what must be reached, for the table
    RUNS: int                                    flights when all are flown
    def run(bench: Bench, runs: int) -> list[Row]

and may use `station.Px4` (one PX4, its ground truth and its parameters) and `companion` (`flightstack` in a process
of its own).  The table keeps the rows of subjects that are not run.
"""
