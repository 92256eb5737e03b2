"""Every number by which the workflow decides: what is a flight, what is named, what is left open.

What stands in the modules is physics, units, formats and numerics (steps, rounds, lengths, filters).  A row holds
value, unit, reason and `changes`: in how many of the 24 frozen cases (`benchmarks.gap_frozen`) a comparison comes out
otherwise or a sum differs at half or one and a half times the value, so that it could matter at all; how many said
something else at half the value, of how many tried; and at one and a half times, of how many (`make gap-sensitivity`).
"""

from __future__ import annotations

from flightstack.effects import EFFECTS

Changes = tuple[int, int, int, int, int]


def decide(value: float, unit: str, why: str, changes: Changes = (0, 0, 0, 0, 0)) -> float:
    """The value of a row."""
    return value


# --- sizes that return
TENTH = decide(0.1, "share", "what a good model of a good vehicle may be off by", (20, 0, 1, 0, 1))
MOSTLY = 1.0 - TENTH
CLEARLY = (1.0 + TENTH) ** 2 - 1.0  # what a tenth of the rms is in power
HALF = decide(0.5, "share", "the greater part: of a force, of a gap, of a flight, of what is no noise", (3, 0, 2, 0, 2))
CLEAR_SHARE = decide(
    0.75, "share", "clearly the greater part: of correlation, of evidence, of a slope", (24, 0, 1, 0, 1)
)
SMALL_SHARE = decide(0.05, "share", "of what is flown or measured, below which nothing is told", (7, 0, 1, 0, 1))
SURE_ERRORS = decide(
    2.0, "standard errors", "by which a difference must stand out: one in twenty is chance", (3, 0, 2, 0, 2)
)
NOT_WORSE = decide(1.02, "ratio", "of a figure's rms: what another fit may cost and still be as good", (21, 0, 1, 0, 1))

# --- probabilities
NAME_P = decide(
    0.0001, "probability", "of a name by chance, after Holm's correction for all candidates", (0, 0, 1, 0, 1)
)
FICKLE_P = NAME_P / len(EFFECTS)  # of being the same everywhere: Bonferroni's correction included
RARE_P = decide(0.001, "probability", "of one effect that was looked for already: no further chances", (0, 0, 1, 0, 1))
CHANCE_P = decide(0.05, "probability", "what is less likely is not taken for chance", (0, 0, 1, 0, 1))

# --- evidence
NAME_EVIDENCE = decide(15.0, "chi-square", "a name's evidence beyond the price of its coefficients", (22, 0, 1, 0, 1))
ALIKE_EVIDENCE = decide(
    10.0, "chi-square", "difference below which one of two explanations is not preferred", (19, 0, 2, 0, 1)
)
LINE_ERROR = decide(
    12.0,
    "chi-square",
    "what columns taken elsewhere may be off by: what is so near is fitted in earnest",
    (15, 0, 1, 0, 2),
)
LINE_ERROR_SHARE = decide(0.3, "share", "of the whole gain, far from where the columns were taken", (3, 0, 2, 0, 2))
REST_EVIDENCE = decide(12.0, "log likelihood", "from which a driver of what is left counts", (5, 0, 1, 0, 1))
CLEAR_EVIDENCE = decide(
    20.0,
    "log likelihood",
    "of gusts, which explain much; chi-square that held-out rows must hold to judge",
    (3, 0, 1, 0, 1),
)
ALIKE_SHARE = decide(0.002, "share", "of what an effect explains, that a good model may miss anyway", (3, 0, 2, 0, 2))
ALIKE_COSINE = decide(0.95, "cosine", "from which two columns or estimates are one for a log", (24, 0, 1, 0, 1))

# --- what is small
NEGLIGIBLE = decide(
    0.05, "share", "of a change that matters: every candidate is taken to be there at this size", (3, 0, 2, 0, 2)
)
NEGLIGIBLE_OF_REQUIRED = decide(0.01, "share", "of a parameter that has no null value", (1, 0, 2, 0, 2))
LEAST_SIZES = decide(3.0, "negligible sizes", "smallest effect that is named", (3, 0, 2, 0, 2))
LEAST_GAIN = decide(
    0.005,
    "share",
    "of the held-out gap, what a force that joins must explain: below, the page says 0 %",
    (0, 0, 1, 0, 1),
)
STEADY_MPS2 = decide(
    0.005,
    "m/s^2",
    "slow error of accelerometer or attitude: 3 to 8 mm/s^2 with the simulator's sensors",
    (0, 0, 1, 0, 1),
)
MATTERS_MPS2 = decide(0.05, "m/s^2", "what is left of force matters from here on", (2, 0, 1, 1, 1))

# --- the verdict on held-out data
GAP_FROM = decide(
    1.2, "noise floors", "from which a figure holds a gap: a floor is known to a tenth or so", (24, 0, 1, 0, 1)
)
GUARD_S = decide(2.0, "s", "between what is learned from and what judges: noise is forgotten within", (3, 0, 2, 0, 2))
HELD_SHARE = decide(1.0 / 3.0, "share", "of each flight, held out where no whole flight is", (24, 0, 1, 0, 1))

