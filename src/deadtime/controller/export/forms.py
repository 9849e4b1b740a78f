"""The forms in which a table is stored in ROM: dense, of low rank, or factorised.

A dense table is one matrix G, rows (context, output), columns (tap, input); one of low rank is
G ≈ L R, where rows are similar. If inputs have different delays, the columns are (input, tap), as
many for each input as its window W_j, so that memory and work are those of Σ W_j past values. The
error of a form is

    max over rows of Σ|G − L R| / Σ|G|,

so that |Δu| is at most this share of Σ|G| max|u|.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from deadtime.base.errors import ArgumentError
from deadtime.controller.past_inputs import FEW
from deadtime.feedback import Feedback

Precision = Literal["double", "float"]
BYTES = {"double": 8, "float": 4}
DTYPE = {"double": np.float64, "float": np.float32}
_MOST_ERROR = 1e-2  # of a low-rank form that a message may recommend
_COUNTERS = 80  # bytes of integers and clock in a controller's state


class TableExtra(NamedTuple):
    """The name and the bytes of the tables beside a law's, whatever form that takes.

    `single` is ROM in single precision, None where there is none.
    """

    name: str
    rom: int
    ram: int
    single: int | None = None


@dataclass(frozen=True, eq=False)
class Form:
    """The constants in ROM for the inputs: named arrays with a comment each (immutable)."""

    kind: Literal["dense", "low rank", "factorised"]
    arrays: dict[str, tuple[np.ndarray, str]]
    state: int  # numbers that the past inputs take in RAM
    error: float = 0.0
    sizes: dict[str, int] = field(default_factory=dict)
    windows: tuple[int, ...] = ()  # of every input, where they differ

    @property
    def numbers(self) -> int:
        """How many numbers the arrays hold."""
        return sum(array.size for array, _ in self.arrays.values())


def windows_of(table: Feedback) -> tuple[int, ...]:
    """W_j of every input: how many of its past values the rows use; empty if all are equal.

    Examples
    --------
    >>> G = np.zeros((1, 4, 2, 2))
    >>> G[0, :, 0, 0], G[0, :2, 0, 1] = 1.0, 1.0
    >>> windows_of(Feedback(np.zeros((1, 2, 1)), G, "none", 0.1))
    (4, 2)
    """
    read = np.any(table.input_gain, axis=(0, 2))
    windows = [int(np.flatnonzero(column).max(initial=0)) + 1 for column in read.T]
    return tuple(windows) if len(set(windows)) > 1 else ()


def past_of(
    table: Feedback, windows: tuple[int, ...]
) -> tuple[Float[np.ndarray, "context m past"], str]:
    """The taps in the order in which a controller stores inputs, and this order in words."""
    if not windows:
        return table.oldest_first, "the oldest input first"
    own = [table.input_gain[:, :count, :, j][:, ::-1] for j, count in enumerate(windows)]
    return np.concatenate(own, axis=1).transpose(0, 2, 1), "input by input, the oldest value first"


def dense(table: Feedback) -> Form:
    """The taps as they are."""
    windows = windows_of(table)
    G, order = past_of(table, windows)
    return Form("dense", {"G": (G, f"taps, {order}")}, 2 * G.shape[-1], windows=windows)


def low_ranks(table: Feedback) -> Iterator[Form]:
    """The taps as a product of rank 1, 2, …, while it is smaller than `dense`."""
    windows = windows_of(table)
    G, order = past_of(table, windows)
    contexts, m, past = G.shape
    G = G.reshape(-1, past)
    rows, columns = G.shape
    sums = np.abs(G).sum(axis=1)
    scale = np.where(sums > 0.0, sums, 1.0)
    # The error is relative to the sum of a row, so rows are scaled by theirs.
    left, values, right = np.linalg.svd(G / scale[:, None], full_matrices=False)
    missing = G / scale[:, None]
    for rank in range(1, len(values) + 1):
        if rank * (rows + columns) >= G.size:
            return
        # Half of each singular value on either side: both factors lose the same digits in float.
        root = np.sqrt(values[:rank])
        missing = missing - np.outer(left[:, rank - 1] * values[rank - 1], right[rank - 1])
        L, R = scale[:, None] * left[:, :rank] * root, root[:, None] * right[:rank]
        arrays = {
            "LEFT": (L.reshape(contexts, m, rank), "the taps of a row are LEFT RIGHT"),
            "RIGHT": (R, order),
        }
        error = float(np.abs(missing).sum(axis=1).max())
        yield Form("low rank", arrays, 2 * past, error, {"rank": rank}, windows)


def factor_form(table: Feedback) -> Form:
    """The taps as H S^{j−1} Γ and the last one."""
    assert table.factor is not None
    H, S, gamma, last = table.factor
    taps, m, order = table.taps, gamma.shape[1], len(S)
    block = -(-(taps - 1) // 2)
    arrays = {
        "S": (S, "one period of the factorisation"),
        "GAMMA": (gamma, "an input, in the factorisation"),
        "WHOLE": (np.linalg.matrix_power(S, block), "S to the power of a block's length"),
        "H": (H, "rows of the factorisation"),
        "LAST": (last, "taps of the oldest input"),
    }
    state = taps * m + order * (3 + block + m) + H.size
    return Form("factorised", arrays, state, 0.0, {"order": order, "block": block})


def form_of(
    table: Feedback, accuracy: float, precision: Precision, budget: int | None = None
) -> Form:
    """The form of the C: the form of the controller, or low rank.

    Rank r costs r sums over the past inputs per period, and a dense row costs m. So low rank is
    used only if it halves the ROM or if the budget requires it.
    """
    if table.factor is not None and table.taps > FEW:
        return factor_form(table)
    whole = dense(table)
    within = budget is None or rom_bytes(table, whole, precision) <= budget
    for form in low_ranks(table):
        if within and 2 * form.numbers > whole.numbers:
            return whole
        if form.error <= accuracy:
            return form
    return whole


def rom_bytes(table: Feedback, form: Form, precision: Precision) -> int:
    """Bytes of all constants: taps, state gains and limits."""
    m = table.input_gain.shape[2]
    return BYTES[precision] * (form.numbers + table.state_gain.size + 2 * m)


def ram_bytes(table: Feedback, form: Form, precision: Precision) -> int:
    """Bytes of one controller, without the padding that the compiler adds."""
    return BYTES[precision] * (form.state + table.input_gain.shape[2]) + _COUNTERS


def require_budget(
    table: Feedback, form: Form, precision: Precision, budget: int | None, beside: TableExtra
) -> None:
    """Refuse tables beyond the budget, and name forms that fit."""
    needed = rom_bytes(table, form, precision) + beside.rom
    if budget is None or needed <= budget:
        return
    fits, room = [], budget - beside.rom
    if precision == "double" and beside.single is not None:
        single = rom_bytes(table, form, "float") + beside.single
        if single <= budget:
            fits.append(f'precision="float" ({single} bytes)')
    if form.kind != "factorised":
        kept = [
            one
            for one in low_ranks(table)
            if rom_bytes(table, one, precision) <= room and one.error <= _MOST_ERROR
        ]
        if kept:
            best = min(kept, key=lambda one: one.error)
            fits.append(
                f"accuracy={_round_up(best.error):.0e} (rank {best.sizes['rank']}, "
                f"{rom_bytes(table, best, precision) + beside.rom} bytes)"
            )
        taps = _fewer_taps(table, precision, room)
        if taps:
            fits.append(f"{taps} past inputs, a period of {_period(table, taps)} s")
    raise ArgumentError(
        f"rom_budget = {budget} bytes is too small: the tables take {needed} ({form.kind}, "
        f"{table.taps} past inputs, {len(table.state_gain)} rows"
        + (f"; {beside.rom} of them {beside.name}); " if beside.rom else "); ")
        + (f"what fits: {', or '.join(fits)}." if fits else "nothing of this law fits.")
    )


def _round_up(error: float) -> float:
    """To one digit, never below."""
    if error == 0.0:
        return 0.0
    unit = 10.0 ** np.floor(np.log10(error))
    return float(np.ceil(error / unit * (1.0 + 1e-9)) * unit)


def _fewer_taps(table: Feedback, precision: Precision, budget: int) -> int:
    """The most past inputs whose dense table fits; ages of a mode shrink with the window."""
    contexts, taps, m, _ = table.input_gain.shape
    n, past = table.state_gain.shape[2], sum(windows_of(table)) or taps * m
    for fewer in range(taps - 1, 0, -1):
        ages = min(table.ages, table.ages * fewer // taps + 2)
        rows = contexts // table.ages * ages
        if BYTES[precision] * (rows * m * (past * fewer // taps + n) + 2 * m) <= budget:
            return fewer
    return 0


def _period(table: Feedback, taps: int) -> str:
    """The period of so many past inputs, to four digits, never below."""
    period = table.step * table.taps / taps
    unit = 10.0 ** (np.floor(np.log10(period)) - 3)
    return f"{np.ceil(period / unit) * unit:.4g}"
