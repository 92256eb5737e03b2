"""Step the plant alone, with a controller of one's own: `python examples/plant_alone.py`."""

from flightstack.testkit import Rates, SteppedVehicle

HEIGHT_M = 2.0
HOVER = 0.45


def fly(seconds: float) -> list[float]:
    """Heights of a vehicle that a proportional-derivative controller brings to HEIGHT_M, one each 4 ms."""
    vehicle = SteppedVehicle("quad-x", seed=1)
    heights_m, integral = [], 0.0
    truth = vehicle.truth
    while vehicle.now_s < seconds:
        error_m = HEIGHT_M + truth.pos_ned_m[2]
        integral += 0.02 * error_m * 0.004
        thrust = HOVER + 0.1 * error_m + integral + 0.12 * truth.vel_ned_mps[2]
        truth = vehicle.step(Rates((0.0, 0.0, 0.0), min(max(thrust, 0.0), 1.0)))
        heights_m.append(-truth.pos_ned_m[2])
    return heights_m


if __name__ == "__main__":
    flown_m = fly(15.0)
    print(f"after 15 s: {flown_m[-1]:.2f} m, at most {max(flown_m):.2f} m")
