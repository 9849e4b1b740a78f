"""What a mode filter is given, checked."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.base.checks import (
    as_floats,
    read_only,
    real_array,
    require_covariance,
    require_shape,
)
from deadtime.base.errors import ArgumentError
from deadtime.loop.running_belief import belief_of
from deadtime.plant import SwitchedSystem

_ALIKE = 1e-9  # of an entry: modes whose entries all differ by less are the same


def require_distinct(plant: SwitchedSystem) -> None:
    """Refuse two modes of which x and u do the same in both."""
    for i in range(plant.modes):
        for j in range(i):
            pairs = ((plant.A[i], plant.A[j]), (plant.B[i], plant.B[j]))
            same = all(_alike(one, other) for one, other in pairs)
            # The delay of an input that does nothing shows nowhere.
            acts = (plant.B[i] != 0.0).any(axis=0)
            if same and _alike(plant.delays[i][acts], plant.delays[j][acts]):
                raise ArgumentError(
                    f"modes {j} and {i} cannot be told apart: A, B and delays are the same, so x "
                    "shows the same in both. Make one mode of them, or allow_alike = True: then "
                    "they share what the switching model gives them."
                )


def require_distinct_outputs(plant: SwitchedSystem, C: Float[np.ndarray, "mode p n"]) -> None:
    """Refuse two modes in which the same x and u give the same outputs at all times.

    By Cayley and Hamilton for the two together: C A^k, and C A^k B of inputs that are as late in
    both, for k < 2n.
    """
    responses, n = [_responses(A, own) for A, own in zip(plant.A, C, strict=True)], plant.states
    for i in range(plant.modes):
        for j in range(i):
            (one, size), (other, its) = responses[i], responses[j]
            most = np.maximum(size, its)
            same = (np.abs(one - other) <= _ALIKE * most).all()
            acting = [one @ plant.B[i], other @ plant.B[j]]
            least = _ALIKE * most @ np.maximum(np.abs(plant.B[i]), np.abs(plant.B[j]))
            same &= (np.abs(acting[0] - acting[1]) <= least).all()
            acts = (np.abs(acting[0]) > least).any(axis=0)
            if same and _alike(plant.delays[i][acts], plant.delays[j][acts]):
                raise ArgumentError(
                    f"modes {j} and {i} cannot be told apart: the same state and inputs give the "
                    f"same outputs in both, C A^k and C A^k B up to k = {2 * n - 1} and delays. "
                    "Measure more, make one mode of them, or allow_alike = True: then they share "
                    "what the switching model gives them."
                )


def _responses(
    A: Float[np.ndarray, "n n"], C: Float[np.ndarray, "p n"]
) -> tuple[np.ndarray, np.ndarray]:
    """C A^k for k < 2n, one below the other, and the sizes of what these add up."""
    rows, sizes = [C], [np.abs(C)]
    for _ in range(2 * len(A) - 1):
        rows.append(rows[-1] @ A)
        sizes.append(sizes[-1] @ np.abs(A))
    return np.concatenate(rows), np.concatenate(sizes)


def _alike(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether all entries are the same, each by its own size, whatever its unit."""
    return bool((np.abs(one - other) <= _ALIKE * np.maximum(np.abs(one), np.abs(other))).all())


def intensities(value: ArrayLike, modes: int, n: int) -> Float[np.ndarray, "*mode n n"]:
    """W, or where modes have their own, W of each."""
    name, form = "disturbance", "one, (n,), (n, n) or (modes, n, n)"
    given = as_floats(name, value, form)
    if given.ndim < 3:
        return intensity(given, n)
    given = real_array(name, given, form, 3)
    require_shape(name, given, (modes, n, n), "(modes, n, n)")
    each = [intensity(W, n, f"{name}[{mode}]") for mode, W in enumerate(given)]
    return each[0] if (given == given[0]).all() else read_only(np.stack(each))


def intensity(value: ArrayLike, n: int, name: str = "disturbance") -> Float[np.ndarray, "n n"]:
    """W, or a covariance, as a matrix."""
    given = as_floats(name, value, "one, (n,) or (n, n)")
    if given.ndim < 2 and (given < 0.0).any():
        raise ArgumentError(
            f"{name} must be ≥ 0, a variance or an intensity, got {given.tolist()}."
        )
    if given.ndim < 2:
        given = np.diag(np.full(n, given) if given.ndim == 0 else given)
    W = require_shape(name, real_array(name, given, "(n, n)", 2), (n, n), "(n, n)")
    require_covariance(name, W)
    return read_only(0.5 * (W + W.T))  # a restored state must be symmetric to the last bit


def deviation(value: ArrayLike, size: int, letter: str = "n") -> Float[np.ndarray, " size"]:
    """A standard deviation per state, or per output."""
    form = f"({letter},)"
    given = as_floats("noise", value, f"one or {form}")
    whole = real_array("noise", np.full(size, given) if given.ndim == 0 else given, form, 1)
    if require_shape("noise", whole, (size,), form).min() < 0.0:
        raise ArgumentError(f"noise must be ≥ 0, a standard deviation, got {whole.tolist()}.")
    return whole


def first_belief(value: ArrayLike | None, modes: int, ages: int) -> Float[np.ndarray, "mode age"]:
    """π_0; of a belief over modes alone all are just begun."""
    whole = np.zeros((modes, ages))
    whole[:, 0] = 1.0
    return whole / modes if value is None else belief_of("initial", value, whole)
