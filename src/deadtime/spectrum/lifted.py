"""The digital loop of one mode and one row of a law's table, as one matrix.

Over a sampling period the plant in one mode under one row (F, G) of a law's table is linear in

    z_k = (x_k, u_{k−1}, …, u_{k−W}),

W the longer of the plant's longest lag N and the law's taps:

    u_k = F x_k + Σ_j G_j u_{k−j},    x_{k+1} = Φ x_k + Σ_l Γ_l u_{k−l},

l over the lags of the plant's period (`plant.sampled_plant`). The rest of z is shifted. The
law's row comes from its own model, which may differ from the plant.

A loop with an observer is the lifted loop of a larger plant. Before the sample at t_k the loop's
state, besides the past inputs, is X = (x, x̄, s): the plant's, the observer's prediction, and for
tracking s = q_{k−1} + h v_{k−1}/2 with v = H C x. Then

    x̂ = x̄ + L (C x − C_o x̄),   q = s + h v/2,   u_k = F (x̂, q) + Σ_j G_j u_{k−j},
    x' = Φ x + …,   x̄' = Φ_o x̂ + …,   s' = s + h v,

the dots being the arriving inputs, with the lags of the plant and of the observer's model, which
may differ.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from deadtime.base.checks import index
from deadtime.feedback import Feedback, Law
from deadtime.plant import SampledPlant, SwitchedSystem
from deadtime.plant.pieces import Period
from deadtime.spectrum.sampled_runs import LoopPeriods, forward
from deadtime.switching import SwitchingSignal

DENSE = 500  # order up to which all eigenvalues are computed, in 0.2 to 1 s at that order
LEADING = 32  # eigenvalues whose errors are estimated: one of them may be the largest
_FAR = 50  # powers of two by which an input's effect may differ from 1
_MOST_VECTORS = 90  # of Arnoldi's method
_POWERS = 200_000  # powers of w in memory at a time


@dataclass(frozen=True, eq=False)
class LiftedLoop:
    """A plant in one mode under one row of a table (immutable).

    Attributes
    ----------
    period : Period
        x_{k+1} = Phi x_k + Σ_l Gamma[l] u_{k−lags[l]}, of the plant.
    F : (m, n), G : (taps, m, m)
        The row.
    """

    period: Period
    F: Float[np.ndarray, "m n"]
    G: Float[np.ndarray, "tap m m"]

    @classmethod
    def of(cls, plant: SwitchedSystem, feedback: Feedback, mode: int, row: int) -> LiftedLoop:
        """The loop of a mode of the plant under a row of a table, at the table's period."""
        period = SampledPlant(plant, feedback.step).period(mode)
        return cls(period, feedback.state_gain[row], feedback.input_gain[row])

    @property
    def past(self) -> int:
        """W, the number of past inputs in z."""
        return max(*self.period.lags, self.G.shape[0])

    @property
    def order(self) -> int:
        """n + W m, the size of z."""
        m, n = self.F.shape
        return n + self.past * m

    def balance(self) -> LiftedLoop:
        """A loop with the same eigenvalues and inputs in `units_of` their effect."""
        Gamma = self.period.Gamma
        power = units_of(Gamma.reshape(-1, Gamma.shape[2]))
        Gamma, F, G = in_units(power, Gamma, self.F, self.G)
        return LiftedLoop(self.period._replace(Gamma=Gamma), F, G)

    def matrix(self) -> Float[np.ndarray, "order order"]:
        """L of z_{k+1} = L z_k."""
        A, B = with_line(self.period, self.order)
        return A + B @ input_row(self.F, self.G, self.order)

    @cached_property
    def _periods(self) -> LoopPeriods:
        return LoopPeriods.of_period(self.period, self.F, self.G)

    def after(self, z: Float[np.ndarray, " order"], periods: int) -> Float[np.ndarray, " order"]:
        """L^periods z, by running the loop: O(W m²) a period."""
        (m, n), W = self.F.shape, self.past
        line, states = np.empty((W + periods) * m), np.empty((periods, n))
        line[: W * m] = z[n:].reshape(W, m)[::-1].ravel()  # runs need the oldest input first
        forward(self._periods, z[:n].copy(), line, states)
        return np.concatenate((states[-1], line.reshape(-1, m)[: -W - 1 : -1].ravel()))

    def growth_rate(self, step: float, dense: int | None = None) -> float:
        """ln(spectral radius of L)/h, −∞ where that is 0; see `leading_eigenvalues`."""
        radius = self.balance().leading_eigenvalues(dense)[1]
        return math.log(radius) / step if radius > 0.0 else -math.inf

    def leading_eigenvalues(
        self, dense: int | None = None
    ) -> tuple[Complex[np.ndarray, " eigenvalue"], float]:
        """Some eigenvalues of L with the largest moduli, and the spectral radius.

        Above the order `dense`, `DENSE` by default, the largest eigenvalue of L^{4W}, or L^{12W},
        is found by Arnoldi's method: the eigenvalues of the power are far apart, those of L are
        close to each other. The rates of the two methods agree to about 1e-9 1/s where eigenvalues
        are well conditioned.
        """
        if self.order > (DENSE if dense is None else dense):
            start = np.random.default_rng(0).normal(size=self.order)
            # L^periods: in a power eigenvalues lie farther apart, so Arnoldi's method needs fewer.
            for periods in (4 * self.past, 12 * self.past):
                with np.errstate(over="ignore", invalid="ignore"):
                    found = leading_eigenvalue(lambda z, k=periods: self.after(z, k), start, 1e-11)
                if found is not None:
                    radius = abs(found[0]) ** (1.0 / periods)
                    return np.array([self._quotient(found[1].astype(complex))]), radius
        values = np.linalg.eigvals(self.matrix())
        values = values[np.argsort(-np.abs(values), kind="stable")[:LEADING]]
        return values.astype(complex), float(np.abs(values[0]))

    def _quotient(self, z: Complex[np.ndarray, " order"]) -> complex:
        """The eigenvalue of L to an eigenvector."""
        now = self.after(np.real(z).copy(), 1) + 1j * self.after(np.imag(z).copy(), 1)
        return complex(np.vdot(z, now) / np.vdot(z, z).real)

    def doubt(self, values: Complex[np.ndarray, " eigenvalue"]) -> float:
        """The relative error of the largest of some eigenvalues, by a step of Newton's method.

        Other eigenvalues count if their errors are so large that they may be the largest. Newton's
        method is for det [[zI − Φ, −Σ_l z^{−l} Γ_l], [−F, I − Σ_j G_j z^{−j}]]. At an eigenvalue
        of multiplicity k its step is a k-th of the distance; k = n is assumed.
        """
        from deadtime.numerics.small_matrices import decompose

        (m, n), z = self.F.shape, values[:, None, None]
        Phi, Gamma, lags = self.period
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            g, slope = transform(self.G, 1.0 / values)
            Delta = np.zeros((values.size, n + m, n + m), complex)
            prime = np.zeros_like(Delta)
            Delta[:, :n, :n], prime[:, :n, :n] = z * np.eye(n) - Phi, np.eye(n)
            arriving = [z ** (-lag) * part for lag, part in zip(lags, Gamma, strict=True)]
            Delta[:, :n, n:] = -sum(arriving)
            prime[:, :n, n:] = sum(map(np.multiply, lags, arriving)) / z
            Delta[:, n:, :n], Delta[:, n:, n:] = -self.F, np.eye(m) - g
            prime[:, n:, n:] = slope / z
            if not (np.isfinite(Delta).all() and np.isfinite(prime).all()):
                return math.inf
            steps = n / np.abs(decompose(Delta, prime).slope(0))
        size = np.abs(values)
        return float(steps[size + steps >= size[0] - steps[0]].max() / size[0])


