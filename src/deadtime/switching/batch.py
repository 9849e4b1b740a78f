"""Many switching signals in flat arrays, for compiled loops over scenarios."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike

from deadtime.base.checks import read_only, require_shape, require_unmasked
from deadtime.base.errors import ArgumentError
from deadtime.base.frozen import Frozen
from deadtime.switching.signal import SwitchingSignal


@dataclass(frozen=True, eq=False, repr=False, init=False)
class SignalBatch(Frozen):
    r"""Right-continuous switching signals, one after the other (immutable).

    .. math::

        \sigma_i(t) = \text{modes}[k] \text{ for } \text{times}[k] \le t < \text{times}[k+1],
        \quad \text{first}[i] \le k < \text{first}[i+1]

    and the last sojourn of each without end. ``batch[i]`` is :math:`\sigma_i`, ``len(batch)`` the
    number of signals.

    Parameters
    ----------
    first : (scenario + 1,) array of int64
        Index of each signal's first sojourn in the flat arrays, then the number of sojourns.
    times : (sojourn,) array
        Starts of sojourns, seconds; strictly increasing from 0 within each signal.
    modes : (sojourn,) array of int64
        Their modes, counted from 0; neighbours in a signal differ.
    end : (scenario,) array
        Time up to which each signal is known, seconds; infinite for none.
    initial_age : (scenario,) array
        How long each first mode has been active before time 0, seconds.

    Raises
    ------
    ArgumentError
        If the arrays are no such signals, or there is none.

    Examples
    --------
    >>> batch = SignalBatch.of([SwitchingSignal([0, 0.5], [0, 1]), SwitchingSignal.constant(2)])
    >>> batch
    SignalBatch(signals=2, switches=1)
    >>> batch.first, batch.times, batch.modes
    (array([0, 2, 3]), array([0. , 0.5, 0. ]), array([0, 1, 2]))
    >>> batch[0](0.7)
    np.int64(1)
    """

    first: Int[np.ndarray, " scenario_and_end"]
    times: Float[np.ndarray, " sojourn"]
    modes: Int[np.ndarray, " sojourn"]
    end: Float[np.ndarray, " scenario"]
    initial_age: Float[np.ndarray, " scenario"]

    def __init__(
        self,
        first: ArrayLike,
        times: ArrayLike,
        modes: ArrayLike,
        end: ArrayLike,
        initial_age: ArrayLike,
    ) -> None:
        first, modes = _own("first", first, "iu"), _own("modes", modes, "iu")
        times, end = _own("times", times, "iuf"), _own("end", end, "iuf")
        age = _own("initial_age", initial_age, "iuf")
        if end.ndim != 1 or not end.size:
            raise ArgumentError(f"end must hold one time per signal, got shape {end.shape}.")
        require_shape("first", first, (end.size + 1,), "(signals + 1,)")
        require_shape("initial_age", age, end.shape, "(signals,)")
        if first[0] != 0 or (np.diff(first) < 1).any():
            raise ArgumentError("first must start at 0 and increase: a signal has a sojourn.")
        require_shape("times", times, (int(first[-1]),), "(first[-1],)")
        require_shape("modes", modes, (int(first[-1]),), "(first[-1],)")
        # Differences between the last sojourn of a signal and the first of the next do not count.
        inner = np.ones(times.size - 1, dtype=bool)
        inner[first[1:-1] - 1] = False
        _require(times[first[:-1]] == 0.0, "times must start at 0")
        _require((np.diff(times) > 0.0) | ~inner, "times must strictly increase", first)
        _require((np.diff(modes) != 0) | ~inner, "neighbouring modes must differ", first)
        _require(modes >= 0, "modes must be counted from 0", first)
        _require(end > times[first[1:] - 1], "end must be later than the last switch")
        _require((age >= 0.0) & (age < np.inf), "initial_age must be ≥ 0 and finite, in s")
        arrays = {"first": first, "times": times, "modes": modes, "end": end, "initial_age": age}
        vars(self).update({name: read_only(array) for name, array in arrays.items()})

    @classmethod
    def of(cls, signals: Sequence[SwitchingSignal]) -> SignalBatch:
        """A list of signals in one batch."""
        if not signals:
            raise ArgumentError("signals must hold at least one signal, got none.")
        return cls(
            np.cumsum([0, *(signal.times.size for signal in signals)]),
            np.concatenate([signal.times for signal in signals]),
            np.concatenate([signal.modes for signal in signals]),
            np.array([signal.end for signal in signals], dtype=np.float64),
            np.array([signal.initial_age for signal in signals], dtype=np.float64),
        )

    def __len__(self) -> int:
        return self.end.size

    def __getitem__(self, signal: int) -> SwitchingSignal:
        """Signal number 0, …, len − 1."""
        if not 0 <= signal < len(self):
            raise ArgumentError(f"signal must be in 0..{len(self) - 1}, got {signal}.")
        own = slice(self.first[signal], self.first[signal + 1])
        age = float(self.initial_age[signal])
        return SwitchingSignal(
            self.times[own], self.modes[own], float(self.end[signal]), initial_age=age
        )

    def __iter__(self) -> Iterator[SwitchingSignal]:
        return map(self.__getitem__, range(len(self)))

    def slice(self, start: int, stop: int) -> SignalBatch:
        """The batch of signals start, …, stop − 1, 0 ≤ start < stop ≤ len."""
        if not 0 <= start < stop <= len(self):
            raise ArgumentError(
                f"start and stop must satisfy 0 ≤ start < stop ≤ {len(self)}, got {start}, {stop}."
            )
        first = self.first[start : stop + 1]
        own = slice(first[0], first[-1])
        return SignalBatch(
            first - first[0],
            self.times[own],
            self.modes[own],
            self.end[start:stop],
            self.initial_age[start:stop],
        )

    def take(self, signals: Int[np.ndarray, " some"]) -> SignalBatch:
        """The batch of the signals with these numbers, in this order.

        Examples
        --------
        >>> batch = SignalBatch.of([SwitchingSignal([0, 0.5], [0, 1]), SwitchingSignal.constant(2)])
        >>> batch.take(np.array([1, 0, 1])).modes
        array([2, 0, 1, 2])
        """
        sizes = np.diff(self.first)[signals]
        first = np.concatenate(([0], np.cumsum(sizes)))
        # Index of each sojourn in the flat arrays, signal by signal.
        own = np.repeat(self.first[signals] - first[:-1], sizes) + np.arange(first[-1])
        whole = self.end[signals], self.initial_age[signals]
        return SignalBatch(first, self.times[own], self.modes[own], *whole)

    def require_modes(self, modes: int) -> SignalBatch:
        """The batch itself, when all its modes are in 0, …, modes − 1; an error otherwise."""
        if self.modes.max() >= modes:
            k = int(np.argmax(self.modes))
            raise ArgumentError(
                f"signal {_signal_of(self.first, k)} enters mode {self.modes[k]} at "
                f"{self.times[k]:g} s, but the plant's modes are 0..{modes - 1}: modes count "
                "from 0."
            )
        return self

    def __repr__(self) -> str:
        return f"SignalBatch(signals={len(self)}, switches={self.times.size - len(self)})"


def _own(name: str, values: ArrayLike, kinds: str) -> np.ndarray:
    """A copy as int64 or float64; a read-only array itself."""
    raw = np.asarray(require_unmasked(name, values))
    if raw.dtype.kind not in kinds:
        wanted = "real numbers" if "f" in kinds else "integers"
        raise ArgumentError(f"{name} must hold {wanted}, got an array of {raw.dtype}.")
    array = raw.astype(np.float64 if "f" in kinds else np.int64, copy=False)
    return array.copy() if array.flags.writeable else array


def _signal_of(first: Int[np.ndarray, " scenario_and_end"], sojourn: int) -> int:
    """The number of the signal with this sojourn."""
    return int(np.searchsorted(first, sojourn, side="right")) - 1


def _require(good: np.ndarray, rule: str, first: np.ndarray | None = None) -> None:
    """Refuse a signal, or with `first` a sojourn, that violates a rule, by the signal's number."""
    if not good.all():
        k = int(np.argmin(good))
        signal = k if first is None else _signal_of(first, k)
        raise ArgumentError(
            f"{rule}, but not so in signal {signal}: SignalBatch.of packs a list of signals."
        )
