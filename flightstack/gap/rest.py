"""What the named effects leave: whether it is to be told, and on what it depends."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from flightstack.gap.compare import residual, velocity_noise
from flightstack.gap.decisions import HALF, MATTERS_MPS2, SMALL_SHARE
from flightstack.gap.naming.bench import SimulatorBench
from flightstack.gap.naming.drivers import block_means
from flightstack.gap.naming.estimate import Estimates
from flightstack.gap.naming.whitening import Mask
from flightstack.gap.records import Samples, Unexplained
from flightstack.gap.remainder import BLOCK_S, FOLDS, GROUPS, Rest, rests
from flightstack.gap.simulate import Knob, sensitivities
from flightstack.gap.track import track
from flightstack.vehicle import Vehicle


def telling(bench: SimulatorBench, made: Estimates, rests_of: Mapping[str, Rest]) -> dict[str, Rest]:
    """Groups of channels whose rest depends on something, strongly enough to matter."""
    slow = _slow_noise(bench, made.vehicle)
    return {
        group: r
        for group, r in rests_of.items()
        if r.drivers and r.share > SMALL_SHARE and r.driven_rms > max(_matters(bench, group), slow[group])
    }


def loud(bench: SimulatorBench, start: Vehicle, told: Mapping[str, Rest]) -> dict[str, Rest]:
    """Of these, what stands out of one step's noise."""
    noise = np.nan_to_num(np.array([residual(start, s).noise for s in bench.flights])).max(axis=0)
    return {g: r for g, r in told.items() if r.driven_rms > HALF * np.linalg.norm(noise[list(GROUPS[g])])}


def beside_names(bench: SimulatorBench, start: Vehicle, made: Estimates) -> Unexplained:
    """The rest beside a poor model's names: on what it depends; that there is one is known."""
    told = telling(bench, made, every_rest(bench, start, made))
    return replace(unexplained(loud(bench, start, told)), significant=True)


def unexplained(told: Mapping[str, Rest]) -> Unexplained:
    """These rests in one, the strongest driver first."""
    drivers: list[str] = []
    for r in sorted(told.values(), key=lambda r: -r.driven):
        drivers += [d for d in r.drivers if d not in drivers]
    return Unexplained(bool(told), tuple(drivers), float(max((r.share for r in told.values()), default=0.0)))


def every_rest(bench: SimulatorBench, start: Vehicle, made: Estimates) -> dict[str, Rest]:
    """What is left of each group of channels, told or not."""
    masks = [s.valid & (np.repeat(f | h, k)[: len(s.t_s)]) for s, f, h, k in _whole(bench)]
    after = [residual(made.vehicle, s).y for s in bench.flights]
    before = [residual(start, s).y for s in bench.flights]
    none = [np.zeros((len(s.t_s), 6, 0)) for s in bench.flights]
    knobs = [Knob(e, p) for e, p in made.slots]
    columns = [sensitivities(made.vehicle, s, knobs) for s in bench.flights] if knobs else none
    blocks = block_means(bench.flights, after, columns, masks, block_s=BLOCK_S, stretch_s=3.0, folds=FOLDS)
    first = block_means(bench.flights, before, none, masks, block_s=BLOCK_S, stretch_s=3.0, folds=FOLDS)
    return rests(first.y, blocks)


def _slow_noise(bench: SimulatorBench, vehicle: Vehicle) -> dict[str, float]:
    """What the velocity's own slow error leaves of each group through the vehicle's drag, root mean square."""
    worst = np.nan_to_num(np.array([velocity_noise(vehicle, s) for s in bench.flights])).max(axis=0)
    return {group: float(np.max(worst[list(channels)])) for group, channels in GROUPS.items()}


def _matters(bench: SimulatorBench, group: str) -> float:
    """What a remainder of this group must reach to be told, root mean square."""
    if group != "torque":
        return MATTERS_MPS2
    flown = [track(s).lowpass(track(s).measured[:, 3:6])[s.valid] for s in bench.flights]
    return SMALL_SHARE * float(np.sqrt(np.nanmean(np.concatenate(flown) ** 2)))


def _whole(bench: SimulatorBench) -> list[tuple[Samples, Mask, Mask, int]]:
    return list(zip(bench.flights, bench.fit, bench.holdout, bench.every, strict=True))
