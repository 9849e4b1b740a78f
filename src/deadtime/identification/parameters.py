"""The unknowns of a plant in one vector: entries of A and B of every mode, then the delays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int


@dataclass(frozen=True)
class Layout:
    """Where each unknown lies.

    modes, n, m : how many modes, states and inputs
    per_mode : whether every mode has delays of its own
    """

    modes: int
    n: int
    m: int
    per_mode: bool

    @property
    def of_A(self) -> Int[np.ndarray, "mode n n"]:
        """Places of A_i[a, b]."""
        return np.arange(self.modes * self.n**2).reshape(self.modes, self.n, self.n)

    @property
    def of_B(self) -> Int[np.ndarray, "mode n m"]:
        """Places of B_i[a, j]."""
        count = self.modes * self.n * self.m
        return self.of_A.size + np.arange(count).reshape(self.modes, self.n, self.m)

    @property
    def of_delay(self) -> Int[np.ndarray, "mode m"]:
        """Places of D_ij, the same for all modes where they share it."""
        start = self.of_A.size + self.of_B.size
        if self.per_mode:
            return start + np.arange(self.modes * self.m).reshape(self.modes, self.m)
        return start + np.tile(np.arange(self.m), (self.modes, 1))

    @property
    def delays(self) -> int:
        """How many delays there are."""
        return self.m * (self.modes if self.per_mode else 1)

    @property
    def size(self) -> int:
        """How many unknowns there are."""
        return self.of_A.size + self.of_B.size + self.delays

    @property
    def least_periods(self) -> int:
        """How many periods each mode needs: twice what a state's regression costs, and one."""
        return 2 * (self.n + 2 * self.m) + 1

    def spread(self, values: np.ndarray) -> np.ndarray:
        """One value per delay as (modes, m)."""
        return values[self.of_delay - self.of_delay.min()]

    @property
    def at_delays(self) -> slice:
        """Where the delays lie."""
        return slice(self.size - self.delays, self.size)

    def join(self, A: np.ndarray, B: np.ndarray, delays: np.ndarray) -> Float[np.ndarray, " size"]:
        """The vector of A (modes, n, n), B (modes, n, m) and delays (modes, m)."""
        own = delays if self.per_mode else delays[0]
        return np.concatenate((A.ravel(), B.ravel(), own.ravel()))

    def split(
        self, theta: Float[np.ndarray, " size"]
    ) -> tuple[
        Float[np.ndarray, "mode n n"], Float[np.ndarray, "mode n m"], Float[np.ndarray, "mode m"]
    ]:
        """A, B and delays of a vector."""
        return theta[self.of_A], theta[self.of_B], theta[self.of_delay]

    def of_each(
        self, count: Int[np.ndarray, " mode"] | Float[np.ndarray, " mode"]
    ) -> Float[np.ndarray, " size"]:
        """Of every unknown a count of its mode's; of a delay that modes share that of all."""
        result = np.empty(self.size)
        result[self.at_delays] = count.sum()
        for i in range(self.modes):
            result[self.of_A[i]], result[self.of_B[i]] = count[i], count[i]
            if self.per_mode:
                result[self.of_delay[i]] = count[i]
        return result

    def names(self) -> list[str]:
        """What each unknown is called.

        Examples
        --------
        >>> Layout(1, 1, 2, False).names()
        ['A[0][0,0]', 'B[0][0,0]', 'B[0][0,1]', 'delay[0]', 'delay[1]']
        """
        names = [f"A[{i}][{a},{b}]" for i, a, b in np.ndindex(self.of_A.shape)]
        names += [f"B[{i}][{a},{j}]" for i, a, j in np.ndindex(self.of_B.shape)]
        if self.delays == 1:
            return [*names, "delay"]
        if self.per_mode:
            return names + [f"delay[{i}][{j}]" for i, j in np.ndindex(self.modes, self.m)]
        return names + [f"delay[{j}]" for j in range(self.m)]
