"""Waypoint files: TOML and CSV alike, times found where missing, impossible courses refused by waypoint."""

from __future__ import annotations

import numpy as np
import pytest

from flightstack.model import Limits
from flightstack.types import InputError
from flightstack.waypoints import Waypoints, parse_waypoints, waypoint_trajectory

TOML = 'schema = "flightstack.waypoints/1"\nwaypoints = [[0, 0, -1], [2, 0, -1.5], [2, 2, -1]]\n'


def test_toml_and_csv_say_the_same() -> None:
    csv = "north_m,east_m,down_m\n0,0,-1\n2,0,-1.5\n2,2,-1\n"
    short = "# a course\nd, n, e\n-1,0,0\n-1.5,2,0\n-1,2,2\n"
    assert parse_waypoints(TOML, "a") == parse_waypoints(csv, "b") == parse_waypoints(short, "c")


def test_yaw_and_time_are_read_and_time_starts_at_zero() -> None:
    waypoints = parse_waypoints("n,e,d,yaw,time\n0,0,-1,0.5,10\n1,0,-1,0.6,13\n", "a")
    assert waypoints.times_s == (0.0, 3.0)
    assert [p[3] for p in waypoints.points] == [0.5, 0.6]


def test_without_times_the_path_is_as_fast_as_speed_or_acceleration_allow() -> None:
    for speed, acceleration in ((1.0, 3.0), (10.0, 2.0)):
        waypoints = Waypoints(((0, 0, -1, 0), (6, 0, -2, 0), (6, 5, -1, 0)), None, speed, acceleration)
        path = waypoint_trajectory(waypoints, "a", Limits())
        points = [path.at(t) for t in np.linspace(0.0, path.duration_s, 2000)]
        fastest = max(float(np.linalg.norm(p.vel_ned_mps)) for p in points)
        hardest = max(float(np.linalg.norm(p.acc_ned_mps2)) for p in points)
        assert fastest <= 1.01 * speed
        assert hardest <= 1.01 * acceleration
        assert fastest == pytest.approx(speed, rel=0.01) or hardest == pytest.approx(acceleration, rel=0.01)


def test_yaw_turns_the_short_way_between_waypoints() -> None:
    path = waypoint_trajectory(Waypoints(((0, 0, -1, 3.0), (3, 0, -1, -3.0))), "a", Limits())
    yaws = [path.at(t).yaw_rad for t in np.linspace(0.0, path.duration_s, 100)]
    assert max(yaws) - min(yaws) == pytest.approx(2 * np.pi - 6.0, abs=1e-6)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "w: no waypoints"),
        ("n,e\n1,2\n", "w: header n,e is not understood"),
        ("n,e,d,colour\n1,2,-3,4\n", "w: header n,e,d,colour is not understood"),
        ("n,e,d\n0,0,-1\n1,x,-1\n", "w: waypoint 2: 1,x,-1 must be 3 numbers"),
        ("n,e,d\n0,0,-1\n1,2\n", "w: waypoint 2: 1,2 must be 3 numbers"),
        ("n,e,d\n0,0,-1\n", "w: waypoints must be a list of 2 to 100"),
        ("n,e,d\n0,0,-1\n1,0,nan\n", "w: waypoint 2: down_m = nan is not allowed"),
        ("n,e,d\n0,0,-1\n1,0,0\n", "w: waypoint 2: down_m = 0 is too low"),
        ("n,e,d\n0,0,-1\n0,0,-1\n", "w: waypoint 2 is where the one before it is"),
        ("n,e,d,time\n0,0,-1,0\n1,0,-1,0\n", "w: waypoint 2: time_s = 0 must be at least 0.4 s after 0"),
        (TOML.replace("[2, 0, -1.5]", "[2, 0]"), r"w: waypoint 2 = \[2, 0\] must be a list of 3 to 5"),
        (TOML.replace("[2, 0, -1.5]", "[2, 0, -1.5, 0, 1]"), "w: 1 of 3 waypoints have a time_s"),
        (TOML + "speed_mps = -1\n", "w: speed_mps = -1 is not allowed"),
        (TOML + "speed = 1\n", "w: unknown key speed"),
        (TOML.replace("waypoints/1", "waypoints/2"), "w: schema = 'flightstack.waypoints/2' is not known"),
        ("schema = [\n", "w: not valid TOML"),
    ],
)
def test_a_mistake_is_one_line_that_names_the_waypoint(text: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        parse_waypoints(text, "w")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("points", "times", "message"),
    [
        (((0, 0, -1, 0), (5, 0, -1, 0)), (0.0, 1.0), "w: on the way to waypoint 2 tilt would be"),
        (((0, 0, -1, 0), (3, 0, -1, 0), (3, 0, -6, 0)), (0.0, 3.0, 4.0), "w: on the way to waypoint [23] "),
        (
            ((0, 0, -4, 0), (1, 0, -0.4, 0), (2, 0, -0.4, 0), (3, 0, -4, 0)),
            (0.0, 3.0, 5.0, 8.0),
            "waypoint 3 the path dips",
        ),
    ],
)
def test_a_course_that_cannot_be_flown_is_refused_by_waypoint(
    points: tuple[tuple[float, float, float, float], ...], times: tuple[float, ...], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        waypoint_trajectory(Waypoints(points, times), "w", Limits())


def test_tilt_beyond_the_limit_is_refused() -> None:
    waypoints = Waypoints(((0, 0, -1, 0), (4, 0, -1, 0)), (0.0, 2.0))
    with pytest.raises(InputError, match=r"tilt would be .* degrees; allowed are 20"):
        waypoint_trajectory(waypoints, "w", Limits(tilt_max_rad=np.radians(20.0)))
    assert waypoint_trajectory(waypoints, "w", Limits()).duration_s == 2.0
