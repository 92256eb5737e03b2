"""The certifier of a flight under attack: held to what is in force, or told other constants than the product's."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any

from benchmarks.attack_worlds import World
from flightstack.barrier.certifier import OnlineCertifier
from flightstack.barrier.certifier_config import CertifierConfig, Thrust
from flightstack.barrier.falsify import Witness
from flightstack.barrier.growing import GrowingCertifier
from flightstack.barrier.records import Certificate
from flightstack.cli.barrier_score import GivenCertificate
from flightstack.model import Model
from flightstack.types import Filtered, Learned, Measurement

_THRUSTS = (Thrust(), Thrust(most_hovers=1.6))


class Held:
    """A certifier that, once `hold` was called, keeps to what is in force, and only watches whether that holds.

    For many attacks on one certificate: making the next ones takes more time than all the rest of a flight.
    """

    enabled = True

    def __init__(self, inner: Any, model: Model) -> None:
        self._inner, self._model = inner, model
        self._given: GivenCertificate | None = None
        self._watch: object = None

    def init(self) -> Any:
        """The inner one's."""
        return self._inner.init()

    def hold(self, certificate: Certificate) -> None:
        """From now on."""
        self._given, self._watch = GivenCertificate(certificate, self._model), Witness()

    def step(
        self, state: Any, learner: Any, measurement: Measurement, learned: Learned, filtered: Filtered
    ) -> tuple[Any, Certificate | None]:
        """The inner one's, or the watch."""
        if self._given is None:
            after: tuple[Any, Certificate | None] = self._inner.step(state, learner, measurement, learned, filtered)
            return after
        self._watch, ended = self._given.step(self._watch, learner, measurement, learned, filtered)
        return state, ended


def told(certifier: Any, change: Callable[[CertifierConfig], CertifierConfig]) -> Any:
    """The certifier with other constants."""
    if isinstance(certifier, GrowingCertifier):
        certifier._first = told(certifier._first, change)
        return certifier
    if not isinstance(certifier, OnlineCertifier):
        return certifier
    return OnlineCertifier(
        certifier.model, certifier.limits, certifier.region, initial=certifier.initial,
        config=change(certifier.config), safe=certifier.safe,
    )  # fmt: skip


def suited(config: CertifierConfig, world: World, planted: str) -> CertifierConfig:
    """How long a command may be held, and with less thrust where more does not close."""
    spared = -math.inf  # the nominal path is no matter here
    changes: dict[str, Any] = {"dt_s": max(world.held_s, config.dt_s), "spared_h": spared}
    if config.thrusts == CertifierConfig().thrusts:
        changes["thrusts"] = _THRUSTS
    if planted == "torque":
        changes["governor"] = None
    return dataclasses.replace(config, **changes)
