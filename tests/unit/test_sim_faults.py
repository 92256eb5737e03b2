"""Injected faults: the words of --fault, what each does to what is sent, and the statistics of bad links."""

from __future__ import annotations

import math

import numpy as np
import pytest
from station import ROOT, Station, airborne

from flightstack.types import InputError
from flightstack_sim.faults import DEFAULT_TIME_S, FAULTS, Injector, parse_faults
from flightstack_sim.link_faults import REORDER_DELAY_US, BadLink, LinkQuality
from mavlink_bridge import messages as m

_BY_NAME = {spec.name: spec for spec in FAULTS}
NUMBER = 20_000


def _flying(fault: str) -> Station:
    """In the air, the fault just begun."""
    station = airborne()
    station.server.faults = Injector(parse_faults(fault))
    station.run_until(lambda: station.server.faults.happened, 5.0)
    station.clear()
    return station


# --- the words ---


def test_a_fault_has_a_time_a_value_and_an_end() -> None:
    plain, full, link = parse_faults("gcs-loss, ekf-reset:-2.5@12, link-loss:0.2@3+4")
    assert (plain.spec.name, plain.at_s, plain.duration_s) == ("gcs-loss", DEFAULT_TIME_S, math.inf)
    assert math.isnan(plain.value)
    assert (full.spec.name, full.value, full.at_s) == ("ekf-reset", -2.5, 12.0)
    assert (link.value, link.at_s, link.duration_s) == (0.2, 3.0, 4.0)
    assert parse_faults(None) == parse_faults("") == ()
    assert math.isnan(parse_faults("link-loss")[0].at_s)  # from the first message


@pytest.mark.parametrize(
    "words",
    [
        "nonsense", "gcs-loss@", "link-loss:x", "link-loss:1.5", "link-loss:-0.1", "low-battery:nan", "clock-jump:e",
        "position-stale:3", "gcs-loss@1.2.3", "ekf-reset@1+2", "link-loss:0.1;rm", "LINK-LOSS", "link-delay:1e9",
    ],
)  # fmt: skip
def test_words_that_are_no_fault_are_one_line_that_says_what_to_do(words: str) -> None:
    with pytest.raises(InputError) as raised:
        parse_faults(words)
    text = str(raised.value)
    assert "\n" not in text
    assert text.startswith("fault ")


def test_an_unknown_fault_is_told_the_whole_table() -> None:
    with pytest.raises(InputError) as raised:
        parse_faults("meteorite")
    assert all(spec.name in str(raised.value) for spec in FAULTS)


@pytest.mark.parametrize("spec", FAULTS, ids=lambda spec: spec.name)
def test_every_row_of_the_table_is_complete_and_its_own_words_are_taken(spec) -> None:
    (fault,) = parse_faults(spec.name)
    assert fault.spec is spec
    assert spec.does
    assert spec.reaction
    path, test = spec.test.split("::")
    assert f"def {test}(" in (ROOT / path).read_text()
    if spec.unit and not math.isnan(spec.value):
        assert spec.limits[0] <= spec.value <= spec.limits[1]


# --- what is sent ---


def test_a_fault_comes_so_many_seconds_after_take_off() -> None:
    station = Station().boot()
    station.server.faults = Injector(parse_faults("clock-jump:5@1.5"))
    assert not station.server.faults.happened  # on the ground nothing happens
    flying = airborne()
    flying.server.faults = Injector(parse_faults("position-stale@1.5+1"))
    start_us = flying.server.t_us
    flying.run(4.0)
    (begun_us, begun), (ended_us, ended) = flying.server.faults.happened
    assert (begun, ended) == ("position-stale begins", "position-stale ends")
    assert begun_us - start_us == pytest.approx(1_500_000, abs=8_000)
    assert ended_us - begun_us == 1_000_000


