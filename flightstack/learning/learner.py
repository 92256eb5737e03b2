"""The learner of the flight stack: recursive Gaussian processes on what the model leaves unexplained.

Each tick: a sample (`sampler`), its error of prediction (`watch`), a step of the window that it belongs to; each full
window is one point of each store (`store`), taken in the ticks after it, one store a tick.  Then two predictions: at
the measured state (the bound), and at the reference (what the controller feeds forward, with its time derivative and
the thrust's own gain).

| stage        | condition                                                                                    |
| ------------ | -------------------------------------------------------------------------------------------- |
| 1 calculable | fit samples come: finite, new, in the air, upright, thrust above 0.3 weights, in range       |
| 2 valid      | and both stores hold at least `valid_points` points, and the last window was no surprise     |
| 3 used       | and has been so for `ramp_s`, over which what is fed forward grows from nothing to all of it |
| 4 frozen     | was used, but no fit sample for `stale_s`: what was learned is kept and used, not changed    |

A sudden change (a payload dropped) is an error of prediction whose short mean lies beyond `alarm_sigmas` of what it
may be.  At once the bound is widened to hold it, the store collects points anew, and after `renew_points` of them the
old ones are forgotten.

In flight nothing raises: a sample that can't be used is refused and counted, and predictions are clipped to a physical
range.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple

import numpy as np

from flightstack.learning import sampler as s
from flightstack.learning.learned_row import ASSEMBLE, SLOPE, WEIGHED
from flightstack.learning.priors import Priors, StorePrior, default_priors, state_only
from flightstack.learning.sampler import Sampler
from flightstack.learning.store import Evidence, Point, Relevance, Store
from flightstack.learning.watch import LATERAL, VERTICAL, Watch
from flightstack.model import Model
from flightstack.types import F64, STANDARD_GRAVITY_MPS2, Command, FlatOutput, Learned, Measurement


@dataclass(frozen=True, slots=True)
class LearnerConfig:
    """Constants of a learner."""

    priors: Priors = field(default_factory=default_priors)
    capacity: int = 300
    """Points of each store."""
    away_m: float = s.AWAY_M
    """From the place of take-off, as estimated, where samples begin: at rest on the ground nothing is to be learned of
    forces, and an estimate that wanders further than this seems to fly."""
    window_ticks: int = 15
    """Samples whose mean is one point: 60 ms at 250 Hz."""
    relevance: Relevance = "oldest"
    valid_points: int = 8
    renew_points: int = 3
    ramp_s: float = 0.4
    stale_s: float = 0.5
    alarm_sigmas: float = 6.0
    unsure_mps2: float = 1.0
    """Bound (three sigma) at which confidence is 0."""
    residual_max_mps2: float = 0.8 * STANDARD_GRAVITY_MPS2
    """Samples beyond are refused, and nothing beyond is fed forward."""
    jerk_max_mps3: float = 20.0
    """Nothing beyond is fed forward."""
    gain_range: tuple[float, float] = (0.4, 2.0)
    floor_mps2: float = 0.0075
    """Least standard deviation of model error that no data remove: 1.5 times the accelerometer bias (5 mm/s^2 with
    motion capture) that an estimator leaves, which is the same in all data and so in what is learned."""
    rate_floor_radps: float = 0.01
    attitude_rad: tuple[float, float] = (5.25e-3, 7.8e-3)
    """Standard deviations of tilt and heading as estimated: 1.5 times those with motion capture.  What is learned in
    world axes is believed in the body's as much turned."""


_FORWARD_EVERY = 4
_GAIN_EVERY = 64
"""Steps between two looks at the gain's own variance; the first of them is none in which something else is due."""
_LATERAL, _VERTICAL, _RATES = range(3)
_TURNS = {step: ((), (1, 2), (0,), (1, 2))[step % _FORWARD_EVERY] for step in range(2, _GAIN_EVERY)}
"""Which stores may take a point at which of so many steps, the first that has not yet: where nothing else is due, just
before its prediction.  The vertical one waits least: where thrust changes with speed each tick of waiting is missed."""
_RECOVERY_US = 1_000_000
"""After a change the widened bound is what is expected: few new points predict badly, and that is no other change."""
_USUAL_TICKS = 2500


class Learnt(NamedTuple):
    """What a certificate rests on, of both processes."""

    lateral: Evidence
    vertical: Evidence

    def evidence(self) -> Learnt:
        """As a learner's state's: itself."""
        return self


