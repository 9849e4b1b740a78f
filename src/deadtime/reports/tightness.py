"""How far each certificate reaches: theorem as printed, corrected, sharp; lifted loop; witness.

All are put on one axis, the distance ε between modes and gains, equation (5), as the modes are
moved apart along their own difference: A_0 + α(A_i − A_0), B alike. A form of the theorem reaches
the ε at which ε(α) = ε*(α); the bracket of `stability_margin` ends at a proof and at a witness.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from deadtime.base.checks import reporter
from deadtime.base.errors import ArgumentError, InfeasibleError, SolverError
from deadtime.base.figure_files import new_figure
from deadtime.base.figure_style import COLOURS, STYLE, WIDTH, plain
from deadtime.base.wording import amount
from deadtime.certificates import theorem_bound
from deadtime.certificates.theorem.bound import stated_forms
from deadtime.certificates.theorem.constants import distance
from deadtime.gains import place
from deadtime.laws import AveragedPredictor
from deadtime.margins import StabilityMargin, stability_margin
from deadtime.plant import SwitchedSystem
from deadtime.problems import Problem
from deadtime.reports.certificate_tables import theorem_refusal

TINY = 1e-6  # below this α everything is linear in α, and computed at this α
LOW = 0.01  # the α at which the search for a margin starts
MOST = 8.0  # the largest α that is searched
ROUNDS = 6  # of the fixed point for ε(α) = ε*(α); it converges in two or three


@dataclass(frozen=True, eq=False)
class Reach:
    """The largest distance that one certificate allows, or that of the witness."""

    name: str
    log10_distance: float  # log₁₀ of ε
    alpha: float  # 0.0 if it underflows
    stable: bool = True  # False for the witness


@dataclass(frozen=True, eq=False)
class Tightness:
    """Distances that certificates reach, as `tightness` found them.

    Attributes
    ----------
    reaches : tuple of Reach
        In rising order of what they reach; shorter where something has no answer.
    own : float
        ε of the problem itself, α = 1.
    margin : StabilityMargin or None
        The bracket that ends in the last two.
    message : str
        The gain of each certificate over the one before, or why something is missing.
    """

    reaches: tuple[Reach, ...]
    own: float
    margin: StabilityMargin | None
    message: str


def move_modes(problem: Problem, alpha: float) -> tuple[SwitchedSystem, np.ndarray]:
    """The plant with its modes α times as far apart, and gains (modes, m, n) for it.

    Gains that place the same poles in every mode, one input, are placed anew; others move along
    their own difference, K_0 + α(K_i − K_0).

    Examples
    --------
    >>> import deadtime as dt
    >>> plant, gains = move_modes(dt.problems.paper(), 0.5)
    >>> plant.A[1].tolist(), gains[1].round(3).tolist()
    ([[2.15, 1.05], [0.025, 1.1]], [[-12.351, -6.188]])
    """
    plant, K = problem.plant, problem.gains
    apart = plant.apart(alpha)
    poles = np.sort_complex(np.linalg.eigvals(plant.A + plant.B @ K))
    common = np.allclose(poles, poles[0], rtol=1e-6, atol=1e-9)
    if plant.inputs == 1 and common:
        return apart, place(apart, poles[0])
    return apart, K[0] + alpha * (K - K[0])


def tightness(
    problem: Problem,
    dwell_time: float,
    step: float = 0.01,
    ratio: float = 1.01,
    progress: Callable[[str], None] | None = None,
) -> Tightness:
    """How far the theorem's three forms, the lifted certificate and a witness reach.

    The theorem is about the ideal loop, certificate and witness are about the loop sampled at
    `step`, all with the averaged law.

    Parameters
    ----------
    problem : Problem
        At least two modes that differ; its signal and laws are not read.
    dwell_time, step : float
        Seconds.
    ratio : float
        As `stability_margin` takes it.
    progress : callable, optional
        Called with a few words, twice.

    Raises
    ------
    ArgumentError
        If the modes do not differ.
    """
    own = distance(problem.plant, problem.gains)
    if own == 0.0 or problem.plant.modes == 1:
        raise ArgumentError("modes of the problem must differ: they are all the same.")
    reaches, missing = [], []
    progress = reporter("progress", progress)
    progress("the theorem's reach")
    forms = stated_forms(problem.plant)
    if not forms:
        missing = ["The theorem has no form for delays that differ between modes."]
    for form in forms:
        try:
            reaches.append(reach_of(problem, dwell_time, form))
        except (ArgumentError, InfeasibleError, SolverError) as error:
            missing = [theorem_refusal(error)]
    progress("between proof and witness")
    margin = None

    def loop(alpha: float) -> tuple[SwitchedSystem, AveragedPredictor]:
        plant, gains = move_modes(problem, alpha)
        return plant, AveragedPredictor(plant, gains, allow_unstable=True)

    try:
        margin = stability_margin(loop, (LOW, MOST), dwell_time, step, ratio)
    except ArgumentError as error:
        missing.append(f"There is no bracket between proof and witness: {error}")
    if margin is not None:
        name = "lifted loop, proved"
        if margin.refuted is None:
            name += " (at least)"
            missing.append(
                f"No signal that grows was found up to {MOST:g} times the distance of the modes, "
                "where the search ended."
            )
        reaches.append(_at(problem, name, margin.certified))
        if margin.refuted is not None:
            reaches.append(_at(problem, "a signal that grows", margin.refuted, stable=False))
    return Tightness(tuple(reaches), own, margin, " ".join([*_improvements(reaches), *missing]))


def reach_of(problem: Problem, dwell_time: float, form: str) -> Reach:
    """The fixed point of ε(α) = ε*(α) along the modes' own difference, α ≤ 1."""
    log_alpha, log_star = math.log10(TINY), 0.0
    for _ in range(ROUNDS):
        alpha = min(max(10.0**log_alpha, TINY), 1.0)
        plant, gains = move_modes(problem, alpha)
        bound = theorem_bound(plant, gains, dwell_time, form=form)
        log_star = bound.log10_epsilon_star
        before, log_alpha = log_alpha, log_star - math.log10(bound.epsilon / alpha)
        if abs(log_alpha - before) < 1e-4 or 10.0 ** max(log_alpha, before) < TINY:
            break
    words = {"printed": "theorem as printed", "corrected": "corrected", "sharp": "sharp"}
    return Reach(words[form], log_star, 10.0**log_alpha)


