"""Innovations of a log as a linear regression, and their responses to inputs of any form.

For given A and noise the prediction of a measurement is linear in the measurements before it and in
the inputs. So the response of all predictions to a change of the inputs is the prediction of a log
with these inputs and measurements of 0. Score tests compare such responses with the innovations.

The likelihood of innovations e of variance s has the score and the information of a least-squares
problem with residuals r and slopes D, both of white unit noise:

    r = (e/√s, (e²/s − 1)/√2),    D = (−∂e/√s, ∂s/(s √2)),    score = Dᵀ r,    F = Dᵀ D.

Where states are exact, s does not depend on the plant, and the second half is left out.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int

from deadtime.identification.likelihoods.switched_filter import Places
from deadtime.identification.log.recording import Part
from deadtime.identification.parameters import Squares, Vector, Window

if TYPE_CHECKING:
    from deadtime.identification.likelihoods.likelihood import ExactLog
    from deadtime.identification.likelihoods.noisy_log import NoisyLog, Starts

Changes = Sequence[Float[np.ndarray, "many sample m"]]  # inputs of every part
Signals = Sequence[Float[np.ndarray, "many sample"]]


@runtime_checkable
class Innovations(Protocol):
    """The innovations of a likelihood, row by row of all parts; 0 where nothing was predicted."""

    def residuals(self, vector: Vector) -> Float[np.ndarray, "row p"]:
        """Innovations over their deviations."""
        ...

    def slopes(self, vector: Vector) -> Float[np.ndarray, "datum size"]:
        """D of the module, over all unknowns."""
        ...

    def stacked(self, residuals: Float[np.ndarray, "row p"]) -> Float[np.ndarray, " datum"]:
        """r of the module."""
        ...

    def responses(self, vector: Vector, inputs: Changes) -> Float[np.ndarray, "datum many"]:
        """Predictions from inputs alone, one column for each of `many` inputs of the log."""
        ...

    def to_signals(self, vector: Vector, signals: Signals) -> Float[np.ndarray, "datum many"]:
        """The responses to signals in place of the first input, whose delay is nearly 0."""
        ...


class ExactInnovations(NamedTuple):
    """Innovations of exact states: their errors of one period.

    usable : the periods of every part; roots : of the noise's covariance in each mode
    """

    log: ExactLog
    usable: tuple[Int[np.ndarray, " period"], ...]
    roots: Squares

    @classmethod
    def at(cls, log: ExactLog, vector: Vector, window: Window) -> ExactInnovations:
        from deadtime.identification.likelihoods.likelihood import concentrated

        parts = log.recording.parts
        k = tuple(log.sampling.usable(part, log.within, *window) for part in parts)
        terms = log.terms_in(*window)(log.cells(vector))(vector)
        counts = np.array([term.periods for term in terms])
        spare = np.maximum(counts - log.layout.n - log.layout.acting - 1, 1)
        S = concentrated(terms, log.layout.size)[1] * (counts / spare)[:, None, None]
        return cls(log, k, np.linalg.cholesky(S))

    def residuals(self, vector: Vector) -> Float[np.ndarray, "row p"]:
        return self._errors(vector, self.log.recording.parts)

    def slopes(self, vector: Vector) -> Float[np.ndarray, "datum size"]:
        log, layout = self.log, self.log.layout
        result = np.zeros((log.recording.samples, layout.n, layout.size))
        maps = log.sampling.maps(layout, vector, log.cells(vector))
        for mode, rows, z in self._periods(vector, log.recording.parts):
            moved = np.tensordot(z[:, layout.n :], maps[mode].by_P, (1, 2))
            white = np.linalg.solve(self.roots[mode], moved.transpose(0, 2, 1))
            result[rows[:, None], :, maps[mode].place] = white.transpose(0, 2, 1)
        return result.reshape(-1, layout.size)

    def stacked(self, residuals: Float[np.ndarray, "row p"]) -> Float[np.ndarray, " datum"]:
        return residuals.ravel()

    def responses(self, vector: Vector, inputs: Changes) -> Float[np.ndarray, "datum many"]:
        log, n, parts = self.log, self.log.layout.n, self.log.recording.parts
        maps = log.sampling.maps(
            log.layout, without_constants(log, vector), log.cells(vector), slopes=False
        )
        whole = [np.linalg.solve(self.roots[i], one.P) for i, one in enumerate(maps)]
        result = np.zeros((len(inputs[0]), log.recording.samples, n))
        for one, changed in enumerate(with_inputs(parts, inputs)):
            for mode, rows, z in self._periods(vector, changed):
                result[one, rows] = z[:, n:] @ whole[mode].T
        return np.nan_to_num(result.reshape(len(result), -1)).T

    def to_signals(self, vector: Vector, signals: Signals) -> Float[np.ndarray, "datum many"]:
        # A period has no memory: its response is that to 1 times the signal at its beginning.
        parts, p = self.log.recording.parts, self.log.layout.n
        one = [np.ones((1, *part.input.shape)) for part in parts]
        early = [np.hstack((s[:, :1], s[:, :-1])) for s in signals]
        acting = np.repeat(np.hstack(early).T, p, axis=0)
        return self.responses(vector, one) * acting

    def _periods(
        self, vector: Vector, parts: Sequence[Part]
    ) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
        """Mode, rows among those of all parts, and z of the usable periods, mode by mode."""
        log = self.log
        reads, first = log.sampling.reads(log.layout, vector, log.cells(vector)), 0
        for part, every in zip(parts, self.usable, strict=True):
            for mode in range(log.layout.modes):
                k = every[part.mode[every] == mode]
                if k.size:
                    z = log.sampling.rows(part, k, reads[mode], log.layout.constant)
                    yield mode, first + k + 1, z
            first += part.time.size

    def _errors(self, vector: Vector, parts: Sequence[Part]) -> Float[np.ndarray, "row p"]:
        log, n = self.log, self.log.layout.n
        maps = log.sampling.maps(log.layout, vector, log.cells(vector), slopes=False)
        result = np.zeros((sum(part.time.size for part in parts), n))
        for mode, rows, z in self._periods(vector, parts):
            e = z[:, :n] - z[:, n:] @ maps[mode].P.T
            result[rows] = np.linalg.solve(self.roots[mode], e.T).T
        return result


class FilterInnovations(NamedTuple):
    """Innovations of noisy measurements: those of Kalman's filter."""

    log: NoisyLog
    starts: Starts

    @classmethod
    def at(cls, log: NoisyLog, vector: Vector, window: Window) -> FilterInnovations:
        return cls(log, log.starts(*window))

    def residuals(self, vector: Vector) -> Float[np.ndarray, "row p"]:
        e, s = self.log.innovations(vector, self.starts)
        return np.where(self._known, e / np.sqrt(s), 0.0)

    def slopes(self, vector: Vector) -> Float[np.ndarray, "datum size"]:
        log = self.log
        places = Places.of(log.layout, len(log.C), log.free)
        blocks = list(log.filter(vector, self.starts).innovations(places))
        s = np.concatenate([block.s for block in blocks])[:, :, None]
        by_e = np.concatenate([block.by_e for block in blocks]) / np.sqrt(s)
        by_s = np.concatenate([block.by_s for block in blocks]) / (np.sqrt(2.0) * s)
        known = self._known[:, :, None]
        result = np.zeros((2, *known.shape[:2], log.size))
        result[0][:, :, log.free] = np.where(known, -by_e, 0.0)
        result[1][:, :, log.free[places.wide]] = np.where(known, by_s, 0.0)
        return result.reshape(-1, log.size)

    def stacked(self, residuals: Float[np.ndarray, "row p"]) -> Float[np.ndarray, " datum"]:
        variance = np.where(self._known, residuals**2 - 1.0, 0.0) / np.sqrt(2.0)
        return np.concatenate((residuals.ravel(), variance.ravel()))

    def responses(self, vector: Vector, inputs: Changes) -> Float[np.ndarray, "datum many"]:
        given, parts = without_constants(self.log, vector), self.log.recording.parts
        many = with_inputs(parts, inputs)
        own = self.log.filter(given, self.starts)
        copied = own._replace(
            parts=tuple(part for each in many for part in each),
            starts=own.starts * len(many),
            left_out=own.left_out * len(many),
        )
        blocks = copied.innovations(Places.none(self.log.layout.modes))
        e = np.concatenate([block.e / np.sqrt(block.s) for block in blocks])
        e = np.where(self._known, e.reshape(len(many), *self._known.shape), 0.0)
        means = e.reshape(len(many), -1).T
        return -np.concatenate((means, np.zeros(means.shape)))

    def to_signals(self, vector: Vector, signals: Signals) -> Float[np.ndarray, "datum many"]:
        inputs = [np.zeros((*one.shape, self.log.layout.m)) for one in signals]
        for own, one in zip(inputs, signals, strict=True):
            own[:, :, 0] = one
        return self.responses(vector, inputs)

    @property
    def _known(self) -> np.ndarray:
        log = self.log
        fresh = np.concatenate(self.starts)[:, None] | np.vstack(log.initial(self.starts))
        return np.isfinite(np.vstack([part.output for part in log.recording.parts])) & ~fresh


def without_constants(log: ExactLog | NoisyLog, vector: Vector) -> Vector:
    plain = vector.copy()
    plain[log.layout.of_constant] = 0.0
    return plain


def with_inputs(parts: Sequence[Part], inputs: Changes) -> list[list[Part]]:
    """The log with measurements of 0 and each of many inputs; missing rows stay missing."""
    return [
        [
            part._replace(output=np.where(np.isfinite(part.output), 0.0, np.nan), input=own[one])
            for part, own in zip(parts, inputs, strict=True)
        ]
        for one in range(len(inputs[0]))
    ]
