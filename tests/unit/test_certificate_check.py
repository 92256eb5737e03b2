"""The checker of certificates: it accepts what is true, and nothing that is not.

Its oracle is brute force and physics: rollouts of the double integrator for what a cell claims, dense grids for what
the cells cover, and the maker's own knowledge (which shares no code with it) for the authority.
"""

from __future__ import annotations

import ast
import json
import os
from collections.abc import Iterator
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from certificate_oracle import changes, still_true, untrue
from certificates import ELLIPSE, STOPPING, certificate, knowledge, resealed, tables_kept
from hypothesis import given, settings
from hypothesis import strategies as st

import flightstack.certificate_check as checker
from flightstack.barrier.file import certificate_to_json
from flightstack.barrier.knowledge import Knowledge
from flightstack.barrier.shapes import value
from flightstack.certificate_check import check
from flightstack.certificate_check.gaussian import factor, posterior
from flightstack.certificate_check.intervals import Interval
from flightstack.certificate_check.knowledge import Box, read, tables
from flightstack.certificate_check.reading import Refused
from tests.thorough import THOROUGH


@cache
def small_text(kind: str = "ellipse") -> str:
    return certificate_to_json(certificate(ELLIPSE if kind == "ellipse" else STOPPING, 30, 10))


@pytest.fixture(scope="module")
def kept() -> Iterator[None]:
    with tables_kept():
        yield


# ---------------------------------------------------------------- what is true


@pytest.mark.parametrize("kind", ["ellipse", "stopping"])
def test_a_true_certificate_is_valid(kind: str) -> None:
    verdict = check(small_text(kind))
    assert verdict.valid, verdict.lines[-1]
    assert "cells meet the condition" in verdict.lines[-1]


def test_one_with_many_points_and_cells_is_valid() -> None:
    verdict = check(certificate_to_json(certificate(ELLIPSE, 300, 24)))
    assert verdict.valid, verdict.lines[-1]
    assert any("300" in line for line in verdict.lines)


LOG = {"collections", "lz4", "struct", "tomllib", "zlib", "zstandard"}
"""For reading logs and vehicle files."""


def test_the_checker_shares_no_code_with_the_maker() -> None:
    allowed = {"__future__", "hashlib", "json", "math", "itertools", "dataclasses", "typing", "numpy"} | LOG
    files = list(Path(checker.__file__).parent.glob("*.py"))
    assert len(files) > 3
    for file in files:
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Import):
                assert {name.name.split(".")[0] for name in node.names} <= allowed, file
            if isinstance(node, ast.ImportFrom) and node.level == 0:
                assert str(node.module).split(".")[0] in allowed, file
            if isinstance(node, ast.ImportFrom):
                assert node.level <= 1, file
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                assert node.func.id not in ("__import__", "eval", "exec"), file


# ---------------------------------------------------------------- brute force


@pytest.mark.parametrize("kind", ["ellipse", "stopping"])
def test_brute_force_agrees_where_nothing_was_changed(kind: str) -> None:
    assert untrue(small_text(kind)) == ""


def test_brute_force_would_find_a_wrong_claim() -> None:
    data = json.loads(small_text())
    data["axes"][0]["cells"][5][5] += 4.0
    assert "cell" in untrue(resealed(data))
    data = json.loads(small_text())
    middle = next(c for c in data["axes"][0]["cells"] if c[0] <= 0.0 <= c[1] and c[2] <= 0.0 <= c[3])
    data["axes"][0]["cells"].remove(middle)
    assert "nothing" in untrue(resealed(data))


# ---------------------------------------------------------------- tampering


@pytest.mark.parametrize("kind", ["ellipse", "stopping"])
def test_any_number_changed_breaks_the_seal(kind: str) -> None:
    text = small_text(kind)
    seen = set()
    last: tuple[Any, ...] = ()
    for path, name, data in changes(text, often):
        if name not in ("-1 %", "one more") or path == last:  # one is enough; a zero has no -1 %
            continue
        last = path
        seen.add(path[0])
        verdict = check(json.dumps(data))
        assert not verdict.valid, path
        assert "seal" in verdict.lines[-1]
    assert seen == {
        "version",
        "centre_ned_m",
        "delta",
        "k_sigma",
        "confidence",
        "budget",
        "axes",
        "premises",
        "governor",
        "knowledge",
    }


CELLS_APART, NODES_APART = (33, 1) if "FLIGHTSTACK_FORGERIES" in os.environ else (100, 4)
"""`make attack` takes three times as many cells and every node of the authority: most of the numbers, and alike."""
APART = 8
"""Of seven changes of each number, every eighth: all of them in turn, and all of all in `make thorough`."""


def often(path: tuple[Any, ...]) -> bool:
    """Every number but cells and points, of which some are taken: there are many alike."""
    if "cells" in path:
        return path[-2] % CELLS_APART == 5
    if path[-3:-2] in (("x",), ("y",)):
        return path[-2] % 30 == 3
    return "authority" not in path or path[-1] % NODES_APART == 0


