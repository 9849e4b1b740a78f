"""A bank of Kalman filters, one per mode, and the belief over the modes: what `OutputModeFilter`
runs.

A period begins in mode i and ends in j. With x̂_i, P_i the mean and covariance of x_{k−1} given i,

    x̄_ij = M x̂_i + the inputs,    P̄_ij = M P_i Mᵀ + (Δ P_i Δᵀ + d dᵀ)/12 + Q_i,

M = Φ_i and Δ = d = 0 where modes change at samples; where they change anywhere M is the mean of Φ_i
and Φ_j, Δ their difference and d that of their predictions. Each pair is corrected by y_k with C_j,
the density of y_k weighs it, and what ends in the same mode is merged into one normal density.
(docs/theory/mode-filter.md; signs and lags are those of `deadtime.feedback.belief`.)
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from deadtime.feedback.belief import Belief, BeliefState


class BankForm(NamedTuple):
    """How a bank moves: data that no run changes.

    chain : Belief, its noise the covariance that a period adds to x
    C : (modes, p, n), variance : (p,), of y about C x
    gain : (modes, n, p) of observers, or None for Kalman's
    estimate : (n,), covariance : (n, n), of x_0 in every mode
    """

    chain: Belief
    C: Float[np.ndarray, "mode p n"]
    variance: Float[np.ndarray, " p"]
    gain: Float[np.ndarray, "mode n p"] | None
    estimate: Float[np.ndarray, " n"]
    covariance: Float[np.ndarray, "n n"]


class Bank:
    """A bank that runs: `begin` at the first sample, then `advance` once a period.

    Attributes
    ----------
    x : (modes, n)
        E[x_k | the mode is i, all that was seen], as of the last sample.
    P : (modes, n, n)
        The covariance about it.
    state : BeliefState
        The belief, in `state.now`.
    """

    def __init__(self, form: BankForm, rows: int) -> None:
        modes = len(form.C)
        self.form, self.state = form, BeliefState.of(form.chain, rows, 1)
        self._unknown = np.tile(form.estimate, (modes, 1)), np.tile(form.covariance, (modes, 1, 1))
        self.x, self.P = self._unknown

    @property
    def mean(self) -> Float[np.ndarray, " n"]:
        """x̂_k, whatever the mode."""
        return self.state.now.sum(axis=1) @ self.x

    def begin(self, y: Float[np.ndarray, " p"]) -> None:
        """The first sample: what y_0 says of x_0, and of the mode where C depends on it."""
        now = self.state.now
        log, self.x, self.P = self._correct(self.x, self.P, y, np.abs(self.x).max(axis=0))
        likely = log[now.any(axis=1)].max()
        if np.isfinite(log).all():
            now *= np.exp(np.minimum(log - likely, 0.0))[:, None]
            now /= now.sum()
        self._start_anew()

    def advance(
        self, y: Float[np.ndarray, " p"], told: Float[np.ndarray, "past m"], row: int
    ) -> None:
        """One period: y_k at its end, and the inputs, u_{k−1} in row `row` of `told`."""
        from deadtime.estimation.belief_kernel import move

        with np.errstate(over="ignore", invalid="ignore"):
            x, P, size = self._predict(told, row)
            log, corrected, rest = self._correct(x, P, y, size)
            seen = bool(np.isfinite(y).any() and np.isfinite(log).all())
            if seen:
                x, P, self.state.density[:] = corrected, rest, log
            move(self.form.chain, self.state, seen)
            self._merge(x, P)
        self._start_anew()

    def _start_anew(self) -> None:
        """Where numbers have left the range of doubles, nothing is known of x any more."""
        if not (np.isfinite(self.x).all() and np.isfinite(self.P).all()):
            self.x, self.P = self._unknown

    def _predict(self, told: np.ndarray, row: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """x̄ and P̄ of every pair, and the size of the terms of predictions per state."""
        form = self.form.chain
        Phi, u = form.Phi, told[row - form.lag]
        drive = np.einsum("ilab,lb->ia", form.Gamma, u)
        ahead = np.einsum("jab,ib->ija", Phi, self.x) + drive
        size = np.einsum("jab,ib->ija", np.abs(Phi), np.abs(self.x))
        size = size + np.einsum("ilab,lb->ia", np.abs(form.Gamma), np.abs(u))
        modes = np.arange(len(Phi))
        own = ahead[modes, modes][:, None]
        apart, slope = ahead - own, Phi[None] - Phi[:, None]
        if not form.within:
            apart, slope = np.zeros_like(apart), np.zeros_like(slope)
        middle, P = Phi[:, None] + 0.5 * slope, self.P[:, None]
        wide = slope @ P @ slope.swapaxes(2, 3) + apart[..., None] * apart[..., None, :]
        spread = middle @ P @ middle.swapaxes(2, 3) + wide / 12.0 + form.noise[:, None]
        return own + 0.5 * apart, spread, size.max(axis=(0, 1))

    def _correct(
        self, x: np.ndarray, P: np.ndarray, y: np.ndarray, size: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """log p(y), x̂ and P after y, of normal densities whose last axis of many is the mode.

        One output after the other, those that are missing left out. Beside its noise each has the
        round-off of its prediction, so that nothing is divided by 0; and of a variance 1e-14 is
        left, as no less is told from round-off.
        """
        from deadtime.estimation.belief_kernel import ROUND_OFF, SPENT

        C, log, before = self.form.C, np.zeros(x.shape[:-1]), (x, P)
        size = np.maximum((np.abs(C) @ size).max(axis=0), np.abs(y))
        for a in np.flatnonzero(np.isfinite(y)):
            c, r = C[:, a], self.form.variance[a] + (ROUND_OFF * size[a]) ** 2
            toward = np.einsum("...ab,...b->...a", P, c)
            s = (toward * c).sum(axis=-1) + r
            if (s <= 0.0).any():
                continue  # nothing moves: 0 is what every mode expects
            gain, wrong = toward / s[..., None], y[a] - (x * c).sum(axis=-1)
            log -= 0.5 * (wrong * wrong / s + np.log(s))
            x = x + gain * wrong[..., None]
            left = SPENT * np.diagonal(P, axis1=-2, axis2=-1)
            P = _after(P, gain[..., None], c[..., None, :], np.array([r]))
            P = P + left[..., None] * np.eye(len(c[0]))
        if self.form.gain is not None:
            x, P = self._observe(*before, y)
        return log, x, P

    def _observe(
        self, x: np.ndarray, P: np.ndarray, y: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The same by the gains of observers, which need all of y."""
        gain, C = self.form.gain, self.form.C
        if gain is None or not np.isfinite(y).all():
            return x, P
        wrong = y - np.einsum("...pa,...a->...p", C, x)
        x = x + np.einsum("...ap,...p->...a", gain, wrong)
        return x, _after(P, gain, C, self.form.variance)

    def _merge(self, x: np.ndarray, P: np.ndarray) -> None:
        """One normal density for each mode, with mean and covariance of those that end in it.

        The part of the belief that is forgotten is spread about x as it is believed to be in all:
        a mode that was ruled out begins there.
        """
        chain, state = self.form.chain, self.state
        pairs = state.mass * state.density
        pairs = pairs / pairs.sum()
        whole = _mixed(pairs.reshape(-1, 1), x.reshape(-1, 1, x.shape[-1]), _flat(P))
        forgotten = np.full((1, len(pairs)), chain.forgetting / len(pairs))
        weight = np.concatenate(((1.0 - chain.forgetting) * pairs, forgotten))
        x = np.concatenate((x, np.broadcast_to(whole[0], (1, *x.shape[1:]))))
        P = np.concatenate((P, np.broadcast_to(whole[1], (1, *P.shape[1:]))))
        self.x, self.P = _mixed(weight, x, P)


def _flat(P: np.ndarray) -> np.ndarray:
    return P.reshape(-1, 1, *P.shape[-2:])


def _after(P: np.ndarray, gain: np.ndarray, C: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """The covariance after a correction with any gain, in Joseph's form."""
    rest = np.eye(P.shape[-1]) - gain @ C
    P = rest @ P @ rest.swapaxes(-1, -2) + (gain * variance) @ gain.swapaxes(-1, -2)
    return 0.5 * (P + P.swapaxes(-1, -2))


def _mixed(
    weight: Float[np.ndarray, "many j"],
    x: Float[np.ndarray, "many j n"],
    P: Float[np.ndarray, "many j n n"],
) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance of mixtures, one per j."""
    share = weight / weight.sum(axis=0)
    mean = np.einsum("ij,ija->ja", share, x)
    apart = x - mean
    return mean, np.einsum("ij,ijab->jab", share, P + apart[..., None] * apart[..., None, :])
