"""Compiled code: a stale one is never loaded, and what makes compiling quick changes no signature."""

from __future__ import annotations

import json
import math
import operator
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest
from numba.core.codegen import JITCPUCodegen

from flightstack import quick_compiling
from flightstack.cli import compiled
from flightstack.jit import machine_key, njit
from flightstack.quick_compiling import typed_once
from tests.thorough import thorough

ROOT = Path(__file__).resolve().parents[2]
_CALLED = "from flightstack.jit import njit\n\n\n@njit\ndef scale(x):\n    return {factor} * x\n"
_CALLER = """import json
from flightstack import quick_compiling
from flightstack.cli import compiled
from flightstack.jit import njit
from benchmarks.called import scale


@njit
def work(x):
    return scale(x) + 1.0


print(json.dumps([work(1.0), scale(1.0), work.stats.cache_hits == {}]))
"""


def test_code_of_a_changed_callee_is_never_loaded_and_that_of_a_restored_one_is(tmp_path: Path) -> None:
    package = tmp_path / "benchmarks"  # one of the project's packages, empty here
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "caller.py").write_text(_CALLER)
    path = os.pathsep.join([str(tmp_path), *filter(None, sys.path)])
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "code"), "PYTHONPATH": path}

    def run(factor: float) -> list[Any]:
        (package / "called.py").write_text(_CALLED.format(factor=factor))
        command = [sys.executable, "-P", "-c", "import benchmarks.caller"]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        answer: list[Any] = json.loads(done.stdout)
        return answer

    assert run(2.0) == [3.0, 2.0, True]
    assert run(5.0) == [6.0, 5.0, True]
    assert run(2.0) == [3.0, 2.0, False]


@njit
def _power(x: float, times: int) -> float:
    y = 1.0
    for _ in range(times):
        y *= x
    return y


@njit
def _sum_of_powers(x: float) -> float:
    return _power(x, 2) + _power(x, 3) + _power(x, times=4)


def test_a_function_is_compiled_once_for_all_constants_and_python_may_call_it_too() -> None:
    assert _sum_of_powers(3.0) == 9.0 + 27.0 + 81.0
    assert _power.signatures == []  # type: ignore[attr-defined]  # the code for compiled callers is another's
    assert _power(3.0, 2) == 9.0
    assert len(_power.signatures) == 1  # type: ignore[attr-defined]


OPERATORS = [operator.add, operator.mul, operator.truediv, operator.pow, operator.lt, operator.eq]
VALUES = [2.5, 3, True, np.array([1.0, -2.0]), np.float32(0.5)]


@pytest.mark.parametrize("function", OPERATORS, ids=lambda function: function.__name__)
def test_remembered_operations_have_numbas_own_signatures(function: Any) -> None:
    context = numba.core.registry.cpu_target.typing_context
    kinds = [numba.typeof(value) for value in VALUES]
    pairs = [(a, b) for a in kinds for b in kinds]

    def signatures() -> list[str]:
        said = []
        for pair in pairs:
            try:
                said.append(str(context.resolve_function_type(function, pair, {})))
            except numba.core.errors.NumbaError:
                said.append("none")
        return said

    context.refresh()
    own = signatures()
    with typed_once():
        assert signatures() == own
        assert signatures() == own  # now out of memory


def test_a_function_compiled_with_remembered_operations_computes_the_same() -> None:
    def work(x: float, n: int, v: Any) -> Any:
        total = 0.0
        for i in range(n):
            total += math.sin(x * i) ** 2 / (1.0 + abs(x - i)) - min(x, i * 0.5) * v[i % v.shape[0]]
        return total, n // 3, v * x + n, x < n, -x

    arguments = (0.7, 11, np.array([1.5, -2.25, 0.125]))
    plain = numba.njit(error_model="numpy")(work)(*arguments)
    with typed_once():
        quick = numba.njit(error_model="numpy")(work)(*arguments)
    for a, b in zip(plain, quick, strict=True):
        np.testing.assert_array_equal(a, b)


def _checked_root(x: float) -> float:
    if x < 0.0:
        raise ValueError("no root")
    return math.sqrt(x)


def _sum_of_roots(v: Any, root: Any) -> float:
    total = 0.0
    for i in range(v.shape[0]):
        total += root(v[i]) / 3.0
    return total


def _copy(source: Any, target: Any, first: int) -> None:
    target[first:] = source


RELAXED = {"reassoc", "contract", "nsz"}
WHOSE = pytest.mark.parametrize("module", ["flightstack.jit", __name__])
"""Of the project's packages, and of somebody else's."""


