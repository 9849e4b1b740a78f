"""Maximum-likelihood plants with a number of hidden modes, and the BIC of that number.

    BIC = −2 log L + q log N,    q unknowns: those of the plant, S of every mode, the chain's odds

N: the periods that are usable for all delays in the range; they are the same for all numbers.

With noisy sensors a fit starts at each of the regressions found without noise, with two guesses of
the sensors' share of the noise. The start that leads highest in coarse steps, with modes that
change at samples, goes on. Steps over plant and noise with the chain fixed alternate with steps of
the chain to its expected jumps.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Generic, NamedTuple, TypeVar

import numpy as np
from jaxtyping import Float

from deadtime.base.errors import ArgumentError
from deadtime.base.wording import number_of
from deadtime.identification.expectation_maximisation import (
    Ascent,
    Regressions,
    climb_regressions,
    draw_start,
    first_cells,
    maximisation_step,
    maximise_plant,
    regression_of,
    scan_cells,
    stretches_of,
)
from deadtime.identification.levels import at_zero, from_zero, near_zero
from deadtime.identification.likelihoods.hidden_chain import (
    Counts,
    Jumps,
    Periods,
    Pooled,
    Posterior,
)
from deadtime.identification.likelihoods.hidden_log import HiddenLog, HiddenNoisyLog
from deadtime.identification.likelihoods.likelihood import (
    ExactLog,
    concentrated,
    maximise,
    rooted,
    window_of,
)
from deadtime.identification.likelihoods.noisy_log import NoiseLevels
from deadtime.identification.log.recording import Recording
from deadtime.identification.noisy_estimate import first_noises
from deadtime.identification.parameters import Layout, SensorMatrix, Vector, Window
from deadtime.identification.sampling import nodes_for, sampling_of
from deadtime.identification.scoring import Maximum
from deadtime.identification.start import cell_range, plant_of, start_of
from deadtime.identification.transition import continuous

Log = TypeVar("Log", HiddenLog, HiddenNoisyLog)

_STARTS = 12
_SHORT = 12  # steps of each start, with one covariance for all modes
_LONG = 100  # steps of the best starts, and of those in other cells
_KEPT = 3
_ALIKE = 5.0  # starts with log likelihoods so close after a few steps lead to the same maximum


class HiddenSearch(NamedTuple):
    """A recording and its periods; and both on a grid, on which searches start.

    plain : the search without constant terms; None where 0 is far from the log
    """

    recording: Recording
    periods: Periods
    grid: Recording
    grid_periods: Periods
    bounds: Window
    plain: HiddenSearch | None


class FitStart(NamedTuple):
    """A plant that fits a recording on a grid with hidden modes, from which a climb starts.

    log : the likelihood of exact states on the grid; posterior : of modes under the regressions
    agreed : the number of `draws` of random stretches that led to the likeliest
    """

    log: HiddenLog
    theta: Vector
    posterior: Posterior
    agreed: int
    draws: int


@dataclass(frozen=True, eq=False, kw_only=True)
class HiddenFit(Generic[Log]):
    """The likeliest plant of a number of modes.

    window : of delays; values : log likelihood after every step
    start : the likelihood on the grid, and the unknowns with which `_delay_scan` weights it: those
    of the fit with exact states, of the start with noisy sensors
    """

    log: Log
    theta: Vector
    window: Window
    values: Float[np.ndarray, " step"]
    bic: float
    start: FitStart

    @property
    def layout(self) -> Layout:
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
    """The usable periods of even rows, with one regression for all modes."""
    cell_range(grid.step, bounds, one.m)  # refuses more cells than a scan has room for
    sampling = sampling_of(grid, np.zeros(0))
    periods = Periods.of(sampling, grid.parts, bounds, None, one.constant)
    stretches = stretches_of(periods, one)
    if not within or stretches is None:
        return periods
    cells = first_cells(periods, stretches, one)
    z = periods.rows(cells)
    P, S = regression_of(rooted(z, np.ones(len(z))), one.n, float(len(z)))
    return replace(periods, pooled=Pooled(P, S, cells, sampling, one.constant))


def _one_plant(recording: Recording, grid: Recording, one: Layout, bounds: Window) -> Pooled:
    """The likeliest plant of one mode of uneven rows."""
    start = start_of(grid, one, bounds, within=False)
    A, _, _ = one.split(start.theta)
    log = ExactLog(recording, one, False, bounds, nodes_for(recording.parts, A))
    best, window = maximise(log, start.theta)
    (term,) = log.terms_in(*window)(log.cells(best.theta))(best.theta)
    (S,), (reads,) = concentrated([term], one.size)[1], one.split(best.theta)[2]
    return Pooled(term.P, S, reads, log.sampling, one.constant)


def refine(fit: HiddenFit[HiddenLog]) -> HiddenFit[HiddenLog]:
    """The fit to exact states over all periods that are usable for delays near those found."""
    near = fit.log.over(*window_of(fit.log, fit.theta[fit.layout.at_delays]))
    ascent = maximise_plant(near, fit.theta, fit.layout.least_periods)
    return fit if ascent is None else _fit_at(ascent, fit.bic, fit.start)


def _require_periods(periods: Periods, layout: Layout) -> None:
    """Refuse more modes than the log has periods for."""
    least = layout.least_periods * layout.modes
    if periods.count < least or stretches_of(periods, layout) is None:
        many = f"modes = {layout.modes} is too many for this log"
        cause = many if layout.modes > 1 else "log is too short"
        raise ArgumentError(
            f"{cause}: {periods.count} periods in it have inputs and ends that are known, and "
            f"{layout.modes} of {number_of(layout.n, 'state')} and {number_of(layout.m, 'input')} "
            f"need at least {least}, in unbroken runs: log for longer, ask for fewer, or narrow "
            "delay=(low, high)."
        )


def _too_many(layout: Layout, draws: int) -> ArgumentError:
    return ArgumentError(
        f"modes = {layout.modes} is too many for this log: from each of {draws} starts a mode is "
        f"left with less than the {layout.least_periods} periods that its matrices cost: ask for "
        "fewer, or log for longer."
    )


def fit_starts(search: HiddenSearch, layout: Layout, common: bool = False) -> list[FitStart]:
    """The plants nearest to the likeliest regressions, likeliest first.

    Refused if the log is too short for so many modes, or each draw leaves one with next to no
    period. common : whether all modes have one covariance
    """
    _require_periods(search.grid_periods, layout)
    regressions, agreed, draws = _best_regressions(search.grid_periods, layout, common)
    starts = []
    for model, posterior in regressions:
        theta = plant_of(
            list(model.P),
            model.cells,
            model.weight,
            layout,
            search.grid.step,
            search.bounds,
            search.grid.hold,
        )
        nodes = nodes_for(search.recording.parts, layout.split(theta)[0])
        within, periods = search.grid_periods.within, search.grid_periods
        given = search.grid, layout, within, search.bounds, nodes, periods
        log = HiddenLog(*given, model.S, model.jumps)
        starts.append(FitStart(log, theta, posterior, agreed, draws))
    if not starts:
        raise _too_many(layout, draws)
    return starts


def _best_regressions(
    periods: Periods, layout: Layout, common: bool
) -> tuple[list[tuple[Regressions, Posterior]], int, int]:
    """Regressions from the best draws, likeliest first; how many draws led to the first, of all.

    The first steps take modes to change at samples, with one covariance: no mode can vanish then
    in a few periods that it explains too well, nor in those that change it.
    """
    rng, runs = np.random.default_rng(0), stretches_of(periods, layout)
    assert runs is not None
    brief = stretches_of(periods, layout, short=True)
    lengths = runs, runs if brief is None else brief
    cells, short = first_cells(periods, runs, layout), []
    draws, whole = 1 if layout.modes == 1 else _STARTS, replace(periods, pooled=None)
    for turn in range(draws):
        start = draw_start(periods, lengths[turn % 2], cells, layout, rng)
        if (one := climb_regressions(whole, start, _SHORT, 1.0, True, 0.1)) is not None:
            short.append(one)
    short.sort(key=lambda one: -one[1].value)
    values = np.array([posterior.value for _, posterior in short])
    agreed = int((values > values.max(initial=-np.inf) - _ALIKE).sum())
    best = [one for row, one in enumerate(short) if row == 0 or row >= agreed][:_KEPT]
    own = whole if common else periods
    each = [_in_best_cells(own, model, layout, common) for model, _ in best]
    long = [one for one in each if one is not None]
    long.sort(key=lambda one: -one[1].value)
    return long, agreed, draws


def _in_best_cells(
    periods: Periods, model: Regressions, layout: Layout, common: bool
) -> tuple[Regressions, Posterior] | None:
    """Regressions in the cells that are likeliest then; with a covariance of each mode, or one."""
    least, tried = layout.least_periods, set()
    while True:
        tried.add(model.cells.tobytes())
        climb = climb_regressions(periods, model, _LONG, least, common, 1e-3)
        if climb is None:
            return None
        model, posterior = climb
        cells, _ = scan_cells(periods, posterior.weight, model.cells, layout)
        if cells.tobytes() in tried:
            return model, posterior
        rows = periods.rows_of_modes(cells)
        model = maximisation_step(rows, posterior, model, cells, common)


def fit_hidden(search: HiddenSearch, layout: Layout) -> HiddenFit[HiddenLog]:
    """The likeliest plant of as many modes as the layout has, from exact states.

    Refused as by `fit_starts`, or if a mode is left with next to no period on the way up.
    """
    starts = fit_starts(search, layout)
    for start in starts:
        fit = _fit_from(search, start, start.posterior)
        if fit is not None:
            return min(fit, _fit_at_zero(search, fit) or fit, key=lambda one: one.bic)
    raise _too_many(layout, starts[0].draws)


def _fit_from(
    search: HiddenSearch, start: FitStart, posterior: Posterior | None
) -> HiddenFit[HiddenLog] | None:
    """The maximum near a start; None if a mode is left with too few periods."""
    layout = start.log.layout
    ascent = maximise_plant(start.log, start.theta, layout.least_periods, posterior)
    if ascent is None:
        return None
    start = start._replace(log=ascent.log)
    if not search.recording.even and (ascent := _off_the_grid(search, ascent)) is None:
        return None
    of_noise = layout.modes * (layout.n * (layout.n + 1) // 2)
    return _fit_at(ascent, _bic(search, layout, of_noise, ascent.posterior.value), start)


def _fit_at(ascent: Ascent, bic: float, start: FitStart) -> HiddenFit[HiddenLog]:
    return HiddenFit(
        log=ascent.log,
        theta=ascent.theta,
        window=ascent.log.window,
        values=ascent.values,
        bic=bic,
        start=start._replace(theta=ascent.theta),
    )


def _bic(search: HiddenSearch, layout: Layout, of_noise: int, value: float) -> float:
    """BIC of a plant with `of_noise` unknowns of its noise, and of a chain."""
    unknowns = layout.size + of_noise + layout.modes * (layout.modes - 1)
    return unknowns * float(np.log(search.periods.count)) - 2.0 * value


def _fit_at_zero(search: HiddenSearch, fit: HiddenFit[HiddenLog]) -> HiddenFit[HiddenLog] | None:
    """The maximum near a fit without its constant terms; None if it has none, or there is none."""
    plain = search.plain
    if plain is None:
        return None
    layout, kept = fit.layout.without_constant()
    log = replace(fit.start.log, recording=plain.grid, layout=layout, periods=plain.grid_periods)
    return _fit_from(plain, fit.start._replace(log=log, theta=fit.theta[kept]), None)


def _off_the_grid(search: HiddenSearch, ascent: Ascent) -> Ascent | None:
    """The maximum of uneven rows, from that of the recording on a grid."""
    grid, theta, periods, posterior = ascent.log, ascent.theta, search.periods, ascent.posterior
    nodes, weight = nodes_for(search.recording.parts, grid.layout.split(theta)[0]), []
    each = zip(periods.parts, periods.usable, search.grid.parts, posterior.node, strict=True)
    for part, k, even, node in each:
        middle = 0.5 * (part.time[k] + part.time[k + 1])
        weight.append(np.column_stack([np.interp(middle, even.time, own) for own in node.T]))
    step, counts = search.recording.step, posterior.counts
    counts = Counts(counts.jumps, counts.spent * step)
    jumps = Jumps.of(grid.jumps.matrix, step, rates=True)
    periods = replace(periods, sampling=sampling_of(search.recording, nodes))
    given = search.recording, grid.layout, periods.within, search.bounds, nodes, periods
    log = HiddenLog(*given, grid.S, jumps)
    posterior = posterior._replace(weight=np.vstack(weight), counts=counts)
    return maximise_plant(log, theta, grid.layout.least_periods, posterior)


_ENOUGH = 2_000  # samples that suffice to compare starts
_ROUNDS = 10  # of plant and chain, alternating
_CHAIN = 20  # steps of the chain in a round
_FAR = 10.0  # times BIC's threshold of constant terms: then they are certain
_SOON, _LATE = 0.3, 1e-3  # rise of log likelihood that ends a climb: at first, at the end


class NoisyStart(NamedTuple):
    """A start of a climb with noisy sensors: a vector, its likelihood, the window of its delays."""

    start: FitStart
    log: HiddenNoisyLog
    vector: Vector
    window: Window


def fit_hidden_noisy(
    search: HiddenSearch, layout: Layout, recording: Recording, C: SensorMatrix
) -> HiddenFit[HiddenNoisyLog]:
    """The likeliest plant and noise of a recording of y = C x, of a number of modes.

    Refused if the log is too short for so many, or a mode is left with next to no row.
    """
    if search.plain is not None and not _seems_to_need_level(search, layout):
        plain = replace(layout, constant=False)
        return fit_hidden_noisy(search.plain, plain, recording.absolute(), C)
    fit, best = _noisy_fit_from(search, _best_start(search, layout, recording, C))
    if search.plain is None:
        return fit
    return min(fit, _noisy_at_zero(search.plain, fit, best) or fit, key=lambda one: one.bic)


def _seems_to_need_level(search: HiddenSearch, layout: Layout) -> bool:
    """Whether constant terms lower BIC of exact states; yes if those cannot be fitted."""
    try:
        return fit_hidden(search, layout).layout.constant
    except ArgumentError:
        return True


def _noisy_at_zero(
    search: HiddenSearch, fit: HiddenFit[HiddenNoisyLog], best: Maximum
) -> HiddenFit[HiddenNoisyLog] | None:
    """The maximum near a fit without its constant terms; None where these are far from chance."""
    given = best.theta, best.information, fit.log.recording, np.linalg.pinv(fit.log.C)
    far, terms = from_zero(fit.layout, *given)
    if far > _FAR * terms * np.log(search.periods.count):
        return None
    log, kept = at_zero(fit.log, best.theta.size)
    log = replace(log, errors=log.errors[kept], _kept={})
    with suppress(ArgumentError):
        start = NoisyStart(fit.start, log, best.theta[kept], fit.window)
        return _noisy_fit_from(search, start)[0]


def _noisy_fit_from(
    search: HiddenSearch, start: NoisyStart
) -> tuple[HiddenFit[HiddenNoisyLog], Maximum]:
    """The maximum that a start leads to, refused if it leaves a mode with next to no row."""
    log, best, values = _climb_in_rounds(start.log, start.vector, start.window, _LATE)
    best, window = maximise(log, best.theta, gain=_LATE)
    layout = log.layout
    if (rows := _least_rows(log, best.theta, window)) < layout.least_periods:
        raise ArgumentError(
            f"modes = {layout.modes} is too many for this log: with noise of the sensors a mode is "
            f"left with {rows:.0f} rows: ask for fewer, or log for longer."
        )
    # BIC compares fits over the same samples: those at which no filter starts, for any delay
    # searched.
    starts = log.starts(*search.bounds)
    value = float(log.filtered(best.theta, starts)[1][~np.concatenate(starts)].sum())
    fit = HiddenFit(
        log=log,
        theta=best.theta,
        window=window,
        values=values,
        bic=_bic(search, layout, best.theta.size - layout.size, value),
        start=start.start,
    )
    return fit, best


def _best_start(
    search: HiddenSearch, layout: Layout, recording: Recording, C: SensorMatrix
) -> NoisyStart:
    """The start with the highest coarse climb, preferably one that leaves rows to all modes."""
    few, tried = recording.stretches(_ENOUGH, recording.lag(search.bounds[1])), []
    for start in _exact_starts(search, layout):
        log, noises = _noisy_log(start, search, recording, C)
        window = window_of(start.log, start.theta[layout.at_delays])
        rough = replace(log, recording=few, within=False, _kept={})
        for noise in noises:
            vector = rough.join(start.theta, noise)
            coarse, best, _ = _climb_in_rounds(rough, vector, window, _SOON)
            whole = _least_rows(coarse, best.theta, window) >= layout.least_periods
            value = coarse.value(best.theta, coarse.starts(*search.bounds))
            own = replace(log, jumps=coarse.jumps)
            tried.append(((whole, value), NoisyStart(start, own, best.theta, window)))
    return max(tried, key=lambda one: one[0])[1]


def _exact_starts(search: HiddenSearch, layout: Layout) -> list[FitStart]:
    """Starts from regressions with one covariance of all modes, and with one of each.

    Sensor noise is the same in all modes, which favours one covariance; but where that hides a
    mode, separate ones may not.
    """
    starts, errors = [], []
    for common in (True, False)[: layout.modes]:
        try:
            starts += fit_starts(search, layout, common)
        except ArgumentError as error:
            errors.append(error)
    if not starts:
        raise errors[0]
    return starts


def _noisy_log(
    start: FitStart, search: HiddenSearch, recording: Recording, C: SensorMatrix
) -> tuple[HiddenNoisyLog, list[NoiseLevels]]:
    """The likelihood with a chain of long stays, and guesses of the noise."""
    exact, theta, layout = start.log, start.theta, start.log.layout
    A, _, _ = layout.split(theta)
    share = start.posterior.weight.sum(axis=0)
    W = np.tensordot(share / share.sum(), continuous(A, exact.S, recording.step), axes=1)
    known = np.diagonal(exact.evaluate(theta, exact.cells(theta)).information)
    i, j = np.tril_indices(layout.n)
    # The diagonal of L is known by its logarithm.
    of_L = np.where(i == j, 1.0, np.sqrt(np.maximum(np.diagonal(W)[i], 1e-300)))
    errors = np.concatenate((1.0 / np.sqrt(np.maximum(known, 1e-300)), of_L, np.ones(len(C))))
    jumps = Jumps.lasting(layout.modes, recording.step, not recording.even)
    given = recording, layout, exact.within, search.bounds, exact.nodes, C
    log = HiddenNoisyLog(*given, errors=errors, jumps=jumps)
    return log, first_noises(W, C, recording.step)


def _least_rows(log: HiddenNoisyLog, theta: Vector, window: Window) -> float:
    """The expected number of rows of the rarest mode."""
    return float(np.vstack(log.posterior(theta, log.starts(*window)).node).sum(axis=0).min())


def _climb_in_rounds(
    log: HiddenNoisyLog, theta: Vector, window: Window, gain: float
) -> tuple[HiddenNoisyLog, Maximum, Float[np.ndarray, " round"]]:
    """Rounds of the plant and of the chain until they gain little; log likelihood of each."""
    values, starts = [], log.starts(*window)
    while True:
        best, _ = maximise(log, theta, window=window, gain=gain)
        theta = best.theta
        values.append(best.value)
        if len(values) == _ROUNDS or (len(values) > 1 and values[-1] - values[-2] < 10.0 * gain):
            return log, best, np.array(values)
        before = -np.inf
        for _ in range(_CHAIN):  # the likeliest chain, with the plant fixed
            posterior = log.posterior(theta, starts)
            if posterior.value - before < _LATE:
                break
            log = replace(log, jumps=log.jumps.next(posterior.counts))
            before = posterior.value
