"""The only sockets, ports and clock of the project."""
