"""Whether a vehicle's own words bear out the sensors that certificates count on."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from certified import certificate
from tlog import recording

from flightstack.barrier.estimate_bounds import EstimateBounds, contradiction, estimate_bounds
from flightstack.barrier.falsify import HAND_OVER
from flightstack.barrier.records import Certificate
from flightstack.cli.barrier_score import WatchedCertifier
from flightstack.cli.offboard import OffboardOptions
from flightstack.cli.preparation import prepare_flight
from flightstack.cli.sensors import error_statistics
from flightstack.seams import NoCertifier
from flightstack.types import Filtered, Learned, Measurement
from flightstack_sim.grade import GRADES, load_grade
from mavlink_bridge import messages as m

BOUNDS = EstimateBounds((0.3, 0.4, 0.8), (0.2, 0.3, 0.4), (0.5, 0.5, 0.1), 4.3)
QUIET = np.zeros(3)


def bounds_of(grade: str) -> EstimateBounds:
    return estimate_bounds(error_statistics(load_grade(grade)))


def test_what_the_estimator_states_is_held_against_the_bounds_axis_by_axis() -> None:
    """Across, both axes together: 0.5 m; a bound is passed by more than itself only."""
    assert contradiction(BOUNDS, "any", (0.5, 0.8), np.array([0.2, 0.3, 0.4])) == ""
    assert "across to 0.51 m" in contradiction(BOUNDS, "any", (0.51, 0.1), QUIET)
    assert "down to 0.81 m" in contradiction(BOUNDS, "any", (0.1, 0.81), QUIET)
    assert "velocity east" in contradiction(BOUNDS, "any", (0.1, 0.1), np.array([0.0, 0.31, 0.0]))
    assert contradiction(BOUNDS, "any", (math.nan, math.nan), QUIET) == "", "what is not stated contradicts nothing"


def test_a_recorded_px4_contradicts_motion_capture_and_not_its_own_grade(recorded: Path) -> None:
    heard = [each.message for each in recording(recorded / "px4_sih_offboard.tlog") if each.system == 1]
    stated = [
        (each.pos_horiz_accuracy_m, each.pos_vert_accuracy_m) for each in heard if isinstance(each, m.EstimatorStatus)
    ]
    assert len(stated) > 20
    for accuracy in stated[10:]:  # aligned
        assert "mocap sensors" in contradiction(bounds_of("mocap"), "mocap", accuracy, QUIET)
        assert contradiction(bounds_of("px4-sih"), "px4-sih", accuracy, QUIET) == ""


@pytest.mark.parametrize("grade", GRADES)
def test_the_simulator_contradicts_no_grade_that_it_simulates(grade: str) -> None:
    estimate = load_grade(grade).estimate
    accuracy = math.hypot(*estimate.pos_std_m[:2]), estimate.pos_std_m[2]
    assert contradiction(bounds_of(grade), grade, accuracy, QUIET) == ""


@pytest.mark.parametrize(
    ("given", "named"),
    [
        ({"sensors": "px4-sih"}, "with px4-sih sensors nothing can be certified: position east is known to 1.4"),
        ({"set_params": "px4-sih-ekf"}, "with px4-sih-ekf sensors nothing can be certified: position down is known to"),
        ({"sensors": "gps", "set_params": "px4-sih-ekf"}, "with gps sensors nothing can be certified"),
    ],
)
def test_the_bound_that_does_not_fit_is_named_before_anything_moves(given: dict[str, str], named: str) -> None:
    protection = prepare_flight(OffboardOptions(connect="", scenario="paper-tracking", **given)).protection
    assert protection.asked
    assert not protection.filter.enabled
    assert protection.unattainable.startswith(named)


def test_by_itself_a_flight_counts_on_what_its_scenario_says() -> None:
    """And the vehicle may contradict it."""
    options = OffboardOptions(connect="", scenario="paper-tracking")
    prepared = prepare_flight(options)
    assert prepared.protection.estimate == bounds_of("mocap")
    assert prepared.protection.unattainable == ""


def test_once_contradicted_nothing_is_certified_and_what_was_is_handed_over_once() -> None:
    class Certifies(NoCertifier):
        enabled = True

        def step(self, state: object, *given: object) -> tuple[object, Certificate | None]:
            return state, certificate()

    said, watched = "", WatchedCertifier(Certifies())
    watched.contradicted = lambda: said
    nothing = (None, Measurement(0, np.zeros(20), 0, 0, 0), Learned.nothing(), Filtered.nothing())
    state = watched.init()
    first = watched.step(state, *nothing)[1]
    assert first is not None
    said = "its position is known to 9 m"
    ended = watched.step(state, *nothing)[1]
    assert ended is not None
    assert ended.version > first.version
    assert ended.knowledge["falsified"] == said
    assert ended.knowledge[HAND_OVER] is True
    said = ""
    assert watched.step(state, *nothing)[1] is None
    assert watched.hindrance == "its position is known to 9 m"
    watched.init()
    assert watched.step(state, *nothing)[1] is not None, "another flight begins anew"
