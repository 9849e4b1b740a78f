"""A sweep's scenarios reduced to what is drawn, cell by cell, in one pass over the store.

Arrays that are lazy are read chunk by chunk: what is held at a time is a chunk for each thread,
however large the store is. A run that diverged counts as the worst there can be; a law with a NaN
in a cell has no figure there.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from deadtime.reports.figures.sweeps.selection import NOT_RUN, RATES, RUNS, axes_of, laws_of
from deadtime.scenarios.paired_statistics import mean_interval, quotient, winners_of

if TYPE_CHECKING:
    import xarray as xr

LEVELS = (0.05, 0.25, 0.5, 0.75, 0.95)

Runs = Float[np.ndarray, "*cell law scenario"]


def score_of(data: xr.Dataset, metric: str) -> xr.DataArray:
    """A metric over (axes…, law, scenario): ±∞ where the run diverged, NaN where there is none."""
    worst = -np.inf if metric in RATES else np.inf
    score = data[metric].where(data["diverged"] != 1, worst)
    if "done" in data:
        score = score.where(data["done"] == 1)
    score = score.transpose(..., *RUNS)
    return score if score.chunks is None else score.chunk(dict.fromkeys(RUNS, -1))


def reduce(
    data: xr.Dataset, metric: str, rivals: Sequence[str] = (), oracle: str = ""
) -> xr.Dataset:
    """Quantiles of a metric, and where asked for the best of some laws, and regret.

    `data` are from `select`, `rivals` the laws to choose the best of, `oracle` the law that regret
    is held against.

    Returns
    -------
    xarray.Dataset
        In memory, over the axes: quantile (law, level); regret (law), the geometric mean of the
        metric over the oracle's; winner, an index into `rivals`, with ratio and verdict as in
        `winners_of`; not_run, where the cell is not done.
    """
    import xarray as xr

    score, laws = score_of(data, metric), laws_of(data)
    parts = xr.apply_ufunc(
        partial(
            _of_cells,
            rivals=[laws.index(law) for law in rivals],
            oracle=laws.index(oracle) if oracle else -1,
        ),
        score,
        input_core_dims=[RUNS],
        output_core_dims=[("law", "level"), ("law",), ("part",)],
        dask="parallelized",
        output_dtypes=[float] * 3,
        dask_gufunc_kwargs={"output_sizes": {"level": len(LEVELS), "part": 3}},
    )
    reduced = xr.Dataset(dict(zip(("quantile", "regret", "best"), parts, strict=True))).compute()
    reduced = reduced.assign_coords(level=list(LEVELS), law=laws)
    winner, ratio, verdict = (reduced["best"].isel(part=part, drop=True) for part in range(3))
    reduced = reduced.drop_vars("best").assign(
        winner=winner.fillna(-1.0).astype(int), ratio=ratio, verdict=verdict
    )
    every = xr.ones_like(winner, dtype=bool)
    done = (data["done"] == 1).compute() if "done" in data else every
    reduced[NOT_RUN] = (~done).transpose(*axes_of(data))
    reduced.attrs = dict(data.attrs)
    reduced["quantile"].attrs = dict(data[metric].attrs)
    for name in axes_of(data):
        reduced[name].attrs = dict(data[name].attrs)
    return reduced


def _of_cells(
    runs: Runs, rivals: Sequence[int], oracle: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Quantiles (…, law, level), regret (…, law), and winner, ratio, verdict (…, 3)."""
    runs = np.asarray(runs, dtype=float)
    regret = np.full(runs.shape[:-1], np.nan)
    best = np.full((*runs.shape[:-2], 3), np.nan)
    if oracle >= 0:
        regret = mean_interval(quotient(runs, runs[..., [oracle], :]))[0]
    if rivals:
        ranking = winners_of(runs[..., list(rivals), :])
        best = np.stack(
            [np.where(ranking.winner < 0, np.nan, ranking.winner), *ranking[1:]], axis=-1
        )
    return quantiles(runs), regret, best


def quantiles(
    values: Float[np.ndarray, "*cell scenario"], levels: Sequence[float] = LEVELS
) -> Float[np.ndarray, "*cell level"]:
    """The linear quantiles that numpy has, also where some values are infinite.

    Examples
    --------
    >>> quantiles(np.array([1.0, 3.0, 5.0, 7.0, np.inf]))
    array([1.4, 3. , 5. , 7. , inf])
    """
    low, high = (np.quantile(values, levels, axis=-1, method=name) for name in ("lower", "higher"))
    with np.errstate(invalid="ignore"):  # ∞ − ∞ between two that diverged
        between = np.quantile(values, levels, axis=-1)
    found = np.where(low == high, low, np.where(np.isinf(low), low, between))
    return np.moveaxis(np.where(np.isinf(high) & np.isfinite(low), high, found), 0, -1)
