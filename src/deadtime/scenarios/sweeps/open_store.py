"""Read a sweep's store: as a dataset, loaded as far as it is used."""

from __future__ import annotations

from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np

from deadtime.scenarios.sweeps.store import (
    Store,
    cached_store,
    coordinates_of,
    open_store,
    place_of,
)

if TYPE_CHECKING:
    import dask.array
    import xarray as xr


def open_sweep(store: str | PathLike[str]) -> xr.Dataset:
    """The dataset of a sweep's store, loaded as far as it is used.

    Plain ``xarray.open_zarr(store)`` reads it, too; this names a damaged chunk, and leaves out what
    was written of cells that are not whole.

    Parameters
    ----------
    store : path or URL
        Where `sweep` wrote, or is writing.

    Returns
    -------
    xarray.Dataset
        Dimensions (axes of the grid, law, scenario): Dask arrays, a chunk to a block of cells.
        Cells that are absent are NaN, and `done` is false there.

    Raises
    ------
    ArgumentError
        If there is no store, or it is not one of a sweep.
    StoreError
        If it cannot be opened; or, when its data are used, if a chunk of it is damaged.

    Examples
    --------
    >>> open_sweep("nowhere.zarr")  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    deadtime.ArgumentError: store '...nowhere.zarr' does not exist: run the sweep first.
    """
    import xarray as xr

    target = open_store(place_of(store))
    names = [*target.definition["metrics"], "diverged", "reason"]
    axes = list(target.definition["grid"])
    variables: dict[str, Any] = {
        name: (array.metadata.dimension_names, _lazy(target, name), dict(array.attrs))
        for name, array in ((name, target.array(name)) for name in names)
    }
    variables["done"] = (axes, target.whole_cells(), dict(target.array("done").attrs))
    coordinates = {
        name: ((name,), values, dict(target.array(name).attrs))
        for name, values in coordinates_of(target.definition).items()
    }
    return xr.Dataset(variables, coordinates, dict(target.group.attrs))


def _lazy(target: Store, name: str) -> dask.array.Array:
    """A variable whose blocks are read when they are used."""
    import dask.array as da
    from dask.array.core import normalize_chunks

    array = target.array(name)
    dtype = np.dtype(object) if name == "reason" else array.dtype
    chunks = normalize_chunks(array.chunks, array.shape)
    nothing = np.empty((0,) * array.ndim, dtype)
    where = target.url, target.key, name
    return da.map_blocks(_read, *where, chunks=chunks, dtype=dtype, meta=nothing)


def _read(url: str, key: str, name: str, block_id: tuple[int, ...]) -> np.ndarray:
    """A block of a variable, as if its cells that are not whole were absent."""
    target = cached_store(url, key)
    layout = target.layout
    where = block_id[: len(layout.shape)]
    number = int(np.ravel_multi_index(where, layout.counts)) if where else 0
    done = target.read("done", number)
    if done.all():
        return target.read(name, number)
    array = target.array(name)
    absent = {"f": np.nan, "b": False}.get(array.dtype.kind, "")
    values = np.full((*done.shape, *array.shape[done.ndim :]), absent)
    return values.astype(object) if name == "reason" else values
