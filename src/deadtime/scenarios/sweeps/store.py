"""The Zarr store of a sweep: a cell is either complete in it or absent.

Every variable is one array over (axes of the grid …, law, scenario), with one chunk per block of
cells; each chunk is an object with a checksum, written at once. `done` marks complete cells: a
block's flags are written after all its other data, so that an interrupted block counts as absent,
and is computed again. A store is read as a dataset, loaded as far as it is used.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import shutil
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import lru_cache
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any
from uuid import uuid4

import numpy as np

from deadtime.base.errors import ArgumentError, StoreError
from deadtime.base.version import __version__
from deadtime.scenarios.dataset import DIVERGED, attributes_of
from deadtime.scenarios.sweeps.axes import Axis, no_write
from deadtime.scenarios.sweeps.blocks import BlockLayout, read_description
from deadtime.scenarios.sweeps.cell import CellOutcome
from deadtime.scenarios.sweeps.study import Study, differences

if TYPE_CHECKING:
    import dask.array
    import xarray as xr
    import zarr


KIND = "deadtime sweep"
UNREADABLE = (RuntimeError, ValueError, OSError, KeyError)  # what codecs and files raise
_REFUSED = (errno.EACCES, errno.EPERM, errno.EROFS)
_FULL = (errno.ENOSPC, errno.EDQUOT)


class Store:
    """A store that exists, with the layout of its blocks."""

    def __init__(self, url: str, group: zarr.Group) -> None:
        self.url, self.group = url, group
        attributes = dict(group.attrs)
        if attributes.get("kind") != KIND:
            raise ArgumentError(
                f"store {url!r} is Zarr, but not made by deadtime sweep: choose another name."
            )
        try:
            self.definition, self.layout = read_description(attributes)
            self._require_arrays()
        except ArgumentError as error:
            raise StoreError(
                f"store {url!r} is damaged: {error} Choose another store, or run the sweep anew."
            ) from None
        whole = json.dumps([self.definition, self.layout.block])
        self.key = hashlib.sha256(whole.encode()).hexdigest()

    def array(self, name: str) -> Any:
        """A variable or coordinate, as a Zarr array that stores empty chunks, too."""
        import zarr

        with zarr.config.set({"array.write_empty_chunks": True}):
            return self.group[name]

    def _require_arrays(self) -> None:
        """Refuse a store whose arrays do not match its definition."""
        from zarr import Array

        shape, block = self.layout.shape, self.layout.block
        law, scenario = len(self.definition["laws"]), self.definition["scenarios"]
        extents = dict.fromkeys((*self.definition["metrics"], "diverged"), (law, scenario))
        extents |= {"reason": (law,), "done": ()}
        expected = {name: ((*shape, *rest), (*block, *rest)) for name, rest in extents.items()}
        kinds = dict.fromkeys(self.definition["metrics"], "f") | {"diverged": "b", "done": "b"}
        axes = {**{n: len(v) for n, v in self.definition["grid"].items()}, "law": law}
        axes["scenario"] = scenario
        expected |= {name: ((size,), (size,)) for name, size in axes.items()}
        for name, sizes in expected.items():
            array = self.group.get(name)
            if not isinstance(array, Array):
                raise ArgumentError(f"it lacks the array {name!r}.")
            if array.dtype.kind != kinds.get(name, array.dtype.kind):
                raise ArgumentError(f"its array {name!r} holds {array.dtype}.")
            names = (*self.definition["grid"], "law", "scenario")
            dims = (name,) if name in axes else names[: len(sizes[0])]
            given = getattr(array.metadata, "dimension_names", None)
            if given != dims or not isinstance(array.metadata.attributes, dict):
                raise ArgumentError(f"its array {name!r} does not say what its axes are.")
            if (array.shape, array.chunks) != sizes:
                raise ArgumentError(
                    f"its array {name!r} has the shape {array.shape} in chunks of {array.chunks}, "
                    f"not {sizes[0]} in chunks of {sizes[1]}."
                )

    def require(self, study: Study) -> None:
        """Refuse to mix the results of different studies."""
        found = differences(self.definition, study.definition())
        if found:
            more = f" (and {len(found) - 4} more)" if len(found) > 4 else ""
            raise ArgumentError(
                f"store {self.url!r} holds another study: {'; '.join(found[:4])}{more}. Choose "
                "another store, or change the study back."
            )

    def whole_cells(self) -> np.ndarray:
        """The complete cells; those whose flags cannot be read are not."""
        done = np.zeros(self.layout.shape, dtype=bool)
        array = self.array("done")
        try:
            done[...] = array[...]
        except UNREADABLE:
            for number in range(self.layout.size):
                place = self.layout.slices(number)
                with suppress(*UNREADABLE):
                    done[place] = array[place]
        return done

    def missing(self) -> list[int]:
        """The blocks that are not complete."""
        done = self.whole_cells()
        return [
            number
            for number in range(self.layout.size)
            if not done[self.layout.slices(number)].all()
        ]

    def write(self, number: int, outcomes: Sequence[CellOutcome]) -> None:
        """Store the outcomes of a block's cells, in their order; the flags last."""
        place = self.layout.slices(number)
        shape = tuple(part.stop - part.start for part in place)
        with writing(self.url):
            for name in outcomes[0].metrics:
                self._put(name, place, shape, [one.metrics[name] for one in outcomes])
            self._put("diverged", place, shape, [one.diverged for one in outcomes])
            reasons = [np.array(one.reasons, dtype=object) for one in outcomes]
            self._put("reason", place, shape, reasons)
            self.array("done")[place] = np.ones(shape, dtype=bool)

    def _put(
        self, name: str, place: tuple[slice, ...], shape: tuple[int, ...], parts: list[np.ndarray]
    ) -> None:
        self.array(name)[place] = np.stack(parts).reshape((*shape, *parts[0].shape))

    def forget(self, number: int) -> None:
        """Mark a block's cells as absent."""
        place = self.layout.slices(number)
        with writing(self.url):
            self.array("done")[place] = np.zeros([s.stop - s.start for s in place], dtype=bool)

    def read(self, name: str, number: int) -> np.ndarray:
        """A block of a variable; `StoreError` that names its chunk if it cannot be read."""
        from zarr.core.sync import sync

        array, place, chunk = self.array(name), self.layout.slices(number), self.chunk(name, number)
        advice = "find all such by `deadtime sweep … --verify`, which computes them again."
        try:
            there = sync(self.group.store.exists(chunk))
            values = array[place]
        except UNREADABLE as error:
            raise StoreError(
                f"store {self.url!r} has a damaged chunk, {self.url}/{chunk} ({error}): {advice}"
            ) from None
        if not there and name != "done":
            raise StoreError(f"store {self.url!r} lacks the chunk {self.url}/{chunk}: {advice}")
        return values.astype(object) if name == "reason" else values

    def faults(self) -> Iterator[tuple[int, str]]:
        """Complete blocks with chunks that cannot be read or are gone, and the fault."""
        done, names = self.whole_cells(), [*self.definition["metrics"], "diverged", "reason"]
        for number in range(self.layout.size):
            if not done[self.layout.slices(number)].all():
                continue
            try:
                for name in names:
                    self.read(name, number)
            except StoreError as error:
                yield number, str(error)

    def restore_coordinates(self) -> list[str]:
        """Rewrite coordinates that differ from the definition; their names."""
        wrong = []
        for name, values in coordinates_of(self.definition).items():
            try:
                fine = (self.array(name)[...] == values).all()
            except UNREADABLE:
                fine = False
            if not fine:
                wrong.append(name)
                with writing(self.url):
                    self.array(name)[...] = values
        return wrong

    def chunk(self, name: str, number: int) -> str:
        """The path in the store of the object that holds a block of a variable."""
        counts, array = self.layout.counts, self.array(name)
        where = [int(i) for i in np.unravel_index(number, counts)] if counts else []
        places = (*where, *[0] * (array.ndim - len(counts)))
        return f"{name}/{array.metadata.encode_chunk_key(places)}"


