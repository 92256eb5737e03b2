"""From the ground with GPS: nothing turns fast before it flies, no rotor is at its limit, and it rises gently."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from flightstack.cli.flight import FlyOptions, fly
from flightstack_logs.reader import read


def test_a_heavy_vehicle_with_gps_leaves_the_ground_upright_and_gently(tmp_path: Path) -> None:
    """Seed 16: rates for errors of the estimate were commanded on the ground for 22 s, one rotor at its limit and the
    rest idling; then it came free at full thrust, 14 m behind its reference, and rose at 7.3 m/s."""
    options = FlyOptions(scenario="gps-barrier", out=tmp_path, seed=16, duration_s=1.0)
    result = fly(options, report_wanted=lambda _: False)
    assert result.passed, result.failure()
    tables = read(tmp_path / "flight.mcap").tables
    truth, command = tables["/truth"], tables["/command"]
    height = -truth["pos_ned_m"][:, 2]
    assert height.max() > 19.0  # it flew
    free_us = int(truth.t_us[np.argmax(height > 0.05)])
    begun_us = int(command.t_us[np.argmax(command["thrust_n"] > 1.0)])
    assert free_us - begun_us < 2_000_000
    turned = np.abs(command["rate_frd_radps"]).max(axis=1) > 0.5
    first = float(np.interp(command.t_us[np.argmax(turned)], truth.t_us, height))
    assert 0.0 < first < 0.5
    ground = (truth.t_us > begun_us) & (truth.t_us < free_us)
    assert truth["motor_u"][ground].max() < 0.99
    assert np.ptp(truth["motor_u"][ground], axis=1).max() < 0.4
    assert -truth["vel_ned_mps"][:, 2].min() < 1.2 + 0.5
    rising = (truth.t_us > begun_us) & (truth.t_us < free_us + 3_000_000)
    assert 2.0 * np.hypot(*truth["q_ned_frd"][rising][:, 1:3].T).max() < 0.35
