"""What a flight is judged by, gathered tick by tick while the scenario is tracked, and the result made of it."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import TYPE_CHECKING

from flightstack.cli.barrier_score import FilterScore, RegionScore, barrier_summary, qp_summary
from flightstack.cli.calibration import LearnedScore, gp_summary
from flightstack.cli.estimate_score import EstimateScore
from flightstack.cli.preparation import Prepared
from flightstack.cli.result import NO_LOOP, FlightResult, LoopTiming, Place, TrackingScore, judge, percentiles, relative
from flightstack.cli.site import TimedSiteFilter
from flightstack.cli.verdict import Ascent, Flown, most_rms_m, protection_of
from flightstack.mission import first_height_m
from flightstack.types import Learned, TickRecord
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
        self.tracking = TrackingScore(of)
        self.companion: Companion | None = None
        self._record: TickRecord | None = None
        self._by_estimate = of == "estimate"
        self._learning = prepared.stack.learner.enabled
        self._last_learned: Learned | None = None
        self._learned = LearnedScore()
        protection = prepared.protection
        self.region = RegionScore(protection.region, protection.watched)
        self._judging = self.region.of is not None
        self._duration_s = prepared.scenario.duration_s
        self._filtering = prepared.stack.filter.enabled
        self._filter = FilterScore()
        self.site = None
        if protection.site is not None and isinstance(protection.filter, TimedSiteFilter):
            self.site = protection.site.score(protection.filter)
        self.ascent = Ascent()
        self.estimate = EstimateScore()

    def on_record(self, record: TickRecord) -> None:
        """A tick of the stack; of an estimated flight it is scored at once."""
        self._record = record
        if self._learning and record.learned.stage >= 0.0:
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
        place, seen = relative(pos_ned_m, start_ned_m), record.measurement
        at_n, at_e, at_d, *velocity = seen.row[:6].tolist()
        flown = relative((at_n, at_e, at_d), companion.start_ned_m)
        self.ascent.height(float(start_ned_m[2]) - float(pos_ned_m[2]))
        if self.site is not None:
            flight_s = (record.t_us - companion.flight_start_us) * 1e-6
            self.site.place(flight_s, record, place)
        if self._judging:
            state = (*flown, *velocity)
            true = None if truth is None else (*relative(truth.pos_ned_m, start_ned_m), *truth.vel_ned_mps)
            self.region.add(record.t_us, state, true)
            watched = self.prepared.protection.watched
            if watched is not None and watched.adopted:
                off = None if true is None else [a - b for a, b in zip(true, state, strict=True)]
                self._filter.judge(record.filtered, watched.adopted[-1], off)
        if not 0.0 <= track_s <= self._duration_s:
            return
        followed = record.reference
        if self.site is not None:  # what was asked for through a wall is not what was to be flown
            followed = self.site.filter.reference or followed
        wanted_n, wanted_e, wanted_d = followed.row[:3].tolist()
        wanted = wanted_n, wanted_e, wanted_d
        self.tracking.add(place, relative(wanted, companion.start_ned_m))
        error = None
        if truth is not None:
            (n, e, d), (tn, te, td) = flown, place
            error = n - tn, e - te, d - td
        self.estimate.add(
            companion.view.streams.observer.disagreement_ned_mps,
            math.dist((at_n, at_e, at_d), wanted), error,
        )  # fmt: skip
        if self._learning:
            self._learned.add(record.learned, truth)

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
        stack, region = prepared.stack, self.region.summary()
        region["filtered_ticks"] = self._filter.acting if self._filtering else None
        tracking, watched = self.tracking.summary(), prepared.protection.watched
        most_m = most_rms_m(self.tracking.of, prepared.settings.get("sensors", ""))
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
            gp=gp_summary(stack.learner, stack.model, self._last_learned, self._learned),
            loop=timing.summary() if timing is not None else NO_LOOP,
            barrier=barrier_summary(self._filtering, region, self._filter, self.site),
            qp=qp_summary(stack.filter, self._filter.infeasible),
            region=region,
            link=link_summary(companion),
            estimator=self.estimate.summary(),
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