def place_of(store: str | PathLike[str]) -> str:
    """The name of a store for all workers: an absolute path, or the URL itself."""
    name = fspath(store)
    return name if "://" in name else str(Path(name).absolute())


def open_store(url: str) -> Store:
    """A store that exists."""
    return Store(url, _group(url))


def _group(url: str) -> zarr.Group:
    try:
        import zarr
    except ModuleNotFoundError:
        raise ArgumentError(
            "a sweep's store needs Zarr, which is not installed: "
            'pip install ".[sweep]" in a clone of deadtime.'
        ) from None
    try:
        return zarr.open_group(url, mode="r+")
    except (FileNotFoundError, NotADirectoryError, FileExistsError):
        if "://" not in url and Path(url).exists():
            raise ArgumentError(
                f"store {url!r} is there, but is no Zarr store: choose another name."
            ) from None
        raise ArgumentError(f"store {url!r} does not exist: run the sweep first.") from None
    except Exception as error:  # Zarr may raise anything for malformed metadata
        why = " ".join(str(error).split())
        raise StoreError(
            f"store {url!r} cannot be opened ({why:.300}): choose another store, or delete "
            "this one and run the sweep anew."
        ) from None


@lru_cache(maxsize=8)
def cached_store(url: str, key: str) -> Store:
    """The store at a URL if it has this key, cached for the many blocks of one process."""
    store = open_store(url)
    if store.key != key:
        raise StoreError(f"store {url!r} was replaced by another one meanwhile: open it again.")
    return store


def exists(url: str) -> bool:
    """Whether there is anything at the place of a store."""
    if "://" not in url:
        return Path(url).exists()
    import zarr

    try:
        zarr.open_group(url, mode="r")
    except FileNotFoundError:
        return False
    except (ImportError, ValueError, OSError) as error:
        raise StoreError(f"store {url!r} cannot be opened: {error}") from None
    return True


