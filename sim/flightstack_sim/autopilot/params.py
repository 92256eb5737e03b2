"""PX4's parameters: one table, and a vehicle's own copy of its values.

Names, types, defaults and units are PX4's (its public parameter reference); the defaults are those that a PX4 with its
internal simulator reported.  Only parameters that the simulated autopilot acts on, or that offboard clients commonly
read, are here.  A few defaults follow the vehicle file instead (`vehicle_defaults`): the hover thrust and the
rotors' places, and the rate loops' K, which PX4 tunes for each airframe.
"""

from __future__ import annotations

import math
import struct
from bisect import bisect_left
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum

from flightstack.types import InputError


class ParamType(IntEnum):
    """MAV_PARAM_TYPE of the two types that PX4 uses."""

    INT32 = 6
    REAL32 = 9


class ParamResult(IntEnum):
    """Outcome of setting a parameter; the numbers are MAVLink's MAV_PARAM_ERROR."""

    OK = 0
    DOES_NOT_EXIST = 1
    VALUE_OUT_OF_RANGE = 2
    READ_ONLY = 5
    TYPE_MISMATCH = 7


@dataclass(frozen=True, slots=True)
class Px4ParamSpec:
    """One parameter: its PX4 name, type, default, allowed range (inclusive), unit and meaning."""

    name: str
    type: ParamType
    default: float
    minimum: float
    maximum: float
    unit: str
    text: str


def _i(name: str, default: int, minimum: int, maximum: int, text: str, unit: str = "") -> Px4ParamSpec:
    return Px4ParamSpec(name, ParamType.INT32, default, minimum, maximum, unit, text)


def _f(name: str, default: float, minimum: float, maximum: float, unit: str, text: str) -> Px4ParamSpec:
    return Px4ParamSpec(name, ParamType.REAL32, _float32(default), minimum, maximum, unit, text)


def _float32(value: float) -> float:
    """The nearest value that PX4's 32-bit float can hold."""
    return float(struct.unpack("<f", struct.pack("<f", value))[0])


_INT_MAX = 2**31 - 1


def _rotor(index: int, x: float, y: float, km: float) -> tuple[Px4ParamSpec, ...]:
    n = f"CA_ROTOR{index}_"
    return (
        _f(n + "PX", x, -100.0, 100.0, "m", "Rotor's place along body x"),
        _f(n + "PY", y, -100.0, 100.0, "m", "Rotor's place along body y"),
        _f(n + "PZ", 0.0, -100.0, 100.0, "m", "Rotor's place along body z"),
        _f(n + "CT", 6.5, 0.0, 100.0, "", "Thrust coefficient"),
        _f(n + "KM", km, -1.0, 1.0, "", "Moment coefficient, positive for counter-clockwise"),
    )


