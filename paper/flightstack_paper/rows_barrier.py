"""Rows of Algorithm 1 in flight, and of the formulas it rests on."""

from __future__ import annotations

import math
from typing import Any

from flightstack.barrier import viability
from flightstack.types import STANDARD_GRAVITY_MPS2
from flightstack_paper.plan import PUBLISHED, SOUND, certify_name
from flightstack_paper.rows import Cell, ResultLine, ResultTable

MU_INITIAL, MU_FINAL, LIMIT_M = 6.3, 0.6, 0.6
_AREA = math.pi * LIMIT_M / math.sqrt(MU_FINAL)
"""Of the paper's final ellipse, m^2/s."""


def flown(run: ResultTable, plant: str, behind: str) -> list[ResultLine]:
    """Section V.B on one plant."""
    sound, published = (certify_name(plant, mode) for mode in (SOUND, PUBLISHED))
    on = run.on(plant)

    def row(row_id: str, claim: str, paper: float | None, unit: str, part: str, make: Any) -> ResultLine:
        return run.row(f"{row_id}{behind}", claim, paper, unit, (part,), lambda found: _on(make(found), on))

    return [
        row("mu-initial", "a conservative barrier with mu = 6.3 is certified at the beginning", MU_INITIAL, "s^2/m^2",
            sound, _initial),
        row("mu-final", "learning expands the region to mu = 0.6 (Fig. 8)", MU_FINAL, "s^2/m^2", published, _final),
        row("mu-final-sound", "the region of mu = 0.6 can be certified with what was learned", MU_FINAL, "s^2/m^2",
            sound, _final_sound),
        row("area-as-published", "area of the final region in the plane of e and v (Fig. 8)", _AREA, "m^2/s",
            published, _area_published),
        row("area-sound", "the same, certified with every margin and verified by the independent checker", _AREA,
            "m^2/s", sound, _area_sound),
        row("area-left-by-margins", "what the paper neglects (lag, delay, sampling, a whole bound) costs no area",
            1.0, "1", sound, _left_by_margins),
        row("barrier-violations", "the quadrotor never leaves the certified region", 0.0, "ticks", sound, _violations),
        row("barrier-violations-as-published", "the same, with the paper's own filter and acceptance", 0.0, "ticks",
            published, _violations),
        row("adaptive-vs-uniform-samples", "adaptive sampling needs far fewer samples than a uniform grid", None, "1",
            published, _samples),
        row("adaptive-vs-uniform-samples-sound", "the same under the sound certificate's bounds", None, "1", sound,
            _samples),
        row("sampling-boundary-over-centre", "samples are much denser near the region's boundary than about its centre "
            "(Fig. 7)", None, "1", published, lambda found: _denser(found, "boundary", "centre")),
        row("sampling-down-over-up", "downward speeds are sampled much denser than upward ones (Fig. 7)", None, "1",
            published, lambda found: _denser(found, "down", "up")),
    ]  # fmt: skip


def formulas(run: ResultTable) -> list[ResultLine]:
    """What the paper's formulas are worth, whatever is flown."""
    rows = (
        ("mu-physics", "mu = 0.6 is what the vehicle can do", MU_FINAL, "s^2/m^2", _mu_physics),
        ("mu-state-only", "what is learned as a function of the state alone holds for every thrust", None, "s^2/m^2",
         _mu_state_only),
        ("sampling-lemma", "the sampling condition (lemma III.1) can be met for some mu, gamma and tau", None, "1",
         _lemma),
        ("sampling-cover-open-cells", "adaptive sampling covers the region of h_mu", 0.0, "cells", _cover),
        ("filter-sampled-max-e", "the QP controller keeps |e| within 0.6 m", LIMIT_M, "m", _sampled),
        ("five-term-rate", "on the boundary of the 5-term h some thrust keeps hdot >= 0", None, "1/s", _five_terms),
        ("gp-block-inverse-residual", "the printed recursion inverts the bordered kernel matrix", None, "1",
         _block_inverse),
        ("gp-joint-confidence", "k_delta = 2 gives 95.5 % confidence", 0.955, "1", _joint),
    )  # fmt: skip
    return [run.row(row_id, claim, paper, unit, ("theory",), make) for row_id, claim, paper, unit, make in rows]


def _on(cell: Cell, where: str) -> Cell:
    return cell[0], cell[1], cell[2] + where


