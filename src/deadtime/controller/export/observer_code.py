"""The observer of a controller in C, with the sums of a servo: tables, memory and bounds.

The source is a `Memory`, and the reference as a schedule. The C has the operations of
`loop/observer_steps.py` in the same order: the results agree to round-off.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from deadtime.base.errors import ArgumentError
from deadtime.controller.controller_state import Observing
from deadtime.controller.export.forms import BYTES, Precision
from deadtime.feedback.memory import Memory

_COUNTERS = 8  # bytes of integers in a controller's state
_NEVER = 2**63  # samples
# Relative to the commanded input: a smaller difference to the applied input is round-off. As
# `_ROUND_OFF` of the kernel.
_ROUND_OFF = {"double": 1e-9, "float": 1e-5}


class ObserverForm(NamedTuple):
    """An observer as data: its `Memory`, and the sample at which each reference begins."""

    memory: Memory
    changes: list[int]
    values: Float[np.ndarray, "change r"]

    @classmethod
    def of(cls, observing: Observing) -> ObserverForm:
        """Of a controller's; its reference is a schedule (`require_schedule`).

        An observer that does not depend on the mode has the matrices of one.
        """
        memory, reference = observing.memory, observing.reference
        if not observing.reads_mode:
            memory = memory._replace(matrices=memory.matrices[:1])
        if reference is None or reference.schedule is None:
            return cls(memory, [0], memory.reference)
        times, slack = reference.schedule.times, reference.schedule.slack
        changes = [_first_sample(time, slack, memory.step) for time in times.tolist()]
        return cls(memory, changes, reference.schedule.values)

    @property
    def sizes(self) -> tuple[int, int, int, int]:
        """Of estimates, outputs, sums and tracked outputs."""
        return self.memory.sizes[:4]


def _first_sample(time: float, slack: float, step: float) -> int:
    """The first k ≥ 0 with k h + slack ≥ time, in floats as `Schedule` counts."""
    if (time - slack) / step > 2.0**60:
        return _NEVER
    # The quotient may be off by a rounding: the comparison of `Schedule` decides.
    k = max(0, math.ceil((time - slack) / step) - 1)
    while k > 0 and (k - 1) * step + slack >= time:
        k -= 1
    while k * step + slack < time:
        k += 1
    return k


def require_schedule(observing: Observing) -> None:
    """Refuse a reference that is a function of time."""
    if observing.reference is not None and observing.reference.schedule is None:
        raise ArgumentError(
            "reference is a function of time, which has no C: make the loop with a constant or "
            "(times, values), and hand the reference to the C at every call."
        )


def require_within(form: ObserverForm, most: float) -> None:
    """Refuse a first estimate or a reference beyond the bound of the C."""
    for name, value in (("estimate", form.memory.start), ("reference", form.values)):
        if np.abs(value).max(initial=0.0) > most:
            raise ArgumentError(
                f"{name} must be within {most:.0e}, the bound of the C, got {value.tolist()}."
            )


def arrays(form: ObserverForm) -> dict[str, tuple[np.ndarray, str]]:
    """The constant arrays in ROM, with a comment each."""
    memory, (n, _, q, r) = form.memory, form.sizes
    start = memory.start.copy()
    start[n + q :] = form.values[0]
    found = {
        "PREDICT_X": (
            memory.Phi,
            "the observer's model over a period, by mode: gains of the estimate",
        ),
        "PREDICT_U": (memory.Gamma, "gains of inputs, by mode and lag"),
        "MEASURE": (memory.C, "the output matrix, by mode"),
        "CORRECT": (memory.gain, "the observer's gain, by mode"),
        "INITIAL": (start, "the initial z"),
    }
    if r:
        found["TRACK"] = memory.tracked, "tracked outputs as combinations of the outputs"
        found["REFERENCE"] = form.values, "the values of the law's own reference"
    if q:
        found["SUM_GAIN"] = memory.push, "the law's gain of the sums, by mode"
    return found


def values(form: ObserverForm, precision: Precision) -> dict[str, Any]:
    """The values that fill the templates."""
    n, p, q, r = form.sizes
    return {
        "estimates": n,
        "outputs": p,
        "sums": q,
        "tracked": r,
        "reads_mode": len(form.memory.matrices) > 1,
        "lags": form.memory.lag.tolist(),
        "sent": _sent(form),
        "changes": form.changes,
        "halvings": (len(form.changes) - 1).bit_length(),
        "round_off": f"{_ROUND_OFF[precision]:g}",
    }


def integer_bytes(form: ObserverForm) -> int:
    """Bytes of tables of integers: four each, eight for numbers of samples."""
    samples = len(form.changes) if len(form.changes) > 1 else 0
    return 4 * form.memory.lag.size + 8 * samples


def ram_bytes(form: ObserverForm, precision: Precision) -> int:
    """Bytes of z, the last outputs and command, and the inputs of the observer."""
    *_, r = form.sizes
    m = form.memory.sizes.m
    return BYTES[precision] * (form.memory.start.size + r + m + _sent(form) * m) + _COUNTERS


def gain(form: ObserverForm, largest: float) -> float:
    """The largest gain from terms to sums within a period, for `bounds`.

    Anti-windup multiplies the part of an input beyond its limits by its change, so the square of
    the bound, times that gain, must not overflow either.
    """
    memory, (n, p, q, _) = form.memory, form.sizes
    m = memory.sizes.m * memory.lag.size
    output = max(n * _most(memory.C), 1.0)
    sums = [
        n * _most(memory.Phi) + m * _most(memory.Gamma),
        1.0 + p * _most(memory.gain) * (1.0 + output),
        p * _most(memory.tracked) * output,
        1.0 + 2.0 * memory.step,
    ]
    change = 2.0 * memory.step * q * _most(memory.push)
    square = math.sqrt(largest) * math.sqrt(2.0 * memory.sizes.m * change / 16.0)
    return max(*sums, change, square)


def _sent(form: ObserverForm) -> int:
    return int(form.memory.lag.max()) + 1


def _most(array: np.ndarray) -> float:
    return float(np.abs(array).max(initial=0.0))
