"""Operating points: plants whose rest is not at 0.

    dx/dt = A_σ (x − x₀) + B_σ (u(t − D) − u₀) = A_σ x + B_σ u(t − D) + c_σ

A level (x̄, ū), the rest at the beginning of the log or its mean, is subtracted from the log. About
it each mode has a constant term c̃, which about 0 is c = c̃ − A x̄ − B ū. If 0 lies within the range
of the log and no c differs significantly from 0 (Wald's test), constant terms are left out. Far
from 0 the test is not made: c = 0 ties the states to the inputs at the level, and would determine
the matrices of a log that cannot contradict it. Otherwise the operating point satisfies

    A_i x₀ + B_i u₀ = A_i x̄ + B_i ū − c̃_i    for all i.

Of several solutions it is the nearest to (x̄, ū) in standard deviations of the log. If there is
none, each mode has its residual as an offset.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple, TypeVar

import numpy as np
from jaxtyping import Float, Int

from deadtime.identification.estimate import Estimate
from deadtime.identification.intervals import inverse
from deadtime.identification.likelihoods.likelihood import Likelihood
from deadtime.identification.log.logged_states import rest_rows
from deadtime.identification.log.recording import Level, Recording
from deadtime.identification.parameters import FisherMatrix, Layout, Vector
from deadtime.identification.residuals import CHANCE
from deadtime.plant import OperatingPoint

_Log = TypeVar("_Log", bound=Likelihood)

_SELDOM = 1e-6  # significance level of constant terms where noise is estimated, too
_APART = 1e-3  # significance level of different rests of modes
_NOTHING = 1e-6  # constant terms relative to the other terms of dx/dt: smaller ones are round-off
_RIDGE = 1e-4  # weight of the distance to the level, which selects the nearest of many points
_BESIDE = 0.1  # of the range of a column: so far outside it 0 still counts as near
_RANK = 1e-6  # relative singular value of directions that hardly change a rest


def near_zero(recording: Recording) -> bool:
    """Whether 0 lies within or near the range of all outputs and inputs."""
    parts = recording.absolute().parts
    low, high = _ends(np.vstack([np.hstack((part.output, part.input)) for part in parts]))
    return bool(((low <= 0.0) & (high >= 0.0)).all())


class Rest(NamedTuple):
    """The operating point and offsets in dx/dt = A_σ (x − x₀) + B_σ (u − u₀) + offset_σ.

    error : (n + m,), standard errors of x₀ and u₀; offset : 0 where modes rest at the same point
    """

    point: OperatingPoint
    error: Float[np.ndarray, " xu"]
    offset: Float[np.ndarray, "mode n"]


def level_of(recording: Recording) -> Level:
    """The level to subtract: the rest before inputs move, else the mean."""
    for part in recording.parts:
        if part.rests:
            own = slice(rest_rows(part.input))
            return Level(known_mean(part.output[own]), part.input[0].copy())
    every = [np.vstack([part[a] for part in recording.parts]) for a in (1, 2)]
    return Level(*(known_mean(one) for one in every))


def known_mean(column: Float[np.ndarray, "sample p"]) -> Float[np.ndarray, " p"]:
    """The mean of the known values of each column; 0 if there are none."""
    known = np.isfinite(column)
    return np.where(known, column, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)


def with_constant(
    theta: Vector, layout: Layout, level: Level, back: Float[np.ndarray, "n p"]
) -> tuple[Float[np.ndarray, " larger"], Layout]:
    """The vector of the same plant about a level; `back` maps outputs to states."""
    if layout.constant:
        return theta, layout
    A, B, delays = layout.split(theta)
    terms = A @ (back @ level.output) + B @ level.input
    return layout.join(A, np.concatenate((B, terms[:, :, None]), axis=2), delays), replace(
        layout, constant=True
    )


def without_level(
    log: _Log, theta: Vector, information: FisherMatrix, back: Float[np.ndarray, "n p"]
) -> tuple[_Log, Int[np.ndarray, " kept"]]:
    """The likelihood without constant terms unless these are significant; and the places kept.

    information : at the maximum `theta`
    """
    from scipy.stats import chi2

    if log.recording.level is None or not log.layout.constant or not near_zero(log.recording):
        return log, np.arange(theta.size)
    far, terms = from_zero(log.layout, theta, information, log.recording, back)
    if terms and far > float(chi2.isf(CHANCE, terms)):
        return log, np.arange(theta.size)
    return at_zero(log, theta.size)


def at_zero(log: _Log, size: int) -> tuple[_Log, Int[np.ndarray, " kept"]]:
    """The likelihood of plants that rest at 0, and the places of a vector that it keeps."""
    smaller, kept = log.layout.without_constant()
    plain = replace(log, recording=log.recording.absolute(), layout=smaller)
    return plain, np.append(kept, np.arange(log.layout.size, size))


def likelier_than_chance(rise: float, more: int) -> bool:
    """Whether constant terms raise log L significantly.

    The level is strict. In logs of 300 rows with 26 unknowns and noise of plant and sensors, 2 log
    L rose by twice the mean of χ²: constants absorb some of the plant's noise, and its estimate
    falls.
    """
    from scipy.stats import chi2

    return bool(2.0 * rise > chi2.isf(_SELDOM, more))


def from_zero(
    layout: Layout,
    theta: Vector,
    information: FisherMatrix,
    recording: Recording,
    back: Float[np.ndarray, "n p"],
) -> tuple[float, int]:
    """Wald's statistic of the constant terms about 0 that exceed round-off, and their number."""
    assert recording.level is not None
    level, scale = recording.level, _deviations(recording, back)
    terms, variance = _constants_about(layout, theta, information, back @ level.output, level.input)
    A, B, _ = layout.split(theta[: layout.size])
    size = np.abs(np.concatenate((A, B[:, :, : layout.m]), axis=2)) @ scale
    free = (np.diagonal(variance) > 0.0) & (np.abs(terms) > _NOTHING * size.ravel())
    if not free.any():
        return 0.0, 0
    return _wald(terms[free], variance[np.ix_(free, free)]), int(free.sum())


