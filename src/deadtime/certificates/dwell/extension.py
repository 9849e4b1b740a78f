"""From a few directions of the table's rows to all of them, for the proof.

The search tells rows apart along a few directions only, and P comes from that. For the proof
the directions must hold every row: with R complete, the best multiplier for the P at hand is the
partial minimum over ξ of

    ξᵀ P ξ − (M₀ ξ + B w)ᵀ P (M₀ ξ + B w)/ρ² − slack    for given (v, w),

a Schur complement. One large inequality then still proves all rows.
"""

from __future__ import annotations

import numpy as np

from deadtime.certificates.dwell.centre import CentreFloats
from deadtime.certificates.proof.evidence import Evidence

ALL = 10**6
# (v, w) that no ξ, or hardly any, gives rise to: singular values of Y as parts of the largest,
# and the weights, as parts of the largest entry of Π, which stand for the partial minimum there.
NONE, HARDLY = 1e-13, 1e-6
WEIGHT_NONE, WEIGHT_HARDLY = 1e6, 1.0


def extend(evidence: Evidence, model: CentreFloats, slack: np.ndarray) -> Evidence | None:
    """The same P and S with all directions of the rows, and Π from P; None where that fails."""
    from scipy.linalg import cho_factor, cho_solve, null_space

    setting = evidence.setting
    full = CentreFloats.of(setting, model.eigenvectors, ALL)
    P, rho, d = evidence.P, evidence.rho, setting.order
    moved = np.concatenate((full.M, full.B), axis=1) / rho
    form = -moved.T @ P @ moved
    form[:d, :d] += P
    form[np.diag_indices_from(form)] -= slack
    inside = 1.0 / np.sqrt(np.maximum(np.abs(np.diag(form)), 1e-300))
    form = form * inside * inside[:, None]
    wide = full.channels.wide * inside
    units = 1.0 / np.linalg.norm(wide, axis=1)
    left, sizes, right = np.linalg.svd(wide * units[:, None])
    values = np.zeros(len(left))
    values[: len(sizes)] = sizes
    keep, none = values > HARDLY * values[0], left[:, values <= NONE * values[0]]
    hardly = left[:, ~keep & (values > NONE * values[0])]
    left, values, right = left[:, keep], values[keep], right[: len(sizes)][keep[: len(sizes)]]
    rest = null_space(right)
    across = rest.T @ form @ right.T
    try:
        inner = cho_factor(rest.T @ form @ rest)
    except np.linalg.LinAlgError:
        return None
    best = right @ form @ right.T - across.T @ cho_solve(inner, across)
    back = left / values
    Pi = back @ best @ back.T
    outside = WEIGHT_NONE * (none @ none.T) + WEIGHT_HARDLY * (hardly @ hardly.T)
    Pi = Pi + np.abs(Pi).max() * outside
    Pi = Pi * units * units[:, None]
    return Evidence(
        setting,
        full.centre,
        P,
        0.5 * (Pi + Pi.T),
        evidence.S,
        evidence.knots,
        rho,
    )
