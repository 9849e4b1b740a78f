"""Fits of plants with a number of hidden modes, and Bayes' information criterion of that number.

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
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
from jaxtyping import Float

from deadtime.base.errors import ArgumentError
from deadtime.base.wording import number_of
from deadtime.identification.expectation_maximisation import (
    Ascent,
    Regressions,
    ascended,
    climbed,
    drawn_start,
    first_cells,
    maximised,
    regressed,
    scanned,
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
from deadtime.identification.likelihoods.hidden_log import HiddenLog, HiddenNoisyLog, Starts
from deadtime.identification.likelihoods.likelihood import (
    ExactLog,
    concentrated,
    maximise,
    rooted,
    window_of,
)
from deadtime.identification.log.recording import Recording
from deadtime.identification.noisy_estimate import first_noises
from deadtime.identification.parameters import Layout, SensorMatrix, Square, Vector, Window
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
    """A recording and its periods; and both on a grid, where searches begin.

    plain : the search without constant terms; None where 0 is far from the log
    """

    recording: Recording
    periods: Periods
    grid: Recording
    even: Periods
    bounds: Window
    plain: HiddenSearch | None


class Begun(NamedTuple):
    """A start of a climb: the plant nearest to regressions with hidden modes.

    log : of the recording on a grid; agreed : the number of `starts` that led to it
    found : the posterior of modes under the regressions
    """

    log: HiddenLog
    theta: Vector
    found: Posterior
    agreed: int
    starts: int


@dataclass(frozen=True, eq=False)
class HiddenFit(Generic[Log]):
    """The likeliest plant of a number of modes, and BIC.

    given : arguments of the likelihood: cells of delays, or samples at which the filter restarts
    window : of delays; values : log likelihood after every step
    grid, on_grid : the likelihood of exact states on a grid, and its unknowns
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
    P, S = regressed(rooted(z, np.ones(len(z))), one.n, float(len(z)))
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
    """The climbs' ends from the best starts, likeliest first; `common`: with one covariance.

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
    """The maximum near a start; None if a mode is left with too few periods."""
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
    """BIC of a plant with `of_noise` unknowns of its noise, and of a chain."""
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
    runs = stretches_of(periods, layout)
    if runs is None:
        return [], 0, 0
    brief = stretches_of(periods, layout, short=True)
    lengths = runs, runs if brief is None else brief
    cells, short = first_cells(periods, runs, layout), []
    starts, whole = 1 if layout.modes == 1 else _STARTS, replace(periods, pooled=None)
    for turn in range(starts):
        start = drawn_start(periods, lengths[turn % 2], cells, layout, rng)
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


_ENOUGH = 2_000  # samples that suffice to compare starts
_ROUNDS = 10  # of plant and chain, alternating
_CHAIN = 20  # steps of the chain in a round
_FAR = 10.0  # times BIC's threshold of constant terms: then they are certain
_SOON, _LATE = 0.3, 1e-3  # rise of log likelihood that ends a climb: at first, at the end


def fitted_with_noise(
    search: HiddenSearch, layout: Layout, recording: Recording, C: SensorMatrix
) -> HiddenFit[HiddenNoisyLog]:
    """The likeliest plant and noise of a recording of y = C x, of a number of modes.

    Raises
    ------
    ArgumentError
        If the log is too short for so many, or a mode is left with next to no row.
    """
    if search.plain is not None and not _seems_to_need_level(search, layout):
        plain = replace(layout, constant=False)
        return fitted_with_noise(search.plain, plain, recording.absolute(), C)
    found, best = _led_with_noise(search, *_best_start(search, layout, recording, C))
    if search.plain is None:
        return found
    return min(found, _noisy_at_zero(search.plain, found, best) or found, key=lambda fit: fit.bic)


def _seems_to_need_level(search: HiddenSearch, layout: Layout) -> bool:
    """Whether constant terms lower BIC of exact states; where these cannot tell, they might."""
    try:
        return fitted(search, layout).layout.constant
    except ArgumentError:
        return True


def _noisy_at_zero(
    search: HiddenSearch, fit: HiddenFit[HiddenNoisyLog], best: Maximum
) -> HiddenFit[HiddenNoisyLog] | None:
    """The maximum near a fit without its constant terms; None where these are far from chance."""
    given = best.theta, best.found.information, fit.log.recording, np.linalg.pinv(fit.log.C)
    far, terms = from_zero(fit.layout, *given)
    if far > _FAR * terms * np.log(search.periods.count):
        return None
    log, kept = at_zero(fit.log, best.theta.size)
    log = replace(log, errors=log.errors[kept], _kept={})
    with suppress(ArgumentError):
        return _led_with_noise(search, fit.begun, log, best.theta[kept], fit.window)[0]


def _led_with_noise(
    search: HiddenSearch, begin: Begun, log: HiddenNoisyLog, theta: Vector, window: Window
) -> tuple[HiddenFit[HiddenNoisyLog], Maximum]:
    """The maximum that a vector leads to.

    Raises
    ------
    ArgumentError
        If it leaves a mode with next to no row.
    """
    layout = log.layout
    log, best, values = _climbed(log, theta, window, _LATE)
    best, window = maximise(log, best.theta, gain=_LATE)
    if (rows := _least_rows(log, best.theta, window)) < layout.least_periods:
        raise ArgumentError(
            f"modes = {layout.modes} is too many for this log: with noise of the sensors a mode is "
            f"left with {rows:.0f} rows: ask for fewer, or log for longer."
        )
    # Of the same samples for all numbers, and all levels: nothing but P0 is known of the first.
    starts = log.starts(*search.bounds)
    value = float(log.filtered(best.theta, starts)[1][~np.concatenate(starts)].sum())
    bic = bic_of(search, layout, best.theta.size - layout.size, value)
    given = log, best.theta, log.starts(*window), window, values, bic
    return HiddenFit(*given, begin, begin.log, begin.theta), best


def _best_start(
    search: HiddenSearch, layout: Layout, recording: Recording, C: SensorMatrix
) -> tuple[Begun, HiddenNoisyLog, Vector, tuple[float, float]]:
    """The start that leads highest in coarse steps, of those that leave all modes rows, if any do.

    And its likelihood, its vector, and the window of its delays.
    """
    few, found = recording.stretches(_ENOUGH, recording.lag(search.bounds[1])), []
    for start in _starts(search, layout):
        log, W = _of_start(start, search, recording, C)
        window = window_of(start.log, start.theta[layout.at_delays])
        rough = replace(log, recording=few, within=False, _kept={})
        for noise in first_noises(W, C, recording.step):
            vector = rough.join(start.theta, noise)
            led, best, _ = _climbed(rough, vector, window, _SOON)
            whole = _least_rows(led, best.theta, window) >= layout.least_periods
            value = led.value(best.theta, led.starts(*search.bounds))
            own = replace(log, jumps=led.jumps)
            found.append(((whole, value), (start, own, best.theta, window)))
    return max(found, key=lambda one: one[0])[1]


def _starts(search: HiddenSearch, layout: Layout) -> list[Begun]:
    """Starts from regressions with one covariance of all modes, and with one of each.

    Sensor noise is the same in all modes, which favours one covariance; but where that hides a
    mode, separate ones may not.
    """
    found, errors = [], []
    for common in (True, False)[: layout.modes]:
        try:
            found += begun(search, layout, common)
        except ArgumentError as error:
            errors.append(error)
    if not found:
        raise errors[0]
    return found


def _of_start(
    start: Begun, search: HiddenSearch, recording: Recording, C: SensorMatrix
) -> tuple[HiddenNoisyLog, Square]:
    """The likelihood with a chain of long stays, and W with all noise attributed to the plant."""
    exact, theta, layout = start.log, start.theta, start.log.layout
    A, _, _ = layout.split(theta)
    share = start.found.weight.sum(axis=0)
    W = np.tensordot(share / share.sum(), continuous(A, exact.S, recording.step), axes=1)
    known = np.diagonal(exact.evaluate(theta, exact.cells(theta)).information)
    errors = np.concatenate((1.0 / np.sqrt(np.maximum(known, 1e-300)), _units(W), np.ones(len(C))))
    jumps = Jumps.lasting(layout.modes, recording.step, not recording.even)
    given = recording, layout, exact.within, search.bounds, exact.nodes, C
    return HiddenNoisyLog(*given, errors=errors, jumps=jumps), W


def _least_rows(log: HiddenNoisyLog, theta: Vector, window: Window) -> float:
    """How many rows the rarest mode is expected to have."""
    return float(np.vstack(log.posterior(theta, log.starts(*window)).node).sum(axis=0).min())


def _climbed(
    log: HiddenNoisyLog, theta: Vector, window: Window, gain: float
) -> tuple[HiddenNoisyLog, Maximum, Float[np.ndarray, " round"]]:
    """Rounds of the plant and of the chain until they gain little; log likelihood of each."""
    values, starts = [], log.starts(*window)
    while True:
        best, _ = maximise(log, theta, window=window, gain=gain)
        theta = best.theta
        values.append(best.found.value)
        if len(values) == _ROUNDS or (len(values) > 1 and values[-1] - values[-2] < 10.0 * gain):
            return log, best, np.array(values)
        log = _next_chain(log, theta, starts)


def _next_chain(log: HiddenNoisyLog, theta: np.ndarray, starts: Starts) -> HiddenNoisyLog:
    """A likelihood with the likeliest chain, the plant held."""
    before = -np.inf
    for _ in range(_CHAIN):
        found = log.posterior(theta, starts)
        if found.value - before < _LATE:
            break
        log, before = replace(log, jumps=log.jumps.next(found.counts)), found.value
    return log


def _units(W: Square) -> Float[np.ndarray, " entry"]:
    """Sizes of the entries of a triangle L, L Lᵀ = W; 1 for the logarithms of its diagonal."""
    i, j = np.tril_indices(len(W))
    return np.where(i == j, 1.0, np.sqrt(np.maximum(np.diagonal(W)[i], 1e-300)))
