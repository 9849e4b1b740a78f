"""Operating points: plants that rest elsewhere than at 0.

    dx/dt = A_σ (x − x₀) + B_σ (u(t − D) − u₀) = A_σ x + B_σ u(t − D) + c_σ

A log is taken about a level of its own, (x̄, ū), where it rests or its mean, and there each mode has
a constant term c̃ of its own. About 0 that is c = c̃ − A x̄ − B ū. Where all c are 0 as far as the log
tells (Wald's test), the log is about 0 and terms are left out. Else an operating point is what every
mode rests at,

    A_i x₀ + B_i u₀ = A_i x̄ + B_i ū − c̃_i    for all i,

of all that do the nearest to (x̄, ū) in deviations of the log: where modes share no such point, what
is left over is an offset of each.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from jaxtyping import Float

from deadtime.base.frozen import Frozen
from deadtime.identification.intervals import inverse
from deadtime.identification.log.recording import Level, Recording
from deadtime.identification.parameters import Layout

if TYPE_CHECKING:
    from deadtime.identification.estimate import Estimate
    from deadtime.identification.maximum import ExactLog
    from deadtime.identification.noisy.likelihood import NoisyLog

    _Log = TypeVar("_Log", ExactLog, NoisyLog)

CHANCE = 0.01  # that constant terms are taken for such though there are none
_APART = 1e-3  # that modes are taken to rest apart though they do not
_NOTHING = 1e-6  # deviations of a log: a level so near to 0 is round-off
_RANK = 1e-6  # of the largest singular value, scaled: a direction that hardly moves a rest


@dataclass(frozen=True, eq=False)
class OperatingPoint(Frozen):
    """Where a plant rests: dx/dt = A_σ (x − states) + B_σ (u(t − D) − inputs) + offset_σ.

    Attributes
    ----------
    states : (n,) array
    inputs : (m,) array
    offset : (modes, n) array
        What each mode adds beside, x per second; 0 where modes rest at the same point.
    """

    states: Float[np.ndarray, " n"]
    inputs: Float[np.ndarray, " m"]
    offset: Float[np.ndarray, "mode n"]


def level_of(recording: Recording) -> Level:
    """The level that a log is taken about: where it rests before its inputs move, else its mean."""
    for part in recording.parts:
        if part.rests:
            own = slice(rest_rows(part.input))
            return Level(np.nanmean(part.output[own], axis=0), part.input[0].copy())
    every = [np.vstack([part[a] for part in recording.parts]) for a in (1, 2)]
    return Level(*(np.nanmean(one, axis=0) for one in every))


def rest_rows(entered: Float[np.ndarray, "sample m"]) -> int:
    """The first rows, in which no input has moved yet."""
    moved = np.flatnonzero((entered != entered[0]).any(axis=1))
    return int(moved[0]) if moved.size else len(entered)


def with_constant(
    theta: Float[np.ndarray, " size"], layout: Layout, level: Level, back: Float[np.ndarray, "n p"]
) -> tuple[Float[np.ndarray, " size"], Layout]:
    """The vector of the same plant about a level; `back` makes states of outputs."""
    if layout.constant:
        return theta, layout
    A, B, delays = layout.split(theta)
    terms = A @ (back @ level.output) + B @ level.input
    return layout.join(A, np.concatenate((B, terms[:, :, None]), axis=2), delays), replace(
        layout, constant=True
    )


def without_level(
    log: _Log,
    theta: Float[np.ndarray, " size"],
    information: Float[np.ndarray, "size size"],
    back: Float[np.ndarray, "n p"],
) -> tuple[_Log, Float[np.ndarray, " size"]]:
    """The likelihood, and where to climb on, without constant terms if the log does not ask for them.

    information : of a vector at which the likelihood is largest
    """
    layout, level = log.layout, log.recording.level
    if level is None or not layout.constant or needs_level(layout, theta, information, level, back):
        return log, theta
    smaller, kept = layout.without_constant()
    own = np.concatenate((kept, np.arange(layout.size, theta.size)))
    plain = replace(log, recording=log.recording.absolute(), layout=smaller)
    return plain, theta[own]


def needs_level(
    layout: Layout,
    theta: Float[np.ndarray, " size"],
    information: Float[np.ndarray, "size size"],
    level: Level,
    back: Float[np.ndarray, "n p"],
) -> bool:
    """Whether constant terms about 0 are told from none, by Wald's test."""
    from scipy.stats import chi2

    terms, variance = _about(layout, theta, information, back @ level.output, level.input)
    free = np.diagonal(variance) > 0.0
    return free.any() and _wald(terms[free], variance[np.ix_(free, free)]) > float(
        chi2.isf(CHANCE, int(free.sum()))
    )


def operating_point(found: Estimate, back: Float[np.ndarray, "n p"]) -> OperatingPoint | None:
    """Where the plant of an estimate rests; None where that is 0."""
    from scipy.stats import chi2

    log, recording = found.log, found.log.recording
    layout, level = log.layout, recording.level
    if level is None or not layout.constant:
        return None
    theta = found.best.theta[: layout.size]
    A, B, _ = layout.split(theta)
    every = [np.vstack([part[a] for part in recording.parts]) for a in (1, 2)]
    scale = np.concatenate((np.abs(back) @ np.nanstd(every[0], axis=0), np.nanstd(every[1], axis=0)))
    scale = np.where(scale > 0.0, scale, scale[scale > 0.0].min())
    M = np.vstack([np.hstack((A[i], B[i][:, : layout.m])) for i in range(layout.modes)])
    size = 1.0 / np.maximum(np.linalg.norm(M * scale, axis=1), 1e-300)
    weighted = size[:, None] * M * scale
    terms = layout.constant_of(theta).ravel()
    shift = scale * np.linalg.lstsq(weighted, -size * terms, rcond=_RANK)[0]
    at, of = shift[: layout.n], shift[layout.n :]
    left, variance = _about(layout, theta, _information(found), -at, -of)
    free, rank = np.diagonal(variance) > 0.0, np.linalg.matrix_rank(weighted, tol=_RANK)
    spare, offset = int(free.sum()) - int(rank), np.zeros(A.shape[:2])
    if spare > 0 and _wald(left[free], variance[np.ix_(free, free)]) > chi2.isf(_APART, spare):
        offset = left.reshape(A.shape[:2])
    states, inputs = back @ level.output + at, level.input + of
    return OperatingPoint(states, inputs, offset)


def _information(found: Estimate) -> Float[np.ndarray, "size size"]:
    return found.best.found.information


def _about(
    layout: Layout,
    theta: Float[np.ndarray, " size"],
    information: Float[np.ndarray, "size size"],
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
    seen = np.diagonal(information) > 0.0
    C = inverse(information[np.ix_(seen, seen)])
    by_theta[:, ~seen] = 0.0
    variance = by_theta[:, seen] @ C @ by_theta[:, seen].T
    return terms.ravel(), variance


def _wald(terms: Float[np.ndarray, " term"], variance: Float[np.ndarray, "term term"]) -> float:
    """How far terms are from 0, in their covariance."""
    unit = 1.0 / np.sqrt(np.diagonal(variance))
    scaled = np.linalg.pinv(variance * unit * unit[:, None], rcond=1e-10, hermitian=True)
    return float((terms * unit) @ scaled @ (terms * unit))
