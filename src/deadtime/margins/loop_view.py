"""A loop as engineers look at it: loci, sensitivity, and its margins of phase and disk, by mode.

With one mode held let L be what goes round the loop (`loop_transfer`, python-control's sign) and
λ_j its eigenvalues. All inputs k times as strong are on the limit of stability where k λ_j = −1,
all with a phase lag φ more where e^{−iφ} λ_j = −1. With S = (I + L)⁻¹ and T = I − S,

    α = 1/max_ω σ((S − T)/2):

L changed by any factor of the disk {(1 + δ/2)/(1 − δ/2): |δ| < α} is stable (Seiler, Packard and
Gahinet, IEEE Control Systems Magazine 40(5), 2020, section 5, with skew 0). For one channel no
larger disk is; for several, each with a factor of its own, this is a lower bound.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Complex, Float
from numpy.typing import ArrayLike

from deadtime.base.frozen import Frozen
from deadtime.feedback import Law
from deadtime.margins.constant_modes import DelayMargin, constant_delay_margin
from deadtime.margins.gain import GainMargin, gain_margin
from deadtime.margins.loop_transfer import check_frequencies, loop_response
from deadtime.numerics.small_matrices import matched
from deadtime.plant import SwitchedSystem
from deadtime.spectrum.held_mode_checks import require_constant

_POINTS, _MOST = 600, 20_000
_PER_TURN = 24  # frequencies while e^{−iωD} turns once


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
        How much more lag every channel may have, degrees; None where no |λ| is 1, and where the
        loop is not stable.
    phase_frequency : float or None
        Where, rad/s.
    disk : float or None
        α; None where the loop is not stable.
    disk_frequency : float or None
        Where the disk is smallest, rad/s.
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
        """The factor by which every channel may be stronger, or weaker, within the disk."""
        if self.disk is None:
            return None
        return (2.0 + self.disk) / (2.0 - self.disk) if self.disk < 2.0 else math.inf

    @property
    def disk_phase(self) -> float | None:
        """The phase by which every channel may be off within the disk, degrees."""
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
        Where the loop is cut; gain and delay margins are those at the plant's input.
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
    """Loci, sensitivity and margins of a loop in every mode that is held.

    Parameters
    ----------
    plant : SwitchedSystem
        The truth; the law has a model of its own.
    law : Law
        As for `loop_transfer`.
    step : float or None
        Sampling period h, s; None for the ideal loop.
    at : "input" or "output"
        Where the loop is cut open.
    frequencies : array_like, shape (K,), optional
        rad/s; by default from a tenth of the slowest motion up to π/h, or to where nothing goes
        round any more, close enough for the turns of the longest delay.

    Returns
    -------
    LoopView
        Margins of phase and disk are refined between the frequencies to 1e-9.

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

    best = minimize_scalar(
        negative, bounds=ends, method="bounded", options={"xatol": 1e-9 * ends[1]}
    )
    peak, at = max((float(size[k]), float(omega[k])), (-float(best.fun), float(best.x)))
    return 1.0 / peak, at


def _default(plant: SwitchedSystem, law: Law, step: float | None) -> Float[np.ndarray, " K"]:
    """From a tenth of the slowest motion to the highest frequency, close enough for every turn."""
    rates = np.abs(np.linalg.eigvals(plant.A)).ravel()
    slowest = min(float(rates[rates > 0.0].min(initial=np.inf)), 1.0 / plant.longest_delay)
    fastest = max(float(rates.max()), 1.0 / plant.shortest_delay)
    high = 100.0 * fastest if step is None else math.pi / step
    low = 0.1 * min(slowest, high)
    memory = plant.longest_delay + law.plant.longest_delay
    even = min(int(_PER_TURN * high * memory / (2.0 * math.pi)), _MOST)
    whole = np.concatenate((np.geomspace(low, high, _POINTS), np.linspace(low, high, max(even, 2))))
    return np.unique(whole)
