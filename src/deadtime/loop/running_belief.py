"""Mode beliefs that run, one sample per call, in filters, laws and controllers."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.base.checks import as_floats, real_array, require_probabilities, require_shape
from deadtime.base.errors import ArgumentError
from deadtime.feedback.belief import BankForm, Belief, BeliefForm
from deadtime.loop.bank_steps import BankState, advance_bank, begin_bank, start_anew
from deadtime.loop.belief_steps import BeliefState, advance_belief, begin_belief, share_rows


class RunningBelief:
    """A belief from states, for a table of `rows`.

    Attributes
    ----------
    form, bank : Belief, BankForm or None
        The filter as data; `bank` where it receives outputs.
    state : BeliefState
        The belief at the last sample is `state.now`; a view that changes.
    begun : bool
        Whether there has been a sample.
    seen : (n,) or (p,) array
        The last measurement, copied: compiled steps are compiled for one type of array.
    """

    bank: BankForm | None = None
    arrays: ClassVar = {"belief": "now", "belief_x": "before"}  # the state

    def __init__(self, form: Belief, rows: int) -> None:
        self.form, self.state, self.begun = form, BeliefState.of(form, rows), False
        n = form.Phi.shape[1]
        self.before, self.seen = np.full((2, n), np.nan)

    @property
    def now(self) -> Float[np.ndarray, "mode age"]:
        return self.state.now

    @property
    def by_mode(self) -> Float[np.ndarray, " mode"]:
        """The probability of each mode."""
        return self.now.sum(axis=1)

    def begin(self) -> None:
        """Start."""
        self.begun, self.before[:] = False, np.nan
        begin_belief.function(self.form, self.state)

    def see(
        self, x: Float[np.ndarray, " n"], known_inputs: Float[np.ndarray, "past m"], row: int
    ) -> None:
        """One sample: x_k, and the inputs, u_{k−1} in row `row`; what is not finite is missing."""
        self.seen[:] = x
        if self.begun:
            advance_belief(self.form, self.state, self.before, self.seen, known_inputs, row)
        self.before[:], self.begun = self.seen, True

    def share(self) -> Float[np.ndarray, " row"]:
        """The share of every row; a view that changes."""
        share_rows(self.state)
        return self.state.weight

    def usable(self, x: np.ndarray) -> bool:
        """Whether a law can compute its command from this measurement."""
        return bool(np.isfinite(x).all())

    def states(self, rows: int) -> Float[np.ndarray, "row n"]:
        """The state that each row multiplies."""
        return np.tile(self.before, (rows, 1))

    def add_states(self, F: Float[np.ndarray, "row m n"], u: Float[np.ndarray, " m"]) -> None:
        """Add to u the mean over all rows of F x, x the state of the row."""
        u += np.einsum("c,cma,ca->m", self.state.weight, F, self.states(len(F)))

    def covariances(self, rows: int) -> Float[np.ndarray, "row n n"]:
        """Covariances of the states of the rows."""
        n = self.before.size
        return np.zeros((rows, n, n))

    def require(self, belief: ArrayLike) -> Float[np.ndarray, "mode age"]:
        """Probabilities from elsewhere, checked; an error if they are none."""
        return belief_of("belief", belief, self.now)

    def snapshot(self) -> dict[str, Any]:
        """Copies of the state."""
        return {name: getattr(self, own).copy() for name, own in self.arrays.items()}

    def load(self, saved: dict[str, Any]) -> None:
        """Restore a `snapshot`; `ArgumentError` if its belief is not one."""
        belief_of("state['belief']", saved["belief"], self.now)
        # The saved numbers, not those that `belief_of` normalises: runs go on to the same bits.
        for name, own in self.arrays.items():
            getattr(self, own)[:] = saved[name]


class RunningBank(RunningBelief):
    """A belief from outputs, by a bank of Kalman filters: rows multiply their modes' estimates."""

    arrays: ClassVar = {"belief": "now", "belief_estimates": "x", "belief_covariances": "P"}

    def __init__(self, bank: BankForm, rows: int) -> None:
        super().__init__(bank.chain, rows)
        self.bank, self.all = bank, BankState.of(bank, rows)
        self.state, self.seen = self.all.chain, np.empty(bank.variance.size)

    @property
    def x(self) -> Float[np.ndarray, "mode n"]:
        return self.all.x

    @property
    def P(self) -> Float[np.ndarray, "mode n n"]:
        return self.all.P

    @property
    def mean(self) -> Float[np.ndarray, " n"]:
        """x̂_k, whatever the mode."""
        return self.by_mode @ self.x

    def begin(self) -> None:
        super().begin()
        start_anew.function(self.bank, self.all, False)

    def see(
        self, x: Float[np.ndarray, " p"], known_inputs: Float[np.ndarray, "past m"], row: int
    ) -> None:
        """One sample: y_k, and the inputs, u_{k−1} in row `row`; what is not finite is missing."""
        self.seen[:] = x
        if self.begun:
            advance_bank(self.bank, self.all, self.seen, known_inputs, row)
        else:
            begin_bank(self.bank, self.all, self.seen)
        self.begun = True

    def usable(self, x: np.ndarray) -> bool:
        return True  # over an output that is missing the filters predict

    def states(self, rows: int) -> Float[np.ndarray, "row n"]:
        return np.repeat(self.x, rows // len(self.x), axis=0)

    def covariances(self, rows: int) -> Float[np.ndarray, "row n n"]:
        return np.repeat(self.P, rows // len(self.P), axis=0)

    def load(self, saved: dict[str, Any]) -> None:
        P = np.asarray(saved["belief_covariances"], float)
        variance = np.diagonal(P, axis1=1, axis2=2)
        if (P.swapaxes(1, 2) != P).any() or variance.min() < 0.0:
            raise ArgumentError(
                "state['belief_covariances'] must be symmetric, their diagonals ≥ 0: pass what "
                "`Controller.state` gave."
            )
        super().load(saved)


def running_belief(form: BeliefForm, rows: int) -> RunningBelief:
    """A belief that runs, from states or from outputs."""
    return RunningBelief(form.chain, rows) if form.bank is None else RunningBank(form.bank, rows)


def belief_of(
    name: str, value: ArrayLike, now: Float[np.ndarray, "mode age"]
) -> Float[np.ndarray, "mode age"]:
    """Probabilities over modes and ages, checked; if over modes alone, with the ages of `now`."""
    modes, ages = now.shape
    form = f"(modes,) or (modes, ages) = {now.shape}"
    given = as_floats(name, value, form)
    given = real_array(name, given, form, 2 if given.ndim == 2 else 1)
    require_shape(name, given, now.shape if given.ndim == 2 else (modes,), form)
    require_probabilities(name, given)
    total = float(given.sum())
    if given.ndim == 2:
        return given / total
    own = now.sum(axis=1, keepdims=True)
    # A mode that had no probability gets all of it at age 0.
    young = np.eye(1, ages)
    share = np.where(own > 0.0, now / np.where(own > 0.0, own, 1.0), young)
    return given[:, None] / total * share
