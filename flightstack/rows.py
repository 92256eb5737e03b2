"""Places of the numbers in the rows of `types` and in what is made like them, for compiled code; NED world, FRD body.

A vector's further parts follow its first: `R_RESIDUAL + 1` is the residual along y.
"""

from __future__ import annotations

Q_W, Q_X, Q_Y, Q_Z = range(4)
"""Of a quaternion."""
VEL_N, VEL_E, VEL_D = 3, 4, 5
"""Of a `Measurement`, a `FlatOutput` and a point of a way, which begin with position and velocity."""
ACC_N, ACC_E, ACC_D, JERK_N, JERK_E, YAW, YAW_RATE = 6, 7, 8, 9, 10, 15, 16
"""Of a `FlatOutput`; a point of a way has them up to the jerk."""
ATTITUDE, RATE_X, RATE_Y, RATE_Z, FORCE_X, FORCE_Y, FORCE_Z = 6, 10, 11, 12, 13, 14, 15
"""Of a `Measurement`; a predicted state has them up to the rates."""
(
    L_GAIN, L_CONFIDENCE, L_STAGE, L_RESIDUAL, L_SIGMA, L_TARGET, L_GAIN_SIGMA, L_RATE, L_RATE_SIGMA, L_APPLIED,
    L_LATENCY, L_POINTS, L_FED, L_REFUSED, L_CHANGES, L_SURPRISE, L_DELAY, LEARNED,
) = 6, 7, 8, 9, 12, 15, 18, 19, 22, 25, 26, 27, 28, 29, 30, 31, 32, 33  # fmt: skip
"""Of a `Learned`, after acceleration and jerk; and how many there are."""
(
    F_H, F_H_STATE, F_STATUS, F_MARGIN, F_ITERATIONS, F_RESIDUAL, F_VERSION, F_INTERVENED, F_WANTED, F_SAFE, F_LOW,
    F_HIGH, F_MARGINS, F_ERROR, F_RATE, F_BOUND, F_THRUST, F_PREMISE, F_ENDED_BY, FILTERED,
) = 0, 1, 2, 3, 4, 5, 6, 7, 8, 11, 14, 17, 20, 23, 26, 29, 32, 33, 34, 35  # fmt: skip
"""Of a `Filtered`; and how many there are."""
WAY_RADIUS, WAY_HALF = 3, 4
"""Of a disc of a way out, after place and height: radius across, half height."""
