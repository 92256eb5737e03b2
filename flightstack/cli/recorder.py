"""From the companion's observations to the log: which message becomes which topic, and what a person is told."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np

from flightstack.barrier.certifier_config import Elsewhere
from flightstack.barrier.premise_watch import NAMES
from flightstack.barrier.records import AXES, Certificate
from flightstack.calibration import STAGES
from flightstack.cli.barrier_score import AS_PUBLISHED, WatchedCertifier
from flightstack.cli.height_events import HeightEvents
from flightstack.estimate_observer import POOR_MPS
from flightstack.rows import F_INTERVENED, F_PREMISE, F_STATUS, L_CHANGES, L_STAGE
from flightstack.scenario import Scenario
from flightstack.types import F64, Filtered, Learned, TickRecord, Tuple3
from flightstack.vehicle import Vehicle
from flightstack_logs.log_clock import LogClock
from flightstack_logs.recorder import NoLog, Recorder
from flightstack_logs.scene import Scene, SceneRegion, StoppingWay
from flightstack_logs.topics import FILTER_STATUS, MESSAGE, TOPICS
from mavlink_bridge import messages as m
from mavlink_bridge.companion import Companion
from mavlink_bridge.frequent import AT, KINDS, Heard
from mavlink_bridge.link import MAX_DATAGRAM

_TOPIC_OF: dict[type, str] = {
    m.AttitudeQuaternion: "/vehicle/attitude",
    m.LocalPositionNed: "/vehicle/local_position",
    m.HighresImu: "/vehicle/imu",
    m.ServoOutputRaw: "/vehicle/motors",
    m.SysStatus: "/vehicle/battery",
}


def write_heard_alone(log: Recorder) -> None:
    """One message of each kind that comes many times a second, by itself: what writes it is made at the first one."""
    for kind in KINDS:
        log.write(_TOPIC_OF[kind], 0, m.BY_EVENT[kind].decode(bytes(MAX_DATAGRAM), 0))


_HEARD_AS = {
    number: (
        _TOPIC_OF[kind],
        AT[number],
        AT[number] + sum(max(field.size, 1) for field in TOPICS[_TOPIC_OF[kind]].fields),
    )
    for number, kind in enumerate(KINDS, 1)
}
"""Topic of what comes in `Heard`, and where its row is."""
DECIDING = frozenset(
    {
        m.AutopilotVersion, m.CommandAck, m.CurrentMode, m.EstimatorStatus, m.ExtendedSysState, m.Heartbeat, m.Odometry,
        m.ParamError, m.ParamValue, m.ScaledImu, m.Statustext, m.SysStatus, m.Timesync,
    }
)  # fmt: skip
"""Messages that the companion goes by and of which no table holds everything: logged as they are, for replay."""
_ZERO = (0.0, 0.0, 0.0)
_LOCATION_PERIOD_US = 200_000
"""GLOBAL_POSITION_INT comes at up to 125 Hz; a map needs less."""
_STATUS_PERIOD_US = 100_000
_STAGE_LASTS_US = 500_000
"""A stage that was there before is told again once it has lasted so long."""
_PREMISE_PERIOD_US = 1_000_000
_ESTIMATE_PERIOD_US = 40_000
_WAY_PERIOD_US = 500_000
_JUDGED_FROM_US = 5_000_000
_SURPRISING_TICKS = 8
"""Ticks over which the error is averaged that says on which axis a change lies."""


class LearnerEvents:
    """Tells each new stage of the learner, a stage that comes back when it lasts, and each sudden change, once."""

    def __init__(self, tell: Callable[[int, str, str, str], None]) -> None:
        self._tell = tell
        self._stage = self._highest = self._changes = 0.0
        self._other_us = -1
        """Since when the stage has been another than the one told; -1: it is that one."""
        self._recent: deque[F64] = deque(maxlen=_SURPRISING_TICKS)

    def on_learned(self, t_us: int, learned: Learned) -> None:
        """What is known at one tick."""
        stage, changes = learned.row.item(L_STAGE), learned.row.item(L_CHANGES)
        if stage < 0.0:
            return
        self._recent.append(learned.row)
        if stage == self._stage:
            self._other_us = -1
        elif self._other_us < 0:
            self._other_us = t_us
        if stage > self._highest or 0 <= self._other_us <= t_us - _STAGE_LASTS_US:
            self._stage, self._highest, self._other_us = stage, max(stage, self._highest), -1
            self._tell(t_us, "learner", f"learner: {STAGES[int(stage)]}", "info")
        if changes > self._changes:
            self._tell(t_us, "learner", f"learner: sudden change noticed{self._where(learned)}", "warning")
        self._changes = changes

    def _where(self, learned: Learned) -> str:
        """The body axis along which the last samples surprised most, and the learner's own measure of it."""
        recent = np.array(self._recent)
        errors = recent[:, Learned.target_frd_mps2.place] - recent[:, Learned.residual_frd_mps2.place]
        errors = errors[np.isfinite(errors).all(axis=1)]
        sigma = recent[0, Learned.sigma_frd_mps2.place]  # from before the bound was widened
        words = ""
        if len(errors):
            words = f" on {'xyz'[int(np.argmax(np.abs(errors.mean(axis=0) / sigma)))]}"
        return words + (f" ({learned.surprise:.1f} sigma)" if np.isfinite(learned.surprise) else "")