def test_a_stale_position() -> None:
    station = _flying("position-stale@0+1")
    station.run(0.9)
    kinds = {type(message) for _, message in station.heard[0]}
    assert not kinds & {m.LocalPositionNed, m.GlobalPositionInt, m.Odometry}
    assert {m.AttitudeQuaternion, m.HighresImu} <= kinds
    station.run(0.3)
    assert station.all(m.LocalPositionNed)


def test_a_frozen_position() -> None:
    """Fresh stamps, one place, whatever the vehicle does."""
    station = _flying("position-frozen@0")
    station.run(1.0)
    told = station.all(m.LocalPositionNed)
    assert len({message.pos_ned_m for message in told}) == 1
    assert len({message.t_boot_us for message in told}) == len(told)
    assert len({message.rate_frd_radps for message in station.all(m.AttitudeQuaternion)}) > 10


def test_an_estimate_that_jumps() -> None:
    station = airborne()
    before = station.last(m.Odometry)
    station.server.faults = Injector(parse_faults("ekf-reset:3@0"))
    station.stream = None  # what was streamed would be flown to
    station.run(0.1)
    after = station.last(m.Odometry)
    assert after.reset_counter == before.reset_counter + 1
    assert after.pos_ned_m[0] - before.pos_ned_m[0] == pytest.approx(3.0, abs=0.3)


def test_a_lost_attitude() -> None:
    station = _flying("attitude-loss@0")
    station.run(2.1)
    kinds = {type(message) for _, message in station.heard[0]}
    assert not kinds & {m.Attitude, m.AttitudeQuaternion}
    assert m.LocalPositionNed in kinds
    assert not station.last(m.EstimatorStatus).flags & 1


def test_a_clock_that_jumps() -> None:
    station = airborne()
    station.server.faults = Injector(parse_faults("clock-jump:2.5@0"))
    before = station.last(m.HighresImu).t_us
    station.clear()
    station.run(0.1)
    assert station.last(m.HighresImu).t_us - before == pytest.approx(2_600_000, abs=30_000)
    station.send(m.Timesync(0, 77, 1, 1))
    station.run(0.02)
    answer = [message for message in station.all(m.Timesync) if message.ts1_ns == 77][-1]
    assert answer.tc1_ns // 1000 == pytest.approx(station.server.t_us + 2_500_000, abs=30_000)


def test_an_estimate_without_a_position() -> None:
    station = _flying("estimator-loss@0")
    station.run(2.1)
    kinds = {type(message) for _, message in station.heard[0]}
    assert not kinds & {m.LocalPositionNed, m.GlobalPositionInt}
    assert all(math.isnan(x) for x in station.last(m.Odometry).pos_ned_m)
    flags = station.last(m.EstimatorStatus).flags
    assert not flags & (0x08 | 0x10)  # neither relative nor absolute horizontal position
    assert flags & 1


def test_a_low_battery_is_told() -> None:
    station = _flying("low-battery:0.06@0")
    station.run(2.1)
    status = station.last(m.BatteryStatus)
    assert (status.remaining, status.charge_state) == (6, 3)  # MAV_BATTERY_CHARGE_STATE_CRITICAL
    assert station.last(m.SysStatus).remaining == 6


# --- links ---


def _carried(quality: LinkQuality, *, seed: int = 3, spacing_us: int = 4_000) -> tuple[BadLink, list[tuple[int, int]]]:
    """(number, time of arrival - time of sending) of what arrives of NUMBER datagrams."""
    link, arrived = BadLink(seed, 0), []
    for k in range(NUMBER + 100):
        sent = [k.to_bytes(4, "little") + bytes(36)] if k < NUMBER else []
        for data in link.carry(sent, quality, k * spacing_us):
            number = int.from_bytes(data[:4], "little")
            arrived.append((number, (k - number) * spacing_us))
    return link, arrived


def _binomial(share: float) -> float:
    """Five standard deviations of the count."""
    return 5.0 * math.sqrt(NUMBER * share * (1.0 - share))