def in_turn(path: tuple[Any, ...], name: str, kind: str) -> bool:
    """All changes of what is proven; of the knowledge, which is the same for both kinds, some for one of them."""
    if path[0] == "axes" and path[2] != "authority":
        return True
    return name in ("+1 %", "sign", "swap") if kind == "ellipse" else name == "-10 %"


@pytest.mark.usefixtures("kept")
@pytest.mark.parametrize("kind", ["ellipse", "stopping"])
def test_a_number_changed_under_a_new_seal_is_refused_or_leaves_the_claims_true(kind: str) -> None:
    text = small_text(kind)
    before = json.loads(text)
    refused, passed = 0, 0
    for at, (path, name, data) in enumerate(changes(text, often)):
        if not in_turn(path, name, kind) or (at % APART and not THOROUGH):
            continue
        sealed = resealed(data)
        verdict = check(sealed)
        assert "not to be read" not in verdict.lines[-1], (path, name)
        refused += not verdict.valid
        passed += verdict.valid
        if verdict.valid:
            assert still_true(before, path, sealed), (path, name)
    assert refused > 280 // (1 if THOROUGH else APART)
    assert passed < 0.4 * refused


def test_each_part_of_the_file_is_needed() -> None:
    data = json.loads(small_text())
    for path in [*((key,) for key in data), *(("axes", 0, key) for key in data["axes"][0]), ("knowledge", "doubts")]:
        kept = json.loads(small_text())
        inner = kept
        for key in path[:-1]:
            inner = inner[key]
        del inner[path[-1]]
        verdict = check(json.dumps(kept) if path == ("seal",) else resealed(kept))
        assert not verdict.valid, path


def test_a_cell_taken_away_is_missed() -> None:
    for i in range(0, len(json.loads(small_text())["axes"][0]["cells"]), 5):
        data = json.loads(small_text())
        cell = data["axes"][0]["cells"].pop(i)
        verdict = check(resealed(data))
        corners = [value(ELLIPSE, e, v) for e in cell[:2] for v in cell[2:4]]
        if max(corners) > 0.0:
            assert not verdict.valid
            assert "no cell covers" in verdict.lines[-1]


def test_a_gap_between_cells_as_narrow_as_can_be_is_found() -> None:
    data = json.loads(small_text())
    cell = next(c for c in data["axes"][0]["cells"] if value(ELLIPSE, c[1], c[2]) > 0.2)
    cell[1] = float(np.nextafter(cell[1], -10.0))
    assert not check(resealed(data)).valid


def test_cells_may_overlap_and_their_order_does_not_matter() -> None:
    data = json.loads(small_text())
    data["axes"][0]["cells"] = data["axes"][0]["cells"][::-1] + data["axes"][0]["cells"][:7]
    assert check(resealed(data)).valid


def test_a_certificate_as_published_or_falsified_is_not_valid() -> None:
    data = json.loads(small_text())
    data["mode"] = "as-published"
    assert "not sound" in check(resealed(data)).lines[-1]
    data = json.loads(small_text())
    data["knowledge"]["hand_over"] = True
    assert "falsified" in check(resealed(data)).lines[-1]


def test_without_the_knowledge_before_take_off_the_same_must_follow_from_what_was_learned() -> None:
    data = json.loads(small_text())
    data["knowledge"]["initial"] = None
    assert check(resealed(data)).valid
    assert still_true(json.loads(small_text()), ("knowledge", "initial"), resealed(data))


# ---------------------------------------------------------------- any text

TEXTS = [
    "", "7", "null", "[]", "{", "NaN", '{"schema": NaN}', "[" * 100_000, '{"a":' * 100_000, '{"a": ' + "9" * 5000 + "}",
    '{"a": 1, "a": 2}', "\x00", "\ud800", "{}", '{"schema": "flightstack.certificate/6"}', '{"a": 1e999}',
    '{"schema": "flightstack.certificate/6", "seal": 1e999}',
]  # fmt: skip


@pytest.mark.parametrize("text", TEXTS, ids=range(len(TEXTS)))
def test_no_text_raises(text: str) -> None:
    verdict = check(text)
    assert not verdict.valid
    assert len(verdict.lines) == 1
    assert "\n" not in verdict.lines[0]


ODD = st.one_of(
    st.none(), st.booleans(), st.text(max_size=5), st.integers(), st.floats(allow_nan=False, allow_infinity=False),
    st.just([]), st.just({}), st.just([[]]), st.just([[1.0]]), st.just({"kernel": "sum"}), st.just(10**400),
)  # fmt: skip


