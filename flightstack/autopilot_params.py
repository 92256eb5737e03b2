"""PX4's parameters of the rate loop and the allocation, as a vehicle file's table `[autopilot]` names them.

Names, defaults and ranges are PX4's (its public parameter reference).  The three K have no default of their own: PX4
tunes them for each airframe, and so does `flightstack.autopilot` where a file leaves them out.
"""

from __future__ import annotations

from typing import NamedTuple

AXES = ("roll", "pitch", "yaw")


class AutopilotParam(NamedTuple):
    """One key of `[autopilot]`."""

    name: str
    """PX4's."""
    default: float | None
    """None: follows from the airframe."""
    minimum: float
    maximum: float


def _gains(axis: str, p: float, i: float, d: float, most_p: float) -> dict[str, AutopilotParam]:
    key, name = f"mc_{axis}rate_", f"MC_{axis.upper()}RATE_"
    return {
        f"{key}p": AutopilotParam(f"{name}P", p, 0.0 if axis == "yaw" else 0.01, most_p),
        f"{key}i": AutopilotParam(f"{name}I", i, 0.0, 10.0),
        f"{key}d": AutopilotParam(f"{name}D", d, 0.0, 1.0),
        f"{key}ff": AutopilotParam(f"{name}FF", 0.0, 0.0, 10.0),
        f"{key}k": AutopilotParam(f"{name}K", None, 0.01, 5.0),
        f"{key}max": AutopilotParam(f"{name}MAX", 200.0 if axis == "yaw" else 220.0, 30.0, 1800.0),
    }


AUTOPILOT_PARAMS: dict[str, AutopilotParam] = {
    **_gains("roll", 0.15, 0.2, 0.003, 0.5),
    **_gains("pitch", 0.15, 0.2, 0.003, 0.6),
    **_gains("yaw", 0.2, 0.1, 0.0, 0.6),
    "mc_rr_int_lim": AutopilotParam("MC_RR_INT_LIM", 0.3, 0.0, 10.0),
    "mc_pr_int_lim": AutopilotParam("MC_PR_INT_LIM", 0.3, 0.0, 10.0),
    "mc_yr_int_lim": AutopilotParam("MC_YR_INT_LIM", 0.3, 0.0, 10.0),
    "imu_gyro_cutoff": AutopilotParam("IMU_GYRO_CUTOFF", 40.0, 0.0, 1000.0),
    "imu_dgyro_cutoff": AutopilotParam("IMU_DGYRO_CUTOFF", 20.0, 0.0, 1000.0),
    "mc_yaw_tq_cutoff": AutopilotParam("MC_YAW_TQ_CUTOFF", 2.0, 0.0, 10.0),
    "thr_mdl_fac": AutopilotParam("THR_MDL_FAC", 0.0, 0.0, 1.0),
    "airmode": AutopilotParam("MC_AIRMODE", 0.0, 0.0, 2.0),
}
"""Key -> PX4's parameter.  Rates in deg/s, cut-offs in Hz (0: no filter), the rest in PX4's own units."""
