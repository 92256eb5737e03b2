"""The words of docs/learning.md that stand between its tables."""

from __future__ import annotations

HEAD = """Errors are distances of the true position from the reference; *settled* is the second half of the track (of
`payload-drop`: from the drop on). Square brackets hold 95 % intervals of a median over seeds (bootstrap)."""

FLOOR = """The floor is the same flight, same seed, fed with the exact model of the forces. Against the best controller
that learns nothing, and against the paper's own learner. A share over 1 means: better than fed with the exact model,
which is no contradiction: a learner also takes in what no force law says (the allocation's extra thrust, a bias of the
sensors it flies by). Where a baseline is within 2 % of the floor there is no excess to share; the bar then asks that
learning is not above it either."""

OTHERS = """With GPS-grade sensors the error is the position estimate's own: nobody can fly better than it is known."""

SCHEDULE = """All that stands above flies with fixed gains. Here poles and damping fall with the learner's confidence
(stiffness with its square), same seeds in all rows; what follows is in
[a decision](decisions/0006-gains-stay-when-learning-knows.md)."""

COVERAGE = """Share of the track's ticks in which the true residual (true specific force less the model's at the thrust
that the rotors delivered, body axes) lies within three sigma of the expected one. Ticks of a flight are not
independent. `*-gps` flies with sensors of GPS grade."""

INPUTS = """q = (position, velocity, thrust direction), q' = q without position: trained on one flight of 20 s, with
hyper-parameters of greatest marginal likelihood for either, tried on other flights of the same path, displaced."""

INPUTS_LESSON = """Where forces do not depend on position, position as an input only misleads away from the data. Where
they depend on height, q' alone fails; q does better near the data and fails beyond; the physics of height (nearness of
the ground, the learner's own seventh input) carries over."""

METHOD = """## How it was measured
* Every flight is `flightstack fly`'s own: simulator and companion in one process, every message through UDP, lockstep;
  its log is kept in memory. Gains are the same fixed ones with and without learning. Seeds begin at {first}: gains are
  those of `controllers/gains.toml`, which says how far each was tuned (most stand where the search begins, so the
  baselines can still gain), on seeds 1000 to 1005, the learner's constants on seeds below {first}; every learner
  begins each flight with nothing learned.
* *exact* (`benchmarks/oracle.py`) feeds forward what the truth's own equations add to the believed model at the
  reference, with its time derivative and the true thrust gain, through the same seam as the learner.
* *px4-sih* is `flightstack fly figure8 --vehicle px4-sihsim-quadx-no-drag --truth px4-sihsim-quadx --sensors mocap`; a
  real PX4 flying this figure with its own position control and feed-forward was measured at 0.98 m.
* Noise of the sensors is part of every error: with motion-capture grade about 1 cm is the position estimate's own.
* All numbers, flight by flight: [learning/results.json](learning/results.json)."""
