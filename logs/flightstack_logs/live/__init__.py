"""A flight that can be watched while it is flown: Foxglove's WebSocket and a page, both on loopback."""