def _roots(monkeypatch: pytest.MonkeyPatch, module: str, fastmath: Any = False) -> Any:
    """The sum of roots, compiled as a function of this module, and the root as one that only it calls."""
    for function in (_checked_root, _sum_of_roots):
        monkeypatch.setattr(function, "__module__", module)
    root = numba.njit(no_cfunc_wrapper=True, no_cpython_wrapper=True, fastmath=fastmath)(_checked_root)
    whole = numba.njit(no_cfunc_wrapper=True, fastmath=fastmath)(_sum_of_roots)
    return lambda values: whole(values, root), whole


@WHOSE
@pytest.mark.parametrize("fastmath", [False, RELAXED], ids=["in order", "in any order"])
def test_what_only_compiled_callers_call_has_no_machine_code_of_its_own(
    module: str, fastmath: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A quarter of a flight's compiling went into machine code that nobody runs."""
    values = np.array([0.1, 0.7, 2.0, 5.3])
    made: list[str] = []
    finish = JITCPUCodegen._add_module
    monkeypatch.setattr(JITCPUCodegen, "_add_module", lambda self, m: (made.append(m.name), finish(self, m))[1])
    roots, _ = _roots(monkeypatch, module, fastmath)
    assert roots(values) == pytest.approx(sum(math.sqrt(value) / 3.0 for value in values), rel=1e-15)
    with pytest.raises(ValueError, match="no root"):
        roots(-values)
    ours = module == "flightstack.jit"
    assert sorted(name for name in made if "_root" in name) == ["_checked_root"] * (not ours) + ["_sum_of_roots"]


def test_a_process_that_only_compiles_makes_the_code_that_a_flight_would(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sums in any order among it: which order depends on what the compiler had seen before."""

    def code() -> str:
        roots, whole = _roots(monkeypatch, "flightstack.jit", RELAXED)
        roots(np.ones(3))
        (text,) = whole.inspect_asm().values()
        lines = [line for line in text.splitlines() if re.match(r"\t\w", line)]
        return re.sub(r"[\w$]*[.$][\w.$]*|\b(_ZN|\d)\w*", "", "\n".join(lines))  # names count what was compiled before

    flight = code()
    assert flight.count("sqrt") >= 1
    assert flight.count("\n") > 30
    with quick_compiling.quick_compiling():
        assert code() == flight


@WHOSE
def test_an_array_for_a_slice_of_another_length_is_an_error_that_needs_no_text(
    module: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A seventh of a flight's compiling was for words that say two lengths; a user's own functions keep them."""
    monkeypatch.setattr(_copy, "__module__", module)
    copy, target = numba.njit(_copy), np.zeros(4)
    copy(np.array([1.0, 2.0]), target, 2)
    assert target.tolist() == [0.0, 0.0, 1.0, 2.0]
    with pytest.raises(ValueError, match="cannot assign slice") as raised:
        copy(np.ones(3), target, 2)
    ours = module == "flightstack.jit"
    assert ("(3,)" in str(raised.value)) is not ours
    (text,) = copy.inspect_llvm().values()
    assert ("unicode" in text) is not ours


def test_only_what_is_missing_is_compiled_and_a_flight_brings_its_simulator(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[tuple[str, ...]] = []

    def compiling(*parts: str) -> subprocess.Popen[str]:
        asked.append(parts)
        for part in parts:
            compiled._marker(part).touch()
        return subprocess.Popen([sys.executable, "-c", ""], stdout=subprocess.PIPE, text=True)

    monkeypatch.setattr(compiled, "cache_folder", lambda: tmp_path)
    monkeypatch.setattr(compiled, "_compiling", compiling)
    for parts in ((), ("simulator",), ("jsbsim", "flight"), ("jsbsim",)):
        compiled.ensure_compiled(lambda text: None, *parts)
    assert asked == [("flight",), ("jsbsim",)]


def test_a_cache_that_was_filled_on_another_processor_is_not_taken_for_compiled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A container's cache came with the mark and numba would load none of its code: all was compiled at the start."""
    monkeypatch.setattr(compiled, "cache_folder", lambda: tmp_path)
    compiled._marker("simulator").touch()
    assert compiled.compiled("simulator")
    monkeypatch.setattr(numba.core.config, "CPU_NAME", "x86-64-v2")
    machine_key.cache_clear()
    try:
        assert not compiled.compiled("simulator")
    finally:
        machine_key.cache_clear()


@pytest.mark.parametrize(("kind", "rest"), [("nbc", 100), thorough("nbi", 0)])
def test_code_that_a_power_cut_left_half_written_is_compiled_anew_and_kept(
    kind: str, rest: int, tmp_path: Path
) -> None:
    """A flight ended before it began, in a traceback of pickle's, and so did each after it."""
    package = tmp_path / "benchmarks"
    package.mkdir()
    for name, text in (("__init__", ""), ("called", _CALLED.format(factor=3.0)), ("caller", _CALLER)):
        (package / f"{name}.py").write_text(text)
    path = os.pathsep.join([str(tmp_path), *filter(None, sys.path)])
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "code"), "PYTHONPATH": path}

    def run() -> list[Any]:
        command = [sys.executable, "-P", "-c", "import benchmarks.caller"]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        answer: list[Any] = json.loads(done.stdout)
        return answer

    assert run() == [4.0, 3.0, True]
    halved = list((tmp_path / "code").rglob(f"*.{kind}"))
    assert halved
    for file in halved:
        file.write_bytes(file.read_bytes()[:rest])
    assert run() == [4.0, 3.0, True]
    assert run() == [4.0, 3.0, False]


_LOADED = """import json, sys
import numpy as np
from flightstack.jit import njit


@njit
def work(a, b):
    if len(b) == 1:
        raise ValueError("one is too few")
    out = np.zeros(len(b) + 1)
    out[1:] = np.dot(a, b)
    return out, out.min(), len(b)


out, least, count = work(np.array([[0.5, 0.0], [0.0, -0.25]]), np.ones(2))
try:
    work(np.ones((1, 1)), np.ones(1))
except ValueError as error:
    said = str(error)
loaded, before = work.stats.cache_hits != {}, "numba.np.arrayobj" in sys.modules


@njit
def later(n):
    return work(2.0 * np.ones((n, n)), np.ones(n))[2]


print(json.dumps([out.tolist(), least, count, said, loaded, before, later(3)]))
"""


def test_code_is_loaded_without_what_only_compiling_needs_and_more_can_be_compiled_after_it(tmp_path: Path) -> None:
    """Of the two seconds in which a gap was found a quarter of one went into preparing to compile."""
    package = tmp_path / "benchmarks"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "kept.py").write_text(_LOADED)
    path = os.pathsep.join([str(tmp_path), *filter(None, sys.path)])
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "code"), "PYTHONPATH": path}
    command = [sys.executable, "-P", "-c", "import benchmarks.kept"]
    answers = []
    for _ in range(2):
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        answers.append(json.loads(done.stdout))
        for each in (tmp_path / "code").rglob("*later*"):
            each.unlink()
    same = [[0.0, 0.5, -0.25], -0.25, 2, "one is too few"]
    assert answers == [[*same, False, True, 3], [*same, True, False, 3]]


