"""Certificates in flight: from what the learner knows to a region that the filter keeps, again and again while it pays.

Once the learner is valid: bounds (`knowledge`), then for each axis of the region the largest ellipse that
the condition allows inside the region's (`search`), with its ledger (`margins`).  The work is cut into pieces of about
a millisecond, one a tick, or is done `elsewhere` while the ticks go on.  The scenario's region gives the safe set of
each axis: its ellipse (kind `axes`), or for an ellipsoid the ellipses shrunk by the root of the number of axes, whose
product lies in it.

    again        a second after the last, and taken if it is larger by 2 %, or as large and surer by a tenth, and holds
                 the vehicle, with room; later and later, up to 16 s, where nothing comes of it
    changed      the learner notices a change: the work begins anew.  The certificate in force was made with bounds of
                 its own, many times wider than what the learner calls a change, and stands while they hold
    falsified    the acceleration as measured stays beyond what the certificate says it may be (`falsify`): at once a
                 new certificate with the bound widened by what was seen; where there is none (or none comes from
                 elsewhere in time), the last one again, marked `hand_over`.  `knowledge["falsified"]` says why.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator, Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Any, TypeVar

import numpy as np

from flightstack.barrier.assess import PASSED
from flightstack.barrier.budgets import HOVER_OFF, budget_for
from flightstack.barrier.certifier_config import CertifierConfig, CertifierState, Elsewhere, Thrust
from flightstack.barrier.design import SafeSet, safe_sets
from flightstack.barrier.falsify import doubt, marked, prepare
from flightstack.barrier.flown import FlownPath, least_h
from flightstack.barrier.initial import DOWN, InitialKnowledge
from flightstack.barrier.knowledge import Knowledge, Request
from flightstack.barrier.margins import Accuracy, Doubts, Ledger
from flightstack.barrier.posterior import Accelerations
from flightstack.barrier.premises import ANY_BATTERY_V, APPLIED_AS_SENT, Premises, gain_of, speeds_of
from flightstack.barrier.queries import Envelope
from flightstack.barrier.records import Authority, AxisCertificate, Budget, Certificate, Response, area_of
from flightstack.barrier.search import Axis, Ratios, Worth, ellipse, largest_steps
from flightstack.barrier.shapes import value
from flightstack.barrier.sizes import SmoothSizes
from flightstack.barrier.torque import within
from flightstack.barrier.turning import stays_within, turning
from flightstack.learning.learner import LearnerState, Learnt
from flightstack.model import Limits, Model
from flightstack.region import Region
from flightstack.rows import L_CHANGES, L_STAGE
from flightstack.types import F64, STANDARD_GRAVITY_MPS2, Filtered, Learned, Measurement

_VALID = 2
_SPARED_MORE = 0.03
"""h that a path is given besides, for which alone a certificate is replaced."""
_LINK_S = 0.003
"""A delay that samples were made with and that is so much more than the file's is the link's, evident or not."""
_PATIENCE, _EAGER = 16.0, 1.0
"""Longest wait in periods, with a certificate in force and without."""
_IN_VAIN_US = 1_500_000
"""Who works elsewhere has so long to replace a certificate that was falsified: here it takes a second of ticks."""
_T = TypeVar("_T")


class OnlineCertifier:
    """The certifier of one believed vehicle and one region; final, holds only constants."""

    __slots__ = ("config", "elsewhere", "initial", "limits", "model", "region", "safe")
    enabled = True

    def __init__(
        self,
        model: Model,
        limits: Limits,
        region: Region,
        *,
        initial: InitialKnowledge | None = None,
        config: CertifierConfig | None = None,
        safe: Mapping[int, SafeSet] | None = None,
        elsewhere: Elsewhere | None = None,
    ) -> None:
        """`safe`: each certified axis' own safe set, in place of the region's; `elsewhere`: who does the work."""
        self.config = config or CertifierConfig()
        self.model, self.region, self.initial = model, region, initial
        self.limits = within(limits, model, self.config.governor)
        self.safe = dict(safe) if safe is not None else safe_sets(region, self.config.axes)
        self.elsewhere = elsewhere
        compile_all()

    def asked(self, safe: Mapping[int, SafeSet]) -> OnlineCertifier:
        """The same for other safe sets."""
        return self._but(safe=safe)

    def paced(self, state: CertifierState) -> OnlineCertifier:
        """The same for commands as far apart, in whole ticks, and messages as late as they have been so far, within
        what a region can bear."""
        config, late = self.config, state.lateness
        dt_s, jitter_s = late.interval_s(config.dt_s), max(late.jitter_s, config.jitter_s)
        age_s = max(late.age_s, config.doubts.age_s)
        if (dt_s, jitter_s, age_s) == (config.dt_s, config.jitter_s, config.doubts.age_s):
            return self
        doubts = config.doubts._replace(delay_s=config.doubts.delay_s + jitter_s - config.jitter_s, age_s=age_s)
        return self._but(config=replace(config, dt_s=dt_s, jitter_s=jitter_s, doubts=doubts))

    def here(self) -> OnlineCertifier:
        """The same that does the work itself."""
        return self._but(elsewhere=None)

    def _but(self, **changes: Any) -> OnlineCertifier:
        given = {"initial": self.initial, "config": self.config, "safe": self.safe, "elsewhere": self.elsewhere}
        return OnlineCertifier(self.model, self.limits, self.region, **given | changes)

    def init(self) -> CertifierState:
        """Nothing certified yet."""
        return CertifierState(flown=FlownPath(self.config.planned))

    def step(
        self, state: CertifierState, learner: LearnerState, measurement: Measurement, learned: Learned,
        filtered: Filtered,
    ) -> tuple[CertifierState, Certificate | None]:  # fmt: skip
        """A piece of the work; a certificate where one is ready and fits."""
        if state.origin_ned_m is None:
            state.origin_ned_m = measurement.pos_ned_m.copy()
        state.lateness.take(measurement)
        if learned.row.item(L_STAGE) < _VALID:
            return state, None
        self._watch(state, measurement, learned)
        state.flown.take(measurement, self.region, state.origin_ned_m)
        if state.work is None and measurement.t_us - state.begun_us >= 1e6 * state.wait_s:
            state.begun_us = measurement.t_us
            there, paced = self.elsewhere, self.paced(state)
            state.work = there.work(paced, learner, learned, state) if there else paced.work(learner, learned, state)
        if state.work is None:
            return state, None
        ready = next(state.work, None)
        if ready is None and self._in_vain(state, measurement):
            assert state.certificate is not None  # nothing else is falsified
            ready = replace(state.certificate, axes=())
        if ready is None:
            return state, None
        state.work = None
        issued = self._judge(state, ready, measurement, filtered.status >= PASSED)
        again = self.config.every_s
        most = (_PATIENCE if state.certificate is not None else _EAGER) * again
        state.turn = (state.turn + 1) % len(self.config.thrusts)
        if issued is not None or state.turn == 0:
            state.wait_s = again if issued is not None else min(max(2.0 * state.wait_s, again), most)
        return state, issued

    def _in_vain(self, state: CertifierState, measurement: Measurement) -> bool:
        """Whether a falsified certificate must not wait any longer for one from elsewhere."""
        if not state.falsified or self.elsewhere is None:
            return False
        return bool(self.elsewhere.lost) or measurement.t_us - state.begun_us > _IN_VAIN_US

    def _watch(self, state: CertifierState, measurement: Measurement, learned: Learned) -> None:
        """Whether what is certified is still so; where it is not, the work begins anew."""
        changes = learned.row.item(L_CHANGES)
        if changes > state.changes:
            state.work, state.begun_us = None, -(10**12)
        state.changes = changes
        certificate = state.certificate
        if certificate is None or state.falsified:  # nothing to watch, or known already and being worked on
            return
        reason, excess = state.witness.observe(certificate, self.model, measurement, learned)
        if reason:
            state.widen_mps2 = np.maximum(state.widen_mps2, 1.5 * excess)
            state.falsified, state.work, state.begun_us = reason, None, -(10**12)

    def _judge(
        self, state: CertifierState, ready: Certificate, measurement: Measurement, engaged: bool
    ) -> Certificate | None:
        """The certificate to hand out for a finished piece of work, if any; `engaged`: the filter is."""
        here = measurement.row[None, :6]  # as it is and looked ahead by lag and delay
        holds = bool(ready.axes) and least_h(ready, here, state.origin_ned_m) >= self.config.room_h
        area = area_of(ready) if ready.axes else 0.0
        if state.falsified:
            if holds:
                issued = marked(ready, state.falsified, hand_over=False)
            elif state.certificate is not None:
                issued = marked(state.certificate, state.falsified, hand_over=True, version=state.version + 1)
            else:
                return None
            state.falsified = ""
            area = area if holds else 0.0
        elif holds and (not engaged or self._lean_is_kept(ready, measurement)) and self._pays(ready, area, state):
            issued = ready
        else:
            return None
        state.certificate, state.area, state.version = issued, area, issued.version
        return issued

    def _lean_is_kept(self, certificate: Certificate, measurement: Measurement) -> bool:
        """Whether the vehicle leans as an engaged filter keeps it: taken in the midst of a wider lean, or of one that
        can't be stopped within, a certificate ends at once."""
        premises, turn = certificate.premises, (0.0, 0.0)
        assert premises is not None
        if certificate.governor is not None:
            turn = turning(certificate.governor, self.model, certificate.budget.low_mps2)
        leans = np.array(premises.leans).ravel()
        return stays_within(measurement.q_ned_frd, measurement.rate_frd_radps, leans, *turn)

    def _pays(self, ready: Certificate, area: float, state: CertifierState) -> bool:
        """Whether it is larger than the one in force, or hardly smaller and surer of every axis' acceleration."""
        held, flown_h = state.certificate, state.flown.least(ready, state.origin_ned_m)
        if held is None:
            return flown_h >= self.config.spared_h
        before_h = state.flown.least(held, state.origin_ned_m)
        if flown_h < min(self.config.spared_h, before_h):
            return False
        if _lateness(ready) > _lateness(held):  # commands or messages came later since
            return True
        if self.config.spared_h > -math.inf and flown_h > before_h + _SPARED_MORE:
            return True
        if area > self.config.growth * state.area:
            return True
        before = {each.axis: doubt(each) for each in held.axes}
        return (
            all(doubt(each) < self.config.surer * before[each.axis] for each in ready.axes)
            and area * self.config.growth > state.area
        )

    def work(
        self, learner: LearnerState | Learnt, learned: Learned, state: CertifierState
    ) -> Iterator[Certificate | None]:
        """A certificate, piece by piece: None after each; without axes where an axis has no region.

        Until there is one, the first of the thrusts, which most often does, is tried beside the one whose turn it is.
        """
        known = yield from _last(Accelerations.frozen_steps(learner, self.model))
        for turn in dict.fromkeys((state.turn, 0) if state.version == 0 else (state.turn,)):
            found = yield from self._regions(known, learned, state, turn)
            if found.axes and state.flown.least(found, state.origin_ned_m) >= self.config.spared_h:
                break
        yield found

    def _regions(
        self, known: Accelerations, learned: Learned, state: CertifierState, turn: int
    ) -> Generator[None, None, Certificate]:
        """The same with one of the thrusts."""
        ratios, version, widen_mps2 = state.ratios, state.version + 1, state.widen_mps2.copy()
        knowledge = yield from _last(self.bounds_steps(known, version, widen_mps2, self.config.thrusts[turn]))
        axes: list[AxisCertificate] = []
        for number in self.config.axes:
            axis, needs = self.axis_of(number, knowledge, learned)
            near, worth = ratios.get((number, turn)), self._worth(axis, needs, state)
            found = yield from largest_steps(axis, needs, near, worth)
            if found is None:
                ratios.pop((number, turn), None)
                axes.clear()
                break
            axes.append(found[0])
            ratios[number, turn] = found[1]
        return self.certificate(knowledge, tuple(axes))

    def _worth(self, axis: Axis, needs: Ledger, state: CertifierState) -> Worth:
        """What is looked for: room for what is flown where that is to be spared, else the largest region."""
        if self.config.spared_h == -math.inf or state.origin_ned_m is None:
            return lambda barrier: barrier.area_m2ps
        i = axis.axis
        return state.flown.worth(axis, needs, self.region.centre_ned_m[i], float(state.origin_ned_m[i]))

    def bounds_steps(
        self, known: Accelerations, version: int, widen_mps2: F64, thrust: Thrust, last: bool = False
    ) -> Iterator[Knowledge | None]:
        """What is known of this region: None after each piece of the work, then it; `last`: none is issued after it."""
        box, hover_mps2 = self._budget(known, thrust)
        yield None
        over = HOVER_OFF * box.thrust_max_mps2 / hover_mps2
        yield from Knowledge.steps(
            Request(
                known, self.model, self._envelope(), box, self.initial, self.config.delta, version, last,
                widen_mps2, over * np.array(self.config.estimate.acc_mps2), self.torque_mps2,
            )
        )  # fmt: skip

    def certificate(self, knowledge: Knowledge, axes: tuple[AxisCertificate, ...]) -> Certificate:
        """Of these axes, with all that they rest on."""
        config = self.config
        return Certificate(
            "sound", self.region.centre_ned_m, axes, knowledge.budget, config.delta, knowledge.k_sigma,
            {**knowledge.as_json(), "doubts": self.doubts._asdict()},
            knowledge.version, self._premises(knowledge, axes), config.governor,
        )  # fmt: skip

    def _premises(self, knowledge: Knowledge, axes: tuple[AxisCertificate, ...]) -> Premises:
        """For what a certificate of these axes holds."""
        config, table = self.config, knowledge.authorities[DOWN]
        north, east, down = knowledge.request.attitude_mps2.tolist()
        delays = [each.response.delay_s for each in axes] or [self.model.transport_delay_s]
        return Premises(
            sensors=config.sensors,
            vehicle_hash="",
            estimate=replace(config.estimate, acc_mps2=(north, east, down)),
            speeds_mps=speeds_of(self._envelope().speeds_mps, [each.axis for each in axes], config.estimate.vel_mps),
            leans=knowledge.budget.leans,
            thrust_mps2=(knowledge.budget.low_mps2, knowledge.budget.thrust_max_mps2),
            applied_share=APPLIED_AS_SENT,
            thrust_gain=gain_of(
                table.gain, max(table.error_low_mps2.max(), table.error_high_mps2.max()), knowledge.budget.high_mps2
            ),
            delay_s=(max(delays) - self.doubts.delay_s, min(delays) + self.doubts.delay_s),
            jitter_s=config.jitter_s,
            age_s=config.doubts.age_s,
            command_interval_s=config.dt_s,
            battery_v=ANY_BATTERY_V,
        )

    @property
    def torque_mps2(self) -> float:
        """Specific thrust that torque may add or take."""
        return 0.0 if self.config.governor is None else self.config.governor.worst_mps2

    @property
    def doubts(self) -> Doubts:
        """How far this vehicle's answer may be off."""
        return self.config.doubts._replace(rotor_lag_s=self.model.motor_lag_s)

    def _envelope(self) -> Envelope:
        sets = [self.safe.get(i) for i in range(3)]
        fast = self.region.semi_axes_mps  # an axis that is not certified is taken to keep to the scenario's region
        speeds = [each.limit_mps if each and each.limit_mps else fast[i] for i, each in enumerate(sets)]
        height = -self.region.centre_ned_m[DOWN]
        reach = self.safe[DOWN].limit_m if DOWN in self.safe else 0.0
        north, east, down = ((-speed, speed) for speed in speeds)
        return Envelope(
            (north, east, down),
            (max(height - reach, 0.0), height + reach),
            self.config.nodes,
            self.config.slice_only,
            self.config.axes,
        )

    def _budget(self, learned: Accelerations, asked: Thrust) -> tuple[Budget, float]:
        tilt_off = max(self.config.estimate.acc_mps2[:2]) / STANDARD_GRAVITY_MPS2
        return budget_for(self.model, self.limits, learned, asked, tilt_off)

    def axis_of(self, axis: int, knowledge: Knowledge, learned: Learned) -> tuple[Axis, Ledger]:
        """One axis to be designed, and what a barrier on it needs."""
        model, box, config = self.model, knowledge.budget, self.config
        delay = learned.latency_s if learned.latency_s > 0.0 else model.transport_delay_s
        if not learned.latency_s > 0.0 and learned.delay_s - delay > _LINK_S:
            delay = learned.delay_s  # the link's, which the samples were made with
        steer = 1.0 / config.attitude_p_ps
        authority, coupling = knowledge.authorities[axis], 0.0
        accuracy = Accuracy(
            config.estimate.pos_m[axis], config.estimate.vel_mps[axis], float(knowledge.request.attitude_mps2[axis])
        )
        if axis == DOWN:
            response = Response(model.motor_lag_s, 0.0, delay)
        else:
            response = Response(steer, steer * model.rate_lag_s, delay)
            lead = max(knowledge.hover_mps2, 0.5 * (box.low_mps2 + box.high_mps2))
            accuracy = accuracy._replace(lead_share=lead / box.thrust_max_mps2)
            apart = max(box.high_mps2 - lead, lead - box.low_mps2) / lead
            coupling = steer * 0.5 * float((authority.u_high_mps2 - authority.u_low_mps2).max()) * apart

        needs = Ledger(
            axis, authority, response, gamma_ps=config.gamma_ps, dt_s=config.dt_s,
            accuracy=accuracy, doubts=self.doubts, gain_part_mps2=knowledge.gain_part_mps2[axis],
            torque_part_mps2=knowledge.torque_part_mps2[axis],
            coupling_mps=coupling,
            inside_ps=config.inside_ps if axis == DOWN else config.inside_lateral_ps,
        )  # fmt: skip
        return Axis(axis, self.safe[axis], authority, response), needs


