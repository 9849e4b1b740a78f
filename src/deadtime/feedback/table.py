"""Feedback: the table that a predictor law becomes at a sampling period.

Row c of the table gives the input from the sampled state and the past inputs,

    u_k = F_c x_k + Σ_{j=1..N} G_{c,j} u_{k−j}.

Laws fill the table; simulators, engines, certificates and exports read it and never ask which
law it came from. Which row applies is a function of the *sampled* modes σ(t_0), …, σ(t_k)
alone, the `context`:

    none        one row
    mode        row = mode
    mode_age    row = mode·ages + min(age, ages − 1); age counts samples since the sampled mode
                last changed, 0 when a new mode is first seen and, unless given, at the start
    step        row = k (laws that know the signal in advance)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike

from deadtime.base.errors import ArgumentError
from deadtime.base.frozen import Frozen

OLDEST = 2.0**30  # samples: beyond the ages of any table, with room to count on in 32 bits
Context = Literal["none", "mode", "mode_age", "step"]


class Factor(NamedTuple):
    r"""The taps as powers of one small matrix.

    :math:`G_{c,j} = H_c S^{j-1} \Gamma_s` for :math:`j < N`, then `last`.

    H : (contexts, m, q),  S : (q, q),  input : Γ_s (q, m),  last : G_{c,N} (contexts, m, m)
    """

    H: Float[np.ndarray, "context m q"]
    S: Float[np.ndarray, "q q"]
    input: Float[np.ndarray, "q m"]
    last: Float[np.ndarray, "context m m"]

    def taps(self, count: int) -> Float[np.ndarray, "context N m m"]:
        r"""The first `count` taps :math:`G_{c,1}, G_{c,2}, \dots`, multiplied out."""
        contexts, m, _ = self.H.shape
        columns, power = self.input, self.S  # Γ_s, S Γ_s, …: twice as many each time
        while columns.shape[1] < (count - 1) * m:
            columns, power = np.hstack((columns, power @ columns)), power @ power
        taps = (self.H @ columns[:, : (count - 1) * m]).reshape(contexts, m, count - 1, m)
        return np.concatenate((taps.swapaxes(1, 2), self.last[:, None]), axis=1)


def side_by_side(taps: Float[np.ndarray, "context N r m"]) -> Float[np.ndarray, "context r past"]:
    """Taps (contexts, N, rows, m) as one matrix per context, in the order given."""
    contexts, count, rows, m = taps.shape
    return taps.transpose(0, 2, 1, 3).reshape(contexts, rows, count * m)


def require_finite_gains(*gains: np.ndarray) -> None:
    """Refuse a law whose prediction over its delay overflows."""
    if not all(np.isfinite(gain).all() for gain in gains):
        raise ArgumentError(
            "the law's gains over its delay overflow: e^{A·delay} is beyond 1e308; the delay is "
            "too long for this plant."
        )


def row_of(context: Context, ages: int, mode: int, age: int) -> int:
    """The row of a table that does not depend on the sample's number."""
    return row_at(0 if context == "none" else ages, ages, mode, age)


def row_at(apart, ages, mode, age):
    """The row of a mode and its age, `apart` being the number of rows between modes."""
    return mode * apart + min(age, ages - 1)


def ages_along(modes: np.ndarray, initial_age: ArrayLike) -> np.ndarray:
    """The age of the mode at each sample along the last axis, `initial_age` at the first.

    Examples
    --------
    >>> ages_along(np.array([0, 0, 1, 1]), 5)
    array([5, 6, 0, 1])
    """
    samples = np.arange(modes.shape[-1])
    changed = np.diff(modes, prepend=modes[..., :1]) != 0
    began = np.where(changed, samples, -np.asarray(initial_age)[..., None])
    return samples - np.maximum.accumulate(began, axis=-1)


def age_after(before: int, age: int, now: int) -> int:
    """The age of the mode that a law uses at a sample, from the mode and age at the one before.

    `now` = −1: no mode is reported and the last one continues. `before` = −1: no mode was known,
    and the first has the age `age`.

    Examples
    --------
    >>> age_after(0, 3, 0), age_after(0, 3, -1), age_after(0, 3, 1), age_after(-1, 3, 1)
    (4, 4, 0, 3)
    """
    if now < 0 or now == before:
        return age + 1
    return age if before < 0 else 0


