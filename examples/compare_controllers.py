"""Compare two controllers on the same flight: `python examples/compare_controllers.py [SECONDS]`."""

import sys
import tempfile
from pathlib import Path

from flightstack.api import FlyOptions, fly

CONTROLLERS = ("flatness", "px4")


def main(duration_s: float) -> dict[str, float]:
    """Each controller's settled error on a figure of eight, metres."""
    errors_m = {}
    with tempfile.TemporaryDirectory() as folder:
        for controller in CONTROLLERS:
            result = fly(
                FlyOptions(
                    scenario="figure8",
                    controller=controller,
                    duration_s=duration_s,
                    learning=False,
                    filtering=False,
                    out=Path(folder) / controller,
                )
            )
            errors_m[controller] = result.tracking["rmse_settled_m"]
    return errors_m


if __name__ == "__main__":
    for name, error_m in main(float(sys.argv[1]) if len(sys.argv) > 1 else 40.0).items():
        print(f"{name:12} {100.0 * error_m:6.1f} cm rms")
