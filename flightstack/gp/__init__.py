"""Gaussian processes: kernels, an exact recursive process of bounded size, hyper-parameters, relevance."""

from flightstack.gp.kernels import (
    Constant,
    Kernel,
    Linear,
    Matern,
    Product,
    SquaredExponential,
    Sum,
    affine_in,
    kernel_from_dict,
)
from flightstack.gp.likelihood import FitResult, fit, log_marginal_likelihood
from flightstack.gp.recursive import Health, RecursiveGP
from flightstack.gp.relevance import least_relevant, oldest, spread

__all__ = [
    "Constant",
    "FitResult",
    "Health",
    "Kernel",
    "Linear",
    "Matern",
    "Product",
    "RecursiveGP",
    "SquaredExponential",
    "Sum",
    "affine_in",
    "fit",
    "kernel_from_dict",
    "least_relevant",
    "log_marginal_likelihood",
    "oldest",
    "spread",
]
