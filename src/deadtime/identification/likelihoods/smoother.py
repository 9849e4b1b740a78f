"""States of a log that was only measured in part: Kalman's filter, and back again.

    x̂_k = x⁻_k + P⁻_k r_k,    r⁻ = c e/s + (I − c gᵀ/s) r,    r_{k−1} = Φ_kᵀ r⁻_k

with e, s and g = P⁻ c of every sensor c in turn (de Jong, Biometrika 76(3), 1989): no covariance is
inverted.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from deadtime.identification.likelihoods.filter_periods import FilterPeriods
from deadtime.identification.likelihoods.noisy_log import NoisyLog


class FilterModel(NamedTuple):
    """What a filter is of.

    Phi, Q : of every kind of period; C, R : sensors, and their variances
    P0 : the covariance of a state of which nothing is known
    """

    Phi: Float[np.ndarray, "kind n n"]
    Q: Float[np.ndarray, "kind n n"]
    C: Float[np.ndarray, "p n"]
    R: Float[np.ndarray, " p"]
    P0: Float[np.ndarray, "n n"]

    @classmethod
    def of(
        cls, log: NoisyLog, vector: Float[np.ndarray, " size"], periods: FilterPeriods
    ) -> FilterModel:
        """That of a log's likelihood at its vector."""
        R = log.noise(vector).deviation ** 2
        return cls(periods.Phi, periods.Q, log.C, R, log.P0)


class PredictedStates(NamedTuple):
    """States and covariances before each sample, then of each sensor e, s and g/s."""

    state: Float[np.ndarray, "sample n"]
    covariance: Float[np.ndarray, "sample n n"]
    error: Float[np.ndarray, "sample p"]
    variance: Float[np.ndarray, "sample p"]
    gain: Float[np.ndarray, "sample p n"]


def filtered(
    output: Float[np.ndarray, "sample p"],
    start: Bool[np.ndarray, " sample"],
    kind: Int[np.ndarray, " sample"],
    moved: Float[np.ndarray, "sample n"],
    model: FilterModel,
) -> PredictedStates:
    """The filter over a log; `kind` and `moved` are of the period that leads to a sample.

    e = 0, s = 1 and g = 0 where nothing was measured.
    """
    (count, p), n = output.shape, model.C.shape[1]
    state, covariance = np.empty((count, n)), np.empty((count, n, n))
    error, variance, gain = np.zeros((count, p)), np.ones((count, p)), np.zeros((count, p, n))
    x, P, unit = np.zeros(n), model.P0, np.eye(n)
    for k in range(count):
        if start[k]:
            x, P = np.zeros(n), model.P0
        else:
            Phi = model.Phi[kind[k]]
            x, P = Phi @ x + moved[k], Phi @ P @ Phi.T + model.Q[kind[k]]
        state[k], covariance[k] = x, P
        for j in range(p):
            if np.isfinite(output[k, j]):
                c = model.C[j]
                g = P @ c
                s = c @ g + model.R[j]
                e, own = output[k, j] - c @ x, g / s
                rest = unit - np.outer(own, c)  # Joseph's form: a vague P stays positive
                x, P = x + own * e, rest @ P @ rest.T + model.R[j] * np.outer(own, own)
                error[k, j], variance[k, j], gain[k, j] = e, s, g / s
    return PredictedStates(state, covariance, error, variance, gain)


def smoothed(
    found: PredictedStates,
    start: Bool[np.ndarray, " sample"],
    kind: Int[np.ndarray, " sample"],
    model: FilterModel,
) -> Float[np.ndarray, "sample n"]:
    """The states given all of the log."""
    count, n = found.state.shape
    states, r = np.empty((count, n)), np.zeros(n)
    for k in range(count - 1, -1, -1):
        for j in range(len(model.C) - 1, -1, -1):
            c = model.C[j]
            r = r + c * (found.error[k, j] / found.variance[k, j] - found.gain[k, j] @ r)
        states[k] = found.state[k] + found.covariance[k] @ r
        r = np.zeros(n) if start[k] else model.Phi[kind[k]].T @ r
    return states


def responses(
    found: PredictedStates,
    start: Bool[np.ndarray, " sample"],
    kind: Int[np.ndarray, " sample"],
    push: Float[np.ndarray, "kind n row"],
    inputs: Float[np.ndarray, "sample column"],
    model: FilterModel,
) -> Float[np.ndarray, "sample p kind*row*column"]:
    """What errors would be less by, in standard deviations, for one more input at a time.

    Input c of period k adds push[i, :, a] inputs[k, c] where its kind is i: one of each i, a, c.
    """
    (kinds, n, rows), columns = push.shape, inputs.shape[1]
    result = np.empty((len(inputs), len(model.C), kinds * rows * columns))
    shape = n, kinds, rows, columns
    flat = np.zeros((n, kinds * rows * columns))
    for k, (i, new) in enumerate(zip(kind.tolist(), start.tolist(), strict=True)):
        if new:
            flat = np.zeros(flat.shape)
        else:
            flat = model.Phi[i] @ flat
            flat.reshape(shape)[:, i] += push[i][:, :, None] * inputs[k]
        for j in range(len(model.C)):
            seen = model.C[j] @ flat
            result[k, j] = seen / np.sqrt(found.variance[k, j])
            flat = flat - np.outer(found.gain[k, j], seen)
    return result
