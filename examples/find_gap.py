"""What does this vehicle have that its file does not say?  `python examples/find_gap.py` flies one and asks its log."""

import tempfile
from dataclasses import replace
from pathlib import Path

from flightstack.api import FlyOptions, GapResult, analyse, fly, load_vehicle, vehicle_to_toml


def main(payload_kg: float) -> GapResult:
    """Fly a figure of eight with a load that the vehicle's file lacks; what the log tells of it."""
    believed, _ = load_vehicle("quad-x")
    with tempfile.TemporaryDirectory() as folder:
        truth = Path(folder) / "truth.toml"
        loaded = replace(believed, effects={**believed.effects, "payload": {"mass_kg": payload_kg}})
        truth.write_text(vehicle_to_toml(loaded))
        result = fly(FlyOptions(scenario="figure8", truth=str(truth), learning=False, out=Path(folder) / "flight"))
        return analyse([Path(result.log)], believed)


if __name__ == "__main__":
    found = main(0.25)
    for effect in found.found:
        for name, number in effect.parameters.items():
            print(f"{effect.name}.{name} = {number.estimate:.3f} (95 %: {number.low:.3f} to {number.high:.3f})")
    print(found.sentence)
