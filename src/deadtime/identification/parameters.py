"""The unknowns of a plant in one vector: entries of A and B of every mode, then the delays.

With an operating point that is not 0, dx/dt = A (x − x₀) + B (u(t − D) − u₀), each mode has the
constant term c = −A x₀ − B u₀. It acts like an input that is always 1, so it is one more column of
B, without a delay.

Between two whole numbers of periods, in a cell of a delay, the same samples of an input act.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.checks import read_only
from deadtime.base.frozen import Frozen
from deadtime.plant import SwitchedSystem

SHORTEST = 1e-6  # of a period: the shortest delay that a search tries in place of 0

Vector = Float[np.ndarray, " size"]  # unknowns, those of a plant first
Window = tuple[float, float]  # the least and the largest delay, seconds
Cells = Int[np.ndarray, " delay"]  # of every delay of a layout
Square = Float[np.ndarray, "n n"]  # of the states
Squares = Float[np.ndarray, "mode n n"]  # one of every mode
FisherMatrix = Float[np.ndarray, "size size"]  # on the unknowns of a vector
SensorMatrix = Float[np.ndarray, "p n"]  # C of outputs y = C x
Nodes = Float[np.ndarray, " node"]  # of interpolation, seconds
ModeCells = Int[np.ndarray, "mode m"]  # of every mode and input
Inputs = Float[np.ndarray, "sample m"]  # of every sample


@dataclass(frozen=True)
class Layout(Frozen):
    """The places of the unknowns in a vector.

    modes, n, m : the numbers of modes, states and inputs
    per_mode : whether every mode has delays of its own
    constant : whether dx/dt has a constant term in each mode, the last column of B
    """

    modes: int
    n: int
    m: int
    per_mode: bool
    constant: bool = False

    @property
    def acting(self) -> int:
        """The number of columns of B: the inputs, and the constant term."""
        return self.m + self.constant

    @cached_property
    def of_A(self) -> Int[np.ndarray, "mode n n"]:
        """Places of A_i[a, b]."""
        return read_only(np.arange(self.modes * self.n**2).reshape(self.modes, self.n, self.n))

    @cached_property
    def of_B(self) -> Int[np.ndarray, "mode n acting"]:
        """Places of B_i[a, j], and of c_i[a] in the last column."""
        count = self.modes * self.n * self.acting
        own = np.arange(count).reshape(self.modes, self.n, self.acting)
        return read_only(self.of_A.size + own)

    @property
    def of_constant(self) -> Int[np.ndarray, "mode n c"]:
        """Places of the constant terms c_i[a], if there are any."""
        return self.of_B[:, :, self.m :]

    @cached_property
    def of_delay(self) -> ModeCells:
        """Places of D_ij, the same for all modes where they share it."""
        own = np.tile(np.arange(self.m), (self.modes, 1))
        if self.per_mode:
            own = np.arange(self.modes * self.m).reshape(self.modes, self.m)
        return read_only(self.of_A.size + self.of_B.size + own)

    def of_mode(self, mode: int) -> Int[np.ndarray, " own"]:
        """Places of the unknowns of a mode: A_i, B_i and D_i."""
        each = self.of_A[mode], self.of_B[mode], self.of_delay[mode]
        return np.concatenate([one.ravel() for one in each])

    @property
    def delays(self) -> int:
        return self.m * (self.modes if self.per_mode else 1)

    @property
    def size(self) -> int:
        return self.of_A.size + self.of_B.size + self.delays

    @property
    def least_periods(self) -> int:
        """Twice the terms of a state's regression, and one: the fewest periods of a mode."""
        return 2 * (self.n + 2 * self.m) + 1

    def spread(self, values: np.ndarray) -> np.ndarray:
        """One value per delay as (modes, m)."""
        return values[self.of_delay - self.of_delay.min()]

    @property
    def delay_places(self) -> Int[np.ndarray, " delay"]:
        return np.arange(self.size)[self.at_delays]

    @property
    def at_delays(self) -> slice:
        """The places of the delays, as a slice."""
        return slice(self.size - self.delays, self.size)

    def join(self, A: np.ndarray, B: np.ndarray, delays: np.ndarray) -> Vector:
        """The vector of A (modes, n, n), B (modes, n, acting) and delays (modes, m)."""
        own = delays if self.per_mode else delays[0]
        return np.concatenate((A.ravel(), B.ravel(), own.ravel()))

    def ordered(
        self, vector: Float[np.ndarray, " some"], order: Int[np.ndarray, " mode"]
    ) -> Float[np.ndarray, " some"]:
        """A vector that begins with this layout's, with modes in another order."""
        A, B, delays = self.split(vector[: self.size])
        theta = self.join(A[order], B[order], delays[order])
        return np.concatenate((theta, vector[self.size :]))

    def plant(self, theta: Vector) -> SwitchedSystem:
        """The plant of a vector, about its operating point."""
        A, B, delays = self.split(theta)
        return SwitchedSystem(A, B[:, :, : self.m], delays)

    def constant_of(self, theta: Vector) -> Float[np.ndarray, "mode n"]:
        """The constant terms of a vector, 0 where there are none."""
        return theta[self.of_constant].sum(axis=2)

    def without_constant(self) -> tuple[Layout, Int[np.ndarray, " kept"]]:
        """The layout without constant terms, and the places of this vector that it keeps."""
        kept = np.setdiff1d(np.arange(self.size), self.of_constant)
        return replace(self, constant=False), kept

    def split(
        self, theta: Vector
    ) -> tuple[Squares, Float[np.ndarray, "mode n acting"], Float[np.ndarray, "mode m"]]:
        """A, B and delays of a vector."""
        return theta[self.of_A], theta[self.of_B], theta[self.of_delay]

    def of_each(self, count: Int[np.ndarray, " mode"] | Float[np.ndarray, " mode"]) -> Vector:
        """A count of each mode for every unknown; for a delay of all modes the total."""
        result = np.empty(self.size)
        result[self.at_delays] = count.sum()
        for i in range(self.modes):
            result[self.of_A[i]], result[self.of_B[i]] = count[i], count[i]
            if self.per_mode:
                result[self.of_delay[i]] = count[i]
        return result

    def names(self) -> list[str]:
        """Names of the unknowns.

        Examples
        --------
        >>> Layout(1, 1, 2, False).names()
        ['A[0][0,0]', 'B[0][0,0]', 'B[0][0,1]', 'delay[0]', 'delay[1]']
        """
        names = [f"A[{i}][{a},{b}]" for i, a, b in np.ndindex(self.of_A.shape)]
        for i, a, j in np.ndindex(self.of_B.shape):
            names.append(f"B[{i}][{a},{j}]" if j < self.m else f"constant[{i}][{a}]")
        if self.delays == 1:
            return [*names, "delay"]
        if self.per_mode:
            return names + [f"delay[{i}][{j}]" for i, j in np.ndindex(self.modes, self.m)]
        return names + [f"delay[{j}]" for j in range(self.m)]


def cell_of(delay: float, step: float, up: bool = False) -> int:
    """The N with D in [(N − 1) h, N h]; the larger one at a whole period where `up`.

    Examples
    --------
    >>> cell_of(0.312, 0.05), cell_of(0.3, 0.05), cell_of(0.3, 0.05, up=True)
    (7, 6, 7)
    """
    ratio = delay / step
    nearest = round(ratio)
    if abs(ratio - nearest) < 1e-9:
        return max(1, nearest + up)
    return max(1, int(np.ceil(ratio)))


def cells_of(delays: Float[np.ndarray, " delay"], step: float) -> Int[np.ndarray, " delay"]:
    return np.array([cell_of(float(delay), step) for delay in delays])
