"""Every number by which the workflow decides: what is a flight, what is named, what is left open.

What stands in the modules is physics, units, formats and numerics (steps, rounds, lengths, filters).  A row holds
value, unit, reason and `changes`: on the frozen set (`benchmarks.gap_frozen`) how many cases said something else at
half the value, of how many tried, and at one and a half times the value, of how many tried.  A case is tried only
where a comparison comes out otherwise or a sum differs (`make gap-sensitivity`).
"""

from __future__ import annotations

from flightstack.effects import EFFECTS

Changes = tuple[int, int, int, int]


def decide(value: float, unit: str, why: str, changes: Changes = (0, 0, 0, 0)) -> float:
    """The value of a row."""
    return value


# --- sizes that return
TENTH = decide(0.1, "share", "what a good model of a good vehicle may be off by")
MOSTLY = 1.0 - TENTH
ALL_OF_ONE = 1.0 - TENTH**2  # the same share in power as MOSTLY is in rms
CLEARLY = (1.0 + TENTH) ** 2 - 1.0  # what a tenth of the rms is in power
HALF = decide(0.5, "share", "the greater part: of a force, of a gap, of a flight, of what is no noise")
CLEAR_SHARE = decide(0.75, "share", "clearly the greater part: of correlation, of evidence, of a slope")
SMALL_SHARE = decide(0.05, "share", "of what is flown or measured, below which nothing is told")
SURE_ERRORS = decide(2.0, "standard errors", "by which a difference must stand out: one in twenty is chance")
NOT_WORSE = decide(1.02, "ratio", "of a figure's rms: what another fit may cost and still be as good")

# --- probabilities
NAME_P = decide(1e-4, "probability", "of a name by chance, after Holm's correction for all candidates")
FICKLE_P = NAME_P / len(EFFECTS)  # of being the same everywhere: Bonferroni's correction included
RARE_P = decide(1e-3, "probability", "of one effect that was looked for already: no further chances")
CHANCE_P = decide(0.05, "probability", "what is less likely is not taken for chance")

# --- evidence
NAME_EVIDENCE = decide(15.0, "chi-square", "a name's evidence beyond the price of its coefficients")
ALIKE_EVIDENCE = decide(10.0, "chi-square", "difference below which one of two explanations is not preferred")
LINE_ERROR = decide(
    12.0, "chi-square", "what columns taken elsewhere may be off by: what is so near is fitted in earnest"
)
LINE_ERROR_SHARE = decide(0.3, "share", "of the whole gain, far from where the columns were taken")
REST_EVIDENCE = decide(12.0, "log likelihood", "from which a driver of what is left counts")
CLEAR_EVIDENCE = decide(
    20.0, "log likelihood", "of gusts, which explain much; chi-square that held-out rows must hold to judge"
)
ALIKE_SHARE = decide(0.002, "share", "of what an effect explains, that a good model may miss anyway")
ALIKE_COSINE = decide(0.95, "cosine", "from which two columns or estimates are one for a log")
DETECTABLE = decide(5.0, "standard deviations", "that an effect must stand out by for a log to be able to show it")

# --- what is small
NEGLIGIBLE = decide(0.05, "share", "of a change that matters: every candidate is taken to be there at this size")
NEGLIGIBLE_OF_REQUIRED = decide(0.01, "share", "of a parameter that has no null value")
LEAST_SIZES = decide(3.0, "negligible sizes", "smallest effect that is named")
LEAST_GAIN = decide(
    0.005, "share", "of the held-out gap, what a force that joins must explain: below, the page says 0 %"
)
STEADY_MPS2 = decide(
    0.005, "m/s^2", "slow error of accelerometer or attitude: 3 to 8 mm/s^2 with the simulator's sensors"
)
MATTERS_MPS2 = decide(0.05, "m/s^2", "what is left of force matters from here on")

# --- the verdict on held-out data
GAP_FROM = decide(1.2, "noise floors", "from which a figure holds a gap: a floor is known to a tenth or so")
GUARD_S = decide(2.0, "s", "between what is learned from and what judges: noise is forgotten within")
HELD_SHARE = decide(1.0 / 3.0, "share", "of each flight, held out where no whole flight is")

# --- intervals
STATE_ERRORS = decide(
    1.15, "ratio", "intervals are wider by it: windows start at smoothed states, whose slow errors none sees"
)
SAMPLED_SHARE = decide(0.004, "share", "how well sampled commands tell an inertia, or a load's length, at best")
TIMING_SHARE = decide(0.05, "sample", "how well the time at which sampled commands act can be known")
BIAS_STD_MPS2 = decide(0.1, "m/s^2", "of an accelerometer in use, before the kinematic columns are looked at")

# --- velocities that err, and gusts
MOVED = decide(3.0, "standard deviations", "that a velocity must vary for a drag to be told: a tenth too small below")
SLOW_ERROR_S = decide(12.0, "s", "for so long an estimator's slow error stays the same")
LEAST_SIGMA_MPS = decide(0.2, "m/s", "weakest gusts that are named")
LEAST_AIRSPEED_MPS = decide(1.0, "m/s", "below which gusts' lengths are not told by time")
GUST_SPREAD_OUT = decide(
    2.0, "ratio", "by which gusts' likelihood ratios at the truth are too large (1.8 on 24 flights)"
)

# --- another vehicle: in factors that one effect makes
OTHER_EACH = decide(0.6, "factors", "thrust and inertia must each be off by")
OTHER_TOGETHER = decide(4.0, "factors", "and all together, for a log to be another vehicle's")
OTHER_LARGER = decide(2.5, "factors", "enough where all moments are off to one side and something is unexplained")
THRUST_OFF = decide(3.0, "factor", "by which the file's thrust for the commands may differ from the one felt")
ORDER_MARGIN = decide(0.3, "correlation", "by which another order of motors must exceed the file's")

# --- what is a flight
LEAST_FLIGHT_S = decide(5.0, "s", "in the air, without which nothing is compared")
SHORT_FLIGHT_S = decide(15.0, "s", "below which the reader is warned")
LEAST_HZ = decide(5.0, "Hz", "slowest signal that is used")
GOOD_HZ = decide(75.0, "Hz", "slowest motors and gyro without a warning")
LEAST_THRUST = decide(0.25, "weights", "commanded: with less, and not falling, a vehicle stands")
CLEAR_M = decide(0.1, "m", "below this no height is that of a flight")
TOUCHING_M = decide(0.03, "m", "least distance of the lowest rotor from the ground; within twice that it may stand")
STANDING_MPS = decide(0.15, "m/s", "slower than this at the ground's height it stands, whatever the motors do")
STOOD_S = decide(10.0, "s", "before take-off, in which a log shows where the ground is")
EDGE_S = decide(
    0.5, "s", "left out after take-off and before landing; a dip of thrust as long as two of them is no landing"
)
AROUND_S = decide(0.25, "s", "left out round a contact and after a stopped rotor: filters carry it there")
STOPPED = decide(0.01, "command", "from which on a rotor is driven")
LAGS = decide(5.0, "time constants", "after which less than a hundredth of a stop is remembered")

# --- conventions of frames and units, by correlations of what must agree
CONVENTION_MARGIN = decide(0.12, "correlation", "by which the sum must grow before a convention is changed")
CONVENTION_NEARLY = decide(0.03, "correlation", "or by so much, where next to nothing is then left")
CONVENTION_POOR = decide(0.25, "correlation", "left to perfect agreement, from which noise may agree with noise")
CONVENTION_CHANCE = decide(
    0.45, "correlation", "greatest that two noises of some seconds may have: what is poor must grow by it"
)