class FullWindow(NamedTuple):
    """A window on its way into the stores."""

    mean: F64
    """Of its samples: inputs, targets, rate inputs, rate targets, thrust apart from the asked."""
    noise_var: F64
    """(3,) of the mean target, tilt axes."""
    span_us: tuple[int, int]
    """Stamps of its first and last sample."""
    left: tuple[int, ...] = (_VERTICAL, _LATERAL, _RATES)
    """Stores that have not taken it yet."""


class LearnerState:
    """What a learner remembers; changed in place by its steps."""

    __slots__ = (
        "began_us", "calm_variance", "carried", "changed_us", "changes", "expected", "fed", "fed_forward", "fit_us",
        "forward", "forward_us", "gain_variance", "lateral", "memory", "noise_quiet", "posterior", "query", "rate_mean",
        "rate_sigma", "rates", "rates_due", "refused", "sample", "steps", "usual_thrust", "valid_us", "variance",
        "vertical", "watch", "window",
    )  # fmt: skip

    def __init__(self, config: LearnerConfig, memory: F64) -> None:
        def store(prior: StorePrior, inputs: int, outputs: int, floor: float) -> Store:
            rule = config.relevance
            return Store(
                prior, inputs=inputs, outputs=outputs, capacity=config.capacity, floor=floor, relevance=rule
            )  # fmt: skip

        self.lateral = store(config.priors.lateral, s.D, 2, config.floor_mps2)
        self.vertical = store(config.priors.vertical, s.D, 1, config.floor_mps2)
        self.rates = store(config.priors.rates, 3, 3, config.rate_floor_radps)
        self.memory = memory
        self.watch = Watch(config.window_ticks, config.alarm_sigmas)
        self.window: FullWindow | None = None
        self.sample = np.zeros(s.SAMPLE)
        self.query = np.zeros((2, s.D))
        self.fed_forward = np.zeros(6)
        """Acceleration and jerk fed forward, as the next tick's fixed-point step takes them."""
        self.fit_us = self.valid_us = -1
        self.began_us = 0
        """When the present window began."""
        self.changed_us = -_RECOVERY_US
        """When a change was noticed last."""
        self.fed = self.refused = self.changes = self.steps = 0
        self.usual_thrust = 1.0
        """Mean thrust of the newest samples, weights."""
        self.expected = np.zeros(3)
        """Mean at the state, tilt axes."""
        self.posterior = np.full(2, math.inf)
        """Posterior variance at the state: lateral, vertical."""
        self.noise_quiet = 4.0 * config.priors.vertical.noise_var
        """Variance of a window's mean along z up to which thrust answers no errors that matter."""
        self.variance = np.full(3, math.inf)
        """Calibrated variances at the state, tilt axes."""
        self.calm_variance = np.full(3, math.inf)
        """The same without what single errors have widened, as of the tick's first prediction."""
        self.gain_variance = math.inf
        """Posterior variance of what one weight of thrust adds to z."""
        self.forward = np.zeros((2, 4))
        self.carried = np.zeros((2, 4))
        """What was worked out last, and the same carried on to this step."""
        self.forward_us = 0
        self.rates_due = False
        """The rate store took a point since its last prediction."""
        self.rate_mean = np.zeros(3)
        self.rate_sigma = np.full(3, math.nan)

    def expect_rates(self) -> None:
        """Prediction of the body rates' residual; once a window, in a tick of its own."""
        self.rates_due = False
        self.rate_mean, spread = self.rates.expect(self.sample[s.S_RATE_INPUT : s.S_RATE_INPUT + 3])
        self.rate_sigma = np.sqrt([self.rates.bound(spread, i) for i in range(3)])

    def evidence(self) -> Learnt:
        """What a certificate rests on, as of now; learning on does not change it."""
        return Learnt(self.lateral.evidence(), self.vertical.evidence())

    def weigh(self, most: float) -> bool:
        """Both calibrated variances for this posterior; whether the sample may be learned from (`fits`)."""
        lateral, vertical = self.lateral, self.vertical
        fit: bool = WEIGHED.call(
            self.sample, most, self.posterior, (lateral.excess, vertical.excess), self.variance,
            (lateral.calm_excess, vertical.calm_excess), self.calm_variance,
        )  # fmt: skip
        return fit


