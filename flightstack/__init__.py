"""The core of the flight stack: pure computation, no sockets, clocks, open files or threads."""
