"""How many modes: fits of several numbers, and Bayes' information criterion.

    BIC = −2 log L + q log N,    q unknowns: those of the plant, S of every mode, the chain's odds

N: the periods that are usable whatever the delays are; they are the same for all numbers.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from deadtime.base.errors import ArgumentError
from deadtime.identification.hidden.ascent import Ascent, ascended
from deadtime.identification.hidden.likelihood import HiddenLog
from deadtime.identification.hidden.periods import Periods, Pooled, Posterior
from deadtime.identification.hidden.regressions import (
    Regressions,
    climbed,
    maximised,
    regressed,
    rooted,
    rows_of_modes,
    scanned,
)
from deadtime.identification.hidden.starts import drawn_start, first_cells, stretches_of
from deadtime.identification.maximum import window_of
from deadtime.identification.parameters import Layout
from deadtime.identification.recording import Recording
from deadtime.identification.start import cell_range, plant_of
from deadtime.identification.uneven import nodes_for

_STARTS = 12
_SHORT = 12  # steps of each start, with one covariance for all modes
_LONG = 100  # steps of the best starts, and of those in other cells
_KEPT = 3
_ALIKE = 5.0  # of log likelihood: starts so close after a few steps lead to the same


class Fitted(NamedTuple):
    """The likeliest plant of a number of modes, BIC, and how many starts led there."""

    layout: Layout
    ascent: Ascent
    bic: float
    agreed: int
    starts: int


def periods_of(
    recording: Recording, layout: Layout, bounds: tuple[float, float], within: bool
) -> Periods:
    """The usable periods of a recording, with the density of one regression for all."""
    first, last = cell_range(recording.step, bounds, layout.m)
    periods = Periods.of(recording.parts, first, last, None)
    one = Layout(1, layout.n, layout.m, per_mode=False)
    stretches = stretches_of(periods, one)
    if not within or stretches is None:
        return periods
    cells = first_cells(periods, stretches, one)
    z = periods.rows(cells)
    pooled = Pooled(*regressed(rooted(z, np.ones(len(z))), layout.n, float(len(z))), cells)
    return replace(periods, pooled=pooled)


def refined(fit: Fitted) -> Fitted:
    """The same over all periods that are usable for delays near those found: a window of them."""
    log, theta = fit.ascent.log, fit.ascent.theta
    near = log.over(*window_of(log, theta[log.layout.at_delays]))
    ascent = ascended(near, theta, fit.layout.least_periods)
    return fit if ascent is None else fit._replace(ascent=ascent)


def require_periods(periods: Periods, layout: Layout) -> None:
    """Refuse more modes than the log has periods for."""
    least = layout.least_periods * layout.modes
    if periods.count < least or stretches_of(periods, layout) is None:
        many = f"modes = {layout.modes} is too many for this log"
        said = many if layout.modes > 1 else "log is too short"
        raise ArgumentError(
            f"{said}: {periods.count} periods in it have inputs and ends that are known, and "
            f"{layout.modes} of {layout.n} states and "
            f"{layout.m} inputs need at least {least}, in unbroken runs: log for longer, ask for "
            "fewer, or narrow delay=(low, high)."
        )


def fitted(
    recording: Recording,
    periods: Periods,
    layout: Layout,
    bounds: tuple[float, float],
    seed: int = 0,
) -> Fitted:
    """The likeliest plant of as many modes as the layout has; `bounds` of its delays, seconds.

    Raises
    ------
    ArgumentError
        If the log is too short for so many, or each start leaves a mode with next to no period.
    """
    require_periods(periods, layout)
    found, agreed, starts = _best_regressions(periods, layout, np.random.default_rng(seed))
    for model, begin in found:
        theta = plant_of(list(model.P), model.cells, model.weight, layout, recording.step, bounds)
        nodes = nodes_for(recording.parts, layout.split(theta)[0])
        log = HiddenLog(recording, layout, bounds, nodes, periods, model.S, model.chain)
        ascent = ascended(log, theta, layout.least_periods, begin)
        if ascent is not None:
            unknowns = layout.size + layout.modes * (layout.n * (layout.n + 1) // 2)
            unknowns += layout.modes * (layout.modes - 1)
            bic = unknowns * float(np.log(periods.count)) - 2.0 * ascent.found.value
            return Fitted(layout, ascent, bic, agreed, starts)
    raise ArgumentError(
        f"modes = {layout.modes} is too many for this log: from each of {starts} starts a mode is "
        f"left with less than the {layout.least_periods} periods that its matrices cost: ask for "
        "fewer, or log for longer."
    )


def _best_regressions(
    periods: Periods, layout: Layout, rng: np.random.Generator
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
    long = [one for model, _ in best if (one := _in_best_cells(periods, model, layout)) is not None]
    long.sort(key=lambda one: -one[1].value)
    return long, agreed, starts


def _in_best_cells(
    periods: Periods, model: Regressions, layout: Layout
) -> tuple[Regressions, Posterior] | None:
    """Regressions with a covariance of each mode, in the cells that are likeliest then."""
    least, tried = layout.least_periods, set()
    while True:
        tried.add(model.cells.tobytes())
        found = climbed(periods, model, _LONG, least, False, 1e-3)
        if found is None:
            return None
        model, posterior = found
        cells, _ = scanned(periods, posterior.weight, model.cells, layout)
        if cells.tobytes() in tried:
            return model, posterior
        model = maximised(rows_of_modes(periods, cells), posterior, cells, common=False)
