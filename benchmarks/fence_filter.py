"""`python -m benchmarks.fence_filter`: what a step of the site filter takes, with 64 edges and 16 solids near by."""

from __future__ import annotations

import math
import time

import numpy as np

from flightstack.barrier.estimate_bounds import estimate_bounds
from flightstack.cli import files
from flightstack.cli.protection import governor_for
from flightstack.cli.sensors import error_statistics
from flightstack.model import Limits, Model
from flightstack.site.file import parse_site
from flightstack.site.filter import SiteFilter
from flightstack.site.stopping import stopping
from flightstack.types import Command, Learned, Measurement
from flightstack_sim.grade import load_grade

STEPS = 4000


def site_text(rng: np.random.Generator) -> str:
    """A star of 64 edges round the start, and 16 solids between 3 and 7 m from it."""
    angle = np.linspace(0.0, 2.0 * math.pi, 64, endpoint=False)
    radius = rng.uniform(6.0, 9.0, 64)
    corners = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1).round(3).tolist()
    text = f'schema = "flightstack.site/1"\nfloor_m = 0.3\nceiling_m = 6.0\ninside = {corners}\n'
    for k in range(16):
        far, way = rng.uniform(3.0, 7.0), 2.0 * math.pi * k / 16
        centre = [round(far * math.cos(way), 2), round(far * math.sin(way), 2)]
        text += f"[[keep_out]]\ncentre = {[*centre, 2.0] if k % 2 else centre}\nradius_m = 0.3\n"
    return text


def main() -> None:
    """Random states inside, random commands; every step lays out a way, and where that is not clear up to four more."""
    rng = np.random.default_rng(0)
    believed, _ = files.load_vehicle(None)
    model, limits = Model.from_vehicle(believed), Limits()
    estimate = estimate_bounds(error_statistics(load_grade("mocap")))
    made = stopping(believed, model, limits, estimate, governor_for(believed, model, limits, "mocap"))
    filtering = SiteFilter(model, limits, made, parse_site(site_text(rng), "site.toml"), np.zeros((1, 2)), 1.6)
    state, t_us, took, changed = filtering.init(np.zeros(3)), 0, [], 0
    sent = Command(0, model.weight_n, model.hover_norm, np.zeros(3))
    row = np.zeros(20)
    row[6], row[15] = 1.0, -9.8
    for k in range(STEPS):
        t_us += 4000
        if k % 20 == 0:
            row[:3] = *rng.uniform(-4.0, 4.0, 2), -rng.uniform(1.0, 4.0)
            row[3:6] = rng.uniform(-2.5, 2.5, 3) * [1.0, 1.0, 0.3]
        norm = float(np.clip(model.hover_norm + rng.normal(0.0, 0.05), 0.2, 0.85))
        command = Command(t_us, model.thrust_of(norm), norm, rng.normal(0.0, 0.5, 3))
        measurement = Measurement(t_us, row.copy(), 4000, 4000, 4000)
        began = time.perf_counter_ns()
        state, sent, filtered = filtering.step(state, measurement, command, sent, Learned.nothing())
        took.append(1e-3 * (time.perf_counter_ns() - began))
        changed += filtered.intervened == 1.0
    median, high = np.percentile(took, [50, 99])
    print(f"{STEPS} steps, {changed} changed: median {median:.0f} us, p99 {high:.0f} us, most {max(took):.0f} us")


if __name__ == "__main__":
    main()
