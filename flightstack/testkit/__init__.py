"""The simulator as a test kit: a vehicle in one's own tests, moved by the test's clock.

`Px4Sim` is what the pytest fixtures `px4_sim` and `px4_fleet` give; it also works without pytest.  `SteppedVehicle` is
physics and sensors alone.  Nothing heavy is imported before one of them is asked for.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from flightstack.testkit.fleet import Fleet
    from flightstack.testkit.px4_sim import Px4Sim
    from flightstack.testkit.vehicle import Rates, SteppedVehicle

_HOME = {"Fleet": "fleet", "Px4Sim": "px4_sim", "Rates": "vehicle", "SteppedVehicle": "vehicle"}
__all__ = ["Fleet", "Px4Sim", "Rates", "SteppedVehicle"]


def __getattr__(name: str) -> Any:
    home = _HOME.get(name)
    if home is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"flightstack.testkit.{home}"), name)