def lifted_loop(
    plant: SwitchedSystem, feedback: Feedback, mode: int, row: int | None = None
) -> Float[np.ndarray, "order order"]:
    """L of z_{k+1} = L z_k, z = (x_k, u_{k−1}, …, u_{k−W}), at the period of the table.

    Parameters
    ----------
    plant : SwitchedSystem
        The true plant; the table may come from another model, with another delay.
    feedback : Feedback
        The law's table.
    mode : int
        The plant's mode, all through the period.
    row : int, optional
        The table's row; by default that of a mode held throughout.

    Examples
    --------
    >>> import deadtime as dt
    >>> plant = dt.SwitchedSystem([[[0.0]]], [[[1.0]]], delay=0.2)
    >>> law = dt.SingleModePredictor(plant, [[[-1.0]]], 0)
    >>> lifted_loop(plant, law.digital(0.1), mode=0)
    array([[ 1. ,  0. ,  0.1],
           [-1. , -0.1, -0.1],
           [ 0. ,  1. ,  0. ]])
    """
    mode = index("mode", mode, plant.modes)
    rows = feedback.state_gain.shape[0]
    row = aged_row(feedback, mode) if row is None else index("row", row, rows)
    return LiftedLoop.of(plant, feedback, mode, row).matrix()


def with_memory(plant: SwitchedSystem, feedback: Feedback) -> SwitchedSystem:
    """The plant with the controller states of a table as further inputs, which have no effect.

    These come first and arrive after one period, whatever the plant's delays.

    Examples
    --------
    >>> import numpy as np, deadtime as dt
    >>> plant = dt.SwitchedSystem([[[0.0]]], [[[1.0]]], delay=0.2)
    >>> table = dt.Feedback(np.zeros((1, 2, 1)), np.zeros((1, 2, 2, 2)), "none", 0.1, memory=1)
    >>> with_memory(plant, table).B, with_memory(plant, table).delays
    (array([[[0., 1.]]]), array([[0.1, 0.2]]))
    """
    q = feedback.memory
    if not q:
        return plant
    idle, soon = np.zeros((*plant.B.shape[:2], q)), np.full((plant.modes, q), feedback.step)
    B, delays = np.concatenate((idle, plant.B), 2), np.concatenate((soon, plant.delays), 1)
    return plant.like(plant.A, B, delays)