class FilterEvents:
    """Tells what the barrier filter came to: engaged, its first change, each fallback and its end, each certificate.

    A status that comes and goes is told at most every 0.1 s, a premise that is broken every second, changes of the
    command only once: they are in /filter.
    """

    def __init__(self, tell: Callable[[int, str, str, str], None]) -> None:
        self._tell = tell
        self._status = _UNENGAGED
        self._changed = False
        self._due_us = self._premise_due_us = 0

    def on_filtered(self, t_us: int, filtered: Filtered) -> None:
        """What the filter did at one tick."""
        said = filtered.row.item
        status, premise = said(F_STATUS), said(F_PREMISE)
        if status < 0.0:
            return
        if premise > 0.0 and t_us >= self._premise_due_us:
            self._premise_due_us = t_us + _PREMISE_PERIOD_US
            self._say(t_us, f"premise broken: {NAMES[int(premise)]} (h {filtered.h:.3f})")
        if not self._changed and said(F_INTERVENED) == 1.0 and status < _FALLBACK:
            self._changed = True
            self._say(t_us, f"first change: wanted {_vector(filtered.wanted_acc_ned_mps2)}, sent "
                      f"{_vector(filtered.safe_acc_ned_mps2)} m/s^2 at h {filtered.h:.3f}")  # fmt: skip
        if status == self._status or t_us < self._due_us or (kind := _kind(status)) == _kind(self._status):
            return
        before, self._status, self._due_us = _kind(self._status), status, t_us + _STATUS_PERIOD_US
        at = f"h {filtered.h:.3f}, at the state {filtered.h_state:.3f}"
        if status >= _FALLBACK:
            margins = _vector(filtered.margins_ned_ps)
            self._say(t_us, f"fallback: {FILTER_STATUS[int(status)]} ({at}, margins {margins} 1/s)", "warning")
        elif kind > _UNENGAGED:
            self._say(t_us, f"{'engaged' if before <= _UNENGAGED else 'solves again'} ({at})")
        else:
            self._say(t_us, f"{FILTER_STATUS[int(status)]} ({at})")

    def on_certificate(self, t_us: int, certificate: Certificate) -> None:
        """The filter keeps to another certificate from this tick on."""
        falsified = certificate.knowledge.get("falsified")
        if falsified:
            self._say(t_us, f"certificate falsified: {falsified}", "warning")
        self._say(t_us, f"certificate {certificate.version}: {certified_words(certificate)}")

    def on_lost(self, t_us: int, why: str) -> None:
        """Who makes certificates is gone."""
        self._say(t_us, f"certifies nothing more ({why}); what is in force stays", "warning")

    def _say(self, t_us: int, text: str, severity: str = "info") -> None:
        self._tell(t_us, "filter", f"filter: {text}", severity)


_UNENGAGED, _FALLBACK = 1.0, 4.0


def _kind(status: float) -> float:
    """Passed and changed are one."""
    return 2.0 if status == 3.0 else status


def _vector(values: F64) -> str:
    return "(" + ", ".join(f"{value:.2f}" for value in values) + ")"


def certified_words(certificate: Certificate) -> str:
    """Its axes: how far and how fast, and the area in (position, velocity)."""
    parts = []
    for axis in certificate.axes:
        low, high, slowest, fastest = axis.barrier.box
        parts.append(
            f"{AXES[axis.axis]} {low:.2f} to {high:.2f} m, {slowest:.2f} to {fastest:.2f} m/s, "
            f"{axis.barrier.area_m2ps:.2f} m^2/s"
        )
    return "; ".join(parts)