@pytest.mark.usefixtures("kept")
@settings(max_examples=100, deadline=None)
@given(st.data())
def test_nothing_put_anywhere_raises(draw: st.DataObject) -> None:
    data = json.loads(small_text())
    inner, path = data, []
    while True:
        keys = list(inner) if isinstance(inner, dict) else list(range(len(inner)))
        path.append(draw.draw(st.sampled_from(keys)))
        deeper = inner[path[-1]]
        if not (isinstance(deeper, dict | list) and deeper) or draw.draw(st.integers(0, 3)) == 0:
            break
        inner = deeper
    if path == ["seal"]:
        return
    inner[path[-1]] = draw.draw(ODD)
    verdict = check(resealed(data))
    assert all("\n" not in line and len(line) < 400 for line in verdict.lines)
    if verdict.valid and data != json.loads(small_text()):  # what was there already may be drawn
        assert path[-1] == "because" or still_true(json.loads(small_text()), tuple(path), resealed(data))


@pytest.mark.parametrize("little", [5e-324, 1e-9, 1e-4])
def test_nothing_is_added_to_what_is_nothing(little: float) -> None:
    """Thrust follows its command by one lag: a second one, however short, is another vehicle's."""
    data = json.loads(small_text())
    assert data["axes"][0]["response"]["c2_s2"] == 0.0
    data["axes"][0]["response"]["c2_s2"] = little
    verdict = check(resealed(data))
    assert not verdict.valid
    assert "c2_s2" in verdict.lines[-1]


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6))
def test_truncated_text_is_one_line(start: int) -> None:
    verdict = check(small_text()[: start % len(small_text())])
    assert not verdict.valid
    assert len(verdict.lines) == 1


# ---------------------------------------------------------------- parts

NUMBERS = st.floats(-1e6, 1e6, allow_nan=False)


@given(NUMBERS, NUMBERS, NUMBERS, st.floats(1e-3, 1e6))
def test_intervals_hold_the_exact_result(a: float, b: float, c: float, d: float) -> None:
    fa, fb, fc, fd = (Fraction(x) for x in (a, b, c, d))
    exact = abs((fa + fb) * fc - fb) / fd
    found = abs((Interval(a) + b) * c - b) / d
    assert Fraction(float(found.lo)) <= exact <= Fraction(float(found.hi))
    assert float(found.hi) - float(found.lo) <= 1e-14 * (abs(a) + abs(b) + 1.0) * (abs(c) + 1.0) / d


def test_the_process_is_that_of_scikit_learn() -> None:
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel, Matern

    rng = np.random.default_rng(3)
    x, y, queries = rng.normal(size=(25, 2)), rng.normal(size=(25, 1)), rng.normal(size=(40, 2))
    spec = {
        "kernel": "sum",
        "left": {"kernel": "matern", "nu": 1.5, "variance": 0.7, "lengthscales": [0.8, 1.7], "columns": None},
        "right": {
            "kernel": "product",
            "left": {"kernel": "constant", "variance": 1.3},
            "right": {"kernel": "squared_exponential", "variance": 1.0, "lengthscales": 1.1, "columns": [0, 1]},
        },
    }
    theirs = ConstantKernel(0.7) * Matern([0.8, 1.7], nu=1.5) + ConstantKernel(1.3) * RBF(1.1)
    model = GaussianProcessRegressor(theirs, alpha=0.05, optimizer=None).fit(x, y[:, 0])
    mean, std = model.predict(queries, return_std=True)
    ours, variance, sums = posterior(spec, x, y, factor(spec, x, 0.05 * np.eye(25), ""), queries, "")
    alone = [model.fit(x, unit).predict(queries) for unit in np.eye(25)]  # the weight of one point
    np.testing.assert_allclose(sums, np.abs(alone).sum(axis=0), atol=1e-9)
    np.testing.assert_allclose(ours[:, 0], mean, atol=1e-10)
    np.testing.assert_allclose(np.sqrt(variance), std, atol=1e-9)


def box_of(made: Knowledge) -> Box:
    return Box(np.array(made.budget.leans), made.budget.lean_spare, made.budget.low_mps2, made.budget.high_mps2)


def test_the_last_certificate_may_spend_what_is_left_of_delta_and_no_other_may() -> None:
    made = knowledge(version=8, last=True)
    data = json.loads(json.dumps(made.as_json()))
    read(data, box_of(made), made.delta, made.k_sigma, 8)
    for change, why in (
        ({"last": False}, "statements"),
        ({"last": 1}, "last"),
        ({"k_sigma": made.k_sigma - 0.01}, "k_si"),
    ):
        changed = {**data, **change}
        with pytest.raises(Refused, match=why):
            read(changed, box_of(made), made.delta, changed["k_sigma"], 8)


@pytest.mark.parametrize("last", [False, True])
def test_the_authority_of_every_axis_is_what_the_maker_says(last: bool) -> None:
    made = knowledge(80, axes=(0, 1, 2), last=last)
    data = json.loads(json.dumps(made.as_json()))
    found = tables(read(data, box_of(made), made.delta, made.k_sigma, made.version))
    assert set(found) == {0, 1, 2}
    for axis, table in found.items():
        np.testing.assert_allclose(table, made.authorities[axis].table, atol=1e-8)