def rest_of(estimate: Estimate, back: Float[np.ndarray, "n p"]) -> Rest | None:
    """The operating point of an estimate; None if it is 0."""
    from scipy.optimize import lsq_linear
    from scipy.stats import chi2

    log, recording = estimate.log, estimate.log.recording
    layout, level = log.layout, recording.level
    if level is None or not layout.constant:
        return None
    theta, information = estimate.best.theta[: layout.size], estimate.best.information
    A, B, _ = layout.split(theta)
    scale = _deviations(recording, back)
    M = np.vstack([np.hstack((A[i], B[i][:, : layout.m])) for i in range(layout.modes)])
    size = 1.0 / np.maximum(np.linalg.norm(M * scale, axis=1), 1e-300)
    weighted = size[:, None] * M * scale
    solve = scale[:, None] * np.linalg.pinv(weighted, rcond=_RANK) * size
    terms = layout.constant_of(theta).ravel()
    logged = np.vstack([np.hstack((p.output @ back.T, p.input)) for p in recording.parts])
    shift, ends = -solve @ terms, _ends(logged)
    spare = int(np.linalg.matrix_rank(weighted, tol=_RANK))
    if ((shift < ends[0]) | (shift > ends[1])).any():
        # Nearly parallel rest equations of modes meet far away: search within the log's range.
        own = np.vstack((weighted, _RIDGE * np.eye(shift.size)))
        given = np.append(-size * terms, np.zeros(shift.size))
        shift, spare = scale * lsq_linear(own, given, ends / scale).x, 0
    shift[np.abs(shift) < _NOTHING * scale] = 0.0  # round-off of a zero
    states, inputs = shift[: layout.n], shift[layout.n :]
    left, variance = _constants_about(layout, theta, information, -states, -inputs)
    free = np.diagonal(variance) > 0.0
    spare = int(free.sum()) - spare
    apart = spare > 0 and _wald(left[free], variance[np.ix_(free, free)]) > chi2.isf(_APART, spare)
    point = OperatingPoint(back @ level.output + states, level.input + inputs)
    error = np.sqrt(np.einsum("ab,bc,ac->a", solve, variance, solve).clip(0.0))
    return Rest(point, error, left.reshape(A.shape[:2]) if apart else np.zeros(A.shape[:2]))


def _ends(columns: Float[np.ndarray, "row xu"]) -> Float[np.ndarray, "2 xu"]:
    """The ends of the range of each column, widened by `_BESIDE`."""
    low, high = np.nanmin(columns, axis=0), np.nanmax(columns, axis=0)
    beside = _BESIDE * np.where(high > low, high - low, np.inf)  # a speed that was not logged
    return np.array([low - beside, high + beside])


def _deviations(recording: Recording, back: Float[np.ndarray, "n p"]) -> Float[np.ndarray, " xu"]:
    """Standard deviations of states and inputs over the log."""
    every = [np.vstack([part[a] for part in recording.parts]) for a in (1, 2)]
    states, inputs = (np.nanstd(one, axis=0) for one in every)
    scale = np.concatenate((np.abs(back) @ states, inputs))
    return np.where(scale > 0.0, scale, scale.max())


def _constants_about(
    layout: Layout,
    theta: Vector,
    information: Float[np.ndarray, "unknown unknown"],
    states: Float[np.ndarray, " n"],
    inputs: Float[np.ndarray, " m"],
) -> tuple[Float[np.ndarray, " term"], Float[np.ndarray, "term term"]]:
    """The constant terms about −(states, inputs), mode by mode, and their covariance."""
    A, B, _ = layout.split(theta[: layout.size])
    terms = layout.constant_of(theta) - A @ states - B[:, :, : layout.m] @ inputs
    by_theta = np.zeros((terms.size, len(information)))
    row = np.arange(terms.size).reshape(terms.shape)
    for b, x in enumerate(states):
        by_theta[row, layout.of_A[:, :, b]] = -x
    for j, u in enumerate(inputs):
        by_theta[row, layout.of_B[:, :, j]] = -u
    by_theta[row, layout.of_B[:, :, layout.m]] = 1.0
    known = np.diagonal(information) > 0.0
    C = inverse(information[np.ix_(known, known)])
    variance = by_theta[:, known] @ C @ by_theta[:, known].T
    return terms.ravel(), variance


def _wald(terms: Float[np.ndarray, " term"], variance: Float[np.ndarray, "term term"]) -> float:
    """cᵀ V⁺ c of terms c with covariance V, scaled first: units of terms differ."""
    unit = 1.0 / np.sqrt(np.diagonal(variance))
    scaled = np.linalg.pinv(variance * unit * unit[:, None], rcond=1e-10, hermitian=True)
    return float((terms * unit) @ scaled @ (terms * unit))
