"""The plants that a certificate is asked about: one, a polytope or an ellipsoid; and delays."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.base.checks import instance, positive
from deadtime.base.errors import ArgumentError
from deadtime.certificates.proof.box import DelayInterval
from deadtime.feedback import Feedback
from deadtime.plant import SwitchedSystem, UncertainPlant
from deadtime.plant.switched_system import check_delays
from deadtime.spectrum import aged_row, constant_growth, with_memory

ROUNDS = 3  # of going to the worst point of the ellipsoid
MOVE = 1e-3  # of the ellipsoid, for a derivative

Range = tuple[ArrayLike, ArrayLike]


def plants_of(
    plant: SwitchedSystem | UncertainPlant | Sequence[SwitchedSystem | UncertainPlant],
    delays: Range | None,
) -> tuple[list[SwitchedSystem], Float[np.ndarray, "axis mode n nm"] | None, Range | None]:
    """The vertices, the axes of an ellipsoid about the one there is, and the range of delays."""
    if isinstance(plant, UncertainPlant):
        axes = plant.axes()
        delays = plant.delay_range() if delays is None else delays
        return [plant.plant], axes if len(axes) else None, delays
    plants: list[SwitchedSystem] = []
    for corner in [plant] if isinstance(plant, SwitchedSystem) else plant:
        if isinstance(corner, UncertainPlant):
            raise ArgumentError(
                "plant must be one UncertainPlant by itself, got a sequence with one: certify them "
                "one by one, or the corners of all, [*one.corners(), *another.corners()]."
            )
        instance("plant", corner, SwitchedSystem)
        plants.append(corner)
    if not plants:
        raise ArgumentError("plant must be a SwitchedSystem or a sequence of them, got none.")
    for corner in plants:
        if not np.array_equal(corner.delays, plants[0].delays):
            raise ArgumentError(
                "plant must have the same delays at all corners of the polytope: give a range of "
                "one delay as delays=(low, high)."
            )
    return plants, None, delays


def delays_of(
    delays: Range | None, plant: SwitchedSystem, step: float
) -> tuple[float, float] | np.ndarray:
    """What `Setting.delays` holds."""
    if delays is None:
        return (plant.delay, plant.delay) if plant.has_one_delay else plant.delays
    if plant.has_one_delay and not any(np.iterable(end) for end in delays):
        low, high = (positive("delays", value) for value in delays)
        if low > high:
            raise ArgumentError(f"delays must ascend, got ({low:g}, {high:g}).")
        _require_one_period(low, high, step, "delays")
        return low, high
    shape = plant.delays.shape
    ends = np.stack([check_delays(end, shape, "delays") for end in delays])
    for i, j in np.ndindex(shape):
        name, (low, high) = f"delays of input {j} in mode {i}", ends[:, i, j].tolist()
        if low > high:
            raise ArgumentError(f"{name} must ascend, got ({low:g}, {high:g}).")
        _require_one_period(low, high, step, name)
    return ends if np.any(ends[0] < ends[1]) else ends[0]


def _require_one_period(low: float, high: float, step: float, name: str) -> None:
    try:
        DelayInterval.of(low, high, step)
    except ValueError:
        raise ArgumentError(
            f"{name} must lie within one period, between two multiples of step = {step:g} s, got "
            f"({low:g}, {high:g}): certify the parts one by one, as delay_margin does."
        ) from None


def extremes(
    plants: list[SwitchedSystem],
    axes: np.ndarray | None,
    delays: tuple[float, float] | np.ndarray,
    table: Feedback,
) -> list[SwitchedSystem]:
    """Plants at which constant modes are looked at: the vertices, and bad ones of an ellipsoid.

    All at the ends of the delays' ranges.
    """
    ends: Any = [delays]
    if isinstance(delays, tuple):
        ends = sorted(set(delays))
    elif delays.ndim == 3:
        ends = list(delays)
    found = [SwitchedSystem(p.A, p.B, delay) for p in plants for delay in ends]
    if axes is not None:
        found += [_worst(one, axes, table, i) for one in found for i in range(one.modes)]
    return found


def _worst(plant: SwitchedSystem, axes: np.ndarray, table: Feedback, mode: int) -> SwitchedSystem:
    """A plant of the ellipsoid in which a constant mode grows about fastest: along the gradient."""
    n, row = plant.states, aged_row(table, mode)

    def at(z: np.ndarray) -> SwitchedSystem:
        moved = np.tensordot(z, axes, 1)
        return plant.like(plant.A + moved[..., :n], plant.B + moved[..., n:])

    def growth(z: np.ndarray) -> float:
        return constant_growth(with_memory(at(z), table), table, mode, row)

    unit = np.eye(len(axes))
    touching = np.flatnonzero(np.any(axes[:, mode], axis=(1, 2)))
    z = best = np.zeros(len(axes))
    most = growth(z)
    for _ in range(ROUNDS):
        here, gradient = growth(z), np.zeros(len(axes))
        for k in touching:
            gradient[k] = (growth(z + MOVE * unit[k]) - here) / MOVE
        size = float(np.linalg.norm(gradient))
        if not 0.0 < size < np.inf:
            break
        z = gradient / size * (1.0 - 1e-9)
        if growth(z) > most:
            most, best = growth(z), z
    return at(best)
