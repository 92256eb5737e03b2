"""Rounds that go faster and faster: what they fly, where they fit, and how much faster the next may be."""

from __future__ import annotations

import math

import numpy as np
import pytest

from flightstack.barrier.estimate_bounds import estimate_bounds
from flightstack.cli import files
from flightstack.cli.protection import governor_for
from flightstack.cli.sensors import error_statistics
from flightstack.model import Limits, Model
from flightstack.site import decide, faster
from flightstack.site.clearance import packed
from flightstack.site.file import parse_site
from flightstack.site.filter import SiteFilter
from flightstack.site.stopping import Prior, StoppingCertificate, stopping
from flightstack.types import F64, Command, Learned, Measurement
from flightstack_sim.grade import load_grade

MIDDLE = np.array([1.0, -2.0, -2.5])


def flown(speed_mps: float) -> list[tuple[F64, F64, F64]]:
    """Places, velocities and accelerations of each path, every 10 ms."""
    paths = []
    for path in faster.star(MIDDLE, 0.3, speed_mps):
        points = [path.at(t_s) for t_s in np.arange(0.0, path.duration_s, 0.01).tolist()]
        paths.append(tuple(np.stack([getattr(p, name) for p in points]) for name in ("pos_ned_m", "vel_ned_mps")))
    return [(place, vel, np.gradient(vel, 0.01, axis=0)) for place, vel in paths]  # type: ignore[misc]


@pytest.mark.parametrize("speed_mps", [1.0, 2.0, 4.5])
def test_a_star_is_flown_at_its_speed_once_in_every_direction(speed_mps: float) -> None:
    paths = flown(speed_mps)
    assert np.allclose(paths[0][0][0], MIDDLE)
    assert np.linalg.norm(paths[-1][0][-1] - MIDDLE) < 0.05
    runs = paths[1:-1]
    assert len(runs) == 8
    headings = []
    for place, vel, acc in runs:
        speeds = np.linalg.norm(vel, axis=1)
        assert speeds.max() == pytest.approx(speed_mps, rel=1e-3)
        assert np.linalg.norm(acc, axis=1).max() <= 3.5 * 1.01
        along = vel[speeds.argmax()] / speeds.max()
        headings.append(round(math.degrees(math.atan2(along[1], along[0])) % 360.0, 3) % 360.0)
        assert np.allclose(place[:, 2], MIDDLE[2])
    assert sorted(headings) == pytest.approx([45.0 * k for k in range(8)], abs=0.01)


@pytest.fixture(scope="module")
def made() -> StoppingCertificate:
    believed, _ = files.load_vehicle(None)
    model, estimate = Model.from_vehicle(believed), estimate_bounds(error_statistics(load_grade("mocap")))
    return stopping(believed, model, Limits(), estimate, governor_for(believed, model, Limits(), "mocap"))


def box(half_m: float) -> F64:
    """A square of so much each way round the origin."""
    corners = [[-half_m, -half_m], [half_m, -half_m], [half_m, half_m], [-half_m, half_m]]
    text = f'schema = "flightstack.site/1"\nfloor_m = 0.3\nceiling_m = 5.0\ninside = {corners}\n'
    return packed(parse_site(text, "box.toml"), np.zeros((1, 2)), 1.6)


def test_a_star_is_as_fast_as_the_room_allows(made: StoppingCertificate) -> None:
    middle = np.array([0.0, 0.0, -2.0])

    def fastest(half_m: float) -> float:
        return faster.fastest_star(middle, 0.0, 5.0, lambda path: faster.leads_clear(path, made, box(half_m)))[0]

    found = [fastest(half_m) for half_m in (1.5, 3.0, 5.0, 30.0)]
    assert found[0] == 0.0  # no room for the tube at rest
    assert 0.0 < found[1] < found[2] < found[3] == 5.0
    # from the middle of a run one has to stop before the wall, and no braking is harder than thrust allows
    for half_m, speed in zip((3.0, 5.0), found[1:3], strict=True):
        assert 0.5 * speed * speed / 9.81 + made.radius_m < half_m


def test_the_next_round_dares_no_more_than_the_certificate_knows() -> None:
    prior = Prior(0.9, 1.1, 0.1, 6.0)
    assert faster.allowed_mps(2.0, 0.0, prior) == pytest.approx(3.0)
    assert faster.allowed_mps(4.5, 0.1, prior) == pytest.approx(6.0)  # as fast as the certificate holds
    # half of the force it holds for was felt at 3 m/s: grown with the square of the speed that is all of it at 4.24 m/s
    assert faster.allowed_mps(3.0, 0.05 * 9.80665, prior) == pytest.approx(3.0 * math.sqrt(2.0))
    assert not faster.is_worth(4.24, 4.0)
    assert faster.is_worth(4.5, 4.0)


def test_nothing_is_certain_on_the_ground_where_no_way_out_was_clear(made: StoppingCertificate) -> None:
    """Flown 20 m out of the site in OFFBOARD, then down: it is set down, and not taken for flown within the site."""
    believed, _ = files.load_vehicle(None)
    model, still = Model.from_vehicle(believed), np.zeros(3)
    square = parse_site('schema = "flightstack.site/1"\ninside = [[-5, -5], [5, -5], [5, 5], [-5, 5]]\n', "box.toml")
    kept = SiteFilter(model, Limits(), made, square, np.zeros((1, 2)), 1.6)
    state, command, row = kept.init(still), Command(0, model.weight_n, model.hover_norm, still), np.zeros(20)
    row[0], row[6], row[15] = 20.0, 1.0, -9.8
    for k, height in enumerate([0.3] * 5 + [0.02] * 5):
        row[2] = -height
        t_us = 4000 * (k + 1)
        wanted = Command(t_us, model.weight_n, model.hover_norm, still)
        state, command, filtered = kept.step(
            state, Measurement(t_us, row.copy(), 4000, 4000, 4000), wanted, command, Learned.nothing()
        )
        assert filtered.status == decide.WAITING, height
    assert command.thrust_n < 0.8 * model.weight_n