@lru_cache(maxsize=1)
def compile_all() -> None:
    """Call everything compiled that a certificate in flight needs, once: no tick waits for the compiler."""
    v, one = np.linspace(-1.0, 1.0, 3), np.ones(3)
    authority = Authority(v, 0.0 * v, 0.0 * v, -3.0 * one, 3.0 * one, 0.1 * one, 0.1 * one)
    axis = Axis(DOWN, SafeSet(1.0, 1.0), authority, Response(0.02, 0.0, 0.01))
    needs = Ledger(DOWN, authority, axis.response, gamma_ps=0.5, dt_s=0.004, inside_ps=20.0)
    for _ in largest_steps(axis, needs, Ratios(0.3, 1.0)):
        pass
    value(ellipse(axis, Ratios(0.3, 1.0)), 0.0, 0.0)
    stays_within(np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.zeros(4), 0.0, 0.0)
    SmoothSizes(np.ones((1, 1)), np.ones((1, 1)), np.ones((1, 1)), 1.0, np.zeros(1), 1.0).log_likelihood(1.0, 1.0, 0.0)
    prepare()


def _lateness(certificate: Certificate) -> float:
    """For how late commands and messages together a certificate holds, s."""
    premises = certificate.premises
    return 0.0 if premises is None else premises.command_interval_s + premises.jitter_s + premises.age_s


def _last(pieces: Iterator[_T | None]) -> Generator[None, None, _T]:
    """What comes of a piece-wise computation, a pause after each piece."""
    found: _T | None = None
    for piece in pieces:
        found = piece
        yield
    assert found is not None
    return found
