"""How well a log knows each unknown, from its information."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.errors import ArgumentError
from deadtime.identification.parameters import Vector

LEVEL = 0.95
_UNSEEN = 1e-12  # of an eigenvalue of the information, scaled to a diagonal of ones


class Spread(NamedTuple):
    """The covariance of all unknowns, and how many standard errors an interval of each reaches.

    inflation : of each unknown's variance, over that of the information as it is
    spare : observations beyond those that unknowns cost, of each unknown
    """

    covariance: Float[np.ndarray, "size size"]
    reach: Vector
    inflation: Vector
    spare: Vector


def spread_of(
    F: Float[np.ndarray, "size size"],
    names: list[str],
    known: Float[np.ndarray, "size size"],
    spare: Vector,
) -> Spread:
    """The inverse of what is `known`, the information F less what the noise's own estimate costs.

    spare : observations beyond those that unknowns cost, of each unknown

    Raises
    ------
    ArgumentError
        If the log does not tell a direction of the unknowns, which is named.
    """
    from scipy.stats import t

    require_seen(F, names)
    covariance = inverse(known)
    inflation = np.diagonal(covariance) / np.diagonal(inverse(F))
    return Spread(covariance, np.asarray(t.ppf(0.5 + 0.5 * LEVEL, spare)), inflation, spare)


def inverse(F: Float[np.ndarray, "size size"]) -> Float[np.ndarray, "size size"]:
    """F⁻¹, scaled so that units of the unknowns do not matter."""
    unit = 1.0 / np.sqrt(np.diagonal(F))
    return np.linalg.inv(F * unit[:, None] * unit) * unit[:, None] * unit


def require_seen(F: Float[np.ndarray, "size size"], names: list[str]) -> None:
    """Refuse an information that is singular, by the direction that it does not hold."""
    diagonal = np.diagonal(F)
    blind = [names[a] for a in np.flatnonzero(~(diagonal > 0.0)) if a < len(names)]
    if blind or not np.isfinite(F).all():
        raise ArgumentError(
            f"log tells nothing of {', '.join(blind) or 'its unknowns'}: what they multiply never "
            "moves. Excite it, or leave it out."
        )
    scaled = F / np.sqrt(diagonal)[:, None] / np.sqrt(diagonal)
    values, vectors = np.linalg.eigh(scaled)
    if values[0] > _UNSEEN:
        return
    direction = vectors[:, 0]
    part = np.abs(direction) > 0.2 * np.abs(direction).max()
    together = [names[a] if a < len(names) else "kinds of noise" for a in np.flatnonzero(part)]
    raise ArgumentError(
        f"log does not tell {', '.join(dict.fromkeys(together))} apart: they can all change "
        "together and nothing in it would. Log a run in which states and inputs move apart, such "
        "as with an input that is not a function of the state alone, or widen delay=(low, high) if "
        "the delay may lie outside it."
    )


def left_of(
    J: Float[np.ndarray, "all all"], of: Int[np.ndarray, " of"]
) -> Float[np.ndarray, "of of"]:
    """Schur's complement: what is left of the information on some unknowns, the others estimated.

    Of scaled unknowns, so that units do not matter to what counts as no information.
    """
    rest = np.setdiff1d(np.arange(len(J)), of)
    unit = 1.0 / np.sqrt(np.maximum(np.abs(np.diagonal(J)), 1e-300))
    scaled = J * unit[:, None] * unit
    cross, own = scaled[np.ix_(of, rest)], scaled[np.ix_(rest, rest)]
    left = scaled[np.ix_(of, of)] - cross @ np.linalg.pinv(own, _UNSEEN, hermitian=True) @ cross.T
    return left / unit[of, None] / unit[of]
