"""Running mode filters: one sample per call."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.base.checks import as_floats, real_array, require_shape
from deadtime.base.frozen import Stateful
from deadtime.feedback.belief import BeliefForm
from deadtime.loop.running_belief import RunningBank, running_belief


class _Running(Stateful):
    """A running filter, from states or from outputs."""

    def __init__(self, form: BeliefForm, u0: ArrayLike | None = None) -> None:
        modes, _, _, m = form.chain.Gamma.shape
        self._running = running_belief(form, modes)
        # Inputs that still act, oldest first, and one row that the first shift drops.
        longest = int(form.chain.lag.max())
        self._line = np.zeros((longest + 1, m))
        if u0 is not None:
            given = real_array("u0", u0, "(m, N)", 2)
            self._line[1:] = require_shape("u0", given, (m, longest), "(m, N)").T

    @property
    def belief(self) -> Float[np.ndarray, "mode age"]:
        """The belief at the last sample; a view that changes."""
        return self._running.now

    def _advance(
        self, name: str, form: str, seen: ArrayLike, u: ArrayLike | None, belief: ArrayLike | None
    ) -> Float[np.ndarray, " mode"]:
        shape, m = self._running.seen.shape, self._line.shape[1]
        given = require_shape(name, as_floats(name, seen, f"shape {shape}"), shape, form)
        sent = np.zeros(m) if u is None else real_array("u", u, "(m,)", 1)
        sent = require_shape("u", sent, (m,), "(m,)")
        # Checked before anything moves: a refused call leaves the filter unchanged.
        replacement = None if belief is None else self._running.require(belief)
        if self._running.begun:
            self._line[:-1] = self._line[1:]  # the oldest leaves, u_{k−1} joins
            self._line[-1] = sent
        self._running.see(given, self._line, len(self._line) - 1)
        if replacement is not None:
            self._running.now[:] = replacement
        return self._running.by_mode


class RunningFilter(_Running):
    """A running `ModeFilter`: call `update` once per period; made by `ModeFilter.start`.

    Attributes
    ----------
    belief : (modes, ages) array
        The belief at the last sample, over modes and ages; a view that changes.
    """

    def update(
        self, x: ArrayLike, u: ArrayLike | None = None, belief: ArrayLike | None = None
    ) -> Float[np.ndarray, " mode"]:
        """The probability of each mode at this sample.

        Parameters
        ----------
        x : array_like, shape (n,)
            The measured state. If an entry is not finite the state is missing, and the switching
            model alone propagates the belief over this period and the next.
        u : array_like, shape (m,), optional
            The input sent at the sample before, as applied; 0 by default, and not read at the first
            call.
        belief : array_like, shape (modes,) or (modes, ages), optional
            A belief at this sample from another source; it replaces the filter's own. Over modes
            alone, each mode keeps the shares of its ages.

        Returns
        -------
        (modes,) array
            Probabilities, sum 1.

        Raises
        ------
        ArgumentError
            If a shape is wrong, or `belief` is not ≥ 0 with sum 1; the filter is then unchanged.
        """
        return self._advance("x", "(n,)", x, u, belief)


class RunningOutputFilter(_Running):
    """A running `OutputModeFilter`, made by `OutputModeFilter.start`."""

    _running: RunningBank

    def update(
        self, y: ArrayLike, u: ArrayLike | None = None, belief: ArrayLike | None = None
    ) -> Float[np.ndarray, " mode"]:
        """The probability of each mode at this sample.

        Parameters
        ----------
        y : array_like, shape (p,)
            The measured outputs; entries that are not finite are missing and correct nothing.
        u, belief
            As of `RunningFilter.update`.

        Returns
        -------
        (modes,) array
            Probabilities, sum 1.

        Raises
        ------
        ArgumentError
            If a shape is wrong, or `belief` is not ≥ 0 with sum 1; the filter is then unchanged.
        """
        return self._advance("y", "(p,)", y, u, belief)

    @property
    def estimate(self) -> Float[np.ndarray, " n"]:
        """x̂ at the last sample, the mean over the modes."""
        return self._running.mean

    @property
    def estimates(self) -> Float[np.ndarray, "mode n"]:
        """x̂ at the last sample, given each mode."""
        return self._running.x.copy()

    @property
    def covariances(self) -> Float[np.ndarray, "mode n n"]:
        """Covariances of the state about `estimates`."""
        return self._running.P.copy()
