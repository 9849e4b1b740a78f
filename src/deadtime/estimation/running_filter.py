"""Mode filters that run, one sample per call."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.base.checks import as_floats, real_array, require_shape
from deadtime.base.frozen import Stateful
from deadtime.estimation.filter_arguments import belief_of
from deadtime.estimation.running_bank import RunningBank
from deadtime.feedback.bank import BankForm
from deadtime.feedback.belief import Belief, BeliefState


class RunningFilter(Stateful):
    """A `ModeFilter` that runs: `update` once a period; made by `ModeFilter.start`.

    Attributes
    ----------
    belief : (modes, ages) array
        The belief at the last sample, over modes and ages; a view that changes.
    """

    def __init__(self, form: Belief, u0: ArrayLike | None = None) -> None:
        modes, _, n, m = form.Gamma.shape
        self.form, self._state = form, BeliefState.of(form, modes, 1)
        self._line = _line_of(u0, m, int(form.lag.max()))
        self._before, self._seen = np.full(n, np.nan), False

    @property
    def belief(self) -> Float[np.ndarray, "mode age"]:
        """The belief at the last sample; a view that changes."""
        return self._state.now

    def update(
        self, x: ArrayLike, u: ArrayLike | None = None, belief: ArrayLike | None = None
    ) -> Float[np.ndarray, " mode"]:
        """How likely each mode is at this sample.

        Parameters
        ----------
        x : array_like, shape (n,)
            The state as measured; where an entry is not finite it counts as missing: the switching
            model alone says how the belief goes on, over this period and the next.
        u : array_like, shape (m,), optional
            The input sent at the sample before, as applied; 0 by default, and not read at the first
            call.
        belief : array_like, shape (modes,) or (modes, ages), optional
            What is known of the mode at this sample from elsewhere: it replaces what the filter
            makes of x. Over modes alone, each mode keeps the shares of its ages.

        Raises
        ------
        ArgumentError
            If a shape is wrong, or `belief` is not ≥ 0 with sum 1; nothing is changed then.
        """
        from deadtime.estimation.belief_kernel import advance_belief

        n, m = self._before.size, self._line.shape[1]
        x = require_shape("x", as_floats("x", x, f"shape ({n},)"), (n,), "(n,)")
        sent = _sent(u, m)
        told = None if belief is None else belief_of("belief", belief, self._state.now)
        if self._seen:
            row = _push(self._line, sent)
            advance_belief(self.form, self._state, self._before, x, self._line, row)
        if told is not None:
            self._state.now[:] = told
        self._before, self._seen = x, True
        return self._state.now.sum(axis=1)


class RunningOutputFilter(Stateful):
    """An `OutputModeFilter` that runs: `update` once a period; made by `OutputModeFilter.start`.

    Attributes
    ----------
    belief : (modes, ages) array
        The belief at the last sample, over modes and ages; a view that changes.
    """

    def __init__(self, form: BankForm, u0: ArrayLike | None = None) -> None:
        modes, _, _, m = form.chain.Gamma.shape
        self.form, self._bank = form, RunningBank(form, modes)
        self._line = _line_of(u0, m, int(form.chain.lag.max()))
        self._seen = False

    @property
    def belief(self) -> Float[np.ndarray, "mode age"]:
        """The belief at the last sample; a view that changes."""
        return self._bank.state.now

    @property
    def estimate(self) -> Float[np.ndarray, " n"]:
        """x̂ at the last sample, whatever the mode."""
        return self._bank.mean

    @property
    def estimates(self) -> Float[np.ndarray, "mode n"]:
        """x̂ at the last sample if the mode is this one."""
        return self._bank.x.copy()

    @property
    def covariances(self) -> Float[np.ndarray, "mode n n"]:
        """Of the state about `estimates`."""
        return self._bank.P.copy()

    def update(
        self, y: ArrayLike, u: ArrayLike | None = None, belief: ArrayLike | None = None
    ) -> Float[np.ndarray, " mode"]:
        """How likely each mode is at this sample.

        Parameters
        ----------
        y : array_like, shape (p,)
            The outputs as measured; those that are not finite are missing, and say nothing.
        u, belief
            As of `RunningFilter.update`.

        Raises
        ------
        ArgumentError
            If a shape is wrong, or `belief` is not ≥ 0 with sum 1; nothing is changed then.
        """
        p, m = self.form.variance.size, self._line.shape[1]
        y = require_shape("y", as_floats("y", y, f"shape ({p},)"), (p,), "(p,)")
        sent = _sent(u, m)
        told = None if belief is None else belief_of("belief", belief, self.belief)
        if self._seen:
            self._bank.advance(y, self._line, _push(self._line, sent))
        else:
            self._bank.begin(y)
        if told is not None:
            self.belief[:] = told
        self._seen = True
        return self.belief.sum(axis=1)


def _line_of(u0: ArrayLike | None, m: int, longest: int) -> Float[np.ndarray, "past m"]:
    """The inputs that still act, oldest first, and room for one more before them."""
    line = np.zeros((longest + 1, m))
    if u0 is not None:
        given = real_array("u0", u0, "(m, N)", 2)
        line[1:] = require_shape("u0", given, (m, longest), "(m, N)").T
    return line


def _sent(u: ArrayLike | None, m: int) -> Float[np.ndarray, " m"]:
    given = np.zeros(m) if u is None else u
    return require_shape("u", real_array("u", given, "(m,)", 1), (m,), "(m,)")


def _push(line: np.ndarray, sent: np.ndarray) -> int:
    """Add the latest input to a line; its row."""
    line[:-1] = line[1:]
    line[-1] = sent
    return len(line) - 1
