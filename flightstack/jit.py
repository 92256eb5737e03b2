"""Compiled hot loops: numba with a cache that is keyed by content, so that it can't go stale.

Numba keys its on-disk cache by the decorated function's own file only: after an edit of a *called* function in another
file the caller's old machine code would stay in use.  Here a function's cache folder is named by a hash over its
module's source and all project sources that this module imports, directly or not.  An edit recompiles what depends on
it and nothing else, and checkouts, branches and installed copies of the same sources share their compiled code.

A function is compiled for what calls it: once for Python, with the wrapper that unpacks Python's objects, and once for
compiled callers, without.  Most have callers of one kind only, and a wrapper takes as long as a short function.
"""

from __future__ import annotations

import atexit
import hashlib
import importlib
import importlib.util
import os
import re
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache, partial
from itertools import count
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

import numba
from numba.core import caching, registry, sigutils, types
from numba.core import config as _numba_config
from numba.core.types import unliteral  # type: ignore[attr-defined]

from flightstack.lean_compiling import compile_leanly
from flightstack.lean_loading import load_leanly

F = TypeVar("F", bound=Callable[..., Any])

_PACKAGES = ("flightstack", "flightstack_sim", "flightstack_logs", "mavlink_bridge", "flightstack_paper", "benchmarks")
_IMPORT = re.compile(r"^\s*(?:from\s+([\w.]+)\s+import\s+(\([^)]*\)|[^\n#]*)|import\s+([\w., ]+))", re.MULTILINE)
_NOT_KEPT = "flightstack-numba-"
_KEEP_S = 7 * 86_400.0  # a folder that no process has used for so long is deleted


@cache
def _package_folder(package: str) -> Path | None:
    """Where a package of the project lies, without importing it."""
    if package not in _PACKAGES:
        return None
    if package == "flightstack":
        return Path(__file__).resolve().parent
    spec = importlib.util.find_spec(package)
    places = spec.submodule_search_locations if spec is not None else None
    return Path(next(iter(places))).resolve() if places else None


@cache
def _source_file(module: str) -> Path | None:
    """The source of a module of the project by its dotted name; None for any other name."""
    package, *rest = module.split(".")
    folder = _package_folder(package)
    if folder is None:
        return None
    for path in (folder.joinpath(*rest, "__init__.py"), folder.joinpath(*rest).with_suffix(".py") if rest else None):
        if path is not None and path.is_file():
            return path
    return None


@cache
def _digest_and_imports(module: str) -> tuple[bytes, frozenset[str]]:
    """SHA-256 of a module's source, and the project's modules that it names in import statements."""
    path = _source_file(module)
    assert path is not None
    source = path.read_bytes()
    return hashlib.sha256(source).digest(), frozenset(_named_modules(source.decode("utf-8")))


def _named_modules(source: str) -> Iterator[str]:
    for parent, names, plain in _IMPORT.findall(source):
        found = [parent, *(f"{parent}.{name}" for name in re.findall(r"\w+", names))] if parent else plain.split(",")
        for name in found:
            parts = name.strip().split(".")
            for length in range(1, len(parts) + 1):  # a package's __init__ runs before its module
                if _source_file(".".join(parts[:length])) is not None:
                    yield ".".join(parts[:length])


@cache
def _closure_key(module: str) -> str:
    """Hash over a module and everything of the project that it imports, directly or not."""
    seen, todo = set[str](), [module]
    while todo:
        name = todo.pop()
        if name not in seen:
            seen.add(name)
            todo.extend(_digest_and_imports(name)[1] - seen)
    digest = hashlib.sha256(numba.__version__.encode())
    for name in sorted(seen):
        digest.update(name.encode() + b"\0" + _digest_and_imports(name)[0])
    return digest.hexdigest()[:20]


class _ContentLocator(caching._CacheLocator):  # type: ignore[misc]
    """Tells numba where the compiled code of a function of this project is kept; leaves all others to numba."""

    def __init__(self, py_func: Any) -> None:
        self._key = _closure_key(py_func.__module__)
        self._line = py_func.__code__.co_firstlineno
        self._folder = cache_folder() / f"code-{self._key}"

    @classmethod
    def from_function(cls, py_func: Any, py_file: str) -> _ContentLocator | None:
        source = _source_file(py_func.__module__)
        if source is None or source != Path(py_file).resolve():
            return None
        locator = cls(py_func)
        return locator if _is_ready(locator._folder) else None

    def get_cache_path(self) -> str:
        return str(self._folder)

    def get_source_stamp(self) -> str:
        return self._key

    def get_disambiguator(self) -> str:
        return str(self._line)


