"""The plant: a linear system that switches between modes and answers its input late.

    dx/dt = A_σ(t) x(t) + B_σ(t) u(t − D),    x ∈ Rⁿ, u ∈ Rᵐ, σ(t) ∈ {0, …, modes − 1}

Arrays hold one matrix per mode, mode first. Modes count from 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.base.checks import brief, number, positive, read_only, real_array, require_shape
from deadtime.base.errors import ArgumentError
from deadtime.base.frozen import Frozen


@dataclass(frozen=True, eq=False, repr=False, init=False)
class SwitchedSystem(Frozen):
    """A switched linear system with one constant input delay (immutable).

    Parameters
    ----------
    A : array_like, shape (modes, n, n)
        State matrices, 1/s.
    B : array_like, shape (modes, n, m)
        Input matrices.
    delay : float
        Input delay D > 0, in seconds.

    Raises
    ------
    ArgumentError
        If shapes disagree, an entry is not finite, or the delay is not positive.

    References
    ----------
    arXiv 2503.08446, equation (1).

    Examples
    --------
    >>> import deadtime as dt
    >>> plant = dt.SwitchedSystem([[[2, 1], [0, 1]], [[2.3, 1.1], [0.05, 1.2]]],
    ...                           [[[0], [1]], [[0], [1.02]]], delay=1.0)
    >>> plant
    SwitchedSystem(modes=2, states=2, inputs=1, delay=1)
    """

    A: Float[np.ndarray, "mode n n"]
    B: Float[np.ndarray, "mode n m"]
    delay: float

    def __init__(self, A: ArrayLike, B: ArrayLike, delay: float) -> None:
        A = real_array("A", A, "(modes, n, n)", 3)
        B = real_array("B", B, "(modes, n, m)", 3)
        modes, n = A.shape[:2]
        require_shape("A", A, (modes, n, n), "(modes, n, n)")
        rows = B.shape[2] == n != B.shape[1]  # of inputs, where columns are meant
        require_shape("B", B, (modes, n, B.shape[1] if rows else B.shape[2]), "(modes, n, m)")
        delay = positive("delay", delay)
        vars(self).update(A=A, B=B, delay=delay)
        require_exponential("delay", A, delay)

    @classmethod
    def from_statespace(cls, systems: Sequence[Any], delay: float) -> SwitchedSystem:
        """A plant from python-control ``StateSpace`` objects, one per mode.

        The systems must be in continuous time and agree in states and inputs.
        Their outputs (C, D) are not used: laws feed back the whole state.
        """
        for i, system in enumerate(systems):
            if not all(hasattr(system, name) for name in ("A", "B", "nstates", "ninputs")):
                raise ArgumentError(
                    f"systems[{i}] must be a StateSpace, got {type(system).__name__}: convert it "
                    "with control.ss."
                )
            if getattr(system, "dt", None) not in (None, 0):
                raise ArgumentError(
                    f"systems[{i}] must be in continuous time, got dt = {system.dt}: "
                    "give the plant before sampling; deadtime samples it exactly."
                )
        sizes = {(system.nstates, system.ninputs) for system in systems}
        if len(sizes) != 1:
            raise ArgumentError(
                "systems must be one or more models with the same numbers of states and "
                f"inputs, got (states, inputs) = {sorted(sizes)}."
            )
        return cls(
            np.stack([np.asarray(s.A) for s in systems]),
            np.stack([np.asarray(s.B) for s in systems]),
            delay,
        )

    @property
    def modes(self) -> int:
        """Number of modes, l + 1."""
        return self.A.shape[0]

    @property
    def states(self) -> int:
        """Number of states, n."""
        return self.A.shape[1]

    @property
    def inputs(self) -> int:
        """Number of inputs, m."""
        return self.B.shape[2]

    @cached_property
    def identity(self) -> Float[np.ndarray, "n n"]:
        """The weight of |x|²."""
        return read_only(np.eye(self.states))

    def mean(self) -> SwitchedSystem:
        """The plant with one mode, the element-wise mean (Ā, B̄) of all modes.

        Examples
        --------
        >>> import deadtime as dt
        >>> dt.problems.paper().plant.mean().A
        array([[[2.15 , 1.05 ],
                [0.025, 1.1  ]]])
        """
        return SwitchedSystem(
            self.A.mean(axis=0, keepdims=True), self.B.mean(axis=0, keepdims=True), self.delay
        )

    def apart(self, alpha: float) -> SwitchedSystem:
        """The plant with its modes α times as far from mode 0: A_0 + α (A_i − A_0), B alike.

        Parameters
        ----------
        alpha : float
            α ≥ 0: 0 makes all modes the same, 1 changes nothing.

        Examples
        --------
        >>> import deadtime as dt
        >>> dt.problems.paper().plant.apart(2.0).A[1]
        array([[2.6, 1.2],
               [0.1, 1.4]])
        """
        try:
            far = number("alpha", alpha)
        except ArgumentError:
            far = -1.0
        if far < 0.0:
            raise ArgumentError(f"alpha must be ≥ 0 and finite, got {brief(alpha)}.")
        A, B = (M[0] + far * (M - M[0]) for M in (self.A, self.B))
        return SwitchedSystem(A, B, self.delay)

    def __repr__(self) -> str:
        return (
            f"SwitchedSystem(modes={self.modes}, states={self.states}, "
            f"inputs={self.inputs}, delay={self.delay:g})"
        )


def require_exponential(name: str, A: Float[np.ndarray, "mode n n"], tau: float) -> float:
    """|A|τ, the largest of all modes; a time for which floats do not hold it is refused."""
    with np.errstate(over="ignore"):
        size = float(np.abs(A).sum(axis=2).max()) * tau
    if not np.isfinite(size):
        raise ArgumentError(
            f"{name} must be short enough for e^(A·{name}), got {tau:g} s with entries of A up to "
            f"{np.abs(A).max():.3g} 1/s: |A|·{name} is beyond what floats hold, 1.8e308."
        )
    return size
