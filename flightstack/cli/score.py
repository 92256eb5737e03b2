"""What a flight is judged by, gathered tick by tick while the scenario is tracked, and the result made of it."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from flightstack.cli.barrier_score import FilterScore, RegionScore, barrier_summary, premises_of, qp_summary
from flightstack.cli.calibration import gp_summary
from flightstack.cli.estimate_score import estimate_summary
from flightstack.cli.preparation import Prepared
from flightstack.cli.result import (
    NO_LOOP,
    FlightResult,
    LoopTiming,
    Place,
    distances_m,
    judge,
    percentiles,
    relative,
    tracking_summary,
)
from flightstack.cli.site import TimedSiteFilter
from flightstack.cli.ticks import FlownTicks, TickTable
from flightstack.cli.verdict import Ascent, Flown, most_rms_m, protection_of
from flightstack.mission import first_height_m
from flightstack.rows import L_STAGE
from flightstack.types import F64, Learned, TickRecord
from flightstack_logs.recorder import NoLog
from flightstack_logs.writer import FlightLog
from mavlink_bridge.companion import Companion
from mavlink_bridge.frequent import DOWN, POSITION, VEL_DOWN, Heard
from mavlink_bridge.messages import LocalPositionNed

if TYPE_CHECKING:
    from flightstack_sim.plant import Truth


class FlightScore:
    """The score of one flight; `companion` is set once it exists."""

    def __init__(self, prepared: Prepared, *, of: str) -> None:
        self.prepared = prepared
        self.of = of
        self.companion: Companion | None = None
        self._record: TickRecord | None = None
        self._by_estimate = of == "estimate"
        self._learning = prepared.stack.learner.enabled
        self._last_learned: Learned | None = None
        self._ticks = FlownTicks()
        protection = prepared.protection
        self._watched = protection.watched
        self._region = RegionScore(protection.region, protection.watched)
        self._duration_s = prepared.scenario.duration_s
        self._filtering = prepared.stack.filter.enabled
        self._filter = FilterScore()
        self.site = None
        if protection.site is not None and isinstance(protection.filter, TimedSiteFilter):
            self.site = protection.site.score(protection.filter)
        self.ascent = Ascent()

    def on_record(self, record: TickRecord) -> None:
        """A tick of the stack; of an estimated flight it is scored at once."""
        self._record = record
        if self._learning and record.learned.row.item(L_STAGE) >= 0.0:
            self._last_learned = record.learned
        companion, track_s = self.companion, self.track_s(record.t_us)
        if companion is None or companion.mission is None or track_s is None:
            return
        if self._filtering:
            flight_s = (record.t_us - companion.flight_start_us) * 1e-6
            climbing = flight_s < companion.mission.takeoff_end_s
            self._filter.add(flight_s, record.filtered, climbing=climbing, governed=record.governed)
            if self.site is not None:
                self.site.add(flight_s, record)
        if self._by_estimate:
            self.add(track_s, record.measurement.pos_ned_m, companion.start_ned_m)

    def on_message(self, t_us: int, message: object) -> None:
        """What the vehicle says, one message or several: of an estimated flight its descent is scored by it."""
        companion = self.companion
        if not self._by_estimate or companion is None or companion.land_command_us < 0:
            return
        if isinstance(message, LocalPositionNed):
            self.ascent.estimated_descent(float(message.pos_ned_m[2]), float(message.vel_ned_mps[2]))
        elif isinstance(message, Heard) and POSITION in message.numbers:
            self.ascent.estimated_descent(message.row.item(DOWN), message.row.item(VEL_DOWN))

    def on_truth(self, truth: Truth) -> None:
        """The truth of a tick, from the start of the take-off to the very end."""
        if self.companion is not None and self.companion.flight_start_us >= 0:
            self.ascent.true_contact(truth.vel_ned_mps, truth.on_ground)

    def track_s(self, t_us: int) -> float | None:
        """Time since the track began, negative before; None without a mission and from the command to land on."""
        companion = self.companion
        if companion is None or companion.mission is None or companion.land_command_us >= 0:
            return None
        return (t_us - companion.flight_start_us) * 1e-6 - companion.mission.track_start_s

    def add(self, track_s: float | None, pos_ned_m: Place, start_ned_m: Place, truth: Truth | None = None) -> None:
        """Score the last tick: position, and where the flight began, in one frame; tracking on the track only."""
        record, companion = self._record, self.companion
        if record is None or companion is None or track_s is None:
            return
        followed = record.reference
        if self.site is not None:
            flight_s = (record.t_us - companion.flight_start_us) * 1e-6
            self.site.place(flight_s, record, relative(pos_ned_m, start_ned_m))
            # what was asked for through a wall is not what was to be flown
            followed = self.site.filter.reference or followed
        certificates = 0 if self._watched is None else len(self._watched.adopted)
        head = record.t_us, certificates, 0.0 <= track_s <= self._duration_s, premises_of(record.filtered)
        self._ticks.add(head, record, followed.row, companion.view.streams.observer.disagreement_ned_mps)
        if truth is not None:
            place = relative(pos_ned_m, start_ned_m)
            true = place if pos_ned_m is truth.pos_ned_m else relative(truth.pos_ned_m, start_ned_m)
            self._ticks.add_truth(place, true, truth)

    def _worked_out(self) -> TickTable:
        """The ticks so far; what was summed up of them is."""
        assert self.companion is not None
        ticks, watched = self._ticks.table(self.companion.start_ned_m), self._watched
        self.ascent.rose_m, self._filter.premises_broken = None, 0
        for down_m in ticks.place_ned_m[:, 2].tolist():
            self.ascent.height(0.0 - down_m)
        for number, certificate in enumerate(watched.adopted if watched is not None else (), start=1):
            under = ticks.in_force == number
            off = None if ticks.true_state is None else ticks.true_state[under] - ticks.state[under]
            self._filter.judge(certificate, ticks.premises[under], off)
        return ticks

    def tracked_m(self) -> F64:
        """(n,) distance from the scenario's reference at each tick of the track so far."""
        return _tracked_m(self._worked_out())

    def tracking(self) -> dict[str, Any]:
        """The JSON's `tracking` so far."""
        return tracking_summary(self.of, self.tracked_m())

    def region(self) -> dict[str, Any]:
        """The JSON's `region` so far, but for the filter's ticks."""
        return self._judged(self._worked_out())

    def _judged(self, ticks: TickTable) -> dict[str, Any]:
        return self._region.summary(ticks.t_us, ticks.in_force, ticks.state, ticks.true_state)

    def result(
        self,
        log: FlightLog | NoLog,
        *,
        wall_s: float,
        clock_s: float,
        timing: LoopTiming | None,
        completed: bool | None,
        checked: bool,
        seed: int | None = None,
        plant: str | None = None,
    ) -> FlightResult:
        """The flight's result; `completed`: whether it came to its end (None: nothing was to be flown); with `checked`
        it is held against the scenario's checks."""
        companion, prepared = self.companion, self.prepared
        assert companion is not None
        flown_us = max(0, companion.last_t_us - companion.flight_start_us) if companion.flight_start_us >= 0 else 0
        stack, ticks, watched = prepared.stack, self._worked_out(), self._watched
        tracking, region = tracking_summary(self.of, _tracked_m(ticks)), self._judged(ticks)
        region["filtered_ticks"] = self._filter.acting if self._filtering else None
        most_m = most_rms_m(self.of, prepared.settings.get("sensors", ""))
        flown = Flown(first_height_m(prepared.scenario), self.ascent.rose_m, self.ascent.touchdown_mps, most_m)
        asked, exits = prepared.protection.asked and completed is not None, self.site.exits if self.site else None
        stopped = self.site.stopped_share if self.site else 0.0
        reason = companion.reason or (flown.shortcoming(tracking["rmse_m"], stopped) if completed else "")
        result = FlightResult(
            scenario=prepared.scenario.name,
            seed=seed,
            log=None if log.path is None else str(log.path),
            completed=completed and not reason,
            reason=reason,
            flight_time_s=flown_us * 1e-6,
            wall_time_s=wall_s,
            clock_time_s=clock_s,
            plant=plant,
            controller=prepared.settings["controller"],
            tracking=tracking,
            gp=gp_summary(stack.learner, stack.model, self._last_learned, ticks),
            loop=timing.summary() if timing is not None else NO_LOOP,
            barrier=barrier_summary(self._filtering, region, self._filter, self.site),
            qp=qp_summary(stack.filter, self._filter.infeasible),
            region=region,
            link=link_summary(companion),
            estimator=_estimator(ticks),
            flown=asdict(flown),
            protection=protection_of(asked, self._filter.spans, region, exits),
            filter_words=prepared.protection.words,
            unprotected_because=prepared.protection.unattainable
            or (watched.hindrance if watched else "")
            or prepared.protection.not_taken(self._filter.acting),
            log_problem=log.failed or "",
        )
        if checked:
            result.checks = [judge(check, result.as_json()) for check in prepared.scenario.checks]
            result.miss_checks()
        return result


def _tracked_m(ticks: TickTable) -> F64:
    on = ticks.tracked
    return distances_m(ticks.place_ned_m[on], ticks.wanted_ned_m[on])


def _estimator(ticks: TickTable) -> dict[str, Any]:
    """The JSON's `estimator`."""
    on = ticks.tracked
    control_m = distances_m(ticks.estimated_ned_m[on], ticks.followed_ned_m[on])
    error_m = None if ticks.true_state is None else (ticks.state[:, :3] - ticks.place_ned_m)[on]
    return estimate_summary(ticks.disagreement_ned_mps[on], control_m, error_m)


def link_summary(companion: Companion) -> dict[str, object]:
    """The JSON's `link`."""
    stats, latency_s = companion.link.stats.as_dict(), companion.view.latency.latency_s
    reasons = ("bad_crc", "bad_length", "bad_signature", "unsigned", "replayed", "unknown_id", "not_finite")
    return {
        "round_trip_us": percentiles(companion.view.round_trips_us),
        "command_latency_s": None if math.isnan(latency_s) else latency_s,
        "received": stats["received"],
        "lost": stats["lost"],
        "dropped": {name: stats[name] for name in reasons if stats[name]},
        "signed": companion.link.signing,
    }
