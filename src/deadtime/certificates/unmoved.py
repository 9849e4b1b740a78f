"""Loops that no certificate can decay: parts of the state that nothing moves.

A plant extended by a reference or a constant disturbance (`deadtime.Servo`) has states that obey
dr/dt = 0. Whatever the law does they stay where they are, so that "stable" can only be asked of
the rest.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from deadtime.plant import SwitchedSystem
from deadtime.spectrum import least_growth

_NOTHING = 1e-12  # relative to the largest singular value


def why_unmoved(plants: Sequence[SwitchedSystem]) -> str:
    """Why nothing can be certified where a part of the state never changes; empty elsewhere.

    That part are the v with vᵀA_i = 0 and vᵀB_i = 0 in every mode: vᵀx is constant.
    """
    motions = np.concatenate([part for p in plants for part in (*p.A, *p.B)], axis=1)
    size = np.abs(motions).max(axis=1)  # no square, which floats might not hold
    still = np.flatnonzero(size == 0.0)
    # In units in which the rows are about 1, so that slow states do not count as still.
    units = np.where(size > 0.0, size, 1.0)
    values = np.linalg.svd(motions / units[:, None], compute_uv=False)
    rank = int((values > _NOTHING * max(float(values[0]), 1e-300)).sum())
    if rank == len(motions):
        return ""
    what = "a combination of the plant's states"
    if still.size == len(motions) - rank:
        what = " and ".join(f"x[{i}]" for i in still) + " of the plant"
    return (
        f"No certificate: in every mode, and whatever the input, {what} keeps its value, as a "
        "reference or a constant disturbance does, so that no law makes all of the state decay. "
        "Certify what moves: of a Servo its `OutputFeedback(law, observer, servo=servo)`, or the "
        "plant `servo.driven`, with a law of it whose gains are K[:, :, servo.moving]."
    )


def neutral(plant: SwitchedSystem, mode: int, growth: float) -> str:
    """Why there is no certificate where a constant mode neither grows nor decays."""
    rate = 0.0 if abs(growth) < 0.01 * least_growth(plant) else growth  # round-off
    return (
        f"Held in mode {mode} the loop neither grows nor decays (its growth rate is {rate:.2g} "
        "1/s, as an integrator's that the law leaves alone), so that no decay can be proved, and "
        "no signal was proved to grow: change the gains so that every mode decays."
    )
