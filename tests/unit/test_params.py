"""The parameter table is PX4's, and setting follows its types and ranges."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from flightstack.types import InputError
from flightstack_sim.autopilot.params import PARAMS, ParamResult, Params, ParamType, find
from tests.recorded_px4 import read_flight


@pytest.mark.recorded
def test_every_default_and_type_is_what_a_real_px4_reported(recorded: Path) -> None:
    _, real = read_flight(recorded)
    for spec in PARAMS:
        type_, value = real[spec.name]
        assert (spec.type is ParamType.INT32) == (type_ == "int32_t"), spec.name
        assert spec.default == value, spec.name


def test_names_are_sorted_unique_and_fit_mavlinks_sixteen_characters() -> None:
    names = [spec.name for spec in PARAMS]
    assert names == sorted(set(names))
    assert all(0 < len(name) <= 16 for name in names)


def test_every_default_lies_within_its_own_range() -> None:
    fresh = Params()
    for index, spec in enumerate(PARAMS):
        assert fresh.set(spec.name, spec.default, spec.type) is ParamResult.OK, spec.name
        assert fresh.at(index) == fresh.get(spec.name) == spec.default
    assert fresh.version == 0  # nothing changed


def test_a_change_is_seen_by_name_and_index_and_counted_once() -> None:
    params = Params()
    assert params.set("COM_OF_LOSS_T", 0.2) is ParamResult.OK
    assert params.set("COM_OF_LOSS_T", 0.2) is ParamResult.OK
    index = find("COM_OF_LOSS_T")
    assert index is not None
    assert params.at(index) == params.get("COM_OF_LOSS_T") == pytest.approx(0.2, rel=1e-7)
    assert params.get("COM_OF_LOSS_T") != 0.2  # 32 bits hold another number
    assert params.version == 1


@pytest.mark.parametrize(
    ("name", "value", "type_", "result"),
    [
        ("NO_SUCH_PARAM", 1.0, None, ParamResult.DOES_NOT_EXIST),
        ("COM_OF_LOSS_T", 1.0, ParamType.INT32, ParamResult.TYPE_MISMATCH),
        ("COM_OBL_RC_ACT", 5.0, ParamType.REAL32, ParamResult.TYPE_MISMATCH),
        ("COM_OBL_RC_ACT", 1.5, None, ParamResult.VALUE_OUT_OF_RANGE),
        ("COM_OBL_RC_ACT", 8, ParamType.INT32, ParamResult.VALUE_OUT_OF_RANGE),
        ("COM_OF_LOSS_T", 60.01, ParamType.REAL32, ParamResult.VALUE_OUT_OF_RANGE),
        ("COM_OF_LOSS_T", -0.01, ParamType.REAL32, ParamResult.VALUE_OUT_OF_RANGE),
        ("COM_OF_LOSS_T", math.nan, ParamType.REAL32, ParamResult.VALUE_OUT_OF_RANGE),
        ("COM_OF_LOSS_T", math.inf, ParamType.REAL32, ParamResult.VALUE_OUT_OF_RANGE),
        ("COM_OF_LOSS_T", 1e300, None, ParamResult.VALUE_OUT_OF_RANGE),
    ],
)
def test_a_bad_set_says_why_and_changes_nothing(
    name: str, value: float, type_: ParamType | None, result: ParamResult
) -> None:
    params = Params()
    before = [params.at(i) for i in range(len(params))]
    assert params.set(name, value, type_) is result
    assert [params.at(i) for i in range(len(params))] == before
    assert params.version == 0


def test_limits_of_a_float_are_inclusive_although_32_bits_round_them() -> None:
    params = Params()
    for spec in PARAMS:
        for limit in (spec.minimum, spec.maximum):
            assert params.set(spec.name, limit) is ParamResult.OK, (spec.name, limit)


def test_constructing_with_a_bad_value_names_the_parameter_and_its_range() -> None:
    with pytest.raises(InputError, match=r"MPC_XY_P = 5.*from 0 to 2"):
        Params({"MPC_XY_P": 5.0})
    with pytest.raises(InputError, match="NOPE does not exist"):
        Params({"NOPE": 5.0})
