"""What the sensors of a flight are like: statistics of a grade's errors, for the state observer and for the bounds."""

from __future__ import annotations

from flightstack.error_statistics import ErrorStatistics, acceleration_errors
from flightstack_sim.grade import Grade


def error_statistics(grade: Grade) -> ErrorStatistics:
    """Statistics of the estimate that sensors of this grade give."""
    imu, estimate = grade.imu, grade.estimate
    bias = imu.accel_bias_std_mps2 * imu.bias_left_by_estimator
    return ErrorStatistics(
        sensors=grade.name,
        pos_std_m=estimate.pos_std_m,
        pos_time_s=estimate.pos_time_constant_s,
        pos_bias_std_m=estimate.pos_bias_std_m,
        vel_std_mps=estimate.vel_std_mps,
        vel_time_s=estimate.vel_time_constant_s,
        acc_std_mps2=acceleration_errors(estimate.tilt_std_rad, estimate.heading_std_rad, bias),
        acc_time_s=estimate.tilt_time_constant_s,
        acc_noise_mps2_rthz=imu.accel_noise_mps2_rthz,
        independent=grade.kalman is None,
    )
