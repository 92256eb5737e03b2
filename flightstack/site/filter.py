"""The site filter: the command passes as long as a certified way out of its consequences is clear of all forbidden.

Each tick: carry the state to when this command begins to act; slide it along what is near (`slide`); lay out how the
vehicle would stop after it, and hold (`backup`), with the tube in which it is certain to stay (`tube`); where all of
that is clear (`clearance`), the command is sent and this way out is committed.  Where it is not, as much of it as
leaves a clear way is sent, else the way that was committed before is kept to: a committed tube covers all time to come,
so that there is always something to do.  A command that is not changed passes bit for bit.

What may break that: an estimate that jumps, a vehicle beyond the prior, a link that loses more than was told.  How far
the vehicle is off its committed way is watched; beyond its tube a premise is broken.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from flightstack.barrier.records import Certificate
from flightstack.barrier.response import CHAIN, new_memory, remember
from flightstack.governor import GovernorLimits
from flightstack.model import Limiter, Limits, Model
from flightstack.rows import ATTITUDE, F_H, F_INTERVENED, F_STATUS, F_THRUST, F_VERSION, FORCE_Z
from flightstack.site import bend as bending
from flightstack.site import decide as d
from flightstack.site import slide
from flightstack.site.backup import LATE_S, ROW, STEPS, widest
from flightstack.site.clearance import CHUTE, GROUND, OPEN, clear_of, edge_name, packed
from flightstack.site.shape import Site
from flightstack.site.stopping import GAIN_STEP, SMOOTH_M, StoppingCertificate
from flightstack.trajectory import Trajectory
from flightstack.types import F64, Command, Filtered, FlatOutput, Learned, Measurement

_EMPTY = np.full(len(Filtered.nothing().row), np.nan)
_BEND_DT_S, _BEND_EVERY_S = 0.004, 0.02
_PAUSE_US = 50_000
"""Without a tick for longer: somebody else flew."""


class SiteState(NamedTuple):
    """Everything that one tick hands to the next; the arrays are written in place."""

    origin_ned_m: F64
    memory: F64
    """Commands sent: `response.new_memory`."""
    numbers: F64
    """`decide.MEMORY` numbers."""
    committed: F64
    """(STEPS, ROW) the way out that is committed."""
    bent: F64
    """`bend.SIZE` numbers."""


def gain_of(state: object) -> float:
    """The thrust gain that was read off the accelerometer; 1 before, and where another filter flies."""
    return float(state.numbers[d.GAIN]) if isinstance(state, SiteState) and d.is_read(state.numbers) else 1.0


class _Known(NamedTuple):
    """One certificate's numbers, as compiled code takes them."""

    known: tuple[F64, F64, F64, F64]
    """`decide.Known`, plain."""
    far: F64
    """`slide` parameters of a reference, by least gain as the rows."""
    most_mps2: float
    """More force than this falsifies it."""
    fastest_mps: float
    """So does a greater speed."""

    @classmethod
    def of(cls, made: StoppingCertificate, model: Model, limits: Limits) -> _Known:
        """Of a certificate."""
        drag = 0.5 * (model.drag_kgps[0] + model.drag_kgps[1]) / model.mass_kg
        ends = [drag, made.eps_gain, *made.prior.gain, GAIN_STEP, made.turning.rotors_s]
        vehicle = np.concatenate([made.chain, made.response.ravel(), limits.rate_max_radps, ends])
        far, doubts = made.soft.copy(), made.doubts[0]
        far[:, slide.RADIUS] += made.kept_m - made.radius_m - SMOOTH_M
        known = vehicle, made.rows, made.soft, made.halves()
        return cls(known, far, doubts.force_mps2 + doubts.rest_mps2, made.prior.speed_mps)