@cache
def _is_ready(folder: Path) -> bool:
    """Whether a module's folder is there and can be written to; it counts as used from now on."""
    try:
        fresh = not folder.is_dir()
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
        os.utime(folder)
    except OSError:
        return False
    if fresh:
        _drop_unused_folders(cache_folder())
    return True


def code_folder(module: str) -> Path | None:
    """Where what follows from the sources of a module of the project is kept; None: nothing can be written there."""
    folder = cache_folder() / f"code-{_closure_key(module)}"
    return folder if _is_ready(folder) else None


def has_code(module: str) -> bool:
    """Whether functions of a module of the project have been compiled here as they stand."""
    return any((cache_folder() / f"code-{_closure_key(module)}").glob("*.nbi"))


@cache
def cache_folder() -> Path:
    """Where compiled functions are kept: NUMBA_CACHE_DIR, else the user's cache, else a temporary folder.

    Where none can be written it is a folder of this process's own, which goes with it.
    """
    given = _numba_config.CACHE_DIR
    candidates = (Path.home() / ".cache" / "flightstack", Path(tempfile.gettempdir()) / "flightstack-cache")
    for folder in (Path(given),) if given else candidates:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=folder):
                pass
        except OSError:
            continue
        return folder
    folder = Path(tempfile.mkdtemp(prefix=_NOT_KEPT))
    atexit.register(_delete, folder, os.getpid())
    return folder


def is_kept() -> bool:
    """Whether what is compiled is found again by the next process; else no folder for it could be written."""
    return not cache_folder().name.startswith(_NOT_KEPT)


def _delete(folder: Path, owner: int) -> None:
    """When a process ends: its own folder, and not the one of a process that it was forked from."""
    if os.getpid() == owner:
        shutil.rmtree(folder, ignore_errors=True)


@cache
def sources_key() -> str:
    """Hash over every source of the installed packages that may hold compiled code."""
    digest = hashlib.sha256(numba.__version__.encode())
    for package in ("flightstack", "flightstack_sim", "mavlink_bridge"):
        folder = _package_folder(package)
        for path in sorted(folder.rglob("*.py")) if folder else ():
            text = path.read_bytes()
            if b"flightstack.jit" in text:
                digest.update(path.relative_to(folder).as_posix().encode() + text)  # type: ignore[arg-type]
    return digest.hexdigest()[:20]


@cache
def machine_key() -> str:
    """Hash over the processor that code is made for: numba loads no other's, so a cache may come from elsewhere."""
    codegen = registry.cpu_target.target_context.codegen()
    return hashlib.sha256(repr(codegen.magic_tuple()).encode()).hexdigest()[:12]


def _drop_unused_folders(base: Path) -> None:
    try:
        for folder in base.glob("code-*"):
            if time.time() - folder.stat().st_mtime > _KEEP_S:
                shutil.rmtree(folder, ignore_errors=True)
    except OSError:  # another process tidies at the same time: its business
        return


def _import_blas() -> None:
    """Import what numba looks for of `scipy.linalg` without that package's own imports: 0.15 s at every start."""
    spec = importlib.util.find_spec("scipy")
    if spec is None or spec.origin is None or "scipy.linalg" in sys.modules:
        return
    shell = ModuleType("scipy.linalg")
    shell.__path__ = [str(Path(spec.origin).parent / "linalg")]
    sys.modules["scipy.linalg"] = shell
    try:
        importlib.import_module("scipy.linalg.cython_blas")
    except ImportError:  # another SciPy: numba imports the whole package
        return
    finally:
        del sys.modules["scipy.linalg"]


_import_blas()
compile_leanly(_PACKAGES)
caching.CacheImpl._locator_classes.insert(0, _ContentLocator)


def njit(function: F) -> F:
    """Compile `function` in nopython mode, IEEE arithmetic (no fastmath: same seed, same bytes), cached on disk."""
    return _compiled(function, inline=True, relaxed=False)


def njit_called(function: F) -> F:
    """`njit` that callers call instead of copying it into themselves: for long functions with several callers."""
    return _compiled(function, inline=False, relaxed=False)


def njit_free(function: F) -> F:
    """`njit_called` that lets Python's other threads work meanwhile: for long loops over many vehicles."""
    return _compiled(function, inline=False, relaxed=False, nogil=True)


