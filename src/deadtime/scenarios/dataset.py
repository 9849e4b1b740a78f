"""Metrics of laws, by their names, over scenarios as a labelled dataset."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float, Int

from deadtime.base.errors import ArgumentError
from deadtime.base.version import __version__
from deadtime.feedback import Law
from deadtime.plant.weight import PLAIN, Weight
from deadtime.simulation.tracking import TRACKING

if TYPE_CHECKING:
    import xarray as xr


def named_laws(laws: object) -> dict[str, Law]:
    """Laws by name, in their order."""
    if isinstance(laws, Mapping):
        pairs = list(laws.items())
    elif isinstance(laws, Sequence) and not isinstance(laws, str):
        pairs = [(_label_of(law), law) for law in laws]
    else:
        hint = ": for one law, write [law]" if isinstance(laws, Law) else ""
        raise ArgumentError(
            f"laws must be a list of laws, or a dict of names to laws, got "
            f"{type(laws).__name__}{hint}."
        )
    if not pairs:
        raise ArgumentError("laws must hold at least one law, got none.")
    named: dict[str, Law] = {}
    for name, law in pairs:
        if not isinstance(law, Law):
            raise ArgumentError(f"laws must hold laws only, got {type(law).__name__}.")
        if not isinstance(name, str):
            raise ArgumentError(f"laws must have names that are strings, got {name!r}.")
        if name in named:
            raise ArgumentError(
                f"laws must have different labels, got {name!r} twice: "
                "name them yourself, with a dict of names to laws."
            )
        named[name] = law
    return named


def _label_of(law: object) -> str:
    """A law's own name."""
    label = getattr(law, "label", "")
    if not isinstance(label, str):
        raise ArgumentError(
            f"{type(law).__name__}.label must be a text, got a {type(label).__name__}: make it a "
            "property, or name the laws yourself, with a dict of names to laws."
        )
    return label


# Metric: (unit, long name), in the order and under the names of `Trajectory.metrics()`.
METRICS = {
    "ise": ("x^2 s", "integral of |x|^2"),
    "energy": ("u^2 s", "integral of |u|^2"),
    "cost": ("x^2 s + u^2 s", "integral of |x|^2 + |u|^2"),
    "peak": ("x", "maximum of |x| over the samples"),
    "settling_time": ("s", "time from which |x| stays within 2 % of its peak, inf if never"),
    "decay_rate": ("1/s", "minus the slope of log|x| over the second half"),
    "final_norm": ("x", "|x| at the end"),
}
IAE = {"iae": ("y s", "integral of |reference - output|, all tracked outputs together")}
DIVERGED = "|x| left 1e100 and the run ended there; its metrics are those up to that end"


def attributes_of(metric: str, cost: str | None = None) -> dict[str, str]:
    """The attributes of a metric in a dataset; for a weighted cost its formula.

    Examples
    --------
    >>> attributes_of("ise", "∫xᵀQx + uᵀRu, …")
    {'units': 'x^2 s', 'long_name': 'integral of |x|^2'}
    """
    if metric == "cost" and cost is not None:
        return {"long_name": "weighted integral of x and u", "formula": cost}
    return dict(zip(("units", "long_name"), (METRICS | IAE)[metric], strict=True))


def formula_of(metric: xr.DataArray) -> str:
    """The formula of a dataset's cost, for labels."""
    return str(metric.attrs.get("formula", PLAIN))


@dataclass(frozen=True, eq=False)
class Results:
    """The results that blocks of a comparison fill, law by law and scenario by scenario.

    Attributes
    ----------
    metrics : mapping
        From a metric to an array (law, scenario); where a law follows a reference also `IAE`, NaN
        for the other laws.
    done : (scenario,) array
        Which scenarios are complete.
    tracking : mapping
        From a figure of `TRACKING` to an array (law, scenario, output), where a law follows a
        reference; NaN for the other laws.
    x, u, mode : arrays or None
        Trajectories if they are kept; NaN past the end of a run that diverged.
    """

    metrics: Mapping[str, Float[np.ndarray, "law scenario"]]
    diverged: Bool[np.ndarray, "law scenario"]
    done: Bool[np.ndarray, " scenario"]
    tracking: Mapping[str, Float[np.ndarray, "law scenario output"]]
    x: Float[np.ndarray, "law scenario n sample"] | None = None
    u: Float[np.ndarray, "law scenario m sample"] | None = None
    mode: Int[np.ndarray, "scenario sample"] | None = None

    @classmethod
    def empty(
        cls, laws: int, scenarios: int, path: tuple[int, int, int] | None = None, tracked: int = 0
    ) -> Results:
        """Empty arrays; `path` = (n, m, samples) of trajectories, None to keep none."""
        shape = laws, scenarios
        metrics = {name: np.empty(shape) for name in METRICS}
        metrics |= {name: np.full(shape, np.nan) for name in IAE if tracked}
        flags = np.zeros(shape, dtype=bool), np.zeros(scenarios, dtype=bool)
        names = TRACKING if tracked else ()
        tracking = {name: np.full((*shape, tracked), np.nan) for name in names}
        if path is None:
            return cls(metrics, *flags, tracking)
        n, m, samples = path
        x, u = np.empty((*shape, n, samples)), np.empty((*shape, m, samples))
        return cls(metrics, *flags, tracking, x, u, np.empty((scenarios, samples), np.int32))


def dataset_of(
    laws: Sequence[str], results: Results, attributes: Mapping[str, Any], weight: Weight | None
) -> xr.Dataset:
    """The finished scenarios as a labelled dataset; `weight` is that of the cost, if it has one."""
    import xarray as xr

    done, dims = np.flatnonzero(results.done), ("law", "scenario")

    def keep(array: np.ndarray, axis: int = 1) -> np.ndarray:
        return array if results.done.all() else np.take(array, done, axis)

    variables: dict[str, Any] = {
        name: (dims, keep(value), attributes_of(name, None if weight is None else weight.text))
        for name, value in results.metrics.items()
    }
    for name, value in results.tracking.items():
        described = dict(zip(("units", "long_name"), TRACKING[name], strict=True))
        variables[name] = ((*dims, "output"), keep(value), described)
    variables["diverged"] = (dims, keep(results.diverged), {"long_name": DIVERGED})
    coordinates: dict[str, Any] = {
        "law": ("law", list(laws), {"long_name": "law"}),
        "scenario": ("scenario", done, {"long_name": "scenario"}),
    }
    if results.tracking:
        tracked = next(iter(results.tracking.values())).shape[2]
        coordinates["output"] = ("output", np.arange(tracked), {"long_name": "tracked output"})
    if results.x is not None and results.u is not None and results.mode is not None:
        time = attributes["step"] * np.arange(results.mode.shape[1])
        coordinates["time"] = ("time", time, {"units": "s", "long_name": "time"})
        variables["x"] = ((*dims, "state", "time"), keep(results.x), {"long_name": "state"})
        variables["u"] = ((*dims, "input", "time"), keep(results.u), {"long_name": "input"})
        variables["mode"] = (
            ("scenario", "time"),
            keep(results.mode, 0),
            {"long_name": "mode at the sample"},
        )
    return xr.Dataset(variables, coordinates, {**attributes, "version": __version__})