def held_table(law: Law, mode: int, step: float) -> Feedback:
    """The table of a linear law, or of the law inside an output feedback, with one mode held."""
    rows = law if law.observer is None else law.row_law
    return rows.digital(step, SwitchingSignal.constant(mode), 1)


def aged_row(feedback: Feedback, mode: int) -> int:
    """The row that applies when a mode has been held throughout."""
    return feedback.row(mode, feedback.ages, feedback.state_gain.shape[0] - 1)


def with_line(period: Period, size: int) -> tuple[np.ndarray, np.ndarray]:
    """A (size, size) and B (size, m) of z_{k+1} = A z_k + B u_k, z = (x_k, u_{k−1}, u_{k−2}, …).

          x   u_{k−1} u_{k−2} …
    A = [ Φ   Γ_1     Γ_2     … ]    B = [ Γ_0 ]
        [ 0   0       0         ]        [ I   ]
        [ 0   I       0         ]        [ 0   ]
        [ 0   0       I         ]        [ 0   ]
    """
    (n, m), A = period.Gamma.shape[1:], np.zeros((size, size))
    B = np.zeros((size, m))
    if size > n:
        A[n + m :, n:-m] = np.eye(size - n - m)
        B[n : n + m] = np.eye(m)
    A[:n, :n] = period.Phi
    for lag, Gamma in zip(period.lags, period.Gamma, strict=True):
        if lag == 0:
            B[:n] += Gamma
        else:
            A[:n, n + (lag - 1) * m : n + lag * m] += Gamma
    return A, B


