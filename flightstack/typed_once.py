"""Typing each operation once while much is compiled: that halves what numba takes for it.

For every `a * b` of floats numba tries the templates that are known for `*` from the first, strings' and arrays'
included, words an error for each that does not fit, and forgets which one did.  The same operation on the same types
has the same signature everywhere, so here it is remembered.  For processes that only compile: it changes numba itself.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from numba.core.types.functions import BaseFunction

_PURE = ("_operator", "math", "builtins")
"""Modules whose functions' signatures depend on the arguments' types and nothing else."""


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

    BaseFunction.get_call_type = get_call_type  # type: ignore[method-assign]
    try:
        yield
    finally:
        BaseFunction.get_call_type = original  # type: ignore[method-assign]
