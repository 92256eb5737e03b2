"""What the learning campaign flies: one table of cases, one of pilots, and which of them meet over which seeds."""

from __future__ import annotations

from dataclasses import dataclass

FIRST_SEED = 100
"""Nothing was tuned on the campaign's seeds, 100 and up: gains were found on seeds 1000 to 1005, the learner's
constants on seeds below 100."""


@dataclass(frozen=True, slots=True)
class Pilot:
    """Who flies: a controller, and what it knows beyond its model."""

    words: str
    controller: str = "flatness"
    learning: bool = True
    exact: bool = False
    """Fed with the truth's own residual (`benchmarks/oracle.py`) instead of a learner's."""
    confident_share: float = 1.0
    """Gain schedule: share of the gains left at full confidence."""


PILOTS: dict[str, Pilot] = {
    "learning": Pilot("flatness control, Gaussian process learning in flight"),
    "none": Pilot("the same without learning", learning=False),
    "exact": Pilot("the same fed with the exact model: the floor", exact=True),
    "pd": Pilot("the paper's PD", "pd", learning=False),
    "pid": Pilot("PID with integral action", "pid", learning=False),
    "indi": Pilot("incremental nonlinear dynamic inversion", "indi", learning=False),
    "dob": Pilot("flatness control, disturbance observer", "dob"),
    "px4": Pilot("PX4's own position control", "px4", learning=False),
    "state-gp": Pilot("the paper's learner: state only, no thrust gain", "state-gp"),
    "lower-gains": Pilot("learning; 0.7 of the gains left at full confidence", confident_share=0.7),
    "half-gains": Pilot("learning; half the gains left at full confidence", confident_share=0.5),
}
SCHEDULED = ("lower-gains", "half-gains")
"""The gain schedule, measured apart."""
FIXED = ("none", "pd", "pid", "indi", "dob", "px4")
"""Controllers that learn nothing: what a user would otherwise take."""
BASELINES = (*FIXED, "state-gp")
"""All that learning is compared with."""


@dataclass(frozen=True, slots=True)
class Case:
    """One flight task: scenario, believed vehicle, truth, sensors; None where the scenario says."""

    words: str
    scenario: str
    vehicle: str | None = None
    truth: str | None = None
    sensors: str | None = None


CASES: dict[str, Case] = {
    "paper-tracking": Case("the paper's path; 1.4 times the mass, 0.1 g of force", "paper-tracking"),
    "right-model": Case("the same path with a right model", "paper-tracking", truth="quad-x"),
    "rotor-drag": Case("figure of eight of 12 m x 6 m in 10 s; rotor drag and translational lift", "rotor-drag"),
    "low-pass": Case("passes 0.15 m above the ground; ground effect", "low-pass"),
    "steady-wind": Case("figure of eight in 6 m/s of wind; rotor drag and translational lift", "steady-wind"),
    "px4-sih": Case(
        "figure of eight of 3 m x 1.5 m in 8 s on PX4's SIH quadrotor; linear drag of 1 kg/s",
        "figure8",
        "px4-sihsim-quadx-no-drag",
        "px4-sihsim-quadx",
        "mocap",
    ),
    "payload-drop": Case("0.3 kg fall off after 20 s", "payload-drop"),
    "figure8": Case("figure of eight with a right model: nothing to learn", "figure8"),
    "hover": Case("hovering with a right model: nothing to learn", "hover"),
    "paper-tracking-gps": Case("the paper's path, sensors of GPS grade", "paper-tracking", sensors="gps"),
    "rotor-drag-gps": Case("the large figure of eight, sensors of GPS grade", "rotor-drag", sensors="gps"),
}


@dataclass(frozen=True, slots=True)
class Flight:
    """One flight to fly."""

    case: str
    pilot: str
    seed: int

    @property
    def key(self) -> str:
        """Its name in results."""
        return f"{self.case}/{self.pilot}/{self.seed}"


@dataclass(frozen=True, slots=True)
class Plan:
    """A line of the campaign: these pilots fly this case over so many seeds (full, quick)."""

    case: str
    pilots: tuple[str, ...]
    seeds: int
    quick: int


CLOSE = ("learning", "none", "exact", "indi", "dob", "state-gp")
"""Those between whom a case is decided; the others' errors are far off and hardly vary."""
FAR = ("pd", "pid", "px4")
PLANS = (
    Plan("paper-tracking", (*CLOSE, "px4"), 20, 1),
    Plan("paper-tracking", ("pd", "pid"), 5, 0),
    Plan("rotor-drag", CLOSE, 12, 1),
    Plan("rotor-drag", FAR, 4, 0),
    Plan("low-pass", CLOSE, 12, 1),
    Plan("low-pass", FAR, 4, 0),
    Plan("steady-wind", CLOSE, 4, 0),
    Plan("px4-sih", CLOSE, 6, 1),
    Plan("px4-sih", FAR, 3, 0),
    Plan("payload-drop", ("learning",), 12, 1),
    Plan("payload-drop", ("none", "exact", "dob"), 3, 0),
    Plan("figure8", ("learning", "none"), 12, 1),
    Plan("hover", ("learning", "none"), 12, 1),
    Plan("right-model", ("none",), 6, 1),
    Plan("paper-tracking", SCHEDULED, 4, 0),
    Plan("rotor-drag", SCHEDULED, 4, 0),
    Plan("figure8", SCHEDULED, 4, 0),
    Plan("paper-tracking-gps", ("learning", "none"), 4, 0),
    Plan("rotor-drag-gps", ("learning", "none"), 4, 0),
)


def flights(*, quick: bool) -> list[Flight]:
    """All flights of the campaign, seed by seed, so that a campaign cut short has some of everything."""
    chosen = [
        Flight(plan.case, pilot, FIRST_SEED + number)
        for plan in PLANS
        for pilot in plan.pilots
        for number in range(plan.quick if quick else plan.seeds)
    ]
    return sorted(chosen, key=lambda flight: flight.seed)
