"""What makes a process quicker that only compiles; it changes numba itself, so no other process should use it.

Each operation is typed once.  For every `a * b` of floats numba tries the templates that are known for `*` from the
first, strings' and arrays' included, words an error for each that does not fit, and forgets which one did.  The same
operation on the same types has the same signature everywhere, so here it is remembered.

Processes that compile side by side keep their code one after the other: numba reads a function's index, takes the next
free number and writes both, and of two that do so at once one may find the other's code under its own signature.
"""

from __future__ import annotations

import fcntl
import gc
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

from numba.core.caching import IndexDataCacheFile
from numba.core.types.functions import BaseFunction

from flightstack.jit import cache_folder

_PURE = ("_operator", "math", "builtins")
"""Modules whose functions' signatures depend on the arguments' types and nothing else."""
_COLLECTED_AFTER = (20_000, 50, 100)


@contextmanager
def quick_compiling() -> Iterator[None]:
    """All of it, meanwhile."""
    with typed_once(), kept_in_turn(), seldom_collected():
        yield


@contextmanager
def seldom_collected() -> Iterator[None]:
    """Python's collector runs seldom meanwhile: numba makes millions of objects, of which hardly any lie in cycles."""
    original = gc.get_threshold()
    gc.set_threshold(*_COLLECTED_AFTER)
    try:
        yield
    finally:
        gc.set_threshold(*original)


@contextmanager
def typed_once() -> Iterator[None]:
    """Operators' and scalar functions' signatures are remembered meanwhile."""
    original = BaseFunction.get_call_type
    known: dict[Any, tuple[Any, Any]] = {}

    def get_call_type(self: Any, context: Any, args: Any, kws: Any) -> Any:
        if kws or getattr(self.typing_key, "__module__", None) not in _PURE:
            return original(self, context, args, kws)
        key = (self.typing_key, self.templates, context, args)
        if key not in known:
            signature = original(self, context, args, kws)
            known[key] = signature, self.get_impl_key(signature)
        signature, self._impl_keys[known[key][0].args] = known[key]
        return signature

    with _replaced((BaseFunction, get_call_type)):
        yield


@contextmanager
def locked(name: str) -> Iterator[None]:
    """Nobody else does meanwhile what goes by this name; where there are no locks, all do."""
    try:
        file = (cache_folder() / f"{name}.lock").open("w")
    except OSError:
        yield
        return
    with file:
        with suppress(OSError):
            fcntl.flock(file, fcntl.LOCK_EX)
        yield


@contextmanager
def kept_in_turn() -> Iterator[None]:
    """One process at a time adds to the cache."""
    keep = IndexDataCacheFile.save

    def save(self: Any, key: Any, data: Any) -> None:
        with locked("keeping"):
            keep(self, key, data)

    with _replaced((IndexDataCacheFile, save)):
        yield


@contextmanager
def _replaced(*methods: tuple[type, Any]) -> Iterator[None]:
    """Methods of classes, by others of the same names."""
    originals = [(owner, new.__name__, getattr(owner, new.__name__)) for owner, new in methods]
    for owner, new in methods:
        setattr(owner, new.__name__, new)
    try:
        yield
    finally:
        for owner, name, original in originals:
            setattr(owner, name, original)