class GpLearner:
    """The learner of one model; final, holds only constants."""

    __slots__ = ("_limits", "_sampler", "config", "model")
    enabled = True

    def __init__(
        self, model: Model, config: LearnerConfig | None = None, *, inputs: Literal["full", "state"] = "full"
    ) -> None:
        self.model = model
        self.config = config or LearnerConfig(priors=default_priors() if inputs == "full" else state_only())
        self._sampler = Sampler(model, self.config.away_m)
        c = self.config
        self._limits = np.array([c.residual_max_mps2, *c.gain_range, c.unsure_mps2, c.jerk_max_mps3, *c.attitude_rad])

    def from_afar(self, away_m: float) -> GpLearner:
        """The same that begins so far from the place of take-off."""
        return GpLearner(self.model, replace(self.config, away_m=away_m))

    def init(self) -> LearnerState:
        """Nothing learned yet."""
        return LearnerState(self.config, self._sampler.init())

    def step(
        self, state: LearnerState, measurement: Measurement, sent: Command, reference: FlatOutput
    ) -> tuple[LearnerState, Learned]:
        """Learn from this measurement; say what is known now."""
        sample, config = state.sample, self.config
        self._sampler.step(state.memory, measurement, sent, sample)
        turns, window = _TURNS.get(state.steps % _GAIN_EVERY, ()), state.window
        due = [turn for turn in turns if turn in window.left] if window is not None else ()
        if window is not None and due:
            _take_turn(state, window, due[0])
        elif state.rates_due and turns:
            state.expect_rates()
        elif turns:
            (state.vertical if turns[0] == _VERTICAL else state.lateral).carry_on()
        self._expect(state, both=state.steps == 0)
        fit = state.weigh(config.residual_max_mps2)
        if fit:
            recovering = measurement.t_us - state.changed_us < _RECOVERY_US
            allowed = state.variance if recovering else state.calm_variance
            if self._learn(state, state.expected, allowed, measurement.t_us):
                state.weigh(config.residual_max_mps2)
        elif sample[s.S_REPEATED] == 0.0:  # a tick between two samples takes nothing from the window
            state.refused += 1
            state.watch.reset()
        stage, weight = self._stage(state, measurement.t_us, fit)
        self._sampler.at_reference(state.memory, reference, state.fed_forward, state.query)
        if state.steps % _FORWARD_EVERY == 0:
            self._look_ahead(state, measurement.t_us)
        elif state.steps % _GAIN_EVERY == 1:
            _look_at_gain(state)
        row, carry_s = np.empty(33), 1e-6 * (measurement.t_us - state.forward_us)
        ASSEMBLE.call(
            self._limits, state.query, state.forward, carry_s, state.carried, weight, stage, sample, state.expected,
            state.variance, int(fit), state.rate_mean, state.rate_sigma, len(state.lateral.gp), state.fed,
            state.refused, state.changes, state.watch.surprise, state.fed_forward, state.usual_thrust,
            state.gain_variance, state.vertical.excess, row,
        )  # fmt: skip
        state.steps += 1
        return state, Learned(row)

    def _expect(self, state: LearnerState, *, both: bool) -> None:
        """Prediction at the state; the stores take turns, so that each is at most a tick old."""
        x = state.sample[s.S_INPUT : s.S_INPUT + s.D]
        if both or state.steps % 2 == 0:
            state.posterior[0] = state.lateral.gp.predict_into(x, state.expected[:2])
        if both or state.steps % 2 == 1:
            state.posterior[1] = state.vertical.gp.predict_into(x, state.expected[2:])

    def _learn(self, state: LearnerState, expected: F64, allowed: F64, t_us: int) -> bool:
        """A fit sample: into the window, against the alarm.  True where a change is noticed: the bound is wider now."""
        state.fit_us = t_us
        state.fed += 1
        thrust = state.sample.item(s.S_INPUT + s.THRUST)
        state.usual_thrust += (thrust - state.usual_thrust) / min(state.fed, _USUAL_TICKS)
        watch, sample = state.watch, state.sample
        state.began_us = state.began_us if watch.held else t_us
        alarm = watch.step(sample, expected, allowed)
        changes = state.changes
        if alarm and state.valid_us >= 0:
            error = watch.error
            if alarm & LATERAL and not state.lateral.renewing:
                state.changes, state.changed_us = state.changes + 1, t_us
                state.lateral.renew(error[:2], self.config.renew_points)
                watch.reset()
            if alarm & VERTICAL and not state.vertical.renewing:
                state.changes, state.changed_us = state.changes + 1, t_us
                state.vertical.renew(error[2:], self.config.renew_points)
                watch.reset()
        if state.changes > changes:
            state.window = None  # of samples from before
            self._sampler.renew(state.memory)
            return True
        if watch.full:
            while state.window is not None:  # windows so short that there are too few ticks between them
                _take_turn(state, state.window, state.window.left[0])
            if state.rates_due:
                state.expect_rates()
            state.window = FullWindow(watch.take(), watch.noise_var, (state.began_us, t_us))
        return False

    def _stage(self, state: LearnerState, t_us: int, fit: bool) -> tuple[int, float]:
        """Stage by the table above, and the share of what is learned that is fed forward."""
        if state.valid_us < 0:
            if min(len(state.lateral.gp), len(state.vertical.gp)) < self.config.valid_points:
                return int(fit), 0.0
            state.valid_us = t_us
        weight = min((t_us - state.valid_us) / (1e6 * self.config.ramp_s), 1.0)
        if t_us - state.fit_us > 1e6 * self.config.stale_s:
            return 4, weight
        return (3 if weight >= 1.0 else 2), weight

    def _look_ahead(self, state: LearnerState, t_us: int) -> None:
        """(2, 4) mean and rate at the reference: x, y, z at no thrust, and what one weight of thrust adds to z.

        Worked out every fourth step, carried along its own rate in between: over 16 ms that is off by half the second
        derivative times 1e-4 s^2.
        """
        mean, mean_rate = state.forward
        query, rate = state.query.copy()
        lateral, vertical = state.lateral.gp, state.vertical.gp
        near, near_rate = query[s.GROUND], rate[s.GROUND]
        query[s.GROUND] = rate[s.GROUND] = 0.0
        lateral.predict_along_into(query, rate, mean[:2], mean_rate[:2])
        vertical.predict_along_into(query, rate, mean[2:3], mean_rate[2:3])
        query[s.THRUST], query[s.GROUND], rate[s.GROUND] = 1.0, near, near_rate
        vertical.predict_along_into(query, rate, mean[3:], mean_rate[3:])
        mean[SLOPE] -= mean[2]
        mean_rate[SLOPE] -= mean_rate[2]
        state.forward_us = t_us


