"""What the log says of the filter: events with their numbers, the topic, the 3-D view, the certificate at its end."""

from __future__ import annotations

import dataclasses
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from certified import CENTRE, axis_certificate, certificate, says
from log_samples import proto_class, tick_record
from mcap.reader import make_reader
from shipped import load_scenario, load_vehicle

from flightstack.barrier.file import parse_certificate
from flightstack.barrier.shapes import Quadratic
from flightstack.cli.barrier_score import GivenCertificate, WatchedCertifier
from flightstack.cli.recorder import FilterEvents, LogObserver, certified_region, certified_words, scene_of
from flightstack.cli.workshop import Workshop
from flightstack.frames import ned_to_enu
from flightstack.model import Model
from flightstack.predictor import Streams
from flightstack.types import Filtered, TickRecord, changed
from flightstack_logs.log_clock import LogClock
from flightstack_logs.reader import Log, read
from flightstack_logs.threaded import ThreadedLog
from flightstack_logs.topics import FINAL_CERTIFICATE
from flightstack_logs.writer import FlightLog

MODEL = Model.from_vehicle(load_vehicle("quad-x"))


def told(*ticks: Filtered) -> list[tuple[int, str, str]]:
    """What is told of these ticks, 4 ms apart: time in ms, text, severity."""
    lines: list[tuple[int, str, str]] = []

    def tell(t_us: int, name: str, text: str, severity: str) -> None:
        assert name == "filter"
        lines.append((t_us // 1000, text, severity))

    events = FilterEvents(tell)
    for index, filtered in enumerate(ticks):
        events.on_filtered(4000 * index, filtered)
    return lines


# ---------------------------------------------------------------- events


def test_each_status_is_told_when_it_comes_with_its_numbers() -> None:
    change = says(3, wanted_acc_ned_mps2=(0.0, 0.0, 2.0), safe_acc_ned_mps2=(0.0, 0.0, -1.5))
    lines = told(*[says(0)] * 50, *[says(1)] * 50, *[says(2)] * 50, *[change] * 50, *[says(4, h=-0.02)] * 50, says(2))
    assert lines == [
        (0, "filter: nothing certified (h 0.400, at the state 0.500)", "info"),
        (200, "filter: not engaged (h 0.400, at the state 0.500)", "info"),
        (400, "filter: engaged (h 0.400, at the state 0.500)", "info"),
        (600, "filter: first change: wanted (0.00, 0.00, 2.00), sent (0.00, 0.00, -1.50) m/s^2 at h 0.400", "info"),
        (
            800,
            "filter: fallback: infeasible (h -0.020, at the state 0.500, margins (1.00, 2.00, 3.00) 1/s)",
            "warning",
        ),
        (1000, "filter: solves again (h 0.400, at the state 0.500)", "info"),
    ]


@pytest.mark.parametrize(("status", "word"), [(5, "not solved"), (6, "falsified")])
def test_the_other_fallbacks_have_their_names(status: int, word: str) -> None:
    assert told(says(2), *[says(status)] * 50)[1][1].startswith(f"filter: fallback: {word} (")


def test_changes_of_the_command_are_told_once_and_what_comes_and_goes_at_most_ten_times_a_second() -> None:
    assert len(told(*[says(2), says(3)] * 500)) == 2  # engaged, first change
    lines = told(*[says(2), says(4)] * 250)
    assert 3 < len(lines) <= 21


def test_without_a_filter_nothing_is_told() -> None:
    assert told(*[Filtered.nothing()] * 10) == []


def test_a_certificate_in_words() -> None:
    down = dataclasses.replace(certificate(), axes=(axis_certificate(2, Quadratic(0.0, 0.0, 4.0, 0.0, 1.0)),))
    assert certified_words(down) == "down -0.50 to 0.50 m, -1.00 to 1.00 m/s, 1.57 m^2/s"


# ---------------------------------------------------------------- the log


def logged(tmp_path: Path, *records: TickRecord) -> Log:
    log = FlightLog.open(tmp_path / "a.mcap", metadata={})
    for record in records:
        log.tick(record)
    log.close()
    assert log.failed is None, log.failed
    return read(tmp_path / "a.mcap")


def filtered_record(t_us: int, **changes: Any) -> TickRecord:
    rng = np.random.default_rng(t_us)
    filtered = changed(Filtered(rng.normal(size=len(Filtered.nothing().row))), status=3.0, **changes)
    return tick_record(t_us, (1.0, 2.0, -3.0))._replace(filtered=filtered)


def test_every_part_of_what_the_filter_says_reads_back(tmp_path: Path) -> None:
    record = filtered_record(8000)
    table = logged(tmp_path, record).tables["/filter"]
    seen = np.concatenate([np.atleast_1d(column[0]) for column in table.columns.values()])
    np.testing.assert_allclose(seen, record.filtered.row, rtol=1e-7)  # names in the order of the row; single precision
    for name in table.columns:
        np.testing.assert_allclose(table[name][0], getattr(record.filtered, name), rtol=1e-7, err_msg=name)
    assert table.units["margin_ps"] == "1/s"


def test_where_nothing_filters_there_is_no_topic(tmp_path: Path) -> None:
    tables = logged(tmp_path, tick_record(8000)).tables
    assert "/filter" not in tables
    assert "/tick" in tables


def scene_updates(path: Path, topic: str) -> list[Any]:
    with path.open("rb") as file:
        found = list(make_reader(file).iter_messages(topics=[topic]))
    return [proto_class(schema.data, schema.name).FromString(message.data) for schema, _, message in found if schema]


def test_the_view_has_the_wanted_and_the_safe_acceleration_as_arrows_at_the_vehicle(tmp_path: Path) -> None:
    wanted, safe = (3.0, -4.0, 0.0), (0.0, -2.0, 0.0)  # to the west, -x in the view: the arrow's worst turn
    logged(tmp_path, filtered_record(8000, wanted_acc_ned_mps2=wanted, safe_acc_ned_mps2=safe))
    (update,) = scene_updates(tmp_path / "a.mcap", "/scene/filter")
    by_name = {entity.id: entity.arrows[0] for entity in update.entities}
    for name, acc in (("wanted", wanted), ("safe", safe)):
        arrow = by_name[name]
        place, turn = arrow.pose.position, arrow.pose.orientation
        np.testing.assert_allclose([place.x, place.y, place.z], ned_to_enu(np.array([1.0, 2.0, -3.0])))
        x, y, z, w = turn.x, turn.y, turn.z, turn.w
        along = [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)]  # the turned +x axis
        length = arrow.shaft_length + arrow.head_length
        np.testing.assert_allclose(np.array(along) * length, 0.1 * ned_to_enu(np.array(acc)), atol=1e-12)


def test_before_it_is_engaged_and_without_numbers_there_are_no_arrows(tmp_path: Path) -> None:
    blind = filtered_record(1_000_000, wanted_acc_ned_mps2=np.nan, safe_acc_ned_mps2=np.nan)
    logged(tmp_path, filtered_record(8000)._replace(filtered=says(1)), blind)
    assert scene_updates(tmp_path / "a.mcap", "/scene/filter") == []


def test_the_certified_region_is_a_box_of_positions_and_as_published_an_ellipsoid() -> None:
    low = Quadratic(0.2, -0.1, 4.0, 0.0, 1.0)  # e within 0.5 of 0.2
    one = dataclasses.replace(certificate(), axes=(axis_certificate(2, low),))
    box = certified_region(one, np.array([10.0, 20.0, 30.0]))
    assert box.shape == "box"
    assert box.center_ned_m == pytest.approx((10.0 + CENTRE[0], 20.0 + CENTRE[1], 30.0 + CENTRE[2] + 0.2))
    assert box.half_size_m == pytest.approx((2.0, 2.0, 0.5))
    assert certified_region(certificate(mode="as-published"), np.zeros(3)).shape == "ellipsoid"


@pytest.mark.parametrize("threaded", [False, True])
def test_the_last_certificate_is_in_the_log_and_its_region_in_the_view(tmp_path: Path, threaded: bool) -> None:
    path = tmp_path / "a.mcap"
    log: Any = FlightLog.open(path, metadata={})
    log = ThreadedLog(log) if threaded else log
    for version in (1, 2):
        one = certificate(semi_m=1.0 * version, version=version)
        log.scene(1000 * version, certified_region(one, np.zeros(3)))
        log.certificate(1000 * version, one)
    log.close()
    assert log.failed is None
    data = read(path).attachment(FINAL_CERTIFICATE)
    assert data is not None
    last = parse_certificate(data.decode(), "attached")
    assert last.version == 2
    assert last.axes[0].margins == certificate().axes[0].margins
    sizes = [update.entities[0].cubes[0].size.x for update in scene_updates(path, "/scene/region")]
    assert sizes == pytest.approx([2.0, 4.0])


def test_a_certificate_that_is_no_plain_json_costs_one_line_and_not_the_log(tmp_path: Path) -> None:
    log = FlightLog.open(tmp_path / "a.mcap", metadata={})
    log.tick(tick_record(4000))
    log.certificate(4000, certificate(knowledge={"what": {1, 2}}))
    log.close()
    assert "certificate" in (log.failed or "")
    seen = read(tmp_path / "a.mcap")
    assert seen.complete
    assert len(seen.tables["/tick"]) == 1


def test_a_watched_certifier_is_what_the_events_speak_of() -> None:
    lines: list[str] = []
    FilterEvents(lambda t_us, name, text, severity: lines.append(text)).on_certificate(0, certificate(version=3))
    assert lines[0].startswith("filter: certificate 3: north -1.00 to 1.00 m")
    assert WatchedCertifier(GivenCertificate(certificate(), MODEL)).enabled


def test_a_falsified_certificate_is_told_with_its_reason() -> None:
    lines: list[tuple[str, str]] = []
    events = FilterEvents(lambda t_us, name, text, severity: lines.append((text, severity)))
    events.on_certificate(0, certificate(version=4, knowledge={"falsified": "down: off by 0.9 m/s^2"}))
    assert lines[0] == ("filter: certificate falsified: down: off by 0.9 m/s^2", "warning")
    assert lines[1][0].startswith("filter: certificate 4: ")


def test_a_process_that_is_lost_is_told_once_with_its_reason(tmp_path: Path) -> None:
    log, shop = FlightLog.open(tmp_path / "a.mcap", metadata={}), Workshop()
    watched = WatchedCertifier(GivenCertificate(certificate(), MODEL), elsewhere=shop)
    clock = LogClock(log, zero_us=0, utc_us=0)
    scene = partial(scene_of, load_scenario("hover"), load_vehicle("quad-x"), (), truth=False)
    observer = LogObserver(log, clock, scene, certifier=watched)
    observer.companion = SimpleNamespace(mission=None, view=SimpleNamespace(streams=Streams()))  # type: ignore[assignment]
    for tick, why in enumerate(("", "its process has ended", "its process has ended")):
        shop.lost = why
        observer.on_tick(filtered_record(4000 * tick))
    log.close()
    lines = [text for text in read(tmp_path / "a.mcap").tables["/events"]["text"].tolist() if "nothing more" in text]
    assert lines == ["filter: certifies nothing more (its process has ended); what is in force stays"]
