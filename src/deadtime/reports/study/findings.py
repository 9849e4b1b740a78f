"""Findings of a study, cell by cell: regret, signals stabilised, and which law is better.

Laws are compared on the same signals, by the quotient of their ∫|x|² and its geometric mean over
the signals. ∫|x|² itself depends on the signal, above all on its first mode, more than on the law;
quotients, too, often fall into one group per first mode, between which a median would jump. A
run that diverged counts as ∫|x|² = ∞.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from deadtime.scenarios.paired_statistics import (
    Proportion,
    Ranking,
    mean_interval,
    median_interval,
    pick,
    quotient,
    ranking_of,
    share_below,
    share_of,
    verdict_of,
)
from deadtime.scenarios.sweeps.axes import ORACLE

if TYPE_CHECKING:
    import xarray as xr

LOST = 100.0  # a regret that counts as no worse than any larger one


def summary(data: xr.Dataset) -> xr.Dataset:
    """Per cell and law: median ∫|x|², regret, and share of signals stabilised.

    Regret is the geometric mean over signals of ∫|x|² over the oracle's, median_regret the median;
    a signal is stabilised when |x| ends below where it started. Variables ending in _low and
    _high are intervals.
    """
    import xarray as xr

    ise, calm = score(data), is_stabilised(data)
    regret = quotient(ise.values, ise.sel(law=[ORACLE]).values)
    shares = np.apply_along_axis(share_of, -1, calm.values)
    shares[np.isnan(regret).any(axis=-1)] = np.nan
    dims = ise.dims[:-1]
    return xr.Dataset(
        {
            "ise": ise.median("scenario"),
            **_with_interval("regret", dims, mean_interval(regret)),
            **_with_interval("median_regret", dims, median_interval(regret)),
            **_with_interval("stabilised", dims, np.moveaxis(shares, -1, 0)),
        },
        {name: data[name] for name in dims},
    )


def _with_interval(name: str, dims: Sequence[Hashable], parts: Iterable[np.ndarray]) -> dict:
    """A figure and the ends of its interval, as variables of a dataset."""
    names = (name, f"{name}_low", f"{name}_high")
    return {part: (dims, values) for part, values in zip(names, parts, strict=True)}


def duel(data: xr.Dataset, first: str, second: str) -> xr.Dataset:
    """One law against another, in every cell.

    ratio, the geometric mean over signals of ∫|x|² under the first over that under the second, and
    median_ratio, their median; share, the part of the signals on which the first is better, those
    aside on which both are the same; all with intervals _low and _high; and verdict: 1 where the
    first is better (the whole interval of ratio below 1), −1 where the second is, 0 where the
    signals do not decide, NaN where one could not be built.
    """
    ise = score(data)
    return _duel(*(ise.sel(law=law, drop=True) for law in (first, second)))


def best(data: xr.Dataset, laws: Sequence[str]) -> xr.Dataset:
    """The law of least regret in every cell, against the second best.

    winner and runner_up, names of laws, empty where fewer than one or two could be built; and
    `duel` of these two: where its verdict is not 1 they are tied.
    """
    ranking = _ranking(data, laws)
    ise = score(data).sel(law=list(laws))
    names, places, runs = np.array([*laws, ""]), {}, []
    for rank, name in enumerate(("winner", "runner_up")):
        place = ranking.place(rank)
        runs.append(_pick(ise, place))
        places[name] = (ise.dims[:-2], names[place])
    return _duel(*runs).assign(places)


def against_best(data: xr.Dataset, law: str, rivals: Sequence[str]) -> xr.Dataset:
    """`duel` of a law against whichever of its rivals is `best` in the cell."""
    ise = score(data)
    rival = _pick(ise.sel(law=list(rivals)), _ranking(data, rivals).place(0))
    return _duel(ise.sel(law=law, drop=True), rival)


def _ranking(data: xr.Dataset, laws: Sequence[str]) -> Ranking:
    return ranking_of(summary(data).regret.sel(law=list(laws)).transpose(..., "law").values)


def _pick(ise: xr.DataArray, place: np.ndarray) -> xr.DataArray:
    """In every cell the score of one law, NaN where its place is −1."""
    return ise.isel(law=0, drop=True).copy(data=pick(ise.values, place))


def unbeaten(data: xr.Dataset, laws: Sequence[str]) -> xr.DataArray:
    """Per cell and law, whether no other of the laws is better; False if it could not be built."""
    import xarray as xr

    rows = []
    for law in laws:
        rivals = [duel(data, law, other).verdict for other in laws if other != law]
        fine = data.ise.sel(law=law, drop=True).notnull().all("scenario")
        for verdict in rivals:
            fine &= verdict != -1.0
        rows.append(fine)
    return xr.concat(rows, "law").assign_coords(law=list(laws))


def typical_regret(data: xr.Dataset) -> xr.DataArray:
    """Per law the geometric mean of its regret over the cells, none counted above `LOST`."""
    regret = summary(data).regret.fillna(np.inf).clip(1.0 / LOST, LOST)
    return np.exp(np.log(regret).mean([dim for dim in regret.dims if dim != "law"]))


def favourite(data: xr.Dataset, laws: Sequence[str]) -> str:
    """The law of least typical regret: small gains in many cells do not outweigh a large loss."""
    typical = typical_regret(data).sel(law=list(laws))
    return str(typical.law.values[int(np.argmin(typical.values))])


def steadier(data: xr.Dataset, first: str, second: str) -> xr.DataArray:
    """Per cell 1 where the first law stabilises more signals than the second, −1 where fewer.

    Judged, as in `duel`, by the signals that one of them stabilises and the other does not.
    """
    calm = is_stabilised(data)
    a, b = (calm.sel(law=law, drop=True) for law in (first, second))
    verdicts = []
    for one, other in zip(_cells(a.values), _cells(b.values), strict=True):
        low, high = Proportion.of(one[one != other]).interval
        verdicts.append((low > 0.5) * 1.0 - (high < 0.5) * 1.0)
    missing = data.ise.sel(law=[first, second]).isnull().any(["law", "scenario"])
    verdict = np.reshape(verdicts, a.shape[:-1])
    return missing.copy(data=np.where(missing.values, np.nan, verdict))


def is_stabilised(data: xr.Dataset) -> xr.DataArray:
    """Where |x| ends below where it started."""
    calm = (data.final_norm < data.attrs["start"]) & ~data.diverged
    return calm.transpose(..., "law", "scenario")


def _cells(values: np.ndarray) -> np.ndarray:
    """One row of scenarios per cell."""
    return values.reshape(-1, values.shape[-1])


def score(data: xr.Dataset) -> xr.DataArray:
    """∫|x|², ∞ for a run that diverged, NaN for a law that could not be built."""
    return data.ise.where(~data.diverged, np.inf).transpose(..., "law", "scenario")


def _duel(a: xr.DataArray, b: xr.DataArray) -> xr.Dataset:
    """`duel` of two scores."""
    import xarray as xr

    dims, values = a.dims[:-1], quotient(a.values, b.values)
    middle, low, high = mean_interval(values)
    shares = np.apply_along_axis(share_below, -1, values)
    shares[np.isnan(middle)] = np.nan
    return xr.Dataset(
        {
            **_with_interval("ratio", dims, (middle, low, high)),
            **_with_interval("median_ratio", dims, median_interval(values)),
            **_with_interval("share", dims, np.moveaxis(shares, -1, 0)),
            "verdict": (dims, verdict_of(low, high)),
        },
        {name: a[name] for name in dims},
    )