_UNSORTED: tuple[Px4ParamSpec, ...] = (
    # battery
    _f("BAT_LOW_THR", 0.15, 0.12, 0.5, "norm", "Charge at which the battery is low"),
    _f("BAT_CRIT_THR", 0.07, 0.05, 0.5, "norm", "Charge at which the battery is critical"),
    _f("BAT_EMERGEN_THR", 0.05, 0.03, 0.5, "norm", "Charge at which the battery is an emergency"),
    _i("BAT1_N_CELLS", 4, -1, 16, "Cells in series"),
    _f("SIM_BAT_DRAIN", 60.0, 1.0, 86400.0, "s", "Time in which the simulated battery loses half its charge"),
    _f("SIM_BAT_MIN_PCT", 50.0, 0.0, 100.0, "%", "Charge at which the simulated battery stays"),
    # control allocation: the rotors of the vehicle file
    _i("CA_AIRFRAME", 0, 0, 15, "0 is a multirotor"),
    _i("CA_METHOD", 2, 0, 2, "2 is automatic: sequential desaturation for a multirotor"),
    _i("CA_ROTOR_COUNT", 4, 0, 12, "Number of rotors"),
    *_rotor(0, 1.0, 1.0, 0.05),
    *_rotor(1, -1.0, -1.0, 0.05),
    *_rotor(2, 1.0, -1.0, -0.05),
    *_rotor(3, -1.0, 1.0, -0.05),
    *(_i(f"PWM_MAIN_FUNC{n}", 100 + n, 0, 2000, "Function of the output; 101 is motor 1") for n in range(1, 5)),
    _f("THR_MDL_FAC", 0.0, 0.0, 1.0, "", "Thrust curve that the outputs undo: f u^2 + (1 - f) u"),
    # commander
    _i("CBRK_FLIGHTTERM", 121212, 0, 121212, "Circuit breaker for flight termination"),
    _i("CBRK_SUPPLY_CHK", 0, 0, 894281, "Circuit breaker for the supply check"),
    _i("COM_ARMABLE", 1, 0, 1, "Arming is possible at all"),
    _i("COM_ARM_WO_GPS", 1, 0, 2, "Arming without GPS: 0 refused, 1 allowed with a warning"),
    _f("COM_DISARM_LAND", 2.0, -1.0, 3600.0, "s", "Disarm this long after landing; negative: never"),
    _f("COM_DISARM_PRFLT", 10.0, -1.0, 3600.0, "s", "Disarm when not taken off in this time; negative: never"),
    _i("COM_DL_LOSS_T", 10, 5, 300, "Ground station counts as lost after", "s"),
    _f("COM_FAIL_ACT_T", 5.0, 0.0, 25.0, "s", "Hold this long before a failsafe action"),
    _i("COM_FLTMODE1", -1, -1, 108, "Mode of the first switch position"),
    _i("COM_LOW_BAT_ACT", 3, 0, 3, "Low battery: 0 warn, 2 land, 3 return, then land"),
    _i("COM_OBL_RC_ACT", 0, 0, 7, "Offboard lost: 0 position, 3 return, 4 land, 5 hold, 6 terminate, 7 disarm"),
    _f("COM_OF_LOSS_T", 1.0, 0.0, 60.0, "s", "Offboard signal counts as lost after"),
    _f("COM_POS_FS_EPH", 5.0, -1.0, 400.0, "m", "Horizontal position error that counts as lost"),
    _f("COM_VEL_FS_EVH", 1.0, 0.0, 400.0, "m/s", "Horizontal velocity error that counts as lost"),
    _i("COM_RCL_EXCEPT", 0, 0, 31, "Modes in which lost manual control is ignored: bit 2 is offboard"),
    _i("COM_RC_IN_MODE", 1, 0, 8, "Manual control: 0 RC, 1 MAVLink, 4 disabled"),
    _f("COM_RC_LOSS_T", 0.5, 0.0, 35.0, "s", "Manual control counts as lost after"),
    _i("COM_RC_OVERRIDE", 1, 0, 3, "Sticks take over: bit 0 in automatic modes, bit 1 in offboard"),
    _f("COM_RC_STICK_OV", 30.0, 5.0, 80.0, "%", "Stick movement that takes over"),
    _f("COM_SPOOLUP_TIME", 1.0, 0.0, 30.0, "s", "Motors spin up this long before take-off"),
    _i("COM_TAKEOFF_ACT", 0, 0, 1, "After take-off: 0 hold, 1 mission"),
    # geofence
    _i("GF_ACTION", 2, 0, 5, "Outside the fence: 0 none, 1 warn, 2 hold, 3 return, 4 terminate, 5 land"),
    _f("GF_MAX_HOR_DIST", 0.0, 0.0, 10000.0, "m", "Fence's radius round home; 0: none"),
    _f("GF_MAX_VER_DIST", 0.0, 0.0, 10000.0, "m", "Fence's height over home; 0: none"),
    # filters of the rate loop
    _f("IMU_DGYRO_CUTOFF", 20.0, 0.0, 1000.0, "Hz", "Cut-off of the angular acceleration; 0: none"),
    _f("IMU_GYRO_CUTOFF", 40.0, 0.0, 1000.0, "Hz", "Cut-off of the gyro; 0: none"),
    _i("IMU_GYRO_RATEMAX", 800, 100, 2000, "Most gyro samples a second in the rate loop", "Hz"),
    _i("IMU_INTEG_RATE", 250, 100, 1000, "Rate of the integrated IMU", "Hz"),
    # land detector
    _f("LNDMC_ALT_GND", 2.0, -1.0, 100.0, "m", "Height below which the ground counts as near"),
    _f("LNDMC_ROT_MAX", 20.0, 0.0, 1000.0, "deg/s", "Most body rate when landed"),
    _f("LNDMC_XY_VEL_MAX", 1.5, 0.0, 1000.0, "m/s", "Most horizontal speed when landed"),
    _f("LNDMC_Z_VEL_MAX", 0.25, 0.0, 1000.0, "m/s", "Most vertical speed when landed"),
    # MAVLink
    _i("MAV_SYS_ID", 1, 1, 250, "System id"),
    _i("MAV_COMP_ID", 1, 1, 250, "Component id"),
    _i("MAV_TYPE", 2, 0, 22, "MAV_TYPE of the heartbeat; 2 is a quadrotor"),
    _i("MAV_PROTO_VER", 2, 1, 2, "MAVLink version"),
    # attitude and rate control
    _i("MC_AIRMODE", 0, 0, 2, "Raise thrust for attitude: 0 never"),
    _i("MC_BAT_SCALE_EN", 0, 0, 1, "Scale the outputs with the battery"),
    _f("MC_PITCHRATE_D", 0.003, 0.0, 1.0, "", "Pitch rate D"),
    _f("MC_PITCHRATE_FF", 0.0, 0.0, 10.0, "", "Pitch rate feed-forward"),
    _f("MC_PITCHRATE_I", 0.2, 0.0, 10.0, "", "Pitch rate I"),
    _f("MC_PITCHRATE_K", 1.0, 0.01, 5.0, "", "Pitch rate gain over all"),
    _f("MC_PITCHRATE_MAX", 220.0, 0.0, 1800.0, "deg/s", "Most pitch rate asked for by the attitude loop"),
    _f("MC_PITCHRATE_P", 0.15, 0.01, 0.6, "", "Pitch rate P"),
    _f("MC_PITCH_P", 4.0, 0.0, 12.0, "1/s", "Pitch P"),
    _f("MC_PR_INT_LIM", 0.3, 0.0, 10.0, "", "Pitch rate integrator limit"),
    _f("MC_ROLLRATE_D", 0.003, 0.0, 1.0, "", "Roll rate D"),
    _f("MC_ROLLRATE_FF", 0.0, 0.0, 10.0, "", "Roll rate feed-forward"),
    _f("MC_ROLLRATE_I", 0.2, 0.0, 10.0, "", "Roll rate I"),
    _f("MC_ROLLRATE_K", 1.0, 0.01, 5.0, "", "Roll rate gain over all"),
    _f("MC_ROLLRATE_MAX", 220.0, 0.0, 1800.0, "deg/s", "Most roll rate asked for by the attitude loop"),
    _f("MC_ROLLRATE_P", 0.15, 0.01, 0.5, "", "Roll rate P"),
    _f("MC_ROLL_P", 4.0, 0.0, 12.0, "1/s", "Roll P"),
    _f("MC_RR_INT_LIM", 0.3, 0.0, 10.0, "", "Roll rate integrator limit"),
    _f("MC_YAWRATE_D", 0.0, 0.0, 1.0, "", "Yaw rate D"),
    _f("MC_YAWRATE_FF", 0.0, 0.0, 10.0, "", "Yaw rate feed-forward"),
    _f("MC_YAWRATE_I", 0.1, 0.0, 10.0, "", "Yaw rate I"),
    _f("MC_YAWRATE_K", 1.0, 0.01, 5.0, "", "Yaw rate gain over all"),
    _f("MC_YAWRATE_MAX", 200.0, 0.0, 1800.0, "deg/s", "Most yaw rate asked for by the attitude loop"),
    _f("MC_YAWRATE_P", 0.2, 0.0, 0.6, "", "Yaw rate P"),
    _f("MC_YAW_P", 2.8, 0.0, 5.0, "1/s", "Yaw P"),
    _f("MC_YAW_TQ_CUTOFF", 2.0, 0.0, 10.0, "Hz", "Cut-off of the yaw torque; 0: none"),
    _f("MC_YAW_WEIGHT", 0.4, 0.0, 1.0, "", "Yaw's priority below roll and pitch"),
    _f("MC_YR_INT_LIM", 0.3, 0.0, 10.0, "", "Yaw rate integrator limit"),
    # take-off, missions, position control
    _f("MIS_TAKEOFF_ALT", 2.5, 0.0, 1000.0, "m", "Height of a take-off that names none"),
    _f("MPC_ACC_DOWN_MAX", 3.0, 2.0, 15.0, "m/s^2", "Most downward acceleration of a trajectory"),
    _f("MPC_MAN_TILT_MAX", 35.0, 1.0, 70.0, "deg", "Lean at full stick"),
    _f("MPC_MAN_Y_MAX", 150.0, 0.0, 400.0, "deg/s", "Yaw rate at full stick"),
    _f("MPC_MANTHR_MIN", 0.08, 0.0, 1.0, "norm", "Thrust at the throttle's lower end"),
    _f("MPC_VEL_MANUAL", 10.0, 3.0, 20.0, "m/s", "Velocity at full stick"),
    _i("FD_FAIL_P", 60, 0, 180, "Pitch that counts as a failure; 0: none", "deg"),
    _f("FD_FAIL_P_TTRI", 0.3, 0.02, 5.0, "s", "after so long"),
    _i("FD_FAIL_R", 60, 0, 180, "Roll that counts as a failure; 0: none", "deg"),
    _f("FD_FAIL_R_TTRI", 0.3, 0.02, 5.0, "s", "after so long"),
    _i("SYS_FAILURE_EN", 1, 0, 1, "Failure injection is allowed"),
    _f("MPC_ACC_HOR", 3.0, 2.0, 15.0, "m/s^2", "Horizontal acceleration of a trajectory"),
    _f("MPC_ACC_HOR_MAX", 5.0, 2.0, 15.0, "m/s^2", "Most horizontal acceleration of a trajectory"),
    _f("MPC_ACC_UP_MAX", 4.0, 2.0, 15.0, "m/s^2", "Most upward acceleration of a trajectory"),
    _f("MPC_JERK_AUTO", 4.0, 1.0, 80.0, "m/s^3", "Jerk of a trajectory"),
    _f("MPC_LAND_ALT1", 10.0, 0.0, 1000.0, "m", "Descent slows down below"),
    _f("MPC_LAND_ALT2", 5.0, 0.0, 1000.0, "m", "Descent has its landing speed below"),
    _f("MPC_LAND_CRWL", 0.3, 0.1, 5.0, "m/s", "Descent right above the ground, with a distance sensor"),
    _f("MPC_LAND_SPEED", 0.7, 0.6, 5.0, "m/s", "Descent near the ground"),
    _f("MPC_THR_HOVER", 0.5, 0.1, 0.8, "norm", "Collective thrust in hover"),
    _f("MPC_THR_MAX", 1.0, 0.0, 1.0, "norm", "Most collective thrust of the position loop"),
    _f("MPC_THR_MIN", 0.12, 0.05, 0.5, "norm", "Least collective thrust of the position loop"),
    _f("MPC_THR_XY_MARG", 0.3, 0.0, 0.5, "norm", "Thrust kept for the horizontal when the vertical wants all"),
    _f("MPC_TILTMAX_AIR", 45.0, 5.0, 89.0, "deg", "Most tilt in flight"),
    _f("MPC_TILTMAX_LND", 12.0, 5.0, 89.0, "deg", "Most tilt in the last stage of landing and at take-off"),
    _f("MPC_TKO_RAMP_T", 3.0, 0.0, 5.0, "s", "Ramp of the vertical speed at take-off"),
    _f("MPC_TKO_SPEED", 1.5, 1.0, 5.0, "m/s", "Climb at take-off"),
    _f("MPC_VELD_LP", 5.0, 0.0, 50.0, "Hz", "Cut-off of the velocity's derivative; 0: none"),
    _f("MPC_XY_CRUISE", 5.0, 3.0, 20.0, "m/s", "Horizontal speed in automatic modes"),
    _f("MPC_XY_P", 0.95, 0.0, 2.0, "1/s", "Horizontal position P"),
    _f("MPC_XY_VEL_D_ACC", 0.2, 0.1, 2.0, "s", "Horizontal velocity D"),
    _f("MPC_XY_VEL_I_ACC", 0.4, 0.0, 60.0, "1/s^2", "Horizontal velocity I"),
    _f("MPC_XY_VEL_MAX", 12.0, 0.0, 20.0, "m/s", "Most horizontal speed"),
    _f("MPC_XY_VEL_P_ACC", 1.8, 1.2, 5.0, "1/s", "Horizontal velocity P"),
    _f("MPC_YAWRAUTO_MAX", 60.0, 5.0, 360.0, "deg/s", "Yaw rate in automatic modes"),
    _f("MPC_Z_P", 1.0, 0.1, 1.5, "1/s", "Vertical position P"),
    _f("MPC_Z_VEL_D_ACC", 0.0, 0.0, 2.0, "s", "Vertical velocity D"),
    _f("MPC_Z_VEL_I_ACC", 2.0, 0.2, 3.0, "1/s^2", "Vertical velocity I"),
    _f("MPC_Z_VEL_MAX_DN", 1.5, 0.5, 4.0, "m/s", "Most descent"),
    _f("MPC_Z_VEL_MAX_UP", 3.0, 0.5, 8.0, "m/s", "Most climb"),
    _f("MPC_Z_VEL_P_ACC", 4.0, 2.0, 15.0, "1/s", "Vertical velocity P"),
    _f("MPC_Z_V_AUTO_DN", 1.5, 0.5, 4.0, "m/s", "Descent in automatic modes"),
    _f("MPC_Z_V_AUTO_UP", 3.0, 0.5, 8.0, "m/s", "Climb in automatic modes"),
    # navigation
    _f("NAV_ACC_RAD", 2.0, 0.05, 200.0, "m", "A waypoint counts as reached within"),
    _i("NAV_DLL_ACT", 0, 0, 6, "Ground station lost: 0 none, 1 hold, 2 return, 3 land, 5 terminate, 6 disarm"),
    _f("NAV_MC_ALT_RAD", 0.8, 0.05, 200.0, "m", "A height counts as reached within"),
    _i("NAV_RCL_ACT", 2, 1, 6, "Manual control lost: 1 hold, 2 return, 3 land, 5 terminate, 6 disarm"),
    _i("RTL_CONE_ANG", 45, 0, 90, "Half angle of the cone in which the return stays low", "deg"),
    _f("RTL_DESCEND_ALT", 10.0, 0.0, 1000.0, "m", "Return descends to this height before it lands"),
    _f("RTL_LAND_DELAY", 0.0, -1.0, 3600.0, "s", "Return waits this long before it lands; negative: for ever"),
    _f("RTL_MIN_DIST", 10.0, 0.5, 100.0, "m", "Return within this distance of home doesn't climb"),
    _f("RTL_RETURN_ALT", 30.0, 0.0, 1000.0, "m", "Return flies home at this height"),
    _i("RTL_TYPE", 0, 0, 5, "Return: 0 to home or a rally point"),
    # system
    _i("SYS_AUTOCONFIG", 0, 0, 2, "Reset of parameters at boot"),
    _i("SYS_AUTOSTART", 10040, 0, 9999999, "Airframe; 10040 is the internal simulator's quadrotor"),
    _i("SYS_HAS_BARO", 1, 0, 1, "A barometer is expected"),
    _i("SYS_HAS_GPS", 1, 0, 1, "A GPS is expected"),
    _i("SYS_HAS_MAG", 1, 0, 1, "A magnetometer is expected"),
    _i("SYS_HITL", 0, -1, 2, "Hardware in the loop"),
    _i("CAL_ACC0_ID", 1310988, 0, _INT_MAX, "Id of the first accelerometer that was calibrated"),
    _i("CAL_GYRO0_ID", 1310988, 0, _INT_MAX, "Id of the first gyro that was calibrated"),
    _i("CAL_MAG0_ID", 197388, 0, _INT_MAX, "Id of the first magnetometer that was calibrated"),
)
PARAMS: tuple[Px4ParamSpec, ...] = tuple(sorted(_UNSORTED, key=lambda spec: spec.name))
"""The table, in index order (by name, as PX4 lists them)."""
_NAMES = tuple(spec.name for spec in PARAMS)