def _initial(found: dict[str, Any]) -> Cell:
    mu, least = found["mu_initial"], found["mu_knowledge"]
    return mu, mu <= MU_INITIAL + 1e-9 and least <= mu and found["areas_m2ps"][0] > 0.0, (
        f"the region that the flight begins with; all that may be true before take-off (mass 0.8 to 1.5 of the "
        f"believed one, 0.15 g of force) allows mu = {least:.2f}; the first certified region has "
        f"{found['areas_m2ps'][0]:.2f} m^2/s, the ellipse of mu = 6.3 {math.pi * LIMIT_M / math.sqrt(mu):.2f}"
    )  # fmt: skip


def _final(found: dict[str, Any]) -> Cell:
    mu = found["mu_final"]
    return mu, round(mu, 1) <= MU_FINAL, (
        f"as published, rounds flown: {found['rounds']}; compared to the one digit that the paper prints; the truth "
        f"allows {found['mu_physics_bare']:.4f} without any margin; not robustly certifiable: see sampling-lemma"
    )  # fmt: skip


def _final_sound(found: dict[str, Any]) -> Cell:
    mu, margins = found["mu_final"], found["margins"]
    largest = ", ".join(f"{name.replace('_', ' ')} {size:.2f}" for name, size in
                        sorted(margins.items(), key=lambda item: -item[1])[:3])  # fmt: skip
    return mu, mu <= MU_FINAL, (
        f"rounds flown: {found['rounds']}; what the certified braking is worth as mu; with margins that knowledge "
        f"can't remove physics allows {found['mu_physics']:.3f}, without any {found['mu_physics_bare']:.4f}: 0.6 "
        f"leaves nothing for margins; the largest are {largest} m/s^2"
    )  # fmt: skip


def _area_published(found: dict[str, Any]) -> Cell:
    area = found["area_m2ps"]
    return area, area >= 0.95 * _AREA, (
        f"an ellipse without cross term, proven by nothing; {100 * area / found['area_kernel_m2ps']:.0f} % of the "
        f"viability kernel at the same braking ({found['area_kernel_m2ps']:.2f}); held to within 5 %"
    )  # fmt: skip


def _area_sound(found: dict[str, Any]) -> Cell:
    area, kernel = found["area_m2ps"], found["area_kernel_m2ps"]
    return area, found["passed"] and area >= _AREA, (
        f"{100 * area / kernel:.0f} % of the viability kernel that all margins leave ({kernel:.2f} m^2/s): a free "
        "centre and a cross term, or stopping distances, win more than the margins cost"
    )  # fmt: skip


def _left_by_margins(found: dict[str, Any]) -> Cell:
    """The price of honesty: viability kernels of the same strip, with all margins and with none."""
    kernel, limit = found["area_kernel_m2ps"], found["limit_m"]
    bare = viability.area(-limit, limit, -1.0 / (limit * found["mu_physics_bare"]), STANDARD_GRAVITY_MPS2)
    return kernel / bare, kernel >= bare, (
        f"the exact viability kernel has {kernel:.2f} m^2/s with every margin ({sum(found['margins'].values()):.2f} "
        f"m/s^2 in all) and {bare:.2f} with none: that is the price of honesty, whatever the form"
    )  # fmt: skip


def _violations(found: dict[str, Any]) -> Cell:
    exits, infeasible = found["exits"], found["infeasible"]
    least = found["min_h_truth"]
    if exits is None or least is None:
        return math.nan, False, "the region never counted: nothing was kept to"
    return float(exits), exits == 0, (
        f"of the true state, {found['flight_time_s']:.0f} s of flight; least h {least:.3f}, {infeasible} infeasible "
        f"steps, {found['interventions']} commands changed"
    )  # fmt: skip


def _samples(found: dict[str, Any]) -> Cell:
    few, many, sampling = found["samples"], found["samples_uniform"], found["sampling"]
    if not few or not many or sampling is None:
        return math.nan, False, "no strict barrier is covered under the bounds that were learned"
    return few / many, few / many < 0.5, (
        f"{few} samples of the strict form against {many} on a uniform grid of the same guarantee "
        f"({sampling['one_modulus']} with one modulus for the whole region, as the paper has it)"
    )  # fmt: skip