class SiteFilter:
    """The filter for one believed vehicle and site; holds constants and buffers for one tick."""

    enabled = True

    def __init__(
        self, model: Model, limits: Limits, certificate: StoppingCertificate, site: Site, chutes: F64, chute_m: float,
        prior: StoppingCertificate | None = None,
    ) -> None:  # fmt: skip
        """`site` in local metres; `chutes` (n, 2): places of take-off and landing, relative to the origin; `prior`:
        what is kept to once the certificate was falsified."""
        self.model, self.limits, self.certificate, self.site = model, limits, certificate, site
        self._limiter = Limiter(model, limits)
        self._site, self._chutes = packed(site, chutes, chute_m), chutes
        self._known = [_Known.of(made, model, limits) for made in (certificate, prior or certificate)]
        assert len(certificate.chain) == CHAIN
        self._scratch, self._way = np.zeros((STEPS, ROW)), np.zeros((STEPS, 5))
        self._rows, self._rate = np.zeros((slide.MOST_ROWS, 6)), np.zeros(3)
        self.compile()

    def compile(self) -> None:
        """Call everything that a tick may need, once."""
        still = np.zeros(3)
        state = self.init(still)
        level = np.zeros(20)
        level[2], level[ATTITUDE], level[FORCE_Z] = -1.0, 1.0, -9.8
        t_us = 2 * _PAUSE_US
        measurement = Measurement(t_us, level, 0, 0, 0)
        command = Command(t_us, self.model.weight_n, self.model.hover_norm, still)
        self.step(state, measurement, command, command, Learned.nothing())
        self.bend(state, FlatOutput(np.zeros(17)))

    def init(self, origin_ned_m: F64) -> SiteState:
        """Nothing committed; the site is relative to the origin, (3,)."""
        numbers = np.zeros(d.MEMORY)
        self._site[CHUTE] = self._site[OPEN]
        low, high = self.certificate.prior.gain
        numbers[d.GAIN], numbers[d.LAST_US] = (low * high) ** 0.5, -1.0
        return SiteState(origin_ned_m.copy(), new_memory(), numbers, np.zeros((STEPS, ROW)), np.zeros(bending.SIZE))

    @property
    def chute_m(self) -> float:
        """Radius of the chutes."""
        return float(self._site[OPEN])

    @property
    def chute_room_m(self) -> float:
        """How far from the middle of its chute a vehicle at rest still is within it."""
        return self.chute_m - self.certificate.kept_m

    def adopt(self, state: SiteState, certificate: Certificate) -> SiteState:
        """Certificates of regions mean nothing here."""
        return state

    def narrow(self, certificate: StoppingCertificate) -> None:
        """Keep to a certificate that was learned of the same vehicle, from the next tick on; at rest only: a way that
        is committed there is a hold, and its tube was clear with the wider certificate's."""
        self.certificate = certificate
        self._known[0] = _Known.of(certificate, self.model, self.limits)

    def governed(self, state: SiteState) -> GovernorLimits | None:
        """Those of the certificate, always."""
        return self.certificate.governor.limits

    def in_force(self, state: SiteState) -> F64 | None:
        """None of a region."""
        return None

    def bend(self, state: SiteState, setpoint: FlatOutput) -> FlatOutput:
        """The reference, led along what it would go through; from the second tick on: the first tells where one is."""
        row, out = setpoint.row.copy(), np.empty(17)
        row[:3] -= state.origin_ned_m
        dt = state.numbers[d.HOLD_S] or _BEND_DT_S
        if state.bent[bending.KNOWN] == 0.0 or not np.isfinite(row[:6]).all():
            return setpoint
        known = self._in_force(state.numbers)
        far = known.far[d.row_of(state.numbers, known.known[0], len(known.far))]
        if not bending.bend(state.bent, self._site, far, row, dt, self._rows, self._way, out):
            return setpoint
        out[:3] += state.origin_ned_m
        return FlatOutput(out)

    def passes(self, path: Trajectory) -> bool:
        """Whether a path, relative to the origin, is bent nowhere at the least gain, nor commands that follow it slid,
        once the chute was left."""
        memory, site, out = np.zeros(bending.SIZE), self._site.copy(), np.empty(17)
        site[CHUTE] = -1.0
        known, rows = self._known[0], self._rows
        soft, far = known.known[2][0], known.far[0]
        bending.begin(memory, path.at(0.0).row, np.zeros(3))
        for t_s in np.arange(0.0, path.duration_s, _BEND_EVERY_S).tolist():
            row = path.at(t_s).row
            near = rows[: slide.bounds(site, row[:3], row[3:6], soft, rows)]
            if (near[:, :3] @ row[6:9] < near[:, slide.BOUND]).any():
                return False
            if bending.bend(memory, site, far, row, _BEND_EVERY_S, rows, self._way, out):
                return False
        return True

    def replace(self, state: SiteState, site: Site, measurement: Measurement) -> str:
        """Keep to another site, in the same local metres, from the next tick on; else one line that says why not.

        It is taken where all that is committed (the way out and its tube; where nobody flies by one, the place at
        rest) is clear of it: what holds for the old site then holds for the new one.
        """
        chute_m = self.chute_m if site.chute_m is None else site.chute_m
        kept, half = self.certificate.kept_m, self.certificate.half_m
        if chute_m < kept or not site.ceiling_m - site.floor_m > 2.0 * half:
            return (
                f"{site.source}: no room for the {kept:.2f} m across and {half:.2f} m up and down of a vehicle at rest"
            )
        new = packed(site, self._chutes, chute_m)
        new[CHUTE], new[GROUND] = -1.0 if state.numbers[d.LEFT] > 0.0 else chute_m, 0.0
        discs = self._all_committed(state, measurement, (kept, half))
        clearance, edge = clear_of(new, discs, len(discs), 1.0)
        if clearance < 0.0:
            return f"{site.source}: the vehicle does not stand clear of its {edge_name(site, edge)}"
        self.site, self._site = site, new
        return ""

    def _all_committed(self, state: SiteState, measurement: Measurement, at_rest: tuple[float, float]) -> F64:
        """Discs (n, 5) that hold the committed way and its tube, as `backup.roll` lays them."""
        numbers, way = state.numbers, state.committed[: int(state.numbers[d.COMMITTED])]
        if not len(way) or measurement.t_us - numbers[d.LAST_US] > _PAUSE_US:
            at = measurement.pos_ned_m - state.origin_ned_m
            return np.array([[at[0], at[1], -at[2], *at_rest]])
        vehicle, rows, _, halves = self._in_force(numbers).known
        row = rows[max(d.row_of(numbers, vehicle, len(rows)) - 1, 0)]  # the gain that it was laid out for may be less
        half = halves[1 if d.is_read(numbers) else 0]
        half = np.append(half[: len(way) - 1], half[-1])
        late = float(rows[:, LATE_S].max()) * float(np.linalg.norm(way[0, 3:6]))
        steps = np.vstack([np.diff(way[:, :3], axis=0), np.zeros(3)])
        middle, half = way[:, :3] + 0.5 * steps, half + late + 0.5 * np.abs(steps[:, 2])
        low, high = float((-middle[:, 2] - half).min()), float((-middle[:, 2] + half).max())
        across = widest(way, len(way), row) + late + 0.5 * np.hypot(steps[:, 0], steps[:, 1])
        flat = np.full((len(way), 2), [0.5 * (low + high), 0.5 * (high - low)])
        return np.ascontiguousarray(np.column_stack([middle[:, :2], flat[:, 0], across, flat[:, 1]]))

    def _begin(self, state: SiteState, measurement: Measurement, sent: Command) -> None:
        """At first, or after somebody else flew: nothing is committed, rotors turn as the accelerometer says; what was
        read of the vehicle stays."""
        numbers, seen = state.numbers, measurement.row
        numbers[d.COMMITTED], state.bent[:], state.memory[:] = 0.0, 0.0, new_memory()
        if d.is_airborne(state.origin_ned_m[2] - seen[2], -seen[FORCE_Z]):
            norm = self.model.norm_of(-seen[FORCE_Z] * self.model.mass_kg / numbers[d.GAIN])
            remember(state.memory, sent.t_us - 1.0, norm, seen[10:13])

    def _in_force(self, numbers: F64) -> _Known:
        """The certificate's numbers, or the prior's once it was falsified."""
        return self._known[1 if numbers[d.BEYOND_S] >= d.BROKEN_S else 0]

    def _watch(self, numbers: F64, speed_mps: float) -> None:
        """Whether the certificate knows force and speed that are shown; once it did not for long, never again."""
        if numbers[d.BEYOND_S] >= d.BROKEN_S:
            return
        shown = float(np.linalg.norm(numbers[d.FORCE : d.FORCE + 3]))
        known = self._known[0]
        beyond = d.is_read(numbers) and (shown > known.most_mps2 or speed_mps > known.fastest_mps)
        numbers[d.BEYOND_S] = numbers[d.BEYOND_S] + numbers[d.HOLD_S] if beyond else 0.0

    def step(
        self, state: SiteState, measurement: Measurement, command: Command, sent: Command, learned: Learned
    ) -> tuple[SiteState, Command, Filtered]:
        """The safe command nearest to `command`; `sent` is the command of the tick before, as it went out."""
        row, numbers = _EMPTY.copy(), state.numbers
        row[F_INTERVENED], row[F_THRUST] = 0.0, command.thrust_n
        if not (np.isfinite(measurement.row[:16]).all() and np.isfinite(command.rate_frd_radps).all()):
            row[F_STATUS] = d.WAITING
            return state, command, Filtered(row)
        if command.t_us - numbers[d.LAST_US] > _PAUSE_US:
            self._begin(state, measurement, sent)
        if state.bent[bending.KNOWN] == 0.0:
            bending.begin(state.bent, measurement.row, state.origin_ned_m)
        times = (float(sent.t_us), float(measurement.t_us), float(command.t_us))
        known = self._in_force(numbers)
        norm, status = d.decide(
            known.known, (state.memory, numbers, state.committed), self._site, state.origin_ned_m, measurement.row,
            times, (sent.thrust_norm, sent.rate_frd_radps, command.thrust_norm, command.rate_frd_radps),
            (self._scratch, self._way, row, self._rate),
        )  # fmt: skip
        self._watch(numbers, float(np.linalg.norm(measurement.row[3:6])))
        row[F_H], row[F_STATUS], row[F_VERSION] = numbers[d.CLEARANCE], status, 0.0
        if status != d.CHANGED and not (status == d.WAITING and numbers[d.KEPT] > 0.0):
            return state, command, Filtered(row)
        row[F_INTERVENED] = 1.0
        safe, _ = self._limiter.limit(self.model.thrust_of(norm), self._rate, command.t_us)
        return state, safe, Filtered(row)
