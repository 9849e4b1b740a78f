"""One cell of a study: its laws on its signals, and the result or failure of each law."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float

from deadtime.base.errors import ArgumentError, DeadtimeError
from deadtime.feedback import Law
from deadtime.scenarios.batch_run import monte_carlo
from deadtime.scenarios.source import draw_signals
from deadtime.scenarios.sweeps.study import Cell, Loop, Study
from deadtime.switching import SignalBatch, SwitchingSignal

if TYPE_CHECKING:
    import xarray as xr

_FEW = 20_000  # signals that are drawn at once, so that equal ones run only once


@dataclass(frozen=True, eq=False)
class CellOutcome:
    """The results of one cell.

    Attributes
    ----------
    metrics : mapping
        From a metric to an array (law, scenario); NaN in the rows of laws that failed.
    diverged : (law, scenario) array
    reasons : tuple of str
        The fault of each law, empty without one.
    """

    metrics: Mapping[str, Float[np.ndarray, "law scenario"]]
    diverged: Bool[np.ndarray, "law scenario"]
    reasons: tuple[str, ...]


def run_cell(study: Study, cell: Cell) -> CellOutcome:
    """Run every law of a study in one cell; a failure is a result with a reason."""
    shape = (len(study.laws), study.scenarios)
    metrics = {name: np.full(shape, np.nan) for name in study.metrics}
    diverged = np.zeros(shape, dtype=bool)
    reasons = dict.fromkeys(study.laws, "")
    try:
        loop = study.loop(cell)
        laws = _with_tables(loop, reasons)
        if laws:
            data = _measure(loop, laws, study.scenarios, cell.values.get("seed", study.seed))
            rows = [study.laws.index(law) for law in laws]
            for name, array in metrics.items():
                array[rows] = data[name].values
            diverged[rows] = data.diverged.values
    except DeadtimeError as error:
        reasons = dict.fromkeys(study.laws, str(error))
    except MemoryError:
        raise
    except Exception as error:
        # A cell's function or a library may raise anything for odd values: other cells go on.
        reasons = dict.fromkeys(study.laws, f"failed: {type(error).__name__}: {error}")
    for law, lost in zip(study.laws, diverged, strict=True):
        if lost.any():
            reasons[law] = f"diverged on {lost.sum():,} of {study.scenarios:,} scenarios"
    return CellOutcome(metrics, diverged, tuple(reasons.values()))


def _with_tables(loop: Loop, reasons: dict[str, str]) -> dict[str, Law]:
    """The laws whose tables can be filled; the faults of the others are added to `reasons`."""
    reasons |= loop.reasons
    strange = [name for name in loop.laws if name not in reasons]
    if strange:
        raise ArgumentError(
            f"laws must be named alike in every cell, {', '.join(reasons)}, got {strange[0]!r}."
        )
    for name in reasons:
        if name not in loop.laws and not reasons[name]:
            reasons[name] = f"no law {name!r} was made here"
    laws = {}
    for name, law in loop.laws.items():
        try:
            if law.observer is None:
                law.tables_along(loop.step, SwitchingSignal.constant(0), 1)
        except DeadtimeError as error:
            reasons[name] = str(error)
        else:
            laws[name] = law
    return laws


def _measure(loop: Loop, laws: Mapping[str, Law], scenarios: int, seed: int) -> xr.Dataset:
    """The metrics of every law on every signal, on one thread: cells run beside each other."""
    given, weight = (loop.x0, loop.horizon, loop.step), loop.weight
    # Imperfections draw anew in every scenario: equal signals do not make equal runs.
    if loop.imperfections or scenarios > _FEW:
        return monte_carlo(
            loop.plant, laws, loop.model, *given, scenarios, seed,
            imperfections=loop.imperfections, threads=1, weight=weight,
        )  # fmt: skip
    reach = max(loop.plant.longest_delay, *(law.plant.longest_delay for law in laws.values()))
    signals, which = _distinct(draw_signals(loop.model, loop.horizon + reach, seed, 0, scenarios))
    data = monte_carlo(loop.plant, laws, signals, *given, threads=1, weight=weight)
    return data.isel(scenario=which)


def _distinct(signals: SignalBatch) -> tuple[SignalBatch, np.ndarray]:
    """The distinct signals of a batch, and the index of every signal among them.

    Signals of fixed sojourns, or of short horizons, are often equal.
    """
    times, modes, first = signals.times.tobytes(), signals.modes.tobytes(), 8 * signals.first
    others = np.stack((signals.end, signals.initial_age), axis=1).tobytes()
    places: dict[tuple[bytes, bytes, bytes], int] = {}
    which, examples = np.empty(len(signals), np.int64), list[int]()
    for i, (a, b) in enumerate(zip(first[:-1].tolist(), first[1:].tolist(), strict=True)):
        key = times[a:b], modes[a:b], others[16 * i : 16 * i + 16]
        which[i] = places.setdefault(key, len(places))
        if len(places) > len(examples):
            examples.append(i)
    return (signals.take(np.array(examples)) if len(examples) < len(signals) else signals), which
