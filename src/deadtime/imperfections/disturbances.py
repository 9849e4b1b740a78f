"""Disturbances of the plant: dx/dt = A_σ x + B_σ u(t − D) + w(t).

Over each stretch of a period (from one arrival of an input to the next) the change of x by w is
drawn with its exact distribution, also across switches. Within a stretch w is replaced by the
constant force with the same effect, so that a run can be evaluated at any time.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.base.checks import as_floats, number, real_array, require_shape
from deadtime.base.errors import ArgumentError
from deadtime.imperfections.base import Disturbance, Sizes, Stacked, number_text, once, per_signal
from deadtime.numerics.covariance import accumulate, lower_root, rates
from deadtime.numerics.kernels import kernel
from deadtime.plant.discretisation import snap
from deadtime.plant.weight import intensities


class DrawnDisturbance(Stacked, Disturbance):
    """A disturbance with a fixed number of normal random numbers per stretch.

    The first stretch of all periods has the run's stream, the second one the first stream spawned
    from it, and so on: so the numbers of a stretch do not depend on how many others there are, and
    a longer run continues a shorter one.
    """

    @abstractmethod
    def counts(self, sizes: Sizes) -> tuple[int, int]:
        """Numbers per stretch: before the first period, and in every one."""

    @abstractmethod
    def draws_from(
        self,
        numbers: Float[np.ndarray, "stretch runs count"],
        sizes: Sizes,
        lengths: tuple[float, ...],
        steps: int,
        room_for: Callable[[tuple[int, ...]], np.ndarray] = np.empty,
    ) -> Float[np.ndarray, "stretch some steps r"]:
        """`Disturbance.draws` of runs, from their normal numbers, stretch by stretch.

        No length is 0. An axis of length 1 stands for all runs. `room_for` allocates the result.
        """

    @abstractmethod
    def spreads_in(
        self, sizes: Sizes, A: np.ndarray, mode: np.ndarray, tau: np.ndarray
    ) -> Float[np.ndarray, "count n r"]:
        """`Disturbance.spread` of many stretches, (count, n, r).

        Their pieces last tau (count, pieces) seconds in a mode (count, pieces) of A (modes, n, n).
        """

    @final
    def spreads(self, sizes: Sizes, A: np.ndarray, tau: np.ndarray) -> np.ndarray:
        mode = np.arange(tau.size).reshape(tau.shape)
        return self.spreads_in(sizes, A.reshape(-1, *A.shape[2:]), mode, tau)

    @final
    def draws(
        self, sizes: Sizes, lengths: tuple[float, ...], steps: int, rng: np.random.Generator
    ) -> np.ndarray:
        before, each = self.counts(sizes)
        (present,) = np.nonzero(np.array(lengths))
        # Stretches of length 0 have a stream, too, so that the others keep theirs.
        streams = [rng, *rng.spawn(len(lengths) - 1)]
        numbers = [streams[i].standard_normal((1, before + each * steps)) for i in present]
        own = self.draws_from(np.stack(numbers), sizes, tuple(lengths[i] for i in present), steps)
        draws = np.zeros((steps, len(lengths), own.shape[3]))
        draws[:, present] = own[:, 0].transpose(1, 0, 2)
        return draws


@dataclass(frozen=True)
class WhiteDisturbance(DrawnDisturbance):
    """White process noise: E[w(t) w(s)ᵀ] = W δ(t − s), with W of the mode if W is per mode.

    The states at the samples and at the arrivals of inputs have exactly the distribution of the
    stochastic differential equation. Paths are smooth within a stretch, which leaves at most
    tr(W) h/6 per second out of the mean of ∫|x|².

    Parameters
    ----------
    intensity : array_like
        W: a number for W = number·I, shape (n,) for a diagonal, (n, n), or (modes, n, n) for one
        per mode; positive semidefinite, in units of x² per second.
    """

    words: ClassVar[str] = "white disturbance (intensity {intensity})"
    intensity: ArrayLike

    def counts(self, sizes: Sizes) -> tuple[int, int]:
        self._check(sizes)
        return 0, sizes.states

    def draws_from(
        self,
        numbers: np.ndarray,
        sizes: Sizes,
        lengths: tuple[float, ...],
        steps: int,
        room_for: Callable[[tuple[int, ...]], np.ndarray] = np.empty,
    ) -> np.ndarray:
        return numbers.reshape(*numbers.shape[:2], steps, sizes.states)

    def spreads_in(
        self, sizes: Sizes, A: np.ndarray, mode: np.ndarray, tau: np.ndarray
    ) -> np.ndarray:
        return lower_root(accumulate(A, self._check(sizes), rates(A), mode, tau)[1])

    @once
    def _check(self, sizes: Sizes) -> Float[np.ndarray, "*mode n n"]:
        name = "WhiteDisturbance.intensity"
        return intensities(name, self.intensity, sizes.modes, sizes.states)


@dataclass(frozen=True)
class ColouredDisturbance(DrawnDisturbance):
    """Coloured noise w = E c with c' = −c/T + white noise (Ornstein–Uhlenbeck), stationary.

    Parameters
    ----------
    std : array_like
        Stationary standard deviation of c, a number or shape (q,).
    time_constant : array_like
        Correlation time T, seconds, a number or shape (q,).
    force : array_like, shape (n,) or (n, q)
        E: how each of the q sources acts on dx/dt.
    """

    words: ClassVar[str] = (
        "coloured disturbance (std {std}, time constant {time_constant} s, force {force})"
    )
    std: ArrayLike
    time_constant: ArrayLike
    force: ArrayLike

    def counts(self, sizes: Sizes) -> tuple[int, int]:
        _, std, _ = self._check(sizes.states)
        return std.size, std.size + sizes.states

    def draws_from(
        self,
        numbers: np.ndarray,
        sizes: Sizes,
        lengths: tuple[float, ...],
        steps: int,
        room_for: Callable[[tuple[int, ...]], np.ndarray] = np.empty,
    ) -> np.ndarray:
        _, std, T = self._check(sizes.states)
        # c(t + τ) given c(t) is normal with mean `kept` c and standard deviation `fresh`.
        tau = np.array(lengths)[:, None]
        kept, fresh = np.exp(-tau / T), std * np.sqrt(-np.expm1(-2.0 * tau / T))
        draws = room_for((*numbers.shape[:2], steps, 2 * std.size + sizes.states))
        if numbers.shape[1] == 1:
            _follow_one(std, kept, fresh, numbers, draws)
        else:
            short = (0.0,) * std.size, (0.0,) * sizes.states
            _follow_many(std, kept, fresh, numbers, draws, *short)
        return draws

    def spreads_in(
        self, sizes: Sizes, A: np.ndarray, mode: np.ndarray, tau: np.ndarray
    ) -> np.ndarray:
        """From c at both ends and n normal numbers: the mean given c, and the rest."""
        E, std, T = self._check(sizes.states)
        n, q = E.shape
        total = tau.sum(axis=1)[:, None]
        W = np.zeros((n + q, n + q))
        W[n:, n:] = np.diag(2.0 * std**2 / T)
        joint = np.zeros((len(A), n + q, n + q))
        joint[:, :n, :n], joint[:, :n, n:], joint[:, n:, n:] = A, E, np.diag(-1.0 / T)
        rate = np.maximum(rates(A), (1.0 / T).max(initial=0.0))
        M, Q = accumulate(joint, W, rate, mode, tau)
        kept, variance = np.exp(-total / T), std**2 * -np.expm1(-2.0 * total / T)
        # x given c at both ends is normal: regression on the new c, and the residual covariance.
        slope = Q[:, :n, n:] / np.where(variance > 0.0, variance, 1.0)[:, None]
        rest = lower_root(Q[:, :n, :n] - slope @ Q[:, n:, :n])
        return np.concatenate((M[:, :n, n:] - slope * kept[:, None], slope, rest), axis=2)

    @once
    def _check(self, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        given = as_floats("ColouredDisturbance.force", self.force, "(n, q)")
        given = given[:, None] if given.ndim == 1 else given
        E = real_array("ColouredDisturbance.force", given, "(n, q)", 2)
        require_shape("ColouredDisturbance.force", E, (n, E.shape[1]), "(n, q)")
        std = per_signal("ColouredDisturbance.std", self.std, E.shape[1])
        T = per_signal("ColouredDisturbance.time_constant", self.time_constant, E.shape[1])
        if (std < 0.0).any() or (T <= 0.0).any():
            raise ArgumentError(
                "ColouredDisturbance must have std ≥ 0 and time_constant > 0, got "
                f"{std.tolist()} and {T.tolist()}."
            )
        return E, std, T


@dataclass(frozen=True)
class StepDisturbance(DrawnDisturbance):
    """A constant force on dx/dt between two times, each rounded up to a sample.

    Parameters
    ----------
    force : array_like, shape (n,) or (modes, n)
        Units of x per second; with a row per mode the force changes at the instant of a switch:
        dx/dt = A_σ x + B_σ u(t − D) + c_σ.
    start, end : float
        Seconds, 0 ≤ start < end.
    """

    force: ArrayLike
    start: float = 0.0
    end: float = math.inf

    def counts(self, sizes: Sizes) -> tuple[int, int]:
        return 0, 0

    def draws_from(
        self,
        numbers: np.ndarray,
        sizes: Sizes,
        lengths: tuple[float, ...],
        steps: int,
        room_for: Callable[[tuple[int, ...]], np.ndarray] = np.empty,
    ) -> np.ndarray:
        start = number("StepDisturbance.start", self.start)
        try:
            end = float(self.end)
        except (TypeError, ValueError):
            end = math.nan
        if not 0.0 <= start < end:
            raise ArgumentError(
                f"StepDisturbance must have 0 ≤ start < end, got {start:g} and {self.end}."
            )
        first, stop = (math.ceil(snap(min(t / sizes.step, steps))) for t in (start, end))
        active = np.zeros((len(lengths), 1, steps, 1))
        active[:, :, first:stop] = 1.0
        return active

    def spreads_in(
        self, sizes: Sizes, A: np.ndarray, mode: np.ndarray, tau: np.ndarray
    ) -> np.ndarray:
        force, n = self._check(sizes), sizes.states
        joint = np.zeros((len(A), n + 1, n + 1))
        joint[:, :n, :n], joint[:, :n, n] = A, force
        return accumulate(joint, None, rates(A), mode, tau)[0][:, :n, n:]

    @property
    def depends_on_mode(self) -> bool:
        return np.ndim(self.force) == 2

    @property
    def in_words(self) -> str:
        """A force of every mode that always acts is an offset, c_σ.

        Examples
        --------
        >>> StepDisturbance([[0.0, 0.0], [0.3, 0.0]]).in_words
        'offset [0.3, 0] in mode 1'
        >>> StepDisturbance([0.3, 0.0], start=2.0).in_words
        'step disturbance (force [0.3, 0], from 2 s)'
        """
        ends = math.isfinite(self.end)
        if self.start > 0.0 or ends or not self.depends_on_mode:
            until = f" to {self.end:g} s" if ends else ""
            force = number_text(self.force)
            return f"step disturbance (force {force}, from {self.start:g} s{until})"
        rows = enumerate(np.asarray(self.force, dtype=float))
        acting = [f"{number_text(row)} in mode {mode}" for mode, row in rows if row.any()]
        return f"offset {' and '.join(acting) or 0}"

    def force_by_mode(self, sizes: Sizes) -> np.ndarray | None:
        return self._check(sizes) if self.depends_on_mode else None

    def _check(self, sizes: Sizes) -> np.ndarray:
        name, modes, n = "StepDisturbance.force", sizes.modes, sizes.states
        given = as_floats(name, self.force, f"({n},) or ({modes}, {n})")
        if given.ndim == 2:
            force = real_array(name, given, "(modes, n)", 2)
            return require_shape(name, force, (modes, n), "(modes, n)")
        return require_shape(name, real_array(name, given, "(n,)", 1), (n,), "(n,)")


@kernel(eager=True, nogil=True)
def _follow_many(std, kept, fresh, numbers, draws, sources, states):
    """Fill `draws` with c before and after every stretch, c ← kept c + fresh·number, and the rest.

        numbers (stretch, run, count):  q initial values | q for c, n for x | q, n | … per step
        draws (stretch, run, step, width):  c before (q) | c after (q) | numbers for x (n)

    c starts at std times the initial values of the first stretch. `sources` and `states` are
    tuples of lengths q and n, so that the compiler unrolls short loops.
    """
    (stretches, runs, steps, _), count = draws.shape, numbers.shape[2]
    q, more = len(sources), len(sources) + len(states)
    width = q + more
    given, filled, now = numbers.reshape(-1), draws.reshape(-1), np.empty(q)
    for run in range(runs):
        for j in range(q):
            now[j] = std[j] * given[run * count + j]
        first, begin = run * count + q, run * steps * width
        for _ in range(steps):
            at, to = first, begin
            for s in range(stretches):
                for j in range(q):
                    c = now[j]
                    filled[to + j] = c
                    c = kept[s, j] * c + fresh[s, j] * given[at + j]
                    filled[to + q + j] = now[j] = c
                for i in range(q, more):
                    filled[to + q + i] = given[at + i]
                at, to = at + runs * count, to + runs * steps * width
            first, begin = first + more, begin + width


def _follow_one(
    std: np.ndarray, kept: np.ndarray, fresh: np.ndarray, numbers: np.ndarray, draws: np.ndarray
) -> None:
    """`_follow_many` of one run, without compiling."""
    stretches, _, steps, width = draws.shape
    q = std.size
    own = numbers[:, 0, q:].reshape(stretches, steps, width - q)
    # (steps, stretches): in the order of time, period by period.
    more = (fresh[:, None] * own[:, :, :q]).transpose(1, 0, 2).reshape(-1, q)
    for j in range(q):
        c, path = float(std[j] * numbers[0, 0, j]), []
        for factor, added in zip(kept[:, j].tolist() * steps, more[:, j].tolist(), strict=True):
            path.append(c)
            c = factor * c + added
        path.append(c)
        whole = np.array(path)
        draws[:, 0, :, j] = whole[:-1].reshape(steps, stretches).T
        draws[:, 0, :, q + j] = whole[1:].reshape(steps, stretches).T
    draws[:, 0, :, 2 * q :] = own[:, :, q:]