def create(url: str, study: Study, layout: BlockLayout, facts: Mapping[str, Any]) -> Store:
    """A new store of absent cells, made under another name and renamed where that is possible.

    If another sweep makes one at the same time, the first one remains.
    """
    if "://" in url:
        _fill(url, study, layout, facts)
        return open_store(url)
    target = Path(url)
    draft = target.with_name(f".{target.name}.{uuid4().hex}")
    with writing(url):
        target.parent.mkdir(parents=True, exist_ok=True)
        try:
            _fill(str(draft), study, layout, facts)
            os.rename(draft, target)
        except OSError:
            if not target.exists():  # otherwise another sweep was quicker
                raise
        finally:
            shutil.rmtree(draft, ignore_errors=True)
    return open_store(url)


def _fill(url: str, study: Study, layout: BlockLayout, facts: Mapping[str, Any]) -> None:
    """Arrays without chunks, coordinates and attributes."""
    import zarr
    from zarr.codecs import BloscCodec, Crc32cCodec

    group = zarr.create_group(url)
    axes, laws, scenarios = tuple(study.grid), len(study.laws), study.scenarios
    dims = (*axes, "law", "scenario")

    def add(name: str, dtype: Any, fill: Any, extent: int, **attributes: Any) -> None:
        rest = (laws, scenarios)[:extent]
        group.create_array(
            name,
            shape=(*layout.shape, *rest),
            chunks=(*layout.block, *rest),
            dtype=dtype,
            fill_value=fill,
            compressors=[BloscCodec(cname="zstd", clevel=3, shuffle="shuffle"), Crc32cCodec()],
            dimension_names=dims[: len(axes) + extent],
            attributes=attributes,
        )

    for name in study.metrics:
        add(name, "f8", np.nan, 2, **attributes_of(name, facts.get("cost")))
    add("diverged", "bool", False, 2, long_name=DIVERGED)
    add("reason", str, "", 1, long_name="what went wrong")
    add("done", "bool", False, 0, long_name="cell is whole")
    for name, values in coordinates_of(study.definition()).items():
        axis = study.axis(name) if name in study.grid else Axis(name, name, "", no_write)
        dtype = str if values.dtype == object else values.dtype
        array = group.create_array(
            name,
            shape=values.shape,
            chunks=values.shape,
            dtype=dtype,
            compressors=[BloscCodec(cname="zstd", clevel=3, shuffle="shuffle"), Crc32cCodec()],
            dimension_names=(name,),
            attributes={"long_name": axis.label, **({"units": axis.unit} if axis.unit else {})},
        )
        array[...] = values
    group.attrs.update(
        {
            "kind": KIND,
            "title": study.title,
            "source": study.source,
            "version": __version__,
            "seed": study.seed,
            "scenarios": scenarios,
            "study": study.text,
            "definition": json.dumps(study.definition(), ensure_ascii=False),
            "block": list(layout.block),
            **facts,
        }
    )
    with warnings.catch_warnings():
        # Read by xarray and zarr alike, and not yet in the specification of Zarr 3.
        warnings.filterwarnings("ignore", message="Consolidated metadata")
        zarr.consolidate_metadata(url)


def coordinates_of(definition: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """The values of all dimensions by name."""
    return {
        **{name: _plain(values) for name, values in definition["grid"].items()},
        "law": np.array(definition["laws"], dtype=object),
        "scenario": np.arange(definition["scenarios"]),
    }


def _plain(values: Sequence[Any]) -> np.ndarray:
    """The values of an axis as numbers, where they all are, or as texts."""
    if all(isinstance(value, (int, float)) and not isinstance(value, bool) for value in values):
        return np.array(values)
    texts = [value if isinstance(value, str) else json.dumps(value) for value in values]
    return np.array(texts, dtype=object)


@contextmanager
def writing(url: str) -> Iterator[None]:
    """Turn errors of writing into a `StoreError` with advice."""
    try:
        yield
    except OSError as error:
        if error.errno in _FULL:
            why, what = "is full", "make room"
        elif error.errno in _REFUSED:
            why, what = "may not be written", "change its rights, or choose another store"
        else:
            reason = error.strerror or error
            raise StoreError(
                f"store {url!r} cannot be written ({reason}): choose another store."
            ) from None
        raise StoreError(
            f"store {url!r} {why}: what is stored is kept; {what} and run the same command again."
        ) from None


def open_sweep(store: str | PathLike[str]) -> xr.Dataset:
    """The dataset of a sweep's store, loaded as far as it is used.

    Plain ``xarray.open_zarr(store)`` reads it, too; this function names damaged chunks, and leaves
    out cells that are not complete.

    Parameters
    ----------
    store : path or URL
        The store of a `sweep`, finished or running.

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
        If it cannot be opened; or, when its data are used, if a chunk is damaged.

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
    """A block of a variable; in an incomplete block all cells count as absent."""
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
