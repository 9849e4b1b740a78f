"""How often something held, with its confidence interval."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Proportion:
    """How often something held: a count out of trials, with Wilson's 95 % interval.

    References
    ----------
    Wilson, "Probable inference, the law of succession, and statistical inference", JASA 1927.

    Examples
    --------
    >>> print(Proportion(984, 1000))
    98.4 % of 1,000 (97.4 to 99.0 %)
    """

    count: int
    trials: int

    @classmethod
    def of(cls, outcomes: np.ndarray) -> Proportion:
        """The share of true entries."""
        return cls(int(np.count_nonzero(outcomes)), outcomes.size)

    @property
    def fraction(self) -> float:
        """count / trials; 0 without any trial."""
        return self.count / self.trials if self.trials else 0.0

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson's 95 % confidence interval; (0, 1) without any trial."""
        if not self.trials:
            return 0.0, 1.0
        from scipy.stats import binomtest

        interval = binomtest(self.count, self.trials).proportion_ci(method="wilson")
        return float(interval.low), float(interval.high)

    def __str__(self) -> str:
        low, high = self.interval
        return (
            f"{100 * self.fraction:.1f} % of {self.trials:,} "
            f"({100 * low:.1f} to {100 * high:.1f} %)"
        )