def input_row(
    F: Float[np.ndarray, "m n"], G: Float[np.ndarray, "tap m m"], size: int
) -> Float[np.ndarray, "m size"]:
    """(F, G_1, G_2, …, 0), the row of u_k = F x_k + Σ_j G_j u_{k−j}."""
    (m, n), taps, row = F.shape, len(G), np.zeros((len(F), size))
    row[:, :n] = F
    row[:, n : n + taps * m] = G.transpose(1, 0, 2).reshape(m, taps * m)
    return row


def leading_eigenvalue(
    apply: Callable[[np.ndarray], np.ndarray], start: np.ndarray, tolerance: float
) -> tuple[complex, np.ndarray] | None:
    """The eigenvalue of largest modulus of an operator and its eigenvector, by Arnoldi's method.

    None if 90 vectors do not give it to a relative `tolerance`, or numbers overflow.
    """
    order = start.size
    most = min(order, _MOST_VECTORS)
    basis, H = np.zeros((most + 1, order)), np.zeros((most + 1, most))
    basis[0] = start / np.linalg.norm(start)
    for j in range(most):
        image = apply(basis[j])
        if not np.isfinite(image).all():
            return None
        for _ in range(2):  # Gram and Schmidt's method loses orthogonality in one pass
            part = basis[: j + 1] @ image
            image = image - part @ basis[: j + 1]
            H[: j + 1, j] += part
        H[j + 1, j] = size = float(np.linalg.norm(image))
        if not np.isfinite(H[: j + 2, j]).all():
            return None
        closed = size <= 1e-14 * np.abs(H[: j + 1, : j + 1]).max() or j + 1 == order
        if closed or j % 4 == 3:
            values, vectors = np.linalg.eig(H[: j + 1, : j + 1])
            i = int(np.argmax(np.abs(values)))
            if closed or size * abs(vectors[-1, i]) <= tolerance * abs(values[i]):
                return complex(values[i]), vectors[:, i] @ basis[: j + 1]
        basis[j + 1] = image / size
    return None


