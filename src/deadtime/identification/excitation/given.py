"""What `design_experiment` is given, checked: modes of rows, periods that count, noise, the law."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import ArrayLike

from deadtime.base.checks import as_floats, bound, instance
from deadtime.base.errors import ArgumentError
from deadtime.identification.likelihoods.likelihood import REACH
from deadtime.identification.parameters import Layout, cells_of
from deadtime.numerics.covariance import noise_covariances
from deadtime.plant import SwitchedSystem
from deadtime.switching import SwitchingSignal
from deadtime.switching.grid import modes_at

if TYPE_CHECKING:
    from deadtime.feedback import Feedback, Law

_FLOOR = 1e-9  # of all noise, that W has in every direction: its root has an inverse


def modes_of_rows(
    plant: SwitchedSystem, signal: SwitchingSignal | None, step: float, samples: int
) -> Int[np.ndarray, " sample"]:
    """The mode of every row."""
    if signal is None:
        if plant.modes > 1:
            raise ArgumentError(
                f"signal must be given for a plant of {plant.modes} modes: those that it is put "
                "into, such as SwitchingSignal.periodic([2.0, 2.0], [0, 1], horizon)."
            )
        return np.zeros(samples, np.int64)
    instance("signal", signal, SwitchingSignal)
    signal.require_modes(plant.modes)
    return np.asarray(modes_at(signal, step * np.arange(samples), step), np.int64)


def used_periods(
    plant: SwitchedSystem, mode: np.ndarray, step: float, layout: Layout, anywhere: bool
) -> Bool[np.ndarray, " sample"]:
    """The periods that an identification uses: those whose inputs it knows."""
    first = int(cells_of(plant.delays.max(keepdims=True).ravel() + REACH * step, step)[0])
    used = np.arange(mode.size) >= first
    used[-1:] = False
    if anywhere:
        used[:-1] &= mode[1:] == mode[:-1]
    least = layout.least_periods
    visits = np.bincount(mode[used], minlength=layout.modes)
    for i in np.flatnonzero(visits < least):
        what = f"signal must hold mode {i} for" if layout.modes > 1 else "horizon must have"
        raise ArgumentError(
            f"{what} at least {least} periods after the first "
            f"{first * step:g} s, got {visits[i]}: so short a log hardly tells it. "
            "Lengthen the horizon, or visit the mode for longer."
        )
    return used


def intensity_of(plant: SwitchedSystem, disturbance: ArrayLike) -> Float[np.ndarray, "mode n n"]:
    """W of every mode."""
    n, form = plant.states, "a number, (n,), (n, n) or (modes, n, n)"
    given = as_floats("disturbance", disturbance, form)
    each = {0: lambda W: W * np.eye(n), 1: np.diag}.get(given.ndim, lambda W: W)(given)
    if each.shape not in ((n, n), (plant.modes, n, n)) or not np.isfinite(each).all():
        raise ArgumentError(f"disturbance must be {form}, finite, got shape {given.shape}.")
    W = np.broadcast_to(each, (plant.modes, n, n))
    size = np.abs(W).max()
    askew = np.abs(W - W.swapaxes(1, 2)).max() > 1e-9 * size
    if askew or np.linalg.eigvalsh(W).min() < -1e-9 * size:
        raise ArgumentError(
            f"disturbance must be symmetric and positive semidefinite, got {given.tolist()}."
        )
    return W


def deviations_of(plant: SwitchedSystem, noise: ArrayLike) -> Float[np.ndarray, " n"]:
    """The standard deviations of the sensors of the states."""
    deviation = bound("noise", noise, plant.states)
    if not ((deviation >= 0.0) & np.isfinite(deviation)).all():
        raise ArgumentError(
            "noise must be the standard deviation of every state's sensor, finite and at least 0, "
            f"got {deviation.tolist()}."
        )
    return deviation


def one_for_all(
    W: Float[np.ndarray, "mode n n"], mode: Int[np.ndarray, " sample"]
) -> tuple[Float[np.ndarray, "mode n n"], bool]:
    """The mean of W over the rows, in every mode, and whether modes had another one."""
    share = np.bincount(mode, minlength=len(W)) / mode.size
    mean = np.broadcast_to(np.tensordot(share, W, 1), W.shape)
    own = np.abs(W - W[0]).max() > 1e-9 * np.abs(W).max()
    return (mean, True) if own else (W, False)


def added_noise(
    plant: SwitchedSystem,
    W: Float[np.ndarray, "mode n n"],
    step: float,
    deviation: Float[np.ndarray, " n"],
) -> Float[np.ndarray, "mode n n"]:
    """S of every mode: what noise adds in a period."""
    S = noise_covariances(plant.A, W, np.full(len(W), step))
    try:
        np.linalg.cholesky(S + np.diag(deviation**2))
    except np.linalg.LinAlgError:
        raise ArgumentError(
            "disturbance must move every state within a period, in every mode, or its sensor be "
            "noisy: without noise a log tells a delay exactly, whatever the inputs. Give a W that "
            "reaches all states, or their noise=."
        ) from None
    return S


def root_of(
    W: Float[np.ndarray, "n n"], deviation: Float[np.ndarray, " n"], step: float
) -> Float[np.ndarray, "n n"]:
    """L with W = L Lᵀ, of a W that has a little in every direction."""
    floor = _FLOOR * (float(np.trace(W)) + float((deviation**2).sum()) / step)
    return np.linalg.cholesky(W + floor * np.eye(len(W)))


def table_of(
    law: Law | None, plant: SwitchedSystem, step: float, mode: np.ndarray
) -> Feedback | None:
    """The law's table."""
    if law is None:
        return None
    from deadtime.feedback import Law

    instance("law", law, Law)
    if law.outputs is not None:
        raise ArgumentError(
            "law must be one of the measured states here: an observer's error is not followed. "
            "Give the law that the observer feeds."
        )
    times = step * np.arange(mode.size)
    at = np.flatnonzero(np.diff(mode, prepend=-1))
    along = SwitchingSignal(times[at], mode[at])
    table = law.digital(step, along, mode.size)
    m, n = table.state_gain.shape[1:]
    if (n, m) != (plant.states, plant.inputs) or table.memory:
        raise ArgumentError(
            f"law must be a table of {plant.states} states and {plant.inputs} inputs without a "
            f"memory of its own, got {n} and {m}."
        )
    return table