def find(name: str) -> int | None:
    """Index of the parameter with this name, None where there is none."""
    index = bisect_left(_NAMES, name)
    return index if index < len(_NAMES) and _NAMES[index] == name else None


class Params:
    """One vehicle's parameter values.

    `set` never raises (values come over the wire); the constructor raises InputError.  `version` counts changes, so
    that loops can tell that they must read their gains again.
    """

    __slots__ = ("_values", "version")

    def __init__(self, values: Mapping[str, float] | None = None) -> None:
        self._values = [spec.default for spec in PARAMS]
        self.version = 0
        for name, value in (values or {}).items():
            result = self.set(name, value)
            if result is ParamResult.DOES_NOT_EXIST:
                raise InputError(f"parameter {name} does not exist; use one of the table in sim/autopilot/params.py")
            if result is not ParamResult.OK:
                spec = PARAMS[_index(name)]
                allowed = f"{spec.type.name} from {spec.minimum:g} to {spec.maximum:g}"
                raise InputError(f"parameter {name} = {value}: must be {allowed}")

    def __len__(self) -> int:
        return len(PARAMS)

    def get(self, name: str) -> float:
        """Value by name (an INT32's is whole); KeyError for a name outside the table."""
        return self._values[_index(name)]

    def at(self, index: int) -> float:
        """Value by index, 0 to len - 1."""
        return self._values[index]

    def set(self, name: str, value: float, type_: ParamType | None = None) -> ParamResult:
        """Set by name; `type_` is the type that the sender claims, None to take the table's."""
        index = find(name)
        if index is None:
            return ParamResult.DOES_NOT_EXIST
        spec = PARAMS[index]
        if type_ is not None and type_ != spec.type:
            return ParamResult.TYPE_MISMATCH
        if not math.isfinite(value) or (spec.type is ParamType.INT32 and value != int(value)):
            return ParamResult.VALUE_OUT_OF_RANGE
        low, high = spec.minimum, spec.maximum
        if spec.type is ParamType.REAL32:  # the limits too are what 32 bits can hold
            if abs(value) > 3.0e38:
                return ParamResult.VALUE_OUT_OF_RANGE
            value, low, high = _float32(value), _float32(low), _float32(high)
        if not low <= value <= high:
            return ParamResult.VALUE_OUT_OF_RANGE
        if value != self._values[index]:
            self._values[index] = value
            self.version += 1
        return ParamResult.OK


def _index(name: str) -> int:
    index = find(name)
    if index is None:
        raise KeyError(name)
    return index
