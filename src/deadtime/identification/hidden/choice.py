"""How many modes: fits of several numbers, and Bayes' information criterion.

    BIC = −2 log L + q log N,    q unknowns: those of the plant, S of every mode, the chain's odds

N: the periods that are usable whatever the delays are; they are the same for all numbers.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
from jaxtyping import Float

from deadtime.base.errors import ArgumentError
from deadtime.base.wording import number_of
from deadtime.identification.hidden.ascent import Ascent, ascended
from deadtime.identification.hidden.regressions import (
    Regressions,
    climbed,
    drawn_start,
    first_cells,
    maximised,
    regressed,
    scanned,
    stretches_of,
)
from deadtime.identification.levels import near_zero
from deadtime.identification.likelihoods.hidden_log import HiddenLog
from deadtime.identification.likelihoods.hidden_noisy_log import HiddenNoisyLog
from deadtime.identification.likelihoods.jumps import Counts, Jumps
from deadtime.identification.likelihoods.likelihood import ExactLog, maximise, window_of
from deadtime.identification.likelihoods.mode_periods import Periods, Pooled, Posterior
from deadtime.identification.log.recording import Recording
from deadtime.identification.parameters import Layout, Vector, Window
from deadtime.identification.regression import concentrated, rooted
from deadtime.identification.sampling import nodes_for, sampling_of
from deadtime.identification.start import cell_range, plant_of, start_of

Log = TypeVar("Log", HiddenLog, HiddenNoisyLog)

_STARTS = 12
_SHORT = 12  # steps of each start, with one covariance for all modes
_LONG = 100  # steps of the best starts, and of those in other cells
_KEPT = 3
_ALIKE = 5.0  # of log likelihood: starts so close after a few steps lead to the same


class HiddenSearch(NamedTuple):
    """A recording and its periods; and the same on a grid, where searches begin.

    plain : of plants with constant terms, the same without; None where 0 is far from the log
    """

    recording: Recording
    periods: Periods
    grid: Recording
    even: Periods
    bounds: Window
    plain: HiddenSearch | None


class Begun(NamedTuple):
    """A plant near regressions whose modes are hidden, where a maximum is looked for.

    log : of the recording on a grid; agreed : how many starts led there, of `starts`
    found : what the log says of the modes under the regressions
    """

    log: HiddenLog
    theta: Vector
    found: Posterior
    agreed: int
    starts: int


@dataclass(frozen=True, eq=False)
class HiddenFit(Generic[Log]):
    """The likeliest plant of a number of modes, and BIC.

    given : what the likelihood is evaluated in: cells of delays, or samples at which it starts anew
    window : of delays; values : log likelihood on the way up
    grid, on_grid : the likelihood of exact states on a grid, and where it is large
    """

    log: Log
    theta: Vector
    given: Any
    window: Window
    values: Float[np.ndarray, " step"]
    bic: float
    begun: Begun
    grid: HiddenLog
    on_grid: Float[np.ndarray, " plant"]

    @property
    def layout(self) -> Layout:
        """Where unknowns of the plant lie."""
        return self.log.layout


def search_of(recording: Recording, layout: Layout, bounds: Window, within: bool) -> HiddenSearch:
    """The usable periods of a recording, with the density of one model for all modes."""
    one = replace(layout, modes=1, per_mode=False)
    plain, grid = None, recording.gridded()
    if layout.constant and near_zero(recording):
        plain = search_of(recording.absolute(), replace(layout, constant=False), bounds, within)
    even = _periods_on_a_grid(grid, one, bounds, within)
    if recording.even:
        return HiddenSearch(recording, even, grid, even, bounds, plain)
    pooled = _one_plant(recording, grid, one, bounds) if even.within else None
    sampling = sampling_of(recording, np.zeros(0))
    periods = Periods.of(sampling, recording.parts, bounds, pooled, layout.constant)
    return HiddenSearch(recording, periods, grid, even, bounds, plain)


def _periods_on_a_grid(grid: Recording, one: Layout, bounds: Window, within: bool) -> Periods:
    """Those of even rows, with one regression for all modes."""
    cell_range(grid.step, bounds, one.m)
    sampling = sampling_of(grid, np.zeros(0))
    periods = Periods.of(sampling, grid.parts, bounds, None, one.constant)
    stretches = stretches_of(periods, one)
    if not within or stretches is None:
        return periods
    cells = first_cells(periods, stretches, one)
    z = periods.rows(cells)
    P, S = regressed(rooted(z, np.ones(len(z))), one.n, float(len(z)))
    return replace(periods, pooled=Pooled(P, S, cells, sampling, one.constant))


def _one_plant(recording: Recording, grid: Recording, one: Layout, bounds: Window) -> Pooled:
    """The plant of one mode that uneven rows are likeliest of."""
    start = start_of(grid, one, bounds, within=False)
    A, _, _ = one.split(start.theta)
    log = ExactLog(recording, one, False, bounds, nodes_for(recording.parts, A))
    best, window = maximise(log, start.theta)
    (term,) = log.terms_in(*window)(log.cells(best.theta))(best.theta)
    (S,), (reads,) = concentrated([term], one.size)[1], one.split(best.theta)[2]
    return Pooled(term.P, S, reads, log.sampling, one.constant)


def refined(fit: HiddenFit[HiddenLog]) -> HiddenFit[HiddenLog]:
    """With exact states, over all periods that are usable for delays near those found."""
    near = fit.log.over(*window_of(fit.log, fit.theta[fit.layout.at_delays]))
    ascent = ascended(near, fit.theta, fit.layout.least_periods)
    return fit if ascent is None else _fit_at(ascent, fit.bic, fit.begun, fit.grid)


def require_periods(periods: Periods, layout: Layout) -> None:
    """Refuse more modes than the log has periods for."""
    least = layout.least_periods * layout.modes
    if periods.count < least or stretches_of(periods, layout) is None:
        many = f"modes = {layout.modes} is too many for this log"
        said = many if layout.modes > 1 else "log is too short"
        raise ArgumentError(
            f"{said}: {periods.count} periods in it have inputs and ends that are known, and "
            f"{layout.modes} of {number_of(layout.n, 'state')} and {number_of(layout.m, 'input')} "
            f"need at least {least}, in unbroken runs: log for longer, ask for fewer, or narrow "
            "delay=(low, high)."
        )


def begun(search: HiddenSearch, layout: Layout, common: bool = False, seed: int = 0) -> list[Begun]:
    """Where the best starts lead, the likeliest first; `common`: with one covariance of all modes.

    Raises
    ------
    ArgumentError
        If the log is too short for so many modes, or each start leaves one with next to no period.
    """
    require_periods(search.even, layout)
    rng, each = np.random.default_rng(seed), []
    found, agreed, starts = _best_regressions(search.even, layout, rng, common)
    for model, begin in found:
        theta = plant_of(
            list(model.P), model.cells, model.weight, layout, search.grid.step, search.bounds
        )
        nodes = nodes_for(search.recording.parts, layout.split(theta)[0])
        given = search.grid, layout, search.even.within, search.bounds, nodes, search.even
        log = HiddenLog(*given, model.S, model.jumps)
        each.append(Begun(log, theta, begin, agreed, starts))
    if not each:
        raise _too_many(layout, starts)
    return each


def fitted(search: HiddenSearch, layout: Layout) -> HiddenFit[HiddenLog]:
    """The likeliest plant of as many modes as the layout has.

    Raises
    ------
    ArgumentError
        As of `begun`, or if a mode is left with next to no period on the way up.
    """
    each = begun(search, layout)
    for one in each:
        found = _led(search, one, one.found)
        if found is not None:
            return min(found, _at_zero(search, found) or found, key=lambda fit: fit.bic)
    raise _too_many(layout, each[0].starts)


def _led(
    search: HiddenSearch, begin: Begun, found: Posterior | None
) -> HiddenFit[HiddenLog] | None:
    """The maximum that a beginning leads to; None where a mode is left with next to no period."""
    layout = begin.log.layout
    ascent = ascended(begin.log, begin.theta, layout.least_periods, found)
    if ascent is None:
        return None
    grid = ascent.log
    if not search.recording.even and (ascent := _off_the_grid(search, ascent)) is None:
        return None
    of_noise = layout.modes * (layout.n * (layout.n + 1) // 2)
    bic = bic_of(search, layout, of_noise, ascent.found.value)
    return _fit_at(ascent, bic, begin, grid)


def _fit_at(ascent: Ascent, bic: float, begin: Begun, grid: HiddenLog) -> HiddenFit[HiddenLog]:
    log, theta = ascent.log, ascent.theta
    cells = log.cells(theta)
    return HiddenFit(log, theta, cells, log.window, ascent.values, bic, begin, grid, theta)


def bic_of(search: HiddenSearch, layout: Layout, of_noise: int, value: float) -> float:
    """BIC of a plant, of so many unknowns of its noise, and a chain."""
    unknowns = layout.size + of_noise + layout.modes * (layout.modes - 1)
    return unknowns * float(np.log(search.periods.count)) - 2.0 * value


def _at_zero(search: HiddenSearch, fit: HiddenFit[HiddenLog]) -> HiddenFit[HiddenLog] | None:
    """The maximum near a fit without its constant terms; None if it has none, or there is none."""
    plain = search.plain
    if plain is None:
        return None
    layout, kept = fit.layout.without_constant()
    log = replace(fit.grid, recording=plain.grid, layout=layout, periods=plain.even)
    return _led(plain, fit.begun._replace(log=log, theta=fit.theta[kept]), None)


def _too_many(layout: Layout, starts: int) -> ArgumentError:
    return ArgumentError(
        f"modes = {layout.modes} is too many for this log: from each of {starts} starts a mode is "
        f"left with less than the {layout.least_periods} periods that its matrices cost: ask for "
        "fewer, or log for longer."
    )


def _off_the_grid(search: HiddenSearch, ascent: Ascent) -> Ascent | None:
    """The maximum of uneven rows, from that of the recording on a grid."""
    grid, theta, periods = ascent.log, ascent.theta, search.periods
    nodes, weight = nodes_for(search.recording.parts, grid.layout.split(theta)[0]), []
    each = zip(periods.parts, periods.usable, search.grid.parts, ascent.found.node, strict=True)
    for part, k, even, node in each:
        middle = 0.5 * (part.time[k] + part.time[k + 1])
        weight.append(np.column_stack([np.interp(middle, even.time, own) for own in node.T]))
    step, counts = search.recording.step, ascent.found.counts
    counts = Counts(counts.jumps, counts.spent * step)
    jumps = Jumps.of(grid.jumps.matrix, step, rates=True)
    periods = replace(periods, sampling=sampling_of(search.recording, nodes))
    given = search.recording, grid.layout, periods.within, search.bounds, nodes, periods
    log = HiddenLog(*given, grid.S, jumps)
    begin = Posterior(ascent.found.value, np.vstack(weight), counts, ascent.found.node)
    return ascended(log, theta, grid.layout.least_periods, begin)


def _best_regressions(
    periods: Periods, layout: Layout, rng: np.random.Generator, common: bool
) -> tuple[list[tuple[Regressions, Posterior]], int, int]:
    """Those that the best starts lead to, the likeliest first; how many starts led there, of all.

    The first steps take modes to change at samples, with one covariance: no mode can vanish then
    in a few periods that it explains too well, nor in those that change it.
    """
    lengths = [stretches_of(periods, layout, short) for short in (False, True)]
    if lengths[0] is None:
        return [], 0, 0
    cells, short = first_cells(periods, lengths[0], layout), []
    starts, whole = 1 if layout.modes == 1 else _STARTS, replace(periods, pooled=None)
    for turn in range(starts):
        start = drawn_start(periods, lengths[turn % 2] or lengths[0], cells, layout, rng)
        if (one := climbed(whole, start, _SHORT, 1.0, True, 0.1)) is not None:
            short.append(one)
    short.sort(key=lambda one: -one[1].value)
    values = np.array([found.value for _, found in short])
    agreed = int((values > values.max(initial=-np.inf) - _ALIKE).sum())
    best = [one for row, one in enumerate(short) if row == 0 or row >= agreed][:_KEPT]
    own = whole if common else periods
    each = [_in_best_cells(own, model, layout, common) for model, _ in best]
    long = [one for one in each if one is not None]
    long.sort(key=lambda one: -one[1].value)
    return long, agreed, starts


def _in_best_cells(
    periods: Periods, model: Regressions, layout: Layout, common: bool
) -> tuple[Regressions, Posterior] | None:
    """Regressions in the cells that are likeliest then; with a covariance of each mode, or one."""
    least, tried = layout.least_periods, set()
    while True:
        tried.add(model.cells.tobytes())
        found = climbed(periods, model, _LONG, least, common, 1e-3)
        if found is None:
            return None
        model, posterior = found
        cells, _ = scanned(periods, posterior.weight, model.cells, layout)
        if cells.tobytes() in tried:
            return model, posterior
        rows = periods.rows_of_modes(cells)
        model = maximised(rows, posterior, model.jumps, cells, common)
