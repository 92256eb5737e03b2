"""Terms of JSBSim's functions, written: a term is a number or the text of an element, all in SI."""

from __future__ import annotations

Term = str | float


def term(value: Term) -> str:
    """A number as a value element; text as it is."""
    return value if isinstance(value, str) else f"<value>{float(value)!r}</value>"


def prop(name: str) -> str:
    """The value of a property."""
    return f"<property>{name}</property>"


def _call(name: str, terms: tuple[Term, ...]) -> str:
    return f"<{name}>{''.join(map(term, terms))}</{name}>"


def total(*terms: Term) -> str:
    """Their sum."""
    return term(terms[0]) if len(terms) == 1 else _call("sum", terms)


def times(*terms: Term) -> str:
    """Their product."""
    return term(terms[0]) if len(terms) == 1 else _call("product", terms)


def minus(first: Term, second: Term) -> str:
    """first - second."""
    return _call("difference", (first, second))


def over(first: Term, second: Term) -> str:
    """first / second."""
    return _call("quotient", (first, second))


def root(value: Term) -> str:
    """Square root."""
    return _call("sqrt", (value,))


def power(value: Term, exponent: float) -> str:
    """value to the power of exponent."""
    return _call("pow", (value, exponent))


def exponential(value: Term) -> str:
    """exp."""
    return _call("exp", (value,))


def sine(value: Term) -> str:
    """sin."""
    return _call("sin", (value,))


def cosine(value: Term) -> str:
    """cos."""
    return _call("cos", (value,))


def greatest(*terms: Term) -> str:
    """max."""
    return _call("max", terms)


def least(*terms: Term) -> str:
    """min."""
    return _call("min", terms)


def positive(value: Term) -> str:
    """1 where value > 0, else 0."""
    return _call("gt", (value, 0.0))


def normal(seed: int) -> str:
    """A standard normal number, a new one at each reading."""
    return f'<random seed="{seed}" mean="0" stddev="1"/>'
