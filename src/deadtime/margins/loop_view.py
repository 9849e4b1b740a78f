"""Frequency responses of a loop: loci, sensitivities, phase and disk margins, by mode.

With one mode held let L be the loop transfer function (`loop_transfer`, python-control's sign) and
λ_j its eigenvalues. With a factor k at all inputs the loop is at the limit of stability where
k λ_j = −1, with an additional phase lag φ where e^{−iφ} λ_j = −1. With S = (I + L)⁻¹ and T = I − S,

    α = 1/max_ω σ((S − T)/2):

L times any factor of the disk {(1 + δ/2)/(1 − δ/2): |δ| < α} is stable (Seiler, Packard and
Gahinet, IEEE Control Systems Magazine 40(5), 2020, section 5, with skew 0). For one channel this is
the largest such disk; for several, each with its own factor, it is a lower bound.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Complex, Float
from numpy.typing import ArrayLike

from deadtime.base.checks import positive, python_control, real_array
from deadtime.base.errors import ArgumentError
from deadtime.base.frozen import Frozen
from deadtime.feedback import Law
from deadtime.margins.delay import DelayMargin, constant_delay_margin
from deadtime.margins.gain import GainMargin, gain_margin
from deadtime.numerics.small_matrices import matched
from deadtime.plant import SwitchedSystem
from deadtime.spectrum.held_mode_checks import check_mode, require_constant
from deadtime.spectrum.open_loop import OpenLoop, ideal_responses

_POINTS, _MOST = 600, 20_000
_PER_TURN = 24  # frequencies while e^{−iωD} turns once


def loop_transfer(
    plant: SwitchedSystem,
    law: Law,
    mode: int,
    step: float | None = 0.01,
    at: str = "input",
    frequencies: ArrayLike | None = None,
) -> Any:
    r"""The loop transfer function with one mode held, for python-control.

    The sign is python-control's: the closed loop is `control.feedback(L)`, and a single loop
    encircles −1. With the plant P from its inputs to the measurement and the law K from the
    measurement to the commanded inputs (K contains the feedback of past inputs),

    .. math::

        L = -K P \text{ at the plant's input}, \quad L = -P K \text{ at its output}.

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
        The point at which the loop is opened: the m inputs of the plant, or the n measured states
        or p outputs.
    frequencies : array_like, shape (K,), optional
        rad/s, positive, increasing, up to :math:`\pi/h`: the exact response at these. Its cost does
        not depend on the delay, while the order of a state-space model grows with it.

    Returns
    -------
    control.StateSpace or control.FrequencyResponseData
        The latter if `frequencies` are given.

    Raises
    ------
    ArgumentError
        As by `growth_rate`; if frequencies are missing without a step, or above :math:`\pi/h`; if
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
        P, K = (control.ss(*part, step) for part in (loop.plant_system(), loop.law_system()))
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
    """Positive, increasing frequencies up to the Nyquist frequency, rad/s, checked."""
    omega = real_array("frequencies", frequencies, "(K,)", 1)
    if not omega.size or omega[0] <= 0.0 or (np.diff(omega) <= 0.0).any():
        raise ArgumentError("frequencies must be positive and increase, in rad/s.")
    if step is not None and omega[-1] > np.pi / step * (1.0 + 1e-12):
        raise ArgumentError(
            f"frequencies must be at most π/step = {np.pi / step:.6g} rad/s, beyond which samples "
            f"tell nothing, got {omega[-1]:g}: are they in Hz? Multiply by 2π; or shorten the step."
        )
    return omega


def _labels(law: Law, size: int, at: str) -> dict[str, list[str]]:
    letter = "u" if at == "input" else "x" if law.outputs is None else "y"
    labels = [f"{letter}[{i}]" for i in range(size)]
    return {"inputs": labels, "outputs": labels}


@dataclass(frozen=True, eq=False)
class ModeView(Frozen):
    """One mode of a loop (immutable).

    Attributes
    ----------
    mode : int
    loci : (K, y)
        The eigenvalues λ of L at the frequencies, each followed from one to the next.
    sensitivity, complementary : (K,)
        The largest singular values of S and T.
    phase : float or None
        Phase margin: the additional lag of every channel that is tolerated, degrees; None if no
        eigenvalue has modulus 1, or the loop is not stable.
    phase_frequency : float or None
        Its frequency, rad/s.
    disk : float or None
        Disk margin α; None if the loop is not stable.
    disk_frequency : float or None
        The frequency of the smallest disk, rad/s.
    """

    mode: int
    loci: Complex[np.ndarray, "K y"]
    sensitivity: Float[np.ndarray, " K"]
    complementary: Float[np.ndarray, " K"]
    phase: float | None
    phase_frequency: float | None
    disk: float | None
    disk_frequency: float | None

    @property
    def disk_gain(self) -> float | None:
        """The largest real factor of every channel within the disk; its inverse is the smallest."""
        if self.disk is None:
            return None
        return (2.0 + self.disk) / (2.0 - self.disk) if self.disk < 2.0 else math.inf

    @property
    def disk_phase(self) -> float | None:
        """The largest phase error of every channel within the disk, degrees."""
        return None if self.disk is None else 2.0 * math.degrees(math.atan(self.disk / 2.0))


@dataclass(frozen=True, eq=False)
class LoopView(Frozen):
    """A loop in every mode over frequency (immutable).

    Attributes
    ----------
    omega : (K,)
        Frequencies, rad/s.
    modes : tuple of ModeView
    gain : GainMargin
        `deadtime.gain_margin`.
    delay : DelayMargin
        `deadtime.delay_margin`, of constant modes.
    at : "input" or "output"
        Where the loop is opened; gain and delay margins are those at the plant's input.
    """

    omega: Float[np.ndarray, " K"]
    modes: tuple[ModeView, ...]
    gain: GainMargin
    delay: DelayMargin
    at: str


def loop_view(
    plant: SwitchedSystem,
    law: Law,
    step: float | None = 0.01,
    at: str = "input",
    frequencies: ArrayLike | None = None,
) -> LoopView:
    """Loci, sensitivities and margins of a loop with each mode held.

    Parameters
    ----------
    plant : SwitchedSystem
        The truth; the law has a model of its own.
    law : Law
        As for `loop_transfer`.
    step : float or None
        Sampling period h, s; None for the ideal loop.
    at : "input" or "output"
        Where the loop is opened.
    frequencies : array_like, shape (K,), optional
        rad/s; by default from a tenth of the slowest motion up to π/h, or 100 times the fastest
        motion of an ideal loop, close enough for the phase of the longest delay.

    Returns
    -------
    LoopView
        Phase and disk margins are refined between the frequencies to 1e-9.

    Examples
    --------
    >>> import deadtime as dt
    >>> plant = dt.SwitchedSystem([[[1.0]]], [[[1.0]]], delay=0.2)
    >>> law = dt.SingleModePredictor(plant, dt.place(plant, [-1.0]), 0)
    >>> view = loop_view(plant, law)
    >>> mode = view.modes[0]
    >>> round(mode.phase, 1), round(mode.disk, 3), round(view.gain.upper, 3)
    (40.4, 0.517, 4.37)
    """
    require_constant(plant, law)
    gain, delay = gain_margin(plant, law, step), constant_delay_margin(plant, law, step)
    omega = _default(plant, law, step) if frequencies is None else frequencies
    omega = check_frequencies(omega, step)
    modes = tuple(
        _mode_view(partial(loop_response, plant, law, mode, step, at=at), mode, omega, growth < 0.0)
        for mode, growth in enumerate(gain.growth.tolist())
    )
    return LoopView(omega, modes, gain, delay, at)


def _mode_view(response: partial, mode: int, omega: np.ndarray, stable: bool) -> ModeView:
    L = response(omega)
    loci = L[:, :, 0] if L.shape[1] == 1 else matched(np.linalg.eigvals(L))
    S = np.linalg.inv(np.eye(L.shape[1]) + L)
    sensitivity, complementary = (_largest(part) for part in (S, np.eye(L.shape[1]) - S))
    phase = disk = (None, None)
    if stable:
        phase, disk = _phase_margin(response, omega, loci), _disk_margin(response, omega, S)
    return ModeView(mode, loci, sensitivity, complementary, *phase, *disk)


def _largest(X: Complex[np.ndarray, "K y y"]) -> Float[np.ndarray, " K"]:
    return np.linalg.svd(X, compute_uv=False)[:, 0]


def _phase_margin(
    response: partial, omega: np.ndarray, loci: np.ndarray
) -> tuple[float | None, float | None]:
    """The least lag, in degrees, that turns a λ of modulus 1 to −1, and the frequency."""
    from scipy.optimize import brentq

    found = []
    for k, j in np.argwhere(np.diff(np.sign(np.abs(loci) - 1.0), axis=0) != 0.0):
        middle = complex(0.5 * (loci[k, j] + loci[k + 1, j]))

        def locus(at: float, near: complex = middle) -> complex:
            values = np.linalg.eigvals(response(np.array([at]))[0])
            return complex(values[np.abs(values - near).argmin()])

        ends: Any = omega[k], omega[k + 1]
        root: Any = brentq(lambda w, locus=locus: abs(locus(w)) - 1.0, *ends)
        at = float(root)
        found.append((math.degrees(math.pi + float(np.angle(locus(at)))) % 360.0, at))
    return min(found, default=(None, None))


def _disk_margin(response: partial, omega: np.ndarray, S: np.ndarray) -> tuple[float, float]:
    """α and the frequency at which it is attained."""
    from scipy.optimize import minimize_scalar

    unit = np.eye(S.shape[1])
    size = _largest(S - 0.5 * unit)
    k = int(size.argmax())
    ends = omega[max(k - 1, 0)], omega[min(k + 1, omega.size - 1)]

    def negative(at: float) -> float:
        inside = np.linalg.inv(unit + response(np.array([at])))
        return -float(_largest(inside - 0.5 * unit)[0])

    best: Any = minimize_scalar(
        negative, bounds=ends, method="bounded", options={"xatol": 1e-9 * ends[1]}
    )
    peak, at = max((float(size[k]), float(omega[k])), (-float(best.fun), float(best.x)))
    return 1.0 / peak, at


def _default(plant: SwitchedSystem, law: Law, step: float | None) -> Float[np.ndarray, " K"]:
    """From a tenth of the slowest motion up, close enough for the phase of the longest delay."""
    rates = np.abs(np.linalg.eigvals(plant.A)).ravel()
    slowest = min(float(rates[rates > 0.0].min(initial=np.inf)), 1.0 / plant.longest_delay)
    fastest = max(float(rates.max()), 1.0 / plant.shortest_delay)
    high = 100.0 * fastest if step is None else math.pi / step
    low = 0.1 * min(slowest, high)
    memory = plant.longest_delay + law.plant.longest_delay
    even = min(int(_PER_TURN * high * memory / (2.0 * math.pi)), _MOST)
    whole = np.concatenate((np.geomspace(low, high, _POINTS), np.linspace(low, high, max(even, 2))))
    return np.unique(whole)