def njit_vector(function: F) -> F:
    """`njit` for loops over many points: sums may be taken in another order and products fused into them.

    That is what fills the machine's vector registers.  NaN and infinity keep their meaning.  The last bits may depend
    on the kind of processor (not on the run: same machine and seed, same bytes).
    """
    return _compiled(function, inline=True, relaxed=True)


def _compiled(function: F, inline: bool, relaxed: bool, nogil: bool = False) -> F:
    # Said outright: a function that leaves fastmath open takes it over from whichever caller compiles it first.
    fastmath = {"reassoc", "contract", "nsz"} if relaxed else False
    options = {"error_model": "numpy", "forceinline": inline, "fastmath": fastmath, "nogil": nogil}
    compiled: Any = numba.njit(cache=True, no_cfunc_wrapper=True, **options)(function)
    _mend_cache(compiled._cache)

    @cache
    def called() -> Any:
        # Not cached: the code is part of every caller's, and numba's cache can't tell it from the one with the wrapper.
        return numba.njit(no_cfunc_wrapper=True, no_cpython_wrapper=True, **options)(function)

    def get_call_template(args: tuple[Any, ...], kws: dict[str, Any]) -> Any:
        # Once for all constants that are passed: LLVM puts them in when it inlines.
        plain = {name: unliteral(kind) for name, kind in kws.items()}
        return called().get_call_template(tuple(unliteral(kind) for kind in args), plain)

    compiled.get_call_template = get_call_template
    compiled.get_overload = lambda signature: called().get_overload(signature)
    return compiled  # type: ignore[no-any-return]


def _mend_cache(kept: Any) -> None:
    """What is kept of a function and can't be read (a power cut while it was written) is compiled anew."""
    loads = (load_leanly(kept), kept.load_overload)  # the latter as numba does it, for what the first may lack

    def load_overload(*signature: Any) -> Any:
        for load in loads:
            with suppress(Exception):  # of pickle, LLVM or the system: whatever half a file makes of them
                return load(*signature)
        with suppress(OSError):
            kept.flush()
        return None

    kept.load_overload = load_overload


_LOOK_EVERY, _LOOK_UP_TO = 32, 4096


class Entry:
    """A compiled function for a caller in Python who always passes the same types, which are said here.

    numba looks at every argument's type at every call, which takes longer than a short function; through `call` it does
    not.  Arrays have to be contiguous and of the type that is said: what is not an array of so many dimensions and of
    that size of element raises, the rest is the caller's promise.  (Tests look at one call in
    32 of the first 4,096: to look at all makes flights three times as long.)
    """

    __slots__ = ("_function", "_types", "call")

    checked = False
    """One call in `_LOOK_EVERY` looks at its arguments, up to `_LOOK_UP_TO`: for tests."""

    def __init__(self, function: Callable[..., Any], types: str) -> None:
        """`types`: of the arguments, in numba's words (`f8[::1], i8`)."""
        self._function: Any = function
        self._types = types
        self.call: Callable[..., Any] = self._first

    def _first(self, *arguments: Any) -> Any:
        self.prepare()
        return self.call(*arguments)

    def prepare(self) -> None:
        """Compile, or load what was compiled: at the first call at the latest."""
        kinds, _ = sigutils.normalize_signature(f"({self._types},)")
        self._function.compile(kinds)
        entry = self._function.overloads[kinds].entry_point
        self.call = partial(self._checked, count(), entry, kinds) if Entry.checked else entry

    def _checked(self, calls: count[int], entry: Callable[..., Any], kinds: tuple[Any, ...], *arguments: Any) -> Any:
        call = next(calls)
        if call >= _LOOK_UP_TO:
            self.call = entry
        if call % _LOOK_EVERY:
            return entry(*arguments)
        # An int of any size: numba has no type for one beyond 64 bits, a float takes it all the same.
        given = tuple(types.int64 if type(argument) is int else numba.typeof(argument) for argument in arguments)
        for kind, other in zip(kinds, given, strict=True):
            same = kind == other if isinstance(kind, types.Array) else self._fits(kind, other)
            assert same or (isinstance(other, types.Array) and other.copy(readonly=False) == kind), (
                f"{self._function.__name__} of {self._types} was called with {given}"
            )
        return entry(*arguments)

    @staticmethod
    def _fits(kind: Any, other: Any) -> bool:
        """Whether a value that is no array is turned into the type without loss."""
        if kind == types.float64:
            return isinstance(other, types.Float | types.Integer | types.Boolean)
        return isinstance(other, types.Integer | types.Boolean) if isinstance(kind, types.Integer) else kind == other
