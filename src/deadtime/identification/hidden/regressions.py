"""Expectation–maximisation over linear regressions: a cell for each delay, and no plant yet.

With the cell N of every delay given, each mode is a regression x_{k+1} = P_i r_k + e, of which the
maximum with weights is known; P and S are free, and so is the chain. Cells are found by scan.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from deadtime.identification.likelihoods.jumps import Jumps
from deadtime.identification.likelihoods.mode_periods import EvenPeriods, Posterior
from deadtime.identification.parameters import Layout
from deadtime.identification.regression import floored, log_density, rooted

_SWEEPS = 3  # over the delays, in a scan


class Regressions(NamedTuple):
    """One regression per mode, P (modes, n, r) and S (modes, n, n), and the chain between them.

    cells : (modes, m); weight : (modes,), periods that each mode is expected to have
    """

    P: Float[np.ndarray, "mode n r"]
    S: Float[np.ndarray, "mode n n"]
    jumps: Jumps
    cells: Int[np.ndarray, "mode m"]
    weight: Float[np.ndarray, " mode"]


def regressed(
    root: Float[np.ndarray, "z z"], n: int, total: float
) -> tuple[Float[np.ndarray, "n r"], Float[np.ndarray, "n n"]]:
    """P and the residuals' covariance of weighted rows (x_{k+1}, r_k), of weight `total`."""
    y, r = root[:, :n], root[:, n:]
    unit = np.maximum(np.sqrt((r**2).sum(axis=0)), 1e-300)
    P = np.linalg.lstsq(r / unit, y, rcond=1e-13)[0].T / unit
    e = y - r @ P.T
    return P, floored(e.T @ e / total, P[:, : y.shape[1]], y, total)


def expected(periods: EvenPeriods, model: Regressions, rows: list[np.ndarray]) -> Posterior:
    """What the log says of the modes under regressions."""
    each = zip(rows, model.P, model.S, strict=True)
    return periods.posterior(
        np.column_stack([log_density(z, *one) for z, *one in each]), model.jumps
    )


def maximised(
    rows: list[np.ndarray],
    found: Posterior,
    jumps: Jumps,
    cells: Int[np.ndarray, "mode m"],
    common: bool,
) -> Regressions:
    """The likeliest regressions given how likely each mode was; `common`: of one S for all."""
    count = found.weight.sum(axis=0)
    P, S = [], []
    for z, weight, total in zip(rows, found.weight.T, count, strict=True):
        n = (z.shape[1] - 2 * cells.shape[1]) // 2  # of an odd number one column is the constant's
        one = regressed(rooted(z, weight), n, max(float(total), 1e-300))
        P.append(one[0])
        S.append(one[1])
    S = np.array(S)
    if common:
        S[:] = np.tensordot(count / count.sum(), S, axes=1)
    return Regressions(np.array(P), S, jumps.next(found.counts), cells, count)


def climbed(
    periods: EvenPeriods, model: Regressions, steps: int, least: float, common: bool, gain: float
) -> tuple[Regressions, Posterior] | None:
    """The regressions after some steps; None where a mode has less periods than `least`."""
    rows, before = periods.rows_of_modes(model.cells), -np.inf
    found = expected(periods, model, rows)
    for _ in range(steps):
        if found.weight.sum(axis=0).min() < least:
            return None
        model = maximised(rows, found, model.jumps, model.cells, common)
        found = expected(periods, model, rows)
        if found.value - before < gain:
            break
        before = found.value
    return model, found


def scanned(
    periods: EvenPeriods,
    weight: Float[np.ndarray, "period mode"],
    cells: Int[np.ndarray, "mode m"],
    layout: Layout,
) -> tuple[Int[np.ndarray, "mode m"], Float[np.ndarray, "delay cell"]]:
    """The likeliest cells, the modes being as likely as they are, and what others would be like.

    One delay after the other, the others in their cells.
    """
    options, count = np.arange(periods.first, periods.last + 1), weight.sum(axis=0)
    groups = [[i] for i in range(layout.modes)] if layout.per_mode else [list(range(layout.modes))]
    cells = cells.copy()

    def likelihood(i: int, own: np.ndarray) -> float:
        root = rooted(periods.rows(own), weight[:, i])
        _, S = regressed(root, layout.n, float(count[i]))
        return -0.5 * float(count[i]) * float(np.linalg.slogdet(S)[1])

    curves = np.empty((len(groups), layout.m, options.size))
    for _ in range(_SWEEPS):
        before = cells.copy()
        for row, group in enumerate(groups):
            for j in range(layout.m):
                for place, option in enumerate(options):
                    own = cells[group[0]].copy()
                    own[j] = option
                    curves[row, j, place] = sum(likelihood(i, own) for i in group)
                cells[group, j] = options[int(curves[row, j].argmax())]
        if (cells == before).all():
            break
    return cells, curves.reshape(-1, options.size)