def _at(problem: Problem, name: str, alpha: float, stable: bool = True) -> Reach:
    return Reach(name, math.log10(distance(*move_modes(problem, alpha))), alpha, stable)


def _times(log10: float) -> str:
    return f"× {10.0**log10:.3g}" if log10 < 3.0 else f"× 10^{log10:.1f}"


def _improvements(reaches: list[Reach]) -> list[str]:
    good = [reach for reach in reaches if reach.stable]
    if len(good) < 2:
        return []
    gains = "; ".join(
        f"{after.name} {_times(after.log10_distance - before.log10_distance)}"
        for before, after in pairwise(good)
        if after.log10_distance - before.log10_distance >= 0.05
    )
    text = f"Distances allowed, each as a multiple of the one before: {gains}."
    if reaches[-1].stable:
        return [text]
    left = 10.0 ** (reaches[-1].log10_distance - good[-1].log10_distance) - 1.0
    return [f"{text} From the last proof to a signal that grows it is {100.0 * left:.2g} %."]


def plot_tightness(result: Tightness, title: str | None = None) -> Figure:
    r"""How far each certificate reaches, on a logarithmic axis of the distance.

    The number between two rows is the ratio of their distances.
    """
    rows, count = result.reaches, len(result.reaches)
    with rc_context(STYLE):
        figure = new_figure(WIDTH, 1.15 + 0.38 * count)
        axes = figure.subplots()
        own = np.log10(result.own)
        logs = [own, *(reach.log10_distance for reach in rows)]
        left, right = min(logs), max(logs)
        room = max(right - left, 0.5)
        left, right = left - 0.06 * room, right + 0.3 * room
        axes.axvline(own, color="#888888", linewidth=0.9, linestyle="--")
        for row, reach in enumerate(rows):
            colour, end = COLOURS[0 if reach.stable else 1], reach.log10_distance
            if reach.stable:
                axes.plot([left, end], [row, row], color=colour, lw=3.0, solid_capstyle="butt")
            axes.plot([end], [row], "o" if reach.stable else "X", color=colour, markersize=6.0)
            axes.annotate(
                _distance_text(end), (end, row), (6.0, 0.0), textcoords="offset points",
                va="center", fontsize=8.5, bbox={"facecolor": "white", "lw": 0.0, "pad": 1.0},
            )  # fmt: skip
        for row, (before, after) in enumerate(pairwise(rows)):
            gain = after.log10_distance - before.log10_distance
            if gain >= 0.05 and after.stable:
                axes.text(
                    0.5 * (before.log10_distance + after.log10_distance), row + 0.5,
                    f"× {amount(10.0**gain)}" if gain < 300.0 else f"× 10^{gain:.0f}",
                    ha="center", va="center", fontsize=8.0, color="#555555",
                )  # fmt: skip
        axes.set_yticks(range(count), [reach.name for reach in rows])
        axes.set_ylim(count - 0.4, -0.9)
        axes.set_xlim(left, right)
        every = max(1, int(np.ceil((right - left) / 6.0)))
        ticks = np.arange(np.ceil(left / every) * every, right, every) + 0.0  # no −0
        axes.set_xticks(ticks, [f"$10^{{{tick:.0f}}}$" for tick in ticks])
        axes.set_xlabel("distance ε between modes and gains")
        axes.grid(False, axis="y")
        axes.text(
            own, -0.62, " this plant ", ha="left" if own < 0.5 * (left + right) else "right",
            va="center", fontsize=8.0, color="#555555",
        )  # fmt: skip
        if title:
            axes.set_title(plain(title))
    return figure


def _distance_text(log10: float) -> str:
    if log10 <= -300.0:
        return f"10^{log10:.0f}"
    value = 10.0**log10
    return f"{value:#.4g}".rstrip(".") if 1e-3 <= value < 1e5 else amount(value)
