"""Covariance functions: immutable expressions of a few leaves, sums and products.

A kernel is written as it is on paper and holds only its hyper-parameters:

    SquaredExponential(1.0, (0.5, 2.0)) + Linear(0.3, column=2) * Matern(2.5, 1.0, 0.7, columns=(0, 1))

    squared exponential   variance exp(-r^2 / 2)
    Matern 1/2            variance exp(-r)
    Matern 3/2            variance (1 + s) exp(-s),             s = sqrt(3) r
    Matern 5/2            variance (1 + s + s^2/3) exp(-s),     s = sqrt(5) r
    constant              variance
    linear                variance x_c x'_c

with r^2 = sum over the columns of ((x_c - x'_c) / lengthscale_c)^2.  Source: Rasmussen and Williams, Gaussian
Processes for Machine Learning (2006), chapter 4.  `flightstack.gp.program` turns any expression into a flat program
that compiled code reads.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import final

import numpy as np

from flightstack.checked import number, only
from flightstack.gp import program
from flightstack.gp.program import KernelFactor, Program, Term
from flightstack.types import F64, InputError

Lengthscales = float | tuple[float, ...]
Columns = tuple[int, ...] | None
_LEAST, _MOST = 1e-50, 1e50
"""Range of every hyper-parameter: squares and products of a few stay finite."""
_COLUMN_MAX = 4096


class Kernel(ABC):
    """A covariance function k(x, x'); immutable, hashable, compared by value."""

    __slots__ = ()

    @abstractmethod
    def _values(self) -> Iterator[float]:
        """The hyper-parameters from left to right; of a leaf the variance, then the length-scales."""

    @abstractmethod
    def _with(self, values: Iterator[float]) -> Kernel:
        """The same expression with other hyper-parameters."""

    @abstractmethod
    def _terms(self, input_dim: int, start: int) -> tuple[Term, ...]:
        """The expression as a sum of products; `start` is the place of its first hyper-parameter."""

    @abstractmethod
    def to_dict(self) -> dict[str, object]:
        """The kernel as plain numbers, lists and tables, for JSON; `kernel_from_dict` reads it."""

    def __add__(self, other: Kernel) -> Sum:
        return Sum(self, other)

    def __mul__(self, other: Kernel) -> Product:
        return Product(self, other)

    @property
    def size(self) -> int:
        """Number of hyper-parameters."""
        return sum(1 for _ in self._values())

    @property
    def theta(self) -> F64:
        """(size,) natural logarithms of the hyper-parameters, from left to right."""
        return np.log(np.fromiter(self._values(), np.float64))

    def with_theta(self, theta: Sequence[float] | F64) -> Kernel:
        """The same expression with the hyper-parameters exp(theta)."""
        values = np.exp(np.asarray(theta, np.float64))
        if values.shape != (self.size,):
            raise InputError(f"theta: shape {values.shape} does not fit; this kernel has {self.size} hyper-parameters")
        return self._with(iter(values.tolist()))

    def program(self, input_dim: int) -> Program:
        """The flat form for inputs of `input_dim` columns; raises InputError where a column is missing."""
        return _flattened(self, input_dim)

    def matrix(self, x: F64, y: F64 | None = None) -> F64:
        """(N, M) covariances between the rows of x (N, D) and those of y (M, D), or of x itself."""
        left = np.ascontiguousarray(np.atleast_2d(x), np.float64)
        right = left if y is None else np.ascontiguousarray(np.atleast_2d(y), np.float64)
        return program.matrix(self.program(left.shape[1]), left, right)

    def diagonal(self, x: F64) -> F64:
        """(N,) prior variances k(x, x) of the rows of x (N, D)."""
        rows = np.ascontiguousarray(np.atleast_2d(x), np.float64)
        return program.diagonal(self.program(rows.shape[1]), rows)


@final
@dataclass(frozen=True, slots=True)
class Constant(Kernel):
    """The same covariance everywhere: an unknown offset."""

    variance: float

    def __post_init__(self) -> None:
        _set(self, "variance", _positive(self.variance, "Constant: variance"))

    def _values(self) -> Iterator[float]:
        yield self.variance

    def _with(self, values: Iterator[float]) -> Kernel:
        return Constant(next(values))

    def _terms(self, input_dim: int, start: int) -> tuple[Term, ...]:
        return (Term((start,), ()),)

    def to_dict(self) -> dict[str, object]:
        """See Kernel."""
        return {"kernel": "constant", "variance": self.variance}


@final
@dataclass(frozen=True, slots=True)
class Linear(Kernel):
    """A function proportional to one input column, through the origin: variance x_c x'_c."""

    variance: float
    column: int

    def __post_init__(self) -> None:
        _set(self, "variance", _positive(self.variance, "Linear: variance"))
        _set(self, "column", _column(self.column, "Linear: column"))

    def _values(self) -> Iterator[float]:
        yield self.variance

    def _with(self, values: Iterator[float]) -> Kernel:
        return Linear(next(values), self.column)

    def _terms(self, input_dim: int, start: int) -> tuple[Term, ...]:
        return (Term((start,), (KernelFactor(program.LINEAR, (self.column,), ()),)),)

    def to_dict(self) -> dict[str, object]:
        """See Kernel."""
        return {"kernel": "linear", "variance": self.variance, "column": self.column}


@final
@dataclass(frozen=True, slots=True)
class SquaredExponential(Kernel):
    """Infinitely smooth functions; one length-scale for all columns, or one for each."""

    variance: float
    lengthscales: Lengthscales
    columns: Columns = None
    """Input columns it looks at, in the order of the length-scales; None: all of them."""

    def __post_init__(self) -> None:
        _check_stationary(self, "SquaredExponential")

    def _values(self) -> Iterator[float]:
        yield self.variance
        yield from _listed(self.lengthscales)

    def _with(self, values: Iterator[float]) -> Kernel:
        return SquaredExponential(next(values), _taken(self.lengthscales, values), self.columns)

    def _terms(self, input_dim: int, start: int) -> tuple[Term, ...]:
        return (_stationary_term(program.SQUARED_EXPONENTIAL, self, input_dim, start),)

    def to_dict(self) -> dict[str, object]:
        """See Kernel."""
        return {"kernel": "squared_exponential", **_stationary_dict(self)}


@final
@dataclass(frozen=True, slots=True)
class Matern(Kernel):
    """Functions that are `nu` - 1/2 times differentiable (mean square); nu is 0.5, 1.5 or 2.5."""

    nu: float
    variance: float
    lengthscales: Lengthscales
    columns: Columns = None
    """Input columns it looks at, in the order of the length-scales; None: all of them."""

    def __post_init__(self) -> None:
        if self.nu not in program.MATERN:
            raise InputError(f"Matern: nu = {self.nu!r} is not allowed; it must be 0.5, 1.5 or 2.5")
        _set(self, "nu", float(self.nu))
        _check_stationary(self, "Matern")

    def _values(self) -> Iterator[float]:
        yield self.variance
        yield from _listed(self.lengthscales)

    def _with(self, values: Iterator[float]) -> Kernel:
        return Matern(self.nu, next(values), _taken(self.lengthscales, values), self.columns)

    def _terms(self, input_dim: int, start: int) -> tuple[Term, ...]:
        return (_stationary_term(program.MATERN[self.nu], self, input_dim, start),)

    def to_dict(self) -> dict[str, object]:
        """See Kernel."""
        return {"kernel": "matern", "nu": self.nu, **_stationary_dict(self)}


@dataclass(frozen=True, slots=True)
class _Pair(Kernel):
    """Two kernels, joined."""

    left: Kernel
    right: Kernel

    def _values(self) -> Iterator[float]:
        yield from self.left._values()
        yield from self.right._values()

    def _with(self, values: Iterator[float]) -> Kernel:
        return type(self)(self.left._with(values), self.right._with(values))


@final
@dataclass(frozen=True, slots=True)
class Sum(_Pair):
    """A sum of two independent functions."""

    def _terms(self, input_dim: int, start: int) -> tuple[Term, ...]:
        return self.left._terms(input_dim, start) + self.right._terms(input_dim, start + self.left.size)

    def to_dict(self) -> dict[str, object]:
        """See Kernel."""
        return {"kernel": "sum", "left": self.left.to_dict(), "right": self.right.to_dict()}


@final
@dataclass(frozen=True, slots=True)
class Product(_Pair):
    """The product of two kernels."""

    def _terms(self, input_dim: int, start: int) -> tuple[Term, ...]:
        right = self.right._terms(input_dim, start + self.left.size)
        return tuple(a.times(b) for a in self.left._terms(input_dim, start) for b in right)

    def to_dict(self) -> dict[str, object]:
        """See Kernel."""
        return {"kernel": "product", "left": self.left.to_dict(), "right": self.right.to_dict()}


def affine_in(column: int, offset: Kernel, slope: Kernel) -> Kernel:
    """Functions a(x) + b(x) f, affine in the input column f: offset + f f' slope.

    The factor f f' has variance 1 of its own, kept in theta; fix it (bounds) when hyper-parameters are fitted.
    """
    return offset + Linear(1.0, column) * slope


def kernel_from_dict(data: object, where: str = "kernel") -> Kernel:
    """The kernel that `to_dict` wrote; raises InputError that names the place of what is wrong."""
    if not isinstance(data, Mapping):
        raise InputError(f"{where} = {data!r} must be a table")
    name = data.get("kernel")
    if not isinstance(name, str) or name not in _FIELDS:
        raise InputError(f"{where}.kernel = {name!r} is not known; known are {', '.join(_FIELDS)}")
    fields = _FIELDS[name]
    only(data, ("kernel", *fields), where)
    missing = [field for field in fields if field not in data and field != "columns"]
    if missing:
        raise InputError(f"{where}.{missing[0]} is missing; a {name} kernel needs {', '.join(fields)}")
    if name in ("sum", "product"):
        left, right = (kernel_from_dict(data[side], f"{where}.{side}") for side in fields)
        return Sum(left, right) if name == "sum" else Product(left, right)
    try:
        return _LEAVES[name](*(data.get(field) for field in fields))
    except InputError as error:
        raise InputError(f"{where}: {error}") from None


_LEAVES: dict[str, Callable[..., Kernel]] = {
    "constant": Constant,
    "linear": Linear,
    "squared_exponential": SquaredExponential,
    "matern": Matern,
}
_FIELDS = {
    "constant": ("variance",),
    "linear": ("variance", "column"),
    "squared_exponential": ("variance", "lengthscales", "columns"),
    "matern": ("nu", "variance", "lengthscales", "columns"),
    "sum": ("left", "right"),
    "product": ("left", "right"),
}


@lru_cache(maxsize=256)
def _flattened(kernel: Kernel, input_dim: int) -> Program:
    return program.flatten(kernel._terms(input_dim, 0), tuple(kernel._values()), input_dim)


def _set(kernel: Kernel, name: str, value: object) -> None:
    object.__setattr__(kernel, name, value)  # the one moment in which a frozen record may change: while it is made


def _positive(value: object, where: str) -> float:
    if isinstance(value, np.floating | np.integer):
        value = value.item()
    return number(value, where, _LEAST, _MOST)


def _column(value: object, where: str) -> int:
    whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not whole or not 0 <= value <= _COLUMN_MAX:  # type: ignore[operator]
        raise InputError(f"{where} = {value!r} is not allowed; it must be a column number from 0")
    return int(value)  # type: ignore[call-overload, no-any-return]


def _check_stationary(kernel: SquaredExponential | Matern, name: str) -> None:
    _set(kernel, "variance", _positive(kernel.variance, f"{name}: variance"))
    scales: object = kernel.lengthscales
    if isinstance(scales, Sequence | np.ndarray) and not isinstance(scales, str):
        if len(scales) == 0:
            raise InputError(f"{name}: lengthscales is empty; give one number, or one for each column")
        _set(kernel, "lengthscales", tuple(_positive(scale, f"{name}: lengthscales") for scale in scales))
    else:
        _set(kernel, "lengthscales", _positive(scales, f"{name}: lengthscales"))
    if kernel.columns is None:
        return
    listed: object = kernel.columns
    if not isinstance(listed, Sequence | np.ndarray) or isinstance(listed, str):
        raise InputError(f"{name}: columns = {listed!r} is not allowed; give a list of column numbers")
    columns = tuple(_column(column, f"{name}: columns") for column in listed)
    if not columns or len(set(columns)) != len(columns):
        raise InputError(f"{name}: columns = {columns} is not allowed; name each column once, at least one")
    if isinstance(kernel.lengthscales, tuple) and len(kernel.lengthscales) != len(columns):
        raise InputError(f"{name}: {len(kernel.lengthscales)} lengthscales for {len(columns)} columns; give as many")
    _set(kernel, "columns", columns)


def _listed(scales: Lengthscales) -> tuple[float, ...]:
    return scales if isinstance(scales, tuple) else (scales,)


def _taken(scales: Lengthscales, values: Iterator[float]) -> Lengthscales:
    return tuple(next(values) for _ in scales) if isinstance(scales, tuple) else next(values)


def _stationary_term(code: int, kernel: SquaredExponential | Matern, input_dim: int, start: int) -> Term:
    columns = tuple(range(input_dim)) if kernel.columns is None else kernel.columns
    scales = kernel.lengthscales
    if isinstance(scales, tuple) and len(scales) != len(columns):
        raise InputError(f"lengthscales: {len(scales)} given for {input_dim} input columns; give one, or as many")
    places = tuple(start + 1 + (i if isinstance(scales, tuple) else 0) for i in range(len(columns)))
    return Term((start,), (KernelFactor(code, columns, places),))


def _stationary_dict(kernel: SquaredExponential | Matern) -> dict[str, object]:
    scales = kernel.lengthscales
    return {
        "variance": kernel.variance,
        "lengthscales": list(scales) if isinstance(scales, tuple) else scales,
        "columns": None if kernel.columns is None else list(kernel.columns),
    }
