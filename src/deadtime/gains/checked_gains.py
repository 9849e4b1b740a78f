"""Gains as arguments: their shapes, and that they leave every mode stable."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from deadtime.base.checks import real_array, require_shape
from deadtime.base.errors import ArgumentError
from deadtime.plant import SwitchedSystem


def check_gains(
    plant: SwitchedSystem, gains: object, allow_unstable: bool
) -> Float[np.ndarray, "mode m n"]:
    """`gains` as a (modes, m, n) array with every A_i + B_i K_i Hurwitz, unless that is waived."""
    K = real_array("gains", gains, "(modes, m, n)", 3)  # pyright: ignore[reportArgumentType]
    if K.shape[0] != plant.modes:
        raise ArgumentError(
            f"gains must hold one (m, n) matrix per mode, {plant.modes}, got {K.shape[0]}: "
            "they may be the gains of another plant."
        )
    for i in range(plant.modes):
        require_shape(f"gains[{i}]", K[i], (plant.inputs, plant.states), "(m, n)")
        require_hurwitz(f"gains[{i}]", f"mode {i}", plant.A[i], plant.B[i], K[i], allow_unstable)
    return K


def require_hurwitz(
    name: str, place: str, A: np.ndarray, B: np.ndarray, K: np.ndarray, allow_unstable: bool
) -> None:
    """Refuse a gain that leaves A + B K unstable, unless the caller says it is meant."""
    rightmost = rightmost_eigenvalue(name, place, A, B, K)
    if rightmost >= 0.0 and not allow_unstable:
        constant = ~(A.any(axis=1) | B.any(axis=1))
        moving = (A + B @ K)[np.ix_(~constant, ~constant)]
        if constant.any() and np.linalg.eigvals(moving).real.max(initial=-1.0) < 0.0:
            which = ", ".join(f"x[{j}]" for j in np.flatnonzero(constant))
            raise ArgumentError(
                f"{name} cannot make A + B K of {place} decay: {which} never moves (its rows of A "
                "and B are 0), as the disturbance and the reference in `Servo.plant`. The rest "
                "decays: allow_unstable = True accepts it."
            )
        raise ArgumentError(
            f"{name} leaves A + B K of {place} unstable (rightmost eigenvalue at "
            f"{rightmost:+.4g} 1/s): the sign is u = +K x, and gains belong to one plant; "
            "allow_unstable = True accepts it, as gains designed for a long step may need, and so "
            "may loops that are stable only with their delay."
        )


def rightmost_eigenvalue(
    name: str, place: str, A: np.ndarray, B: np.ndarray, K: np.ndarray
) -> float:
    """The largest real part of an eigenvalue of A + B K, 1/s; an error where floats hold none."""
    with np.errstate(over="ignore", invalid="ignore"):
        loop = A + B @ K
    if not np.isfinite(loop).all():
        raise ArgumentError(
            f"{name} must keep A + B K of {place} below 1.8e308, got entries up to "
            f"{np.abs(K).max():.3g}: measure states or inputs in other units."
        )
    return float(np.linalg.eigvals(loop).real.max())