@dataclass(frozen=True, eq=False, repr=False)
class Feedback(Frozen):
    r"""A digital feedback law as a table (immutable).

    Attributes
    ----------
    state_gain : (contexts, m, n)
        :math:`F_c`.
    input_gain : (contexts, N, m, m)
        :math:`G_{c,j}`, :math:`j = 1` (the latest input) first, :math:`N \ge 1`.
    context : "none", "mode", "mode_age" or "step"
        What selects the row; see the module.
    step : float
        Sampling period h the table is made for, in seconds.
    ages : int
        Rows per mode of a (mode, age) table, 1 otherwise.
    factor : Factor or None
        The taps as :math:`H_c S^{j-1} \Gamma_s`, where that form exists: its cost does not depend
        on :math:`N`.
    memory : int
        How many of the m outputs, the first ones, are the law's state w_{k+1} and not inputs of
        the plant (`feedback.recurrence`); 0 for a law without a state.

    Examples
    --------
    >>> import deadtime as dt
    >>> problem = dt.problems.paper()
    >>> dt.AveragedPredictor(problem.plant, problem.gains).digital(0.01)
    Feedback(context='none', rows=1, taps=100, inputs=1, step=0.01, factored)
    """

    state_gain: Float[np.ndarray, "context m n"]
    input_gain: Float[np.ndarray, "context N m m"]
    context: Context
    step: float
    ages: int = 1
    factor: Factor | None = None
    memory: int = 0

    def __post_init__(self) -> None:
        rows, m = self.state_gain.shape[:2]
        taps = self.input_gain.shape
        if self.input_gain.ndim != 4 or taps != (rows, taps[1], m, m):
            raise ArgumentError(
                f"input_gain must have shape (contexts, N, m, m) = ({rows}, N, {m}, {m}), "
                f"got {taps}."
            )
        if taps[1] == 0:
            raise ArgumentError(
                f"input_gain must hold at least one tap a row (N ≥ 1), got shape {taps}: a law "
                f"that reads no past input has one of zeros, np.zeros(({rows}, 1, {m}, {m}))."
            )
        require_finite_gains(self.state_gain, self.input_gain)
        # Read-only in place, not as copies: a table may take most of the memory.
        for array in (self.state_gain, self.input_gain, *(self.factor or ())):
            array.flags.writeable = False

    @property
    def apart(self) -> int:
        """The number of rows from one mode to the next; 0 if one row serves all modes."""
        return 0 if self.context == "none" else self.ages

    @property
    def taps(self) -> int:
        """N, the number of past inputs that a row reads."""
        return self.input_gain.shape[1]

    @property
    def latest_first(self) -> Float[np.ndarray, "context m past"]:
        """The taps of each row side by side, (contexts, m, N m), the latest input first."""
        return side_by_side(self.input_gain)

    @property
    def oldest_first(self) -> Float[np.ndarray, "context m past"]:
        """The taps of each row side by side, (contexts, m, N m), the oldest input first.

        Examples
        --------
        >>> import numpy as np
        >>> Feedback(np.zeros((1, 1, 1)), np.array([[[[1.0]], [[2.0]]]]), "none", 0.1).oldest_first
        array([[[2., 1.]]])
        """
        return side_by_side(self.input_gain[:, ::-1])

    def row(self, mode: int, age: int = 0, sample: int = 0) -> int:
        """The row that applies at a sample: of a mode, its age in samples, the sample's number.

        Examples
        --------
        >>> import numpy as np
        >>> table = Feedback(np.zeros((6, 1, 1)), np.zeros((6, 1, 1, 1)), "mode_age", 0.1, ages=3)
        >>> table.row(1, age=7)
        5
        """
        return sample if self.context == "step" else row_of(self.context, self.ages, mode, age)

    def rows(self, modes: np.ndarray, initial_age: int = 0) -> np.ndarray:
        r"""The row that applies at each sample of a run, from the sampled modes.

        `initial_age` is the age of :math:`\sigma(t_0)` in samples.

        Examples
        --------
        >>> import numpy as np
        >>> table = Feedback(np.zeros((6, 1, 1)), np.zeros((6, 1, 1, 1)), "mode_age", 0.1, ages=3)
        >>> table.rows(np.array([0, 0, 0, 0, 1, 1]))
        array([0, 1, 2, 2, 3, 4])
        """
        if self.context == "none":
            return np.zeros(modes.size, np.int64)
        if self.context == "step":
            return np.arange(modes.size)
        rows = modes
        if self.context == "mode_age":
            ages = ages_along(modes, min(initial_age, self.ages))
            rows = rows * self.ages + np.minimum(ages, self.ages - 1)
        return rows.astype(np.int64)

    def __repr__(self) -> str:
        rows, m = self.state_gain.shape[:2]
        return (
            f"Feedback(context={self.context!r}, rows={rows}, taps={self.taps}, inputs={m}, "
            f"step={self.step:g}, {'factored' if self.factor else 'dense'})"
        )


class Known(NamedTuple):
    """The rows that may apply, with the state in each, and the inputs in flight.

    One row if the mode is measured; under a belief, rows with a `share` each.

    row : (cases,), of the law's table
    share : (cases,), probabilities
    x : (cases, n), the state, or its estimate
    P : (cases, n, n), the covariance of the state about it
    past : (N, m), the inputs as applied, the oldest first
    """

    row: Int[np.ndarray, " case"]
    share: Float[np.ndarray, " case"]
    x: Float[np.ndarray, "case n"]
    P: Float[np.ndarray, "case n n"]
    past: Float[np.ndarray, "N m"]
