"""The plant: a linear system that switches between modes, with delayed inputs.

    dx/dt = A_σ(t) x(t) + Σ_j b_σ(t),j u_j(t − D_σ(t),j),   x ∈ Rⁿ, u ∈ Rᵐ, σ(t) ∈ {0, …, modes − 1}

A mode *reads* input j its own D_σ,j seconds back: after a switch to a longer delay past values are
read again, after one to a shorter delay some are skipped.

Arrays hold one matrix per mode, mode first. Modes count from 0. A plant with an equilibrium other
than 0 has an `OperatingPoint`.
"""

from __future__ import annotations

import math
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

ROUND_OFF = 1e-12  # relative difference up to which delays are equal


@dataclass(frozen=True, eq=False, repr=False, init=False)
class SwitchedSystem(Frozen):
    """A switched linear system with input delays: one, or one per input, per mode, or both.

    It is immutable.

    Parameters
    ----------
    A : array_like, shape (modes, n, n)
        State matrices, 1/s.
    B : array_like, shape (modes, n, m)
        Input matrices.
    delay : float or array_like, shape (m,), (modes, 1) or (modes, m)
        Input delays D > 0, in seconds: one for all, one per input, one per mode, or one per mode
        and input. A one-dimensional array is per input, even with as many modes as inputs.

    Attributes
    ----------
    delays : (modes, m) array
        The delay of every input in every mode, seconds.

    Raises
    ------
    ArgumentError
        If shapes disagree, an entry is not finite, a delay is not positive, or an input has a
        delay of its own and acts in no mode.

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

    Throttle and brake, each with its own delay; and the same where the second mode is slower:

    >>> dt.SwitchedSystem([[[-0.1]]], [[[1.0, -4.0]]], delay=[0.3, 0.1])
    SwitchedSystem(modes=1, states=1, inputs=2, delay=[0.3, 0.1])
    >>> A, B = [[[-0.1]], [[-0.2]]], [[[1.0, -4.0]], [[0.8, -4.0]]]
    >>> dt.SwitchedSystem(A, B, delay=[[0.3, 0.1], [0.5, 0.1]]).delays
    array([[0.3, 0.1],
           [0.5, 0.1]])
    """

    A: Float[np.ndarray, "mode n n"]
    B: Float[np.ndarray, "mode n m"]
    delays: Float[np.ndarray, "mode m"]

    def __init__(self, A: ArrayLike, B: ArrayLike, delay: ArrayLike) -> None:
        A = real_array("A", A, "(modes, n, n)", 3)
        B = real_array("B", B, "(modes, n, m)", 3)
        modes, n = A.shape[:2]
        require_shape("A", A, (modes, n, n), "(modes, n, n)")
        rows = B.shape[2] == n != B.shape[1]  # of inputs, where columns are meant
        require_shape("B", B, (modes, n, B.shape[1] if rows else B.shape[2]), "(modes, n, m)")
        delays = check_delays(delay, (modes, B.shape[2]))
        idle = np.flatnonzero(~B.any(axis=(0, 1)))
        if idle.size and (delays != delays[:, :1]).any():
            raise ArgumentError(
                f"B[:, :, {idle[0]}] must not be zero in every mode where inputs have delays of "
                f"their own: input {idle[0]} acts on nothing, so it has none; leave it out."
            )
        vars(self).update(A=A, B=B, delays=delays)
        require_exponential("delay", A, self.longest_delay)

    def like(
        self, A: np.ndarray, B: np.ndarray, delays: np.ndarray | None = None
    ) -> SwitchedSystem:
        """This plant with other matrices, and with other delays if they are given.

        Its inputs may act in no mode.
        """
        plant = object.__new__(SwitchedSystem)
        delays = self.delays if delays is None else delays
        A, B, delays = (np.array(part, dtype=float, order="C") for part in (A, B, delays))
        vars(plant).update(A=read_only(A), B=read_only(B), delays=read_only(delays))
        require_exponential("delay", A, plant.longest_delay)
        return plant

    def only(self, modes: Sequence[int]) -> SwitchedSystem:
        """The plant with these of its modes, in this order.

        Examples
        --------
        >>> import deadtime as dt
        >>> dt.problems.paper().plant.only([1])
        SwitchedSystem(modes=1, states=2, inputs=1, delay=1)
        """
        modes = list(modes)
        return self.like(self.A[modes], self.B[modes], self.delays[modes])

    @classmethod
    def from_statespace(cls, systems: Sequence[Any], delay: ArrayLike) -> SwitchedSystem:
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
    def longest_delay(self) -> float:
        """The longest delay of an input in a mode, seconds."""
        return float(self.delays.max())

    @cached_property
    def shortest_delay(self) -> float:
        """The shortest delay of an input in a mode, seconds."""
        return float(self.delays.min())

    @property
    def has_one_delay(self) -> bool:
        """Whether all inputs have the same delay in all modes."""
        return bool((self.delays == self.delays[0, 0]).all())

    @property
    def modes_share_delays(self) -> bool:
        """Whether each input has the same delay in all modes."""
        return bool((self.delays == self.delays[0]).all())

    @property
    def delay(self) -> float:
        """The input delay, seconds; an `ArgumentError` for a plant with several `delays`."""
        return self.one_delay("plant.delay, which is a number (plant.delays has all)")

    def one_delay(self, feature: str) -> float:
        """The one delay, seconds; an ArgumentError with the feature's name if there are several."""
        if not self.has_one_delay:
            raise ArgumentError(
                f"plant must have one delay for {feature}, got delay={self.delay_text}: several "
                "are not possible there."
            )
        return float(self.delays[0, 0])

    @property
    def delay_text(self) -> str:
        """`delay_data` as text."""
        return f"{self.delay_data:g}" if self.has_one_delay else f"{self.delay_data}"

    @property
    def delay_data(self) -> float | list[float] | list[list[float]]:
        """The delays as the constructor takes them: one, one per input, or per mode and input."""
        if self.has_one_delay:
            return float(self.delays[0, 0])
        return self.delays[0].tolist() if self.modes_share_delays else self.delays.tolist()

    @cached_property
    def identity(self) -> Float[np.ndarray, "n n"]:
        """The weight of :math:`|x|^2`."""
        return read_only(np.eye(self.states))

    def mean(self) -> SwitchedSystem:
        """The plant with one mode, the element-wise mean (Ā, B̄) of all modes, and of delays.

        Examples
        --------
        >>> import deadtime as dt
        >>> dt.problems.paper().plant.mean().A
        array([[[2.15 , 1.05 ],
                [0.025, 1.1  ]]])
        """
        # Round-off of a mean of equal delays would make them another delay.
        same = (self.delays == self.delays[0]).all(axis=0)
        delays = np.where(same, self.delays[0], self.delays.mean(axis=0))
        A, B = self.A.mean(axis=0, keepdims=True), self.B.mean(axis=0, keepdims=True)
        return self.like(A, B, delays[None])

    def apart(self, alpha: float) -> SwitchedSystem:
        r"""The plant with its modes α times as far from mode 0.

        :math:`A_0 + \alpha (A_i - A_0)`, and :math:`B` alike.

        Parameters
        ----------
        alpha : float
            :math:`\alpha \ge 0`: 0 makes all modes the same, 1 changes nothing.

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
        return self.like(A, B)

    def __repr__(self) -> str:
        return (
            f"SwitchedSystem(modes={self.modes}, states={self.states}, "
            f"inputs={self.inputs}, delay={self.delay_text})"
        )


def check_delays(delay: ArrayLike, shape: tuple[int, int], name: str = "delay") -> np.ndarray:
    """The delays of all modes and inputs, (modes, m), from a number or an array of them."""
    modes, m = shape
    if isinstance(delay, str) or not np.iterable(delay):
        return read_only(np.full(shape, positive(name, delay)))
    form = f"(m,) = ({m},), (modes, 1) = ({modes}, 1) or (modes, m) = ({modes}, {m})"
    rows = any(np.iterable(row) for row in delay)
    delays = real_array(name, delay, form, 2 if rows else 1)
    if delays.shape not in ((m,), (modes, 1), (modes, m)):
        per_mode = delays.shape == (modes,)
        hint = (
            f"; for one per mode give {[[value] for value in delays.tolist()]}" if per_mode else ""
        )
        raise ArgumentError(
            f"{name} must be a number or have shape {form}, got {delays.shape}: a list is one per "
            f"input{hint}."
        )
    delays = np.array(np.broadcast_to(delays, shape))
    low = -math.inf
    for value in np.unique(delays):  # those that differ by round-off become the least of them
        if value - low > ROUND_OFF * abs(value):
            low = value
        delays[delays == value] = low
    wrong = np.argwhere(delays <= 0.0)
    if wrong.size:
        i, j = wrong[0]
        raise ArgumentError(
            f"{name} of input {j} in mode {i} must be positive, in s, got {delays[i, j]:g}: for an "
            "input that acts at once give a small share of the sampling period."
        )
    return read_only(delays)


def require_exponential(name: str, A: Float[np.ndarray, "mode n n"], tau: float) -> float:
    """The largest |A|τ of all modes; an ArgumentError if it overflows."""
    with np.errstate(over="ignore"):
        size = float(np.abs(A).sum(axis=2).max()) * tau
    if not np.isfinite(size):
        raise ArgumentError(
            f"{name} must be short enough for e^(A·{name}), got {tau:g} s with entries of A up to "
            f"{np.abs(A).max():.3g} 1/s: |A|·{name} is beyond what floats hold, 1.8e308."
        )
    return size


@dataclass(frozen=True, eq=False, init=False)
class OperatingPoint(Frozen):
    """The equilibrium x₀, u₀ from which a plant's states and inputs are deviations.

        dx/dt = A_σ (x − x₀) + B_σ (u(t − D) − u₀)

    Parameters
    ----------
    x : array_like, shape (n,)
        In the units of the states.
    u : array_like, shape (m,)
        In the units of the inputs.

    Examples
    --------
    >>> OperatingPoint([30.0, 25.0], [45.0]).in_words(("level", "heat"), ("valve",))
    'level = 30, heat = 25 with valve = 45'
    """

    x: Float[np.ndarray, " n"]
    u: Float[np.ndarray, " m"]

    def __init__(self, x: ArrayLike, u: ArrayLike) -> None:
        object.__setattr__(self, "x", real_array("x", x, "(n,)", 1))
        object.__setattr__(self, "u", real_array("u", u, "(m,)", 1))
        self.__post_init__()

    def in_words(self, states: tuple[str, ...], inputs: tuple[str, ...]) -> str:
        """The point as text, with these names of states and inputs."""
        x, u = (
            ", ".join(f"{name} = {value:.4g}" for name, value in zip(names, part, strict=True))
            for names, part in ((states, self.x), (inputs, self.u))
        )
        return f"{x} with {u}"