def test_a_perfect_link_changes_nothing() -> None:
    _, arrived = _carried(LinkQuality())
    assert arrived == [(k, 0) for k in range(NUMBER)]


@pytest.mark.parametrize("share", [0.01, 0.1, 0.5, 1.0])
def test_as_many_are_lost_as_were_asked_for(share: float) -> None:
    _, arrived = _carried(LinkQuality(loss=share))
    assert NUMBER - len(arrived) == pytest.approx(share * NUMBER, abs=_binomial(share))


def test_as_many_come_twice_as_were_asked_for() -> None:
    _, arrived = _carried(LinkQuality(duplicate=0.1))
    assert len(arrived) - NUMBER == pytest.approx(0.1 * NUMBER, abs=_binomial(0.1))
    assert {number for number, _ in arrived} == set(range(NUMBER))


def test_a_delay_is_kept_and_jitter_is_even_up_to_its_most() -> None:
    _, arrived = _carried(LinkQuality(delay_us=20_000.0))
    assert {late for _, late in arrived} == {20_000}
    _, arrived = _carried(LinkQuality(jitter_us=20_000.0), spacing_us=1_000)
    late = np.array([late for _, late in arrived])
    assert late.max() <= 20_000
    assert np.mean(late - 500.0) == pytest.approx(10_000, abs=5.0 * 20_000 / math.sqrt(12 * NUMBER))
    numbers = [number for number, _ in arrived]
    assert numbers != sorted(numbers)


def test_reordered_ones_are_overtaken() -> None:
    _, arrived = _carried(LinkQuality(reorder=0.1))
    late = [number for number, by in arrived if by]
    assert len(late) == pytest.approx(0.1 * NUMBER, abs=_binomial(0.1))
    assert {by for _, by in arrived} == {0, REORDER_DELAY_US}
    assert {number for number, _ in arrived} == set(range(NUMBER))


def test_damage_flips_one_to_four_bits_and_no_more() -> None:
    link, sent = BadLink(5, 0), bytes(range(40))
    flips = []
    for k in range(NUMBER):
        (data,) = link.carry([sent], LinkQuality(corrupt=0.1), k)
        flipped = sum((a ^ b).bit_count() for a, b in zip(data, sent, strict=True))
        if flipped:
            flips.append(flipped)
    assert set(flips) == {1, 2, 3, 4}
    assert link.corrupted == pytest.approx(0.1 * NUMBER, abs=_binomial(0.1))


def test_the_same_seed_is_the_same_link_another_seed_or_direction_is_not() -> None:
    quality = LinkQuality(loss=0.1, jitter_us=20e3, corrupt=0.01, duplicate=0.05, reorder=0.05)
    once, again, other = (_carried(quality, seed=seed)[1] for seed in (1, 1, 2))
    assert once == again
    assert once != other


def test_one_fault_does_not_move_another_ones_dice() -> None:
    """Which datagrams are lost stays the same whatever else happens to them."""
    _, plain = _carried(LinkQuality(loss=0.1))
    _, busy = _carried(LinkQuality(loss=0.1, delay_us=8_000.0))
    assert {number for number, _ in plain} == {number for number, _ in busy}


def test_the_degraded_link_is_10_percent_loss_20_ms_jitter_1_percent_damage() -> None:
    quality = Injector(parse_faults("link-degraded")).link_quality(0)
    assert quality == LinkQuality(loss=0.1, jitter_us=20_000.0, corrupt=0.01)
    assert _BY_NAME["link-degraded"].settings


def test_link_faults_add_up_and_end() -> None:
    injector = Injector(parse_faults("link-loss:0.3+2,link-delay:15"))
    assert injector.link_quality(0) == LinkQuality(loss=0.3, delay_us=15_000.0)
    assert injector.link_quality(3_000_000) == LinkQuality(delay_us=15_000.0)
