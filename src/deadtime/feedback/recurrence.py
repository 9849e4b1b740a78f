"""A law and its state as one table: a linear update from period to period.

Before the sample at t_k a `Memory` holds w_k = (x̄_k, s_k): its prediction, and of the sums of
errors s_k = q_{k−1} + h v_{k−1}/2. What the law's rows are multiplied with is linear in x_k and
w_k, and so is what it holds a period later. In the mode i that is reported at t_k

    x̂ = x̄ + L_i (C x − C_i x̄),    q = s + h v/2,    v = H C x,
    u_k = F_c (x̂, q) + Σ_j G_{c,j} u_{k−j},
    x̄⁺ = Φ_i x̂ + Σ_l Γ_{i,l} u_{k−l},    s⁺ = s + h v,

l over the lags at which inputs reach the model, C and C_i the true outputs and the model's. So
(w_{k+1}, u_k) are rows of a table over (x_k, w_k, u_{k−1}, …). The first `Feedback.memory` of what
it gives are w: the plant does not read them, and the law reads the last of them. The reference is
0, every sample is measured, and every input is applied as asked for.

Where a sample is lost, `with_lost_rows`: an observer goes on as if it had received C_i x̄, what it
expects, so x̂ = x̄ and v = H C_i x̄, i the mode reported last; a law of the state holds its
last input, u_k = u_{k−1}. These are rows of their own.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from deadtime.feedback.law import Law
from deadtime.feedback.memory import Memory
from deadtime.feedback.table import Feedback
from deadtime.switching import SwitchingSignal


def recurrence_of(law: Law, step: float, signal: SwitchingSignal | None = None) -> Feedback | None:
    """A law's table, with its state among the outputs; None of a law that is no table.

    `signal` is that of a preview, the constant mode 0 by default; such a law with a memory is no
    table.

    Examples
    --------
    >>> import deadtime as dt
    >>> problem = dt.problems.paper()
    >>> law = dt.AveragedPredictor(problem.plant, problem.gains)
    >>> observer = dt.luenberger(problem.plant, [[1.0, 0.0]], poles=[-4, -5], step=0.1)
    >>> table = recurrence_of(dt.OutputFeedback(law, observer), 0.1)
    >>> table.memory, table.context, table.state_gain.shape, table.input_gain.shape
    (2, 'mode', (2, 3, 2), (2, 10, 3, 3))
    """
    signal = SwitchingSignal.constant(0) if signal is None else signal
    if not law.is_linear:
        return None
    if law.outputs is None:
        return law.digital(step, signal, 1)
    tables = law.tables_along(step, signal, 1)
    if tables is None or tables.feedback is None or tables.memory is None:
        return None
    return _joined(tables.feedback, tables.memory, law.outputs, lost=False)


def with_lost_rows(law: Law, table: Feedback) -> Feedback:
    """The table of `recurrence_of` with as many rows again: those of a sample that is lost.

    The row c of a sample that is measured becomes c + rows where it is lost.

    Examples
    --------
    >>> import deadtime as dt
    >>> problem = dt.problems.paper()
    >>> law = dt.AveragedPredictor(problem.plant, problem.gains)
    >>> both = with_lost_rows(law, recurrence_of(law, 0.1))
    >>> both.state_gain[1].tolist(), both.input_gain[1, :2].ravel().tolist()
    ([[0.0, 0.0]], [1.0, 0.0])
    """
    F, G = np.zeros_like(table.state_gain), np.zeros_like(table.input_gain)
    if law.outputs is not None:
        tables = law.tables_along(table.step, SwitchingSignal.constant(0), 1)
        assert tables is not None
        assert tables.feedback is not None
        assert tables.memory is not None
        lost = _joined(tables.feedback, tables.memory, law.outputs, lost=True)
        F, G = lost.state_gain, lost.input_gain
    else:
        G[:, 0] = np.eye(F.shape[1])
    return Feedback(
        np.concatenate((table.state_gain, F)),
        np.concatenate((table.input_gain, G)),
        table.context,
        table.step,
        table.ages,
        memory=table.memory,
    )


def same_outputs(law: Law) -> bool:
    """Whether a law measures the same of the state in every mode.

    Else the measurement of a law to which another mode is reported depends on both modes.
    """
    return law.outputs is None or bool(np.all(law.outputs == law.outputs[:1]))


def _joined(
    feedback: Feedback, memory: Memory, outputs: Float[np.ndarray, "mode p n"], lost: bool
) -> Feedback:
    """The table of (w, u) from those of u and of w, `outputs` being the plant's C."""
    modes, _, n = outputs.shape
    by_mode = feedback.context == "none" and memory.reads_mode
    context = "mode" if by_mode else feedback.context
    rows = range(modes if by_mode else len(feedback.state_gain))
    pairs = [(c, 0) if by_mode else (c // feedback.ages, c) for c in rows]
    taps = max(feedback.taps, int(memory.lag.max()))
    found = np.stack([_row(feedback, memory, outputs[i], i, row, taps, lost) for i, row in pairs])
    m, q = feedback.state_gain.shape[1], memory.gain.shape[1] + memory.push.shape[2]
    G = np.zeros((len(found), taps, q + m, q + m))
    G[:, 0, :, :q] = found[:, :, n : n + q]
    past = found[:, :, n + q :].reshape(len(found), q + m, taps, m)
    G[:, :, :, q:] = past.transpose(0, 2, 1, 3)
    F = np.ascontiguousarray(found[:, :, :n])
    return Feedback(F, G, context, feedback.step, feedback.ages, memory=q)


def _row(
    feedback: Feedback,
    memory: Memory,
    C: Float[np.ndarray, "p n"],
    mode: int,
    row: int,
    taps: int,
    lost: bool,
) -> Float[np.ndarray, "out columns"]:
    """(w_{k+1}, u_k) over (x_k, w_k, u_{k−1}, …, u_{k−taps}), under a row in a mode."""
    n, n_o, sums = C.shape[1], memory.gain.shape[1], memory.push.shape[2]
    F, m, h = feedback.state_gain[row], feedback.state_gain.shape[1], memory.step
    # Each quantity is a row over (x, w, past inputs), built from rows of the unit matrix: so the
    # equations of the module are below as they are written there.
    unit = np.eye(n + n_o + sums + taps * m)
    x, x_bar, s, past = np.split(unit, np.cumsum([n, n_o, sums]))
    measured = memory.C[mode] @ x_bar if lost else C @ x
    v = memory.tracked[:sums] @ measured
    estimate = x_bar + memory.gain[mode] @ (measured - memory.C[mode] @ x_bar)
    u = F[:, :n_o] @ estimate + F[:, n_o : n_o + sums] @ (s + h / 2.0 * v)
    u = u + feedback.latest_first[row] @ past[: feedback.taps * m]
    # Row l is u_{k−l}, so that the lags of the memory index it.
    line = np.stack((u, *past.reshape(taps, m, -1)))
    ahead = memory.Phi[mode] @ estimate + (memory.Gamma[mode] @ line[memory.lag]).sum(axis=0)
    return np.concatenate((ahead, s + h * v, u))
