"""One set of hidden values for each effect of the table, on the default vehicle, and the flights that hide them."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from flightstack.gap.name import Selection, name
from flightstack.gap.records import Samples
from flightstack.vehicle import Vehicle, parse_vehicle, with_effects
from tests.gap_batch import fly

HIDDEN: dict[str, dict[str, float]] = {
    "payload": {"mass_kg": 0.2},
    "thrust_scale": {"scale": 0.92},
    "thrust_curve": {"thrust_model_factor": 0.7},
    "rotor_fault": {"rotor": 3.0, "effectiveness": 0.9},
    "com_offset": {"x_m": 0.01, "y_m": -0.006, "z_m": 0.0},
    "inertia": {"scale_x": 1.3, "scale_y": 0.8, "scale_z": 1.2},
    "motor_lag": {"time_constant_s": 0.035},
    "transport_delay": {"delay_s": 0.012},
    "battery_sag": {"thrust_loss_per_v": 0.05},
    "linear_drag": {"d_x_kgps": 0.35, "d_y_kgps": 0.35, "d_z_kgps": 0.5},
    "angular_damping": {"k_x_nms": 0.03, "k_y_nms": 0.03, "k_z_nms": 0.04},
    "rotor_drag": {"k_d_kg_per_rad": 1.6e-4},
    "induced_inflow": {"k_z_kg_per_rad": 1.6e-4},
    "parasitic_drag": {"c_x_kg_per_m": 0.06, "c_y_kg_per_m": 0.06, "c_z_kg_per_m": 0.08},
    "translational_lift": {"k_h_kg_per_m": 0.012},
    "blade_flapping": {"k_flap_nms2_per_rad_m": 3e-6},
    "rotor_gyroscopic": {"rotor_inertia_kgm2": 1e-4},
    "ground_effect": {"strength": 2.5},
    "vortex_ring": {"strength": 0.3},
    "steady_wind": {"north_mps": 3.0, "east_mps": -2.0, "down_mps": 0.0},
    "constant_force": {"north_n": 1.0, "east_n": 0.5, "down_n": 0.0},
    "turbulence": {"sigma_mps": 1.0, "length_m": 10.0},
    "slung_load": {"mass_kg": 0.2, "length_m": 0.8},
    "accelerometer_bias": {"x_mps2": 0.3, "y_mps2": -0.2, "z_mps2": 0.25},
    "gyro_bias": {"x_radps": 0.02, "y_radps": -0.03, "z_radps": 0.01},
    "attitude_misalignment": {"roll_rad": 0.03, "pitch_rad": -0.04, "yaw_rad": 0.05},
}
ACT_THROUGH_DRAG = ("steady_wind", "turbulence")
SECONDS = 24.0


@cache
def believed() -> Vehicle:
    """The default vehicle with a drag that its file knows: without one, no wind could ever show.

    It differs from axis to axis, else a wind and a constant force would be the same thing.
    """
    path = Path(__file__).resolve().parents[1] / "flightstack/data/vehicles" / "quad-x.toml"
    plain = parse_vehicle(path.read_text("utf-8"), "quad-x.toml")
    return with_effects(plain, {"linear_drag": {"d_x_kgps": 0.5, "d_y_kgps": 0.2, "d_z_kgps": 0.3}})


@cache
def flights() -> dict[str, Samples]:
    """Effect -> flight in which it is hidden; "" -> a flight in which nothing is."""
    hidden = [{}, *({effect: values} for effect, values in HIDDEN.items())]
    return dict(zip(("", *HIDDEN), fly(believed(), hidden, seconds=SECONDS), strict=True))


def named(samples: Samples) -> Selection:
    """The verdict, the last fifth held out."""
    at = samples.t_s - samples.t_s[0]
    return name(believed(), [samples], [at < 0.78 * SECONDS], [at > 0.82 * SECONDS])