def _denser(found: dict[str, Any], where: str, than: str) -> Cell:
    sampling = found["sampling"]
    if sampling is None:
        return math.nan, False, "the learned bounds know too few speeds"
    paper, strict = (sampling[form]["density"] for form in ("published", "strict"))
    ratio = paper[where] / paper[than]
    return ratio, ratio > 2.0, (
        f"{paper[where]:.0f} against {paper[than]:.0f} samples for each m^2/s, the paper's h and one modulus; what is "
        f"close to the tips stays open ({len(sampling['published']['open'])} cells); of the strict form "
        f"{strict[where] / strict[than]:.1f}; 'much' is read as twice"
    )  # fmt: skip


def _mu_physics(found: dict[str, Any]) -> Cell:
    mu = found["mu"]
    return mu["wind_north"], mu["wind_north"] <= MU_FINAL, (
        f"least mu of any controller with the true vehicle known exactly, the 0.1 g from aside balanced by tilt; "
        f"without wind {mu['exact']:.4f} = (0.6 / 0.36) / ((1.8 / 1.4 - 1) g), which 0.6 clears by "
        f"{mu['slack_mps2']:.3f} m/s^2; 0.1 g down {mu['wind_down']:.3f}, up {mu['wind_up']:.3f}"
    )  # fmt: skip


def _mu_state_only(found: dict[str, Any]) -> Cell:
    mu = found["mu"]
    return mu["state_only"], mu["state_only"] >= mu["exact"], (
        f"learned from hover it claims this mu; full true braking overshoots its region by "
        f"{100 * mu['state_only_overshoot_m']:.1f} cm; with the thrust's gain learned it is {mu['exact']:.4f}"
    )  # fmt: skip


def _lemma(found: dict[str, Any]) -> Cell:
    lemma = found["lemma"]
    return lemma["greatest_share"], lemma["greatest_share"] >= 1.0, (
        f"left over right side at the grid's point nearest to a tip (e = 0.6 m, v = 0), the greatest of "
        f"{lemma['tried']} choices; at most 1/2 for any, since all of the left side vanishes at the tip"
    )  # fmt: skip


def _cover(found: dict[str, Any]) -> Cell:
    cover = found["cover"]
    deepest = max(cover["open"], key=int)
    still = ", ".join(f"{count} at {depth} halvings" for depth, count in cover["open"].items())
    return float(cover["open"][deepest]), cover["open"][deepest] == 0, (
        f"cells left open at both tips for mu = {cover['mu']:g}, exact model: {still}; with a cross term "
        f"{cover['strict_samples']} samples cover it, left side at least {cover['strict_margin_ps']:.2f} /s"
    )  # fmt: skip


def _sampled(found: dict[str, Any]) -> Cell:
    sampled = found["sampled"]
    at = sampled["periods_s"].index(0.004)
    published, cross = sampled["published"], sampled["cross"]
    most = ", ".join(
        f"{m:.2f} m at {1000 * p:g} ms" for p, m in zip(sampled["periods_s"], published["most_m"], strict=True)
    )
    return published["most_m"][at], published["most_m"][at] <= LIMIT_M, (
        f"mu = 0.6, exact model, pushed down, a command every 4 ms: it creeps out by g dt / 2, {most}; "
        f"{100 * published['infeasible'][at]:.0f} % of steps infeasible; with a cross term at most "
        f"{max(cross['most_m']):.3f} m at every period, {100 * max(cross['infeasible']):.0f} % infeasible"
    )  # fmt: skip


def _five_terms(found: dict[str, Any]) -> Cell:
    five = found["five_terms"]
    return five["rate_ps"], five["rate_ps"] >= 0.0, (
        f"level at x = 0.283 m, vx = 0.354 m/s, z = -0.8 m: thrust has no hold (L_g h = {five['slope']:g}), hdot is "
        f"this, {five['rate_wind_ps']:.2f} /s in 0.1 g: with thrust alone h is no control barrier function"
    )  # fmt: skip


def _block_inverse(found: dict[str, Any]) -> Cell:
    block = found["block_inverse"]
    return block["printed"], block["printed"] < 1e-6, (
        f"max |M F - I| of the formula as printed; {block['right']:.0e} with the sign of the upper right block and the "
        "inverse of the corner put right"
    )  # fmt: skip


def _joint(found: dict[str, Any]) -> Cell:
    joint = found["joint"]
    return joint["2"], joint["2"] >= 0.955, (
        f"of six independent outputs at once at one state; {100 * joint['3']:.1f} % with k_delta = 3; for all states "
        "at once, as the proof uses it, it is less still"
    )  # fmt: skip
