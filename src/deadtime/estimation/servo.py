"""Tracking as state feedback of a larger plant, so that every law's forecast applies to it.

A servo adds to the states x those that remove the offset,

    z = (x, d, q, r):    dx/dt = A_σ x + E_σ d + B_σ u(t − D),    dd/dt = 0,
                         dq/dt = H C_σ x − r,                     dr/dt = 0,

a constant disturbance d that an observer estimates, the integral q of the tracking error, and the
reference r. In mode i the outputs stay at r where x = X_d d + X_r r and u = U_d d + U_r r with

    A X_d + B U_d + E = 0,  H C X_d = 0;        A X_r + B U_r = 0,  H C X_r = I,

and the gain on z drives the mode there,

    u = K_x (x − X_d d − X_r r) + K_q (q − Θ r) + U_d d + U_r r,

[K_x, K_q] being a gain of (x, q) alone. A law predicts z at t + D as it predicts x, so u is the
expectation of this expression over modes.

Θ only moves the value at which q settles. With Θ = 0 the integral of the error would have to
return to 0 after a step of r, so the error accumulated during the delay and while the loop settles
would cause overshoot. Θ minimises ∫ |H C x − r|² after a step, over all
modes together: with the loops F_i = A_z + B_z [K_x, K_q] and X_i = ∫ e^{F_iᵀs} (HC)ᵀHC e^{F_i s} ds
in blocks of (x, q),

    Θ = −D I − (Σ_i X_qq)⁻¹ Σ_i X_qx X_r,i.

One Θ serves all modes, so a switch between modes with the same x and u at rest causes no transient.

A `Reference` is a constant, drawn or not, a schedule, or a function of time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike

from deadtime.base.checks import (
    as_floats,
    instance,
    positive,
    real_array,
    require_shape,
    require_unmasked,
)
from deadtime.base.errors import ArgumentError
from deadtime.base.frozen import Frozen
from deadtime.estimation.observer import output_matrices, per_mode
from deadtime.gains import state_feedback as design
from deadtime.plant import SwitchedSystem
from deadtime.plant.discretisation import TOLERANCE, finite_discretisation


@runtime_checkable
class Drawable(Protocol):
    """A distribution as scipy.stats freezes it."""

    def rvs(self, size: Any = ..., random_state: Any = ...) -> Any:
        """Numbers drawn."""
        ...

    def mean(self) -> Any:
        """Their mean."""
        ...

    def support(self) -> Any:
        """The least and the largest."""
        ...


@dataclass(frozen=True, eq=False)
class Reference:
    """r(t), from a time in seconds to shape (size,).

    With a `distribution`, of which every run draws a constant for each output, it is the mean.
    """

    function: Callable[[float], Any]
    size: int
    schedule: Schedule | None = None
    distribution: Drawable | None = None

    def __call__(self, time: float) -> Float[np.ndarray, " size"]:
        return check_reference(self.function(time), self.size)

    def along(self, time: Float[np.ndarray, " T"]) -> Float[np.ndarray, "T size"]:
        """r at many times."""
        if self.schedule is not None:
            return self.schedule.along(time)
        return np.array([self(t) for t in time.tolist()]).reshape(time.size, self.size)

    @property
    def values(self) -> Float[np.ndarray, "count size"]:
        """The values known beforehand: none of a function; of a distribution its mean and ends."""
        if self.schedule is None:
            return np.zeros((0, self.size))
        if self.distribution is None:
            return self.schedule.values
        ends = [np.broadcast_to(end, self.size) for end in self.distribution.support()]
        return np.array([*self.schedule.values, *(end for end in ends if np.isfinite(end).all())])

    def drawn(self, rng: np.random.Generator) -> Reference:
        """The reference of one run: a sample of the distribution, if there is one."""
        if self.distribution is None:
            return self
        return Reference.of(self.distribution.rvs(size=self.size, random_state=rng), self.size)

    @classmethod
    def of(cls, value: Any, size: int) -> Reference:
        """From what a user gives: a number, (size,), (times, values), a function or a distribution.

        A distribution is one that scipy.stats freezes, of finite mean.
        """
        if isinstance(value, Reference):
            return value
        if isinstance(value, Drawable):
            mean = value.mean()
            if not np.isfinite(mean).all():
                raise ArgumentError(f"reference must have a finite mean, got {mean}.")
            schedule = Schedule(np.zeros(1), check_reference(mean, size)[None])
            return cls(schedule, size, schedule, value)
        if callable(value):
            return cls(value, size)
        if isinstance(value, tuple) and len(value) == 2 and np.ndim(value[0]) == 1:
            schedule = Schedule.of(*value, size)
        else:
            schedule = Schedule(np.zeros(1), check_reference(value, size)[None])
        return cls(schedule, size, schedule)


def check_reference(value: Any, size: int) -> Float[np.ndarray, " size"]:
    """A number for every output, or one for each."""
    given = require_unmasked("reference", value)
    whole = [given] * size if np.ndim(given) == 0 else given
    array = real_array("reference", whole, "(tracked,)", 1)
    return require_shape("reference", array, (size,), "(tracked,)")


@dataclass(frozen=True, eq=False)
class Schedule:
    """Piecewise constant: each value from its time on, the first from the start."""

    times: Float[np.ndarray, " change"]
    values: Float[np.ndarray, "change size"]

    @classmethod
    def of(cls, times: Any, values: Any, size: int) -> Schedule:
        """From a number or (size,) for every time."""
        times = real_array("reference, times", times, "(T,)", 1)
        values = as_floats("reference, values", values, "(T,) or (T, tracked)")
        values = np.tile(values[:, None], size) if values.ndim == 1 else values
        values = real_array("reference, values", values, "(T,) or (T, tracked)", 2)
        require_shape("reference, values", values, (times.size, size), "(T, tracked)")
        if (np.diff(times) <= 0.0).any():
            raise ArgumentError(f"reference, times must increase, got {times.tolist()}.")
        return cls(times, values)

    def __call__(self, time: float) -> Float[np.ndarray, " size"]:
        return self.along(np.array([time]))[0]

    @property
    def slack(self) -> float:
        """Seconds by which a sample may precede a change and still count as at it (round-off)."""
        return TOLERANCE * max(1.0, float(np.abs(self.times).max()))

    def along(self, time: Float[np.ndarray, " T"]) -> Float[np.ndarray, "T size"]:
        """The values at many times."""
        late = np.searchsorted(self.times, time + self.slack, "right") - 1
        return self.values[np.maximum(late, 0)]  # before its first time, the first value


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Servo(Frozen):
    r"""A plant extended for tracking (immutable); see the module for the equations.

    Parameters
    ----------
    plant : SwitchedSystem
        The plant.
    C : array_like, shape (p, n) or (modes, p, n)
        What is measured, :math:`y = C_\sigma x`.
    tracked : array_like, shape (tracked, p), optional
        H: the combinations of y that follow the reference; all of y by default.
    integral : bool
        Sum the tracking error: no offset for any law and any constant error of the model, as
        long as the loop is stable.
    disturbance : array_like, shape (n, k) or (modes, n, k), optional
        E: where a constant disturbance acts, for an observer to estimate. It acts faster than the
        sum; alone it leaves no offset only where the law's forecast is right at rest.

    Attributes
    ----------
    base : SwitchedSystem
        The plant that was given.
    model : SwitchedSystem
        With the states (x, d): for the observer, with its outputs `C` (modes, p, n + k).
    plant : SwitchedSystem
        With the states z = (x, d, q, r): for the law. d and r being constant, laws of it need
        allow_unstable=True.
    tracked : (tracked, p)
        H.
    sums : int
        Size of q: the number of tracked outputs with `integral`, 0 without.
    driven : SwitchedSystem
        With the states (x, q), all that moves: for certificates.
    moving : (x and q,) int
        Where these are in z.

    Raises
    ------
    ArgumentError
        If a shape is wrong, or a mode cannot hold the outputs at every reference.

    Examples
    --------
    >>> import deadtime as dt
    >>> plant = dt.SwitchedSystem([[[0.0]], [[0.5]]], [[[1.0]], [[1.0]]], delay=0.3)
    >>> servo = dt.Servo(plant, C=[[1.0]])
    >>> servo.plant
    SwitchedSystem(modes=2, states=3, inputs=1, delay=0.3)
    >>> servo.place([-1.0, -2.0], step=0.1).round(3)      # on x, q and r
    array([[[-2.678, -1.725,  2.147]],
    <BLANKLINE>
           [[-3.112, -1.682,  2.095]]])
    """

    base: SwitchedSystem
    model: SwitchedSystem
    plant: SwitchedSystem
    C: Float[np.ndarray, "mode p nd"]
    tracked: Float[np.ndarray, "r p"]
    integral: bool
    disturbance: Float[np.ndarray, "mode n k"]

    def __init__(
        self,
        plant: SwitchedSystem,
        C: ArrayLike,
        tracked: ArrayLike | None = None,
        *,
        integral: bool = True,
        disturbance: ArrayLike | None = None,
    ) -> None:
        instance("plant", plant, SwitchedSystem)
        C, modes, n = output_matrices(C, plant), plant.modes, plant.states
        H = np.eye(C.shape[1]) if tracked is None else real_array("tracked", tracked, "(r, p)", 2)
        if H.shape[1] != C.shape[1]:
            raise ArgumentError(
                f"tracked must have one column per output, {C.shape[1]}, got {H.shape}."
            )
        E = np.zeros((modes, n, 0)) if disturbance is None else _forces(disturbance, plant)
        A = np.zeros((modes, n + E.shape[2], n + E.shape[2]))
        A[:, :n, :n], A[:, :n, n:] = plant.A, E
        B = np.zeros((modes, n + E.shape[2], plant.inputs))
        B[:, :n] = plant.B
        model = plant.like(A, B)
        measured = np.concatenate((C, np.zeros((modes, C.shape[1], E.shape[2]))), axis=2)
        vars(self).update(
            base=plant, model=model, C=measured, tracked=H, integral=bool(integral), disturbance=E
        )
        vars(self).update(plant=_with_errors(model, H @ measured, self.sums))
        for i in range(modes):
            self._require_regular(i)

    @property
    def sums(self) -> int:
        """Number of integrated errors, the size of q."""
        return len(self.tracked) if self.integral else 0

    def place(
        self, poles: ArrayLike | Sequence[ArrayLike], step: float | None = None
    ) -> Float[np.ndarray, "mode m z"]:
        """Gains on z with the poles of (x, q), n plus the size of q, given as for `place`."""
        return self.complete(design.place(self.driven, poles, step), step)

    def lqr(
        self, Q: ArrayLike, R: ArrayLike, step: float | None = None
    ) -> Float[np.ndarray, "mode m z"]:
        """Gains on z whose part on (x, q) is that of `lqr`, with Q of the size of (x, q)."""
        return self.complete(design.lqr(self.driven, Q, R, step), step)

    @property
    def moving(self) -> Int[np.ndarray, " xq"]:
        """Indices of (x, q) in the state z; the rest, d and r, are constant."""
        n, k = self.base.states, self.disturbance.shape[2]
        return np.r_[0:n, n + k : n + k + self.sums]

    @property
    def driven(self) -> SwitchedSystem:
        """The plant with the states (x, q), for certificates: d and r do not decay.

        A law of it whose gains are K[:, :, servo.moving] is the servo's at d = 0 and r = 0.
        """
        keep = self.moving
        A, B = self.plant.A[:, keep][:, :, keep], self.plant.B[:, keep]
        return self.plant.like(A, B)

    def complete(self, K: ArrayLike, step: float | None = None) -> Float[np.ndarray, "mode m z"]:
        """Gains on z from gains on (x, q), which must make every mode decay.

        Parameters
        ----------
        K : array_like, shape (modes, m, n + size of q)
            As `place` and `lqr` of `driven` give them.
        step : float, optional
            Their sampling period, seconds; None for a continuous loop.

        Returns
        -------
        (modes, m, size of z) array
            The gains on z = (x, d, q, r).

        Examples
        --------
        >>> import deadtime as dt
        >>> plant = dt.SwitchedSystem([[[0.0]]], [[[1.0]]], delay=0.3)
        >>> servo = dt.Servo(plant, C=[[1.0]])
        >>> servo.complete([[[-3.0, -2.0]]]).round(3)      # poles -1 and -2
        array([[[-3. , -2. ,  2.4]]])
        """
        n, k = self.base.states, self.disturbance.shape[2]
        step = None if step is None else positive("step", step)
        shape = self.base.modes, self.base.inputs, n + self.sums
        K = require_shape("K", real_array("K", K, "(modes, m, xq)", 3), shape, "(modes, m, xq)")
        _require_decay(self.driven, K, step)
        rest = [self._rest(i) for i in range(self.base.modes)]
        shift = self._shift(K, [X[:, k:] for X, _ in rest], step)
        result = []
        for gain, (X, U) in zip(K, rest, strict=True):
            onward = U - gain[:, :n] @ X
            onward[:, k:] -= gain[:, n:] @ shift
            # z = | x | d | q | r |
            result.append(np.hstack((gain[:, :n], onward[:, :k], gain[:, n:], onward[:, k:])))
        return np.stack(result)

    def steady_input(
        self, reference: ArrayLike, force: ArrayLike | None = None
    ) -> Float[np.ndarray, "mode m"]:
        """The constant input that holds the tracked outputs at a reference, for every mode.

        :math:`A_i x + B_i u + c_i = 0` and :math:`H C_i x = r`; the smallest :math:`(x, u)` where
        there are several.

        Parameters
        ----------
        reference : array_like
            r: a number, or shape (tracked,).
        force : array_like, shape (n,) or (modes, n), optional
            c: a constant force on dx/dt; 0 by default.

        Returns
        -------
        (modes, m) array
            The input of every mode.

        Examples
        --------
        >>> import deadtime as dt
        >>> plant = dt.SwitchedSystem([[[-1.0]], [[-2.0]]], [[[1.0]], [[1.0]]], delay=0.3)
        >>> dt.Servo(plant, C=[[1.0]]).steady_input(3.0, force=[-0.5]).round(6).tolist()
        [[3.5], [6.5]]
        """
        n, modes = self.base.states, self.base.modes
        r = check_reference(reference, self.tracked.shape[0])
        given = np.zeros(n) if force is None else as_floats("force", force, "(n,) or (modes, n)")
        if given.shape not in ((n,), (modes, n)):
            form = f"(n,) = ({n},) or (modes, n) = ({modes}, {n})"
            raise ArgumentError(f"force must have shape {form}, got {given.shape}.")
        c = np.broadcast_to(
            real_array("force", given, "(n,) or (modes, n)", given.ndim), (modes, n)
        )
        held = [np.linalg.lstsq(self._regulator(i), np.r_[-c[i], r])[0] for i in range(modes)]
        return np.stack(held)[:, n:]

    def _rest(self, i: int) -> tuple[np.ndarray, np.ndarray]:
        """X = [X_d, X_r] and U = [U_d, U_r], the smallest where there are several."""
        n, k, r = self.base.states, self.disturbance.shape[2], len(self.tracked)
        right = np.zeros((n + r, k + r))
        right[:n, :k], right[n:, k:] = -self.disturbance[i], np.eye(r)
        # Least squares: with more inputs than tracked outputs the system is underdetermined.
        both = np.linalg.lstsq(self._regulator(i), right, rcond=None)[0]
        return both[:n], both[n:]

    def _regulator(self, i: int) -> np.ndarray:
        """[[A, B], [HC, 0]]."""
        HC = self.tracked @ self.C[i, :, : self.base.states]
        zero = np.zeros((len(HC), self.base.inputs))
        return np.block([[self.base.A[i], self.base.B[i]], [HC, zero]])

    def _require_regular(self, i: int) -> None:
        matrix = self._regulator(i)
        rank = int(np.linalg.matrix_rank(matrix))
        if rank == len(matrix):
            return
        r, m = len(self.tracked), self.base.inputs
        if r > m:
            raise ArgumentError(
                f"tracked must have at most as many rows as there are inputs, {m}, got {r}: "
                f"{m} constant inputs hold no more than {m} outputs. Choose them by tracked, such "
                f"as {np.eye(m, self.tracked.shape[1]).astype(int).tolist()}."
            )
        raise ArgumentError(
            f"mode {i} cannot hold the tracked outputs at every reference: rank [A B; HC 0] = "
            f"{rank} < {len(matrix)}. There is an output that no constant input moves, as the "
            "speed of something that must come to rest; track another one, such as its position."
        )

    def _shift(
        self, K: np.ndarray, X_r: list[np.ndarray], step: float | None
    ) -> Float[np.ndarray, "q r"]:
        """Θ of the module docstring."""
        from scipy.linalg import solve_continuous_lyapunov, solve_discrete_lyapunov

        n, r = self.base.states, len(self.tracked)
        if not self.integral:
            return np.zeros((0, r))
        driven, weight = self.driven, np.zeros((n + r, n + r))
        qq, qx = np.zeros((r, r)), np.zeros((r, r))
        for i, X in enumerate(X_r):
            HC = self.tracked @ self.C[i, :, :n]
            weight[:n, :n] = HC.T @ HC
            if step is None:
                F = driven.A[i] + driven.B[i] @ K[i]
                G = solve_continuous_lyapunov(F.T, -weight)
            else:
                Phi, Gamma = finite_discretisation(driven.A[i], driven.B[i], step)
                # The sum over samples times h stands for the integral.
                G = solve_discrete_lyapunov((Phi + Gamma @ K[i]).T, weight * step)
            qq += G[n:, n:]
            qx += G[n:, :n] @ X
        return -self.base.longest_delay * np.eye(r) - np.linalg.solve(qq, qx)

    def __repr__(self) -> str:
        d = self.disturbance.shape[2]
        return f"Servo(tracked={len(self.tracked)}, sums={self.sums}, disturbances={d})"


def _require_decay(
    driven: SwitchedSystem, K: Float[np.ndarray, "mode m xq"], step: float | None
) -> None:
    """Refuse gains under which (x, q) does not decay in some mode: nothing would settle."""
    for i, (A, B) in enumerate(zip(driven.A, driven.B, strict=True)):
        if step is None:
            rate = np.linalg.eigvals(A + B @ K[i]).real.max()
        else:
            Phi, Gamma = finite_discretisation(A, B, step)
            rate = np.log(np.abs(np.linalg.eigvals(Phi + Gamma @ K[i])).max()) / step
        if rate >= 0.0:
            raise ArgumentError(
                f"gains must make (x, q) decay in every mode; mode {i} has the rate {rate:+.3g} "
                "1/s: poles must lie left of the imaginary axis."
            )


def _forces(disturbance: ArrayLike, plant: SwitchedSystem) -> Float[np.ndarray, "mode n k"]:
    """E of every mode."""
    modes, n = plant.modes, plant.states
    shape = as_floats("disturbance", disturbance, "(n, k) or (modes, n, k)").shape
    if len(shape) not in (2, 3) or shape[-2] != n:
        raise ArgumentError(
            f"disturbance must have n = {n} rows and a column per constant force, shape (n, k) or "
            f"(modes, n, k), such as {np.eye(n, 1, 1 - n).tolist()} on the last state, got {shape}."
        )
    return per_mode("disturbance", disturbance, modes, (n, shape[-1]), "(n, k)")


def _with_errors(
    model: SwitchedSystem, HC: Float[np.ndarray, "mode r nd"], sums: int
) -> SwitchedSystem:
    """The plant with the states (x, d, q, r)."""
    modes, r, n = HC.shape
    size = n + sums + r
    A, B = np.zeros((modes, size, size)), np.zeros((modes, size, model.inputs))
    A[:, :n, :n], B[:, :n] = model.A, model.B
    if sums:
        A[:, n : n + sums, :n] = HC
        A[:, n : n + sums, n + sums :] = -np.eye(r)
    return model.like(A, B)
