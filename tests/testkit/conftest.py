"""pytester forgets modules that are first imported while it runs; numba's registries can't be imported twice."""

from __future__ import annotations

from numba.core.registry import cpu_target

cpu_target.target_context.refresh()