class EstimateEvents:
    """Tells once that the vehicle's velocity and position disagree by more than they may."""

    def __init__(self, tell: Callable[[int, str, str, str], None]) -> None:
        self._tell = tell
        self._told = False
        self._from_us = -1

    def on_estimate(self, t_us: int, rms_ned_mps: F64) -> None:
        """rms(c) at one tick; judged once there are some seconds of it."""
        self._from_us = t_us if self._from_us < 0 else self._from_us
        if self._told or t_us < self._from_us + _JUDGED_FROM_US or not float(rms_ned_mps.max()) > POOR_MPS:
            return
        self._told = True
        text = f"estimate: velocity and position disagree by {_vector(rms_ned_mps)} m/s rms (north, east, down)"
        self._tell(t_us, "estimate", f"{text}, more than {POOR_MPS:g}: look at the estimator's sensors", "warning")


class LogObserver:
    """The companion's observer: everything goes to the log, and each tick to `on_record`.

    Log times are those of `clock`, whatever time the companion counts.  `companion` is set once it exists; `scene` says
    what the 3-D view shows of a flight that begins at a place, `way_ned_m` how the site filter would stop now.
    """

    def __init__(
        self,
        log: Recorder,
        clock: LogClock,
        scene: Callable[[F64], Scene],
        *,
        way_ned_m: Callable[[], F64] | None = None,
        certifier: WatchedCertifier | None = None,
    ) -> None:
        self.companion: Companion | None = None
        self._log, self._clock = log, clock
        self._kept = not isinstance(log, NoLog)
        self._scene, self._way_ned_m, self._way_due_us = scene, way_ned_m, 0
        self.record_to: Callable[[TickRecord], None] | None = None
        """Told each tick."""
        self.message_to: Callable[[int, object], None] | None = None
        """Told each message of the vehicle; several at once as they are heard (`Heard`)."""
        self._learner_events = LearnerEvents(self._tell)
        self._filter_events = FilterEvents(self._tell)
        self._estimate_events = EstimateEvents(self._tell)
        self._height_events = HeightEvents(self._tell)
        self._estimate_due_us = 0
        self._certifier = certifier
        if certifier is not None and certifier.elsewhere is not None:
            certifier.elsewhere.count_anew()
        self._certificates, self._served, self._lost, self._placed = 0, 0, False, False
        self._location_due_us = 0
        self._resets = -1

    def on_event(self, t_us: int, name: str, text: str, severity: str) -> None:
        """A transition, a change of mode or phase, a text of the vehicle."""
        self._tell(t_us, name, text, severity)

    def _tell(self, t_us: int, name: str, text: str, severity: str) -> None:
        self._log.event(self._clock.t_us, name, text, severity)

    def on_tick(self, record: TickRecord) -> None:
        """One tick of the stack."""
        if self._kept:
            self._show(record)
        self._log.tick(record, self._clock.t_us)
        if self._certifier is not None:
            self._certifier.trail.add(record)
        if self._kept:
            self._on_estimate(record.t_us)
            self._learner_events.on_learned(record.t_us, record.learned)
            self._filter_events.on_filtered(record.t_us, record.filtered)
        if self.record_to is not None:
            self.record_to(record)

    def _show(self, record: TickRecord) -> None:
        """What the 3-D view shows; with the first tick of the mission it knows where the scenario lies."""
        if not self._placed and self.companion is not None and self.companion.mission is not None:
            self._placed = True
            self._height_events.begin()
            self._log.scene(self._clock.t_us, self._scene(self.companion.start_ned_m))
        if self._way_ned_m is not None and record.t_us >= self._way_due_us:
            self._way_due_us = record.t_us + _WAY_PERIOD_US
            if len(way := self._way_ned_m()):
                self._log.scene(self._clock.t_us, StoppingWay(way))
        self._on_certificates(record.t_us)

    def _on_estimate(self, t_us: int) -> None:
        """The estimate's agreement with itself, 25 times a second."""
        if self.companion is None or t_us < self._estimate_due_us:
            return
        self._estimate_due_us = t_us + _ESTIMATE_PERIOD_US
        observed = self.companion.view.streams.observer
        rms = observed.rms_ned_mps
        self._log.write("/estimate", self._clock.t_us, (observed.disagreement_ned_mps, rms, observed.weight))
        self._estimate_events.on_estimate(t_us, rms)

    def _on_certificates(self, t_us: int) -> None:
        """Each new certificate: told, shown in the 3-D view and kept for the log's end."""
        certifier, companion = self._certifier, self.companion
        if certifier is None or companion is None:
            return
        there = certifier.elsewhere
        if there is not None and (there.lost or len(there.served) > self._served):
            self._on_elsewhere(t_us, there)
        if len(certifier.adopted) == self._certificates:
            return
        self._certificates = len(certifier.adopted)
        certificate = certifier.adopted[-1]
        self._filter_events.on_certificate(t_us, certificate)
        self._log.scene(self._clock.t_us, certified_region(certificate, companion.start_ned_m))
        self._log.certificate(self._clock.t_us, certificate)

    def _on_elsewhere(self, t_us: int, there: Elsewhere) -> None:
        for each in there.served[self._served :]:
            self._log.write("/certifier", self._clock.t_us, each)
        self._served = len(there.served)
        if not self._lost and there.lost:
            self._lost = True
            self._filter_events.on_lost(t_us, there.lost)

    def _on_deciding(self, t_us: int, message: object) -> None:
        if isinstance(message, m.Odometry):  # of which only the count of resets decides, where it changes
            if message.reset_counter == self._resets:
                return
            self._resets = message.reset_counter
            message = m.Odometry(message.t_us, 0, 0, _ZERO, (*_ZERO, 0.0), _ZERO, _ZERO, message.reset_counter)
        row = m.BY_EVENT[type(message)]
        self._log.write(MESSAGE, t_us, row.id.to_bytes(3, "little") + row.encode(message))

    def _on_heard(self, t_us: int, heard: Heard) -> None:
        if not self._kept:
            return
        self._height_events.on_heard(t_us, heard)
        write, row, t_us = self._log.write, heard.row, self._clock.t_us
        for number in heard.numbers:
            topic, begin, end = _HEARD_AS[number]
            write(topic, t_us, row[begin:end])

    def on_message(self, t_us: int, message: object) -> None:
        """A message of the vehicle, as a table; or several at once."""
        if self.message_to is not None:
            self.message_to(t_us, message)
        kind = type(message)
        if isinstance(message, Heard):
            self._on_heard(t_us, message)
            return
        if not self._kept:
            return
        self._height_events.on_message(t_us, message)
        t_us = self._clock.t_us
        topic = _TOPIC_OF.get(kind)
        if topic is not None and not (kind is m.ServoOutputRaw and message.port):  # type: ignore[attr-defined]
            self._log.write(topic, t_us, message)
        if kind in DECIDING:
            self._on_deciding(t_us, message)
        if topic is not None:
            return
        if isinstance(message, m.Statustext):
            self._log.statustext(t_us, message.severity, message.text)
        elif isinstance(message, m.Heartbeat) and self.companion is not None:
            view = self.companion.view
            self._log.write("/vehicle/status", t_us, (view.mode_name, view.armed, view.on_ground))
        elif isinstance(message, m.GlobalPositionInt):
            if t_us >= self._location_due_us:
                self._location_due_us = t_us + _LOCATION_PERIOD_US
                self._log.location(t_us, message.lat_deg, message.lon_deg, message.alt_msl_m)