def _take_turn(state: LearnerState, window: FullWindow, turn: int) -> None:
    """Let one store take a full window: an exchange of points costs what a tick can spare once."""
    mean, noise, span_us, left = window
    x, y = mean[: s.D], mean[s.D : s.D + 3]
    if turn == _LATERAL:
        state.lateral.hear(max(noise[0], noise[1]))
        state.lateral.take(x, y[:2], span_us)
    elif turn == _VERTICAL:
        state.vertical.hear(noise[2])
        state.vertical.take(*_as_asked(state, mean, noise[2]), span_us, (x, y[2:3]))
    else:
        state.rates.take(mean[s.D + 3 : s.D + 6], mean[s.D + 6 : s.D + 9])
        state.rates_due = True
    left = tuple(other for other in left if other != turn)
    state.window = window._replace(left=left) if left else None


def _as_asked(state: LearnerState, mean: F64, noise_var: float) -> Point:
    """Input (D,) and target (1,) of the vertical store's point: a window's mean, moved to the thrust asked for.

    Thrust that answers errors of the estimate is worse than nothing as an input (`asked`).  How much of what was not
    asked for does so is told by the noise as measured: none with up to twice the deviation that the prior says of a
    window, nearly all with many times it.  The target goes along by the gain as learned.
    """
    x, y = mean[: s.D], mean[s.D + 2 : s.D + 3]
    shift = max(1.0 - state.noise_quiet / noise_var, 0.0) * mean[s.D + 9]
    if shift == 0.0:
        return x, y
    x = x.copy()
    x[s.GROUND] *= 1.0 - shift / x[s.THRUST]
    x[s.THRUST] -= shift
    return x, y - shift * state.forward[0, SLOPE]


def _look_at_gain(state: LearnerState) -> None:
    """The kernel is affine in thrust, so the variances at no, one and two weights give that of the slope exactly."""
    query = state.query[0].copy()
    near = query[s.GROUND]
    at = []
    for weights in (0.0, 1.0, 2.0):
        query[s.THRUST], query[s.GROUND] = weights, weights * near
        at.append(state.vertical.expect(query)[1])
    state.gain_variance = max(0.5 * (at[0] - 2.0 * at[1] + at[2]), 0.0)