# --- intervals
STATE_ERRORS = decide(
    1.15,
    "ratio",
    "intervals are wider by it: windows start at smoothed states, whose slow errors none sees",
    (20, 0, 1, 0, 1),
)
SAMPLED_SHARE = decide(
    0.004, "share", "how well sampled commands tell an inertia, or a load's length, at best", (0, 0, 1, 0, 1)
)
TIMING_SHARE = decide(0.05, "sample", "how well the time at which sampled commands act can be known", (24, 0, 1, 0, 1))
BIAS_STD_MPS2 = decide(
    0.1, "m/s^2", "of an accelerometer in use, before the kinematic columns are looked at", (20, 0, 1, 0, 1)
)

# --- velocities that err, and gusts
MOVED = decide(
    3.0,
    "standard deviations",
    "that a velocity must vary for a drag to be told: a tenth too small below",
    (0, 0, 1, 0, 1),
)
SLOW_ERROR_S = decide(12.0, "s", "for so long an estimator's slow error stays the same", (24, 0, 1, 0, 1))
LEAST_SIGMA_MPS = decide(0.2, "m/s", "weakest gusts that are named", (0, 0, 1, 0, 1))
LEAST_AIRSPEED_MPS = decide(1.0, "m/s", "below which gusts' lengths are not told by time", (6, 0, 1, 0, 1))
GUST_SPREAD_OUT = decide(
    2.0, "ratio", "by which gusts' likelihood ratios at the truth are too large (1.8 on 24 flights)", (2, 0, 1, 0, 1)
)

# --- another vehicle: in factors that one effect makes
OTHER_EACH = decide(0.6, "factors", "thrust and inertia must each be off by", (1, 0, 2, 0, 1))
OTHER_TOGETHER = decide(
    4.9,
    "factors",
    "and all together, for a log to be another vehicle's (a rough file: 1.86, 1.5 and 3 make 4.8)",
    (0, 0, 1, 0, 1),
)
OTHER_LARGER = decide(
    2.5, "factors", "enough where all moments are off to one side and something is unexplained", (0, 0, 1, 0, 1)
)
THRUST_OFF = decide(
    3.0, "factor", "by which the file's thrust for the commands may differ from the one felt", (1, 1, 1, 0, 1)
)
ORDER_MARGIN = decide(0.3, "correlation", "by which another order of motors must exceed the file's", (0, 0, 1, 0, 1))

# --- what is a flight
LEAST_FLIGHT_S = decide(5.0, "s", "in the air, without which nothing is compared", (0, 0, 1, 0, 1))
SHORT_FLIGHT_S = decide(15.0, "s", "below which the reader is warned", (0, 0, 1, 0, 0))
LEAST_HZ = decide(5.0, "Hz", "slowest signal that is used", (0, 0, 0, 0, 0))
GOOD_HZ = decide(75.0, "Hz", "slowest motors and gyro without a warning", (6, 0, 0, 0, 0))
LEAST_THRUST = decide(0.25, "weights", "commanded: with less, and not falling, a vehicle stands", (18, 0, 0, 0, 0))
CLEAR_M = decide(0.1, "m", "below this no height is that of a flight", (0, 0, 0, 0, 0))
TOUCHING_M = decide(
    0.03, "m", "least distance of the lowest rotor from the ground; within twice that it may stand", (19, 0, 0, 0, 0)
)
STANDING_MPS = decide(
    0.15, "m/s", "slower than this at the ground's height it stands, whatever the motors do", (24, 0, 0, 0, 0)
)
STOOD_S = decide(10.0, "s", "before take-off, in which a log shows where the ground is", (0, 0, 0, 0, 0))
EDGE_S = decide(
    0.5,
    "s",
    "left out after take-off and before landing; a dip of thrust as long as two of them is no landing",
    (24, 0, 0, 0, 0),
)
AROUND_S = decide(
    0.25, "s", "left out round a contact and after a stopped rotor: filters carry it there", (5, 0, 0, 0, 0)
)
STOPPED = decide(0.01, "command", "from which on a rotor is driven", (0, 0, 0, 0, 0))
LAGS = decide(5.0, "time constants", "after which less than a hundredth of a stop is remembered", (0, 0, 0, 0, 0))

SPIKE_BENDS = decide(
    3.0, "ratio", "of a sample's distance to how far its neighbours bend, which a peak's do as much", (0, 0, 0, 0, 0)
)
SPIKE_SPREADS = decide(
    10.0,
    "standard deviations",
    "off the median of those round it, from which a single sample is none of the flight's",
    (0, 0, 0, 0, 0),
)

# --- conventions of frames and units, by correlations of what must agree
CONVENTION_MARGIN = decide(
    0.12, "correlation", "by which the sum must grow before a convention is changed", (0, 0, 0, 0, 0)
)
CONVENTION_NEARLY = decide(0.03, "correlation", "or by so much, where next to nothing is then left", (0, 0, 0, 0, 0))
CONVENTION_POOR = decide(
    0.25, "correlation", "left to perfect agreement, from which noise may agree with noise", (0, 0, 0, 0, 0)
)
CONVENTION_CHANCE = decide(
    0.45,
    "correlation",
    "greatest that two noises of some seconds may have: what is poor must grow by it",
    (22, 0, 0, 0, 0),
)
