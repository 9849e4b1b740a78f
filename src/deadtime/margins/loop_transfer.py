"""What goes round a loop once, as a system of python-control."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Complex, Float
from numpy.typing import ArrayLike

from deadtime.base.checks import positive, python_control, real_array
from deadtime.base.errors import ArgumentError
from deadtime.feedback import Law
from deadtime.plant import SwitchedSystem
from deadtime.spectrum.held_mode_checks import check_mode
from deadtime.spectrum.open_loop import OpenLoop, StateSpace, ideal_responses


def loop_transfer(
    plant: SwitchedSystem,
    law: Law,
    mode: int,
    step: float | None = 0.01,
    at: str = "input",
    frequencies: ArrayLike | None = None,
) -> Any:
    """The transfer function of a loop cut open, with one mode held, for python-control.

    The sign is python-control's: the closed loop is `control.feedback(L)`, and a single loop
    encircles −1. With the plant from its inputs to what is measured, P, and the law from what is
    measured to the inputs that it asks for, K (the law's own past inputs are within it),

        L = −K P  at the plant's input,    L = −P K  at its output.

    Parameters
    ----------
    plant : SwitchedSystem
        The truth; the law has a model of its own.
    law : Law
        A law that is a table, or an `OutputFeedback` of one; without a step, one that has a closed
        form in continuous time.
    mode : int
        The mode that is held.
    step : float or None
        Sampling period h, s: the loop at samples, delays of any length included exactly. None
        for the ideal loop, which is no finite system and is given at `frequencies`.
    at : "input" or "output"
        Where it is cut: at the m inputs of the plant, or at the n states, or p outputs, that are
        measured.
    frequencies : array_like, shape (K,), optional
        rad/s, positive, increasing, up to π/h: the response there, exactly. It costs no more for a
        delay of many periods, as a system with all inputs in flight as states does.

    Returns
    -------
    control.StateSpace or control.FrequencyResponseData
        The latter if `frequencies` are given.

    Raises
    ------
    ArgumentError
        As by `growth_rate`; if frequencies are missing without a step, or above π/h; if
        python-control is not installed.

    Examples
    --------
    >>> import control, numpy as np, deadtime as dt
    >>> plant = dt.SwitchedSystem([[[1.0]]], [[[1.0]]], delay=0.2)
    >>> law = dt.SingleModePredictor(plant, dt.place(plant, [-1.0]), 0)
    >>> L = dt.loop_transfer(plant, law, 0)
    >>> closed = np.log(abs(control.feedback(L).poles()).max()) / 0.01
    >>> round(float(closed), 6), round(dt.growth_rate(plant, law, 0), 6)
    (-1.010101, -1.010101)
    """
    control = python_control("transfer functions of loops")
    mode = check_mode(plant, law, mode)
    if at not in ("input", "output"):
        raise ArgumentError(f'at must be "input" or "output", got {at!r}.')
    step = None if step is None else positive("step", step)
    names: Any = {"name": f"loop of mode {mode}"}
    if frequencies is None:
        if step is None:
            raise ArgumentError(
                "frequencies must be given for the ideal loop (step=None): its delays are no "
                "finite system; give rad/s, as numpy.geomspace(0.01, 100, 500)."
            )
        loop = OpenLoop.of(plant, law, mode, step)
        P, K = (_system(part, step) for part in (loop.plant_system(), loop.law_system()))
        L = -(K * P) if at == "input" else -(P * K)
        L.update_names(**_labels(law, L.ninputs, at), **names)
        return L
    omega = check_frequencies(frequencies, step)
    response = loop_response(plant, law, mode, step, omega, at)
    labels = _labels(law, response.shape[1], at)
    timebase = 0 if step is None else step
    return control.frd(np.moveaxis(response, 0, 2), omega, timebase, **labels, **names)


def loop_response(
    plant: SwitchedSystem,
    law: Law,
    mode: int,
    step: float | None,
    omega: Float[np.ndarray, " point"],
    at: str = "input",
) -> Complex[np.ndarray, "point y y"]:
    """L at frequencies, rad/s; see `loop_transfer`."""
    if step is None:
        P, K = ideal_responses(plant, law, mode, omega)
    else:
        P, K = OpenLoop.of(plant, law, mode, step).responses(omega, step)
    return -(K @ P) if at == "input" else -(P @ K)


def check_frequencies(frequencies: ArrayLike, step: float | None) -> Float[np.ndarray, " point"]:
    """Positive, increasing frequencies that a period tells apart, rad/s."""
    omega = real_array("frequencies", frequencies, "(K,)", 1)
    if not omega.size or omega[0] <= 0.0 or (np.diff(omega) <= 0.0).any():
        raise ArgumentError("frequencies must be positive and increase, in rad/s.")
    if step is not None and omega[-1] > np.pi / step * (1.0 + 1e-12):
        raise ArgumentError(
            f"frequencies must be at most π/step = {np.pi / step:.6g} rad/s, beyond which samples "
            f"tell nothing, got {omega[-1]:g}: are they in Hz? Multiply by 2π; or shorten the step."
        )
    return omega


def _system(part: StateSpace, step: float) -> Any:
    return python_control("systems").ss(*part, step)


def _labels(law: Law, size: int, at: str) -> dict[str, list[str]]:
    letter = "u" if at == "input" else "x" if law.outputs is None else "y"
    labels = [f"{letter}[{i}]" for i in range(size)]
    return {"inputs": labels, "outputs": labels}
