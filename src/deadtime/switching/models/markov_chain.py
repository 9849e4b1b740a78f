"""A Markov chain of the mode at samples, with switches at multiples of a period only."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import ArrayLike

from deadtime.base.checks import count as whole_number, positive
from deadtime.base.errors import ArgumentError
from deadtime.switching.models.fit import Signals, check_signals
from deadtime.switching.models.jump_process import JumpProcess, Quantiles, Switches
from deadtime.switching.models.model import (
    SampledChain,
    SwitchingModel,
    check_probabilities,
    rows_text,
)


@dataclass(frozen=True, eq=False, init=False, repr=False)
class MarkovChain(SwitchingModel):
    r"""A Markov chain of modes that switches at multiples of a period only.

    .. math::

        P(\sigma((k + 1) h_c) = j \mid \sigma(k h_c) = i, \text{the past}) = P_{ij}

    Sojourns are geometrically many whole periods. Signals start in a uniformly drawn mode. A law or
    filter of period :math:`h_c` observes every switch and is exact; one of period :math:`r h_c`
    uses the chain :math:`P^r`, as if switches within its period were at the end of it.

    Parameters
    ----------
    P : array_like, shape (modes, modes)
        Probabilities of the next mode, rows summing to 1, the diagonal included.
    step : float
        Period :math:`h_c` of the chain, seconds.

    Attributes
    ----------
    P : (modes, modes) array
    step : float

    Raises
    ------
    ArgumentError
        If P is not square, a row holds no probabilities, or the period is not positive; by laws
        and filters whose period is no multiple of it.

    References
    ----------
    Norris, "Markov Chains", Cambridge University Press 1997, chapter 1.

    Examples
    --------
    >>> from deadtime import MarkovChain
    >>> model = MarkovChain([[0.9, 0.1], [0.25, 0.75]], step=0.05)
    >>> model
    MarkovChain(modes=2, step=0.05, mean sojourns 0.5, 0.2 s)
    >>> model.sample(1.0, seed=1).times.round(12)
    array([0.  , 0.05, 0.15, 0.2 , 0.4 , 0.5 , 0.9 ])
    """

    P: Float[np.ndarray, "mode mode"]
    step: float

    def __init__(self, P: ArrayLike, step: float) -> None:
        vars(self).update(P=check_probabilities("P", P), step=positive("step", step))

    @property
    def modes(self) -> int:
        return len(self.P)

    @property
    def transitions(self) -> Bool[np.ndarray, "mode mode"]:
        return (self.P > 0.0) & ~np.eye(self.modes, dtype=bool)

    @property
    def mean(self) -> Float[np.ndarray, " mode"]:
        with np.errstate(divide="ignore"):
            return self.step / self._leave

    @property
    def _leave(self) -> Float[np.ndarray, " mode"]:
        """1 − P_ii as a sum of the other entries, without cancellation."""
        return np.minimum(np.where(np.eye(self.modes), 0.0, self.P).sum(axis=1), 1.0)

    def ages(self, step: float, most: int | None = None) -> None:
        return None  # memoryless

    def chain(self, step: float, ages: int = 1) -> SampledChain:
        """:math:`P^r` at a period of r steps."""
        from deadtime.plant.discretisation import snap

        periods = snap(positive("step", step) / self.step)
        if periods < 1.0 or not periods.is_integer():
            raise ArgumentError(
                f"step = {step:g} s must be that of the MarkovChain, {self.step:g} s, or a "
                "multiple of it: the chain is not defined at other instants. Change one of them, "
                "or describe the sojourns by a SemiMarkov model."
            )
        P = np.linalg.matrix_power(self.P, int(periods))
        return SampledChain.of_matrix(P, within=periods > 1.0)

    def at_samples(self, step: float) -> bool:
        from deadtime.plant.discretisation import snap

        return snap(self.step / step).is_integer()

    def switches(self, horizon: float, seed: int = 0, first: int = 0, count: int = 1) -> Switches:
        """Sojourns of whole periods; every instant is a float multiple of the period."""
        from deadtime.plant.discretisation import snap

        periods = np.ceil(snap(positive("horizon", horizon) / self.step))
        each = np.eye(self.modes, dtype=bool)
        sojourns = [
            (f"P[{i}]", partial(_geometric, leave, self.step), each[i])
            for i, leave in enumerate(self._leave.tolist())
        ]
        none = np.zeros(self.modes)
        process = JumpProcess(
            Quantiles(none, none, tuple(sojourns)),
            np.where(each, 0.0, self.P),
            float(self.mean.max()),
        )
        # Half a period less, so that round-off cannot add a switch at the horizon.
        drawn = process.draw((periods - 0.5) * self.step, seed, first, count)
        # A sum of sojourns drifts off the grid by round-off; k·step does not.
        return drawn._replace(times=np.rint(drawn.times / self.step) * self.step)

    @classmethod
    def fit(cls, signals: Signals, step: float, *, modes: int | None = None) -> MarkovChain:
        r"""The chain of maximum likelihood for the modes that logged signals have at samples.

        .. math::

            P_{ij} = N_{ij} / \sum_j N_{ij}

        with :math:`N_{ij}` the number of samples of mode i that are followed by one of mode j. Of
        two switches within a period the first is not observed. The last sojourn of a log without an
        end does not count. The number of modes is `modes`, or the largest mode in the logs plus
        one. A mode without a sample after it is refused.

        References
        ----------
        Anderson and Goodman, "Statistical inference about Markov chains", Annals of Mathematical
        Statistics 28, 1957.

        Examples
        --------
        >>> truth = MarkovChain([[0.9, 0.1], [0.25, 0.75]], step=0.05)
        >>> MarkovChain.fit(truth.sample(2000.0, seed=1), step=0.05).P.round(2)
        array([[0.9 , 0.1 ],
               [0.25, 0.75]])
        """
        from deadtime.plant.discretisation import snap, snap_all

        step, logs = positive("step", step), check_signals(signals)
        number = 1 + max(int(log.modes.max()) for log in logs)
        if modes is not None:
            if whole_number("modes", modes) < number:
                raise ArgumentError(
                    f"modes must be at least {number}, got {modes}: signals enter mode "
                    f"{number - 1}, and modes count from 0."
                )
            number = modes
        N = np.zeros((number, number))
        for log in logs:
            # The first sample of each sojourn; one without a sample is not observed.
            begin = np.ceil(snap_all(log.times / step))
            end = np.ceil(snap(log.end / step)) if np.isfinite(log.end) else begin[-1] + 1.0
            samples = np.diff(begin, append=max(end, begin[-1]))
            seen = samples > 0.0
            mode = log.modes[seen]
            np.add.at(N, (mode, mode), samples[seen] - 1.0)
            np.add.at(N, (mode[:-1], mode[1:]), 1.0)
        total = N.sum(axis=1, keepdims=True)
        if not total.all():
            raise ArgumentError(
                f"signals show no sample after one of mode {int(np.argmin(total))}, so its "
                "successors are unknown: log longer, or give MarkovChain its P."
            )
        return cls(N / total, step)

    def section(self) -> str:
        rows = rows_text("P", self.P)
        return f'[switching]\nkind = "markov-chain"\n{rows}\nstep = {self.step!r}'

    def __repr__(self) -> str:
        means = ", ".join(f"{mean:.3g}" for mean in self.mean)
        return f"MarkovChain(modes={self.modes}, step={self.step:g}, mean sojourns {means} s)"


def _geometric(leave: float, step: float, u: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Sojourns that last with probability (1 − leave)^n for more than n periods; seconds."""
    # log1p: 1 − leave would lose the digits of a small probability.
    return np.maximum(np.ceil(np.log(u) / np.log1p(-leave)), 1.0) * step
