"""Markov switching: the next switch does not depend on how long the mode has been active."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import ArrayLike

from deadtime.base.checks import positive, read_only, real_array
from deadtime.base.errors import ArgumentError
from deadtime.switching.models.jump_process import JumpProcess, Quantiles, Switches
from deadtime.switching.models.model import SampledChain, SwitchingModel, rows_text


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Markov(SwitchingModel):
    r"""A Markov process of modes, in continuous time.

    In mode i, a switch to mode j comes at the rate :math:`\Lambda_{ij}`.

    .. math::

        P(\sigma(t + s) = j \mid \sigma(t) = i) = (e^{s \Lambda})_{ij}

    Sojourns in mode i are exponential with mean :math:`1/\sum_j \Lambda_{ij}`; a mode that no rate
    leaves is held. Signals start in a uniformly drawn mode.

    Parameters
    ----------
    rates : array_like, shape (modes, modes)
        :math:`\Lambda_{ij} \ge 0` for :math:`i \ne j`, in 1/s. The diagonal may be 0 or minus the
        sum of its row.

    Attributes
    ----------
    rates : (modes, modes) array
        The rates, with 0 on the diagonal.
    generator : (modes, modes) array
        :math:`\Lambda`: the rates, with minus their sum on the diagonal, so that rows sum to 0;
        1/s.

    Raises
    ------
    ArgumentError
        If the rates are not square, a rate is negative, or the diagonal is something else.

    References
    ----------
    Norris, "Markov Chains", Cambridge University Press 1997, theorem 2.8.2.

    Examples
    --------
    >>> from deadtime import Markov
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
    generator: Float[np.ndarray, "mode mode"]  # pyright: ignore[reportIncompatibleVariableOverride]

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
        vars(self).update(rates=read_only(off), generator=read_only(off - np.diag(exits)))

    @property
    def modes(self) -> int:
        return self.rates.shape[0]

    @property
    def transitions(self) -> Bool[np.ndarray, "mode mode"]:
        return self.rates > 0.0

    @property
    def mean(self) -> Float[np.ndarray, " mode"]:
        with np.errstate(divide="ignore"):
            return 1.0 / self.rates.sum(axis=1)

    def ages(self, step: float, most: int | None = None) -> None:
        return None  # memoryless

    def chain(self, step: float, ages: int = 1) -> SampledChain:
        r""":math:`P = e^{h \Lambda}`; a mode that is left and entered again in a period stays."""
        from deadtime.numerics.covariance import transition

        P = transition(self.generator, positive("step", step))
        return SampledChain.of_matrix(P, within=True)

    def switches(self, horizon: float, seed: int = 0, first: int = 0, count: int = 1) -> Switches:
        sojourn = Quantiles(np.zeros(self.modes), self.mean)
        process = JumpProcess(sojourn, self.rates, float(self.mean.max()))
        return process.draw(horizon, seed, first, count)

    def section(self) -> str:
        return f'[switching]\nkind = "markov"\n{rows_text("rates", self.rates)}'

    def __repr__(self) -> str:
        means = ", ".join(f"{mean:.3g}" for mean in self.mean)
        return f"Markov(modes={self.modes}, mean sojourns {means} s)"
