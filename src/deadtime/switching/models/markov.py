"""Markov switching: the next switch does not depend on how long the mode has been active."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.base.checks import count, positive, real_array
from deadtime.base.errors import ArgumentError
from deadtime.base.frozen import Frozen
from deadtime.switching.models.quantiles import Quantiles
from deadtime.switching.random import Draw, jump_switches, require_few
from deadtime.switching.signal import SwitchingSignal

if TYPE_CHECKING:
    from deadtime.switching.batch import SignalBatch


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Markov(Frozen):
    """A Markov process of modes: in mode i, a switch to mode j comes at the rate Λ_ij.

        P(σ(t + s) = j | σ(t) = i) = (e^{sΛ})_ij

    Sojourns in mode i are exponential with mean 1/Σ_j Λ_ij; a mode that no rate leaves is
    held. Signals start in a uniformly drawn mode.

    Parameters
    ----------
    rates : array_like, shape (modes, modes)
        Λ_ij ≥ 0 for i ≠ j, in 1/s. The diagonal may be 0 or minus the sum of its row.

    Attributes
    ----------
    rates : (modes, modes) array
        The rates, with 0 on the diagonal.

    Raises
    ------
    ArgumentError
        If the rates are not square, a rate is negative, or the diagonal is something else.

    References
    ----------
    Norris, "Markov Chains", Cambridge University Press 1997, theorem 2.8.2.

    Examples
    --------
    >>> from deadtime.switching import Markov
    >>> model = Markov([[0.0, 2.0], [1.0, 0.0]])
    >>> model.generator
    array([[-2.,  2.],
           [ 1., -1.]])
    >>> model.mean
    array([0.5, 1. ])
    >>> model.sample(1000.0, seed=1).switches > 1200  # one every 0.75 s
    True
    """

    rates: Float[np.ndarray, "mode mode"]

    def __init__(self, rates: ArrayLike) -> None:
        given = real_array("rates", rates, "(modes, modes)", 2)
        if given.shape[0] != given.shape[1]:
            raise ArgumentError(
                f"rates must have shape (modes, modes), got {given.shape}: give one row and one "
                "column per mode."
            )
        diagonal, off = np.diagonal(given), given.copy()
        np.fill_diagonal(off, 0.0)
        if off.min() < 0.0:
            i, j = np.unravel_index(np.argmin(off), off.shape)
            raise ArgumentError(f"rates[{i}, {j}] must be ≥ 0, in 1/s, got {off[i, j]:g}.")
        exits = off.sum(axis=1)
        wrong = (diagonal != 0.0) & (np.abs(diagonal + exits) > 1e-9 * exits)
        if wrong.any():
            i = int(np.argmax(wrong))
            raise ArgumentError(
                f"rates[{i}, {i}] must be 0 or minus the sum of the other rates in its row, "
                f"{-exits[i]:g}, got {diagonal[i]:g}: give the rates off the diagonal only."
            )
        off.flags.writeable = False
        vars(self).update(rates=off)

    @property
    def modes(self) -> int:
        """Number of modes."""
        return self.rates.shape[0]

    @property
    def generator(self) -> Float[np.ndarray, "mode mode"]:
        """Λ: the rates, with minus their sum on the diagonal, so that rows sum to 0; 1/s."""
        return self.rates - np.diag(self.rates.sum(axis=1))

    @property
    def mean(self) -> Float[np.ndarray, " mode"]:
        """Mean sojourn in each mode, seconds; infinite for a mode that is never left."""
        with np.errstate(divide="ignore"):
            return 1.0 / self.rates.sum(axis=1)

    def sample(self, horizon: float, seed: int = 0) -> SwitchingSignal:
        """A signal on [0, horizon).

        The same seed gives the same signal; a longer horizon continues it.

        Raises
        ------
        ArgumentError
            If the horizon is not positive or would hold too many switches.
        """
        horizon = positive("horizon", horizon)
        count("seed", seed, least=0)
        mean = self.mean
        require_few(horizon, float(mean.max()))
        return SwitchingSignal(
            *jump_switches([_exponential(scale) for scale in mean], self.rates, horizon, seed),
            horizon,
        )

    @property
    def drawable(self) -> bool:
        """Whether `draw` can be asked for; always."""
        return True

    def draw(self, horizon: float, seed: int = 0, first: int = 0, count: int = 1) -> SignalBatch:
        """The signals of scenarios first, …, first + count − 1 on [0, horizon), in one batch.

        A scenario's signal is a function of the model, `seed` and its number only, whatever else
        is drawn with it; a longer horizon continues it. It follows the same law as those of
        `sample`, but is none of them: other numbers are read.

        Parameters
        ----------
        horizon : float
            The signals end here, seconds.
        seed : int
            At least 0.
        first, count : int
            Number of the first scenario, at least 0, and how many, at least 1.

        Raises
        ------
        ArgumentError
            If the horizon is not positive, an integer is out of its range, or the batch would
            hold too many switches.

        Examples
        --------
        >>> model = Markov([[0.0, 2.0], [1.0, 0.0]])
        >>> batch = model.draw(10.0, seed=1, count=1000)
        >>> (batch[700].times == model.draw(10.0, seed=1, first=700)[0].times).all()
        np.True_
        """
        from deadtime.switching.models.drawing import draw_signals

        mean = self.mean
        quantiles = Quantiles(np.zeros(self.modes), mean)
        longest = float(mean.max())
        return draw_signals(quantiles, self.rates, longest, horizon, seed, (first, count))

    def __repr__(self) -> str:
        means = ", ".join(f"{mean:.3g}" for mean in self.mean)
        return f"Markov(modes={self.modes}, mean sojourns {means} s)"


def _exponential(mean: float) -> Draw:
    """Draws exponential sojourns; endless ones when the mean is infinite."""
    if mean == np.inf:
        return lambda _, size: np.full(size, np.inf)
    return lambda rng, size: rng.exponential(mean, size)