def certified_region(certificate: Certificate, start_ned_m: F64) -> SceneRegion:
    """The positions that a certificate allows: a box, as published an ellipsoid.

    Along an axis that it says nothing of it reaches `_OPEN_M` each way.
    """
    spans = {axis.axis: axis.barrier.box[:2] for axis in certificate.axes}
    low, high = (np.array([spans.get(axis, (-_OPEN_M, _OPEN_M))[side] for axis in range(3)]) for side in (0, 1))
    north, east, down = (np.asarray(certificate.centre_ned_m) + start_ned_m + 0.5 * (low + high)).tolist()
    half: Tuple3 = tuple((0.5 * (high - low)).tolist())
    shape = "ellipsoid" if certificate.mode == AS_PUBLISHED else "box"
    return SceneRegion(shape, (north, east, down), half)


_OPEN_M = 2.0


def path_of(scenario: Scenario) -> F64:
    """(n, 3) the reference from the start, NED: takes milliseconds, too long for a tick."""
    times = np.arange(0.0, scenario.duration_s, 0.05)
    return np.array([scenario.trajectory.at(float(t)).pos_ned_m for t in times]).reshape(-1, 3)


def scene_of(
    scenario: Scenario, vehicle: Vehicle, path_ned_m: F64, site: tuple[F64, ...], start_ned_m: F64, *, truth: bool
) -> Scene:
    """What the 3-D view shows, for a flight that began at `start_ned_m` (3,): vehicle, ground, region, `path_of` the
    reference, and the lines of a site, (n, 3) from there."""
    region = None
    if scenario.region is not None:
        north, east, down = (np.asarray(scenario.region.centre_ned_m) + start_ned_m).tolist()
        shape = "ellipsoid" if scenario.region.kind == "ellipsoid" else "box"
        region = SceneRegion(shape, (north, east, down), scenario.region.semi_axes_m)
    return Scene(
        rotor_position_frd_m=vehicle.rotors.position_m,
        rotor_radius_m=vehicle.rotors.radius_m,
        ground_down_m=float(start_ned_m[2]),
        region=region,
        reference_ned_m=path_ned_m + start_ned_m,
        site_ned_m=tuple(line + start_ned_m for line in site),
        truth=truth,
    )