def transform(G, w):
    """Σ_j G_j w^j and Σ_j j G_j w^j, (points, m, m), for G (taps, m, m) and w (points,)."""
    taps, m, _ = G.shape
    flat = G.reshape(taps, m * m)
    both = np.concatenate((flat, flat * np.arange(1.0, taps + 1.0)[:, None]), axis=1)
    result = np.empty((w.size, 2 * m * m), np.complex128)
    size = max(1, _POWERS // taps)
    for start in range(0, w.size, size):
        some = w[start : start + size, None]
        with np.errstate(all="ignore"):  # far outside the unit circle powers overflow
            result[start : start + size] = np.cumprod(np.repeat(some, taps, axis=1), axis=1) @ both
    value, slope = result.reshape(-1, 2, m, m).transpose(1, 0, 2, 3)
    return value, slope


class LawSide(NamedTuple):
    """Observer and law from the measurement, w = (x̄, s): w' = A w + B y, u = E w + D y.

    Without the arriving inputs and the law's feedback of past inputs.
    """

    A: Float[np.ndarray, "w w"]
    B: Float[np.ndarray, "w seen"]
    E: Float[np.ndarray, "m w"]
    D: Float[np.ndarray, "m seen"]

    @classmethod
    def of(
        cls,
        law: Law,
        C: Float[np.ndarray, "p seen"],
        x_bar: Period,
        F: Float[np.ndarray, "m z"],
        mode: int,
    ) -> LawSide:
        """Observer and law for the gain F of the law inside; C is the identity for y itself."""
        h, observer = law.observer.step, law.observer
        C_o, L = observer.C[mode], observer.gain[mode]
        H = np.zeros((0, len(C))) if law.servo is None else law.servo.tracked[: law.servo.sums]
        seen, n_o, q = C.shape[1], len(x_bar.Phi), len(H)
        estimate, v = np.zeros((n_o, seen + n_o + q)), np.zeros((q, seen + n_o + q))
        estimate[:, :seen], estimate[:, seen : seen + n_o] = L @ C, np.eye(n_o) - L @ C_o
        v[:, :seen] = H @ C
        q_now = h / 2.0 * v
        q_now[:, seen + n_o :] += np.eye(q)
        after = np.vstack((x_bar.Phi @ estimate, h * v))
        after[n_o:, seen + n_o :] += np.eye(q)
        gain = F[:, :n_o] @ estimate + F[:, n_o : n_o + q] @ q_now
        return cls(after[:, seen:], after[:, :seen], gain[:, seen:], gain[:, :seen])


class Joined(NamedTuple):
    """X' = Phi X + …, u_k = gain X + …, X = (x, x̄, s); the first `true` states are the plant's."""

    Phi: Float[np.ndarray, "size size"]
    gain: Float[np.ndarray, "m size"]
    true: int

    @classmethod
    def of(cls, law: Law, x: Period, x_bar: Period, F: np.ndarray, mode: int) -> Joined:
        """Plant and observer, each with its own delay line, for the gain F of the law inside."""
        assert law.outputs is not None
        side, n = LawSide.of(law, law.outputs[mode], x_bar, F, mode), len(x.Phi)
        Phi = np.zeros((n + len(side.A), n + len(side.A)))
        Phi[:n, :n] = x.Phi
        Phi[n:, :n], Phi[n:, n:] = side.B, side.A
        return cls(Phi, np.hstack((side.D, side.E)), n)

    def arrivals(self, x: Period, x_bar: Period) -> Period:
        """The period of X with the inputs of the plant and of the observer's model, lag by lag."""
        n, m = x.Gamma.shape[1:]
        rows = {"plant": slice(0, n), "model": slice(n, n + x_bar.Gamma.shape[1])}
        lags = tuple(sorted({*x.lags, *x_bar.lags}, reverse=True))
        Gamma = np.zeros((len(lags), len(self.Phi), m))
        for name, period in (("plant", x), ("model", x_bar)):
            for lag, part in zip(period.lags, period.Gamma, strict=True):
                Gamma[lags.index(lag), rows[name]] = part
        return Period(self.Phi, Gamma, lags)


def periods_of(plant: SwitchedSystem, law: Law, mode: int) -> tuple[Period, Period]:
    """A period of the plant, and of the observer's model of it."""
    step, model = law.observer.step, law.observer.plant
    return SampledPlant(plant, step).period(mode), SampledPlant(model, step).period(mode)


def observed_loop(
    plant: SwitchedSystem, law: Law, feedback: Feedback, mode: int, row: int
) -> LiftedLoop:
    """The loop of plant, observer and one row of the table of the law inside, reference 0."""
    x, x_bar = periods_of(plant, law, mode)
    X = Joined.of(law, x, x_bar, feedback.state_gain[row], mode)
    return LiftedLoop(X.arrivals(x, x_bar), X.gain, feedback.input_gain[row])


def units_of(effect: Float[np.ndarray, "row m"]) -> np.ndarray:
    """Exponents of the powers of two, (m,), that scale each input so that its effect is near 1.

    Without it round-off would hide the eigenvalues of a loop with effects of 1e100. 0, no change,
    for effects between 2^−50 and 2^50; powers of two change no digits.
    """
    power = np.frexp(np.abs(effect).max(axis=0))[1]
    return np.where(np.abs(power) <= _FAR, 0, power)


def in_units(
    power: np.ndarray, effect: np.ndarray, F: np.ndarray, G: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The inputs' effect (…, m) and the row (F, G) that computes them, in other units."""
    column = power[:, None]
    return np.ldexp(effect, -power), np.ldexp(F, column), np.ldexp(G, column - power)
