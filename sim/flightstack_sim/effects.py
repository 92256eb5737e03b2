"""The table of the effects; each has its file in `flightstack.effects`."""

from flightstack.effects import EFFECTS as EFFECTS