_UNKEPT = """from flightstack.cli import compiled
from flightstack.jit import cache_folder


def begun(command, *, env, **more):
    print(said[0], env["NUMBA_CACHE_DIR"], cache_folder(), cache_folder().is_dir(), sep="\\n")
    raise SystemExit


said, compiled.subprocess.Popen = [], begun
compiled.ensure_compiled(said.append)
"""


def test_where_no_compiled_code_can_be_kept_it_is_compiled_once_for_the_process_and_said_so(tmp_path: Path) -> None:
    """Each process compiled into a folder of its own, so that a flight compiled all again by itself: 87 s, now 30."""
    (tmp_path / "file").touch()
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "file"), "TMPDIR": str(tmp_path)}
    command = [sys.executable, "-P", "-c", _UNKEPT]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    said, given, own, there = done.stdout.splitlines()
    assert said == "compiling (at each start: no folder can be written for it)"
    assert (given, there) == (own, "True")
    assert Path(own).parent == tmp_path
    assert not Path(own).exists(), "left behind"


def test_the_other_half_of_compiling_ends_with_the_process_that_began_it() -> None:
    half = compiled._compiling(compiled._COMPANION)
    assert half.stdin is not None
    half.stdin.close()
    assert half.wait(60.0) == 1
    assert half.stdout is not None
    half.stdout.close()


def test_compiling_gives_back_the_priority_that_a_flight_was_started_with() -> None:
    """Two processes that compiled in real time (`chrt -f 20 flightstack offboard`) held both processors."""
    program = "import os\nfrom flightstack.cli import compiled\ncompiled.compiled = lambda part: True\n"
    program += "compiled.main(['simulator'])\nprint(os.sched_getscheduler(0))"
    raised = "import os, sys\nos.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))\n"  # needs no permission
    command = [sys.executable, "-P", "-c", raised + "os.execv(sys.argv[1], sys.argv[1:])", sys.executable, "-P", "-c"]
    done = subprocess.run([*command, program], capture_output=True, text=True, check=True)
    assert int(done.stdout) == os.SCHED_OTHER


def test_a_cache_folder_that_went_away_stops_no_compiling(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(quick_compiling, "cache_folder", lambda: tmp_path / "gone")
    kept: list[object] = []
    monkeypatch.setattr(quick_compiling.IndexDataCacheFile, "save", lambda self, key, data: kept.append(data))
    with quick_compiling.kept_in_turn():
        quick_compiling.IndexDataCacheFile.save(None, "key", "code")
    assert kept == ["code"]
