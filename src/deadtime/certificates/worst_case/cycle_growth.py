"""The growth of the sampled loop over a cycle: the spectral radius of one large operator.

The operator takes the lifted state ζ = (x_k, u_{k−W}, …, u_{k−1}) over a cycle. It is applied by
running the loop, O(K W m²) for K periods, never formed, and its largest eigenvalue is found by
Arnoldi's method on a power of it that spans several delays, where the eigenvalues lie far apart.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple, Protocol

import numpy as np
from jaxtyping import Float

from deadtime.certificates.worst_case.cycles import Cycle
from deadtime.feedback import Feedback
from deadtime.feedback.table import side_by_side
from deadtime.loop.received_samples import rows_of_run
from deadtime.plant import SampledPlant, SwitchedSystem
from deadtime.spectrum import aged_row
from deadtime.spectrum.lifted import leading_eigenvalue
from deadtime.spectrum.sampled_runs import LoopPeriods, carry_back, forward
from deadtime.switching.grid import cuts_of, modes_at

WINDOWS = 3  # of the delay in one application
TOLERANCE = 1e-9
DENSE = 600  # up to this order all eigenvalues are computed where Arnoldi's method fails


class Growth(NamedTuple):
    """The growth rate of a cycle in 1/s, and the eigenvector: ζ at its start (complex)."""

    rate: float
    vector: np.ndarray


class Growing(Protocol):
    """A loop whose growth along cycles can be computed or measured."""

    @property
    def step(self) -> float:
        """The period h, seconds."""
        ...

    def growth(self, cycle: Cycle, tolerance: float = ...) -> Growth | None:
        """The growth rate of a cycle and the direction that grows; None if not found."""
        ...


@dataclass(frozen=True, eq=False)
class SampledLoop:
    """A plant under a law's table, weighted by e^{−shift·t} (immutable).

    Attributes
    ----------
    G : (contexts, m, window), window = taps·m
        The table's taps, weighted, the oldest input first.
    shift : float
        1/s; a rate near the expected ones, so that numbers stay near 1.
    lag : int
        Samples by which the mode is reported late.
    """

    plant: SwitchedSystem
    feedback: Feedback
    sampled: SampledPlant
    G: Float[np.ndarray, "context m window"]
    shift: float
    lag: int = 0

    @classmethod
    def of(
        cls, plant: SwitchedSystem, feedback: Feedback, shift: float, lag: int = 0
    ) -> SampledLoop:
        """The loop; without a weight where `shift` is 0."""
        decay = math.exp(-shift * feedback.step) ** np.arange(1, feedback.taps + 1)
        weighted = (feedback.input_gain * decay[:, None, None])[:, ::-1]
        G = np.ascontiguousarray(side_by_side(weighted))
        return cls(plant, feedback, SampledPlant(plant, feedback.step), G, shift, lag)

    @property
    def weight(self) -> float:
        """The weight of one period, e^{−shift h}."""
        return math.exp(-self.shift * self.step)

    @property
    def step(self) -> float:
        """The period h, seconds."""
        return self.feedback.step

    @property
    def past(self) -> int:
        """W, the number of past inputs in ζ."""
        return max(self.sampled.longest_lag, self.feedback.taps)

    @property
    def order(self) -> int:
        """The size of ζ."""
        return self.plant.states + self.past * self.plant.inputs

    def table(self, cycle: Cycle) -> LoopPeriods:
        """The periods of a cycle repeated since t = −∞."""
        step, feedback = self.step, self.feedback
        signal, periods = cycle.signal(step), cycle.periods
        seen = modes_at(signal, np.arange(periods) * step, step)
        if cycle.lost:
            lost = np.isin(np.arange(periods), cycle.lost)
            reported = np.where(lost, -1, seen)
            # Two rounds: the first one determines the mode and age last reported.
            rows = rows_of_run(
                np.tile(reported, 2), np.tile(seen, 2), feedback.ages, feedback.apart, feedback.ages
            )[periods:]
            # The rows of lost samples come after those of measured ones.
            rows = rows + lost * (len(feedback.state_gain) // 2)
        elif cycle.constant:
            rows = np.full(periods, aged_row(feedback, cycle.modes[0]))
        else:
            rows = np.roll(feedback.rows(np.tile(seen, 2))[periods:], self.lag)
        pieces = self.sampled.along(cuts_of(signal, self.sampled), periods)
        return LoopPeriods.of(pieces, rows, feedback.state_gain, self.G, self.weight)

    def run(self, table: LoopPeriods, repeats: int, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """From ζ (order,): weighted states (samples, n) at the end of every period, and inputs
        (W + samples, m), the W past ones first."""
        n, m, W = self.plant.states, self.plant.inputs, self.past
        samples = repeats * table.rows.size
        line, states = np.empty((W + samples) * m), np.empty((samples, n))
        line[: W * m] = z[n:]
        forward(table, z[:n].copy(), line, states)
        return states, line.reshape(-1, m)

    def after(self, table: LoopPeriods, repeats: int, z: np.ndarray) -> np.ndarray:
        """ζ (order,) after some cycles, weighted."""
        states, inputs = self.run(table, repeats, z)
        return np.concatenate((states[-1], inputs[-self.past :].ravel()))

    def before(self, table: LoopPeriods, y: np.ndarray) -> np.ndarray:
        """The functional (order,) of ζ at the start of a cycle that is `y` at its end, weighted."""
        n, held = self.plant.states, self.past * self.plant.inputs
        line = np.zeros(held + table.rows.size * self.plant.inputs)
        line[-held:] = y[n:]
        p = y[:n].copy()
        carry_back(table, p, line, np.empty(n))
        return np.concatenate((p, line[:held]))

    def growth(self, cycle: Cycle, tolerance: float = TOLERANCE) -> Growth | None:
        """The growth rate of a cycle and the direction that grows; None if not found.

        `tolerance` is relative, of the eigenvalue.
        """
        table = self.table(cycle)
        start = np.random.default_rng(0).normal(size=self.order)  # generic, and the same each time
        spanning = max(1, -(-WINDOWS * self.past // table.rows.size))
        dominant, repeats = None, 1
        with np.errstate(over="ignore", invalid="ignore"):
            # Over several delays the eigenvalues lie far apart; one cycle is the last resort.
            for repeats in (spanning, 3 * spanning, 1):
                apply = partial(self.after, table, repeats)
                dominant = leading_eigenvalue(apply, start, tolerance)
                if dominant is not None:
                    break
        if dominant is None:
            dominant, repeats = self._dense(table), 1
        if dominant is None:
            return None
        value, vector = dominant
        time = repeats * table.rows.size * self.step
        rate = math.log(abs(value)) / time if value else -math.inf
        n, m, W = self.plant.states, self.plant.inputs, self.past
        back = self.weight ** np.arange(W, 0, -1)  # ũ_{−j} = w^{−j} u_{−j}
        vector = np.append(vector[:n], vector[n:] * np.repeat(back, m))
        return Growth(self.shift + rate, vector)

    def _dense(self, table: LoopPeriods) -> tuple[complex, np.ndarray] | None:
        if self.order > DENSE:
            return None
        operator = np.array([self.after(table, 1, z) for z in np.eye(self.order)]).T
        if not np.isfinite(operator).all():
            return None
        values, vectors = np.linalg.eig(operator)
        largest = int(np.argmax(np.abs(values)))
        return complex(values[largest]), vectors[:, largest]
