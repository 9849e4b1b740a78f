"""The inner loops of a digital run: compiled, and over Python's own numbers.

`closed_loop` reads arrays element by element, which costs Python several times as much as reading
lists. In most runs the law receives the state itself at every sample, and there are neither limits
nor disturbances. Uncompiled, these runs take `bare_loop`, over lists: the same products, added in
the same order, so the bits are those of the kernel.

    period                 k              k + 1       one switch and one arriving input in period k
    sample                 |              |
    piece       …  q − 1   | q  q+1  q+2  | q+3  …    first[k] = q, first[k + 1] = q + 3
    path[q]: x at the start of piece q                inputs[past + k]: u_k, the history before it
"""

from __future__ import annotations

import numpy as np

from deadtime.imperfections.sensors_and_actuators import InputLimits, limit_input
from deadtime.loop.belief_steps import run_belief
from deadtime.loop.observer_steps import run_observer
from deadtime.loop.preview_steps import answer_ahead, enter_piece, move_window, predict_ahead
from deadtime.loop.received_samples import is_held
from deadtime.numerics.exponential import advance
from deadtime.numerics.kernels import kernel
from deadtime.plant.pieces import PieceTable
from deadtime.simulation.loop_arrays import LIMIT, DelayLine, MeasurementInstants, Rows
from deadtime.simulation.record_kernel import LONG, dot


def is_bare(
    table: PieceTable,
    line: DelayLine,
    instants: MeasurementInstants,
    limits: InputLimits,
    shift: np.ndarray,
) -> bool:
    """Whether the law receives the state at every sample, and the plant every command."""
    seen = not (instants.noise.size or instants.C.shape[1]) and (instants.way < 0).all()
    given = line.known_inputs is line.inputs is line.asked and not (
        limits.relative.size or shift.size
    )
    return bool(
        given and seen and np.array_equal(instants.piece, table.first[: instants.piece.size])
    )


def bare_loop(
    table: PieceTable, rows: Rows, line: DelayLine, x0: np.ndarray
) -> tuple[int, np.ndarray]:
    """`closed_loop` of a run that `is_bare`, by rows: it fills `line` and returns the same."""
    plain_dot, within_limit = dot.function, _within_limit.function  # plain Python takes lists, too
    past, m, samples = line.past, line.inputs.shape[1], rows.row.size
    first, entry, row = table.first.tolist(), table.entry.tolist(), rows.row.tolist()
    moves, lag = np.concatenate((table.Phi, table.Gamma), axis=2).tolist(), table.lag.tolist()
    F, G, window = rows.F.tolist(), rows.G.tolist(), rows.G.shape[2]
    flat, x = line.inputs[:past].ravel().tolist(), x0.tolist()
    path = [x]
    for k in range(len(first) - 1):
        if 0 < k < samples and not within_limit(x):
            samples = k
        if k < samples:
            line.measured[k] = x
            recent = flat[len(flat) - window :]
            of = row[k]
            flat += [
                plain_dot(g, recent) + plain_dot(f, x) for f, g in zip(F[of], G[of], strict=True)
            ]
        for q in range(first[k], first[k + 1]):
            lags = lag[entry[q]]
            # Past the last sample the plant runs on only while it reads inputs that were sent.
            if k - min(lags) >= samples:
                return _filled(line, samples, flat, path)
            acting = [flat[(past + k - late) * m + i] for i, late in enumerate(lags)]
            x = _moved(moves[entry[q]], x + acting)
            path.append(x)
    return _filled(line, samples, flat, path)


def _filled(
    line: DelayLine, samples: int, flat: list[float], path: list[list[float]]
) -> tuple[int, np.ndarray]:
    """The return value of `closed_loop`, after writing the inputs into their line."""
    line.inputs[line.past : line.past + samples] = np.reshape(
        flat[line.past * line.inputs.shape[1] :], (samples, -1)
    )
    return samples, np.array(path)


def _moved(rows: list[list[float]], z: list[float]) -> list[float]:
    """[Φ Γ] z, added from left to right."""
    result = []
    for row in rows:
        total = 0.0
        for a, b in zip(row, z, strict=True):
            total += a * b
        result.append(total)
    return result


@kernel
def _row_dot(A, c, i, b):
    """`dot` of A[c, i] and b, for short rows: handing over a slice costs as much as 20 terms."""
    first = second = third = fourth = 0.0
    whole = b.size - b.size % 4
    for j in range(0, whole, 4):
        first += A[c, i, j] * b[j]
        second += A[c, i, j + 1] * b[j + 1]
        third += A[c, i, j + 2] * b[j + 2]
        fourth += A[c, i, j + 3] * b[j + 3]
    total = (first + second) + (third + fourth)
    for j in range(whole, b.size):
        total += A[c, i, j] * b[j]
    return total


@kernel
def _mean_row(rows, weight, recent, known, answer):
    """The answers of all rows, each by its weight."""
    for i in range(answer.size):
        answer[i] = 0.0
    for c in range(weight.size):
        if weight[c] > 0.0:
            for i in range(answer.size):
                own = _row_dot(rows.F, c, i, known)
                answer[i] += weight[c] * (dot(rows.G[c, i], recent) + own)


@kernel
def _within_limit(x):
    """Whether |x| ≤ LIMIT (false when x is not a number)."""
    square = 0.0
    for i in range(len(x)):
        square += (x[i] / LIMIT) * (x[i] / LIMIT)
    return square <= 1.0


# Inlined: a call that hands over a tuple of arrays, or many of them, costs as much as 50 terms.
@kernel(forceinline=True)
def _apply(answer, held, at, asked, inputs, low, high, relative):
    """Command the answer, or the last command again, and apply it within the limits."""
    for i in range(answer.size):
        u = asked[at - 1, i] if held else answer[i]
        asked[at, i] = u
        inputs[at, i] = limit_input(low, high, relative, i, u, inputs[at - 1, i])


@kernel
def _go_on(table, instants, k, x, inputs, past, result):
    """x of the instant at which it is measured, within a piece, from x at the piece's start."""
    q, way, now = instants.piece[k], instants.way[k], past + instants.step[k]
    e, m = table.entry[q], inputs.shape[1]
    acting = np.empty(instants.Gamma.shape[2])
    for i in range(acting.size):
        acting[i] = inputs[now - table.lag[e, i], i] if i < m else instants.force[q, i - m]
    advance(instants.Phi[way], instants.Gamma[way], x, acting, result)


@kernel(forceinline=True)
def _see(instants, k, x, measured, seen):
    """Write the measurement of x at sample k into `seen`, NaN where there is none."""
    for i in range(seen.size):
        if instants.piece[k] < 0:
            seen[i] = np.nan
        elif instants.C.shape[1]:
            seen[i] = _row_dot(instants.C, instants.mode[k], i, x)
        else:
            seen[i] = x[i]
        if instants.noise.size:
            seen[i] += instants.noise[k, i]
        measured[k, i] = seen[i]


@kernel
def answer_with_preview(law, k, past, known_inputs, x, answer):
    """The input of sample k for the state x: K x(t_k + D) + L u_{k−1}, u_0 in row `past`."""
    stacks, piece, begin, end = law.stacks, law.piece, law.window[k, 0], law.window[k, 1]
    for q in range(stacks.bounds[0], end):
        for j in range(stacks.acting.size):
            stacks.acting[j] = known_inputs[past + piece[q, 1 + j], j]
        enter_piece(stacks, law.move[piece[q, 0]])
    for i in range(x.size):
        stacks.x[i] = x[i]
    if begin < end:
        move_window(stacks, begin)
        predict_ahead(stacks, begin)
    answer_ahead(stacks, law.tails[law.mode[k]], known_inputs[past + k - 1], answer)


@kernel
def _move(Phi, Gamma, e, path, q, acting):
    """x at the end of piece q, of entry e, from its start: row q of `path` into row q + 1."""
    for i in range(path.shape[1]):
        total = 0.0
        for j in range(path.shape[1]):
            total += Phi[e, i, j] * path[q, j]
        for j in range(acting.size):
            total += Gamma[e, i, j] * acting[j]
        path[q + 1, i] = total


def _in_python(table, rows, memory, observer, belief, state, preview, *run):
    """`closed_loop` where it is not compiled: over lists where the run is bare."""
    line, instants, limits, shift, x0 = run
    simple = memory is None and belief is None and preview is None
    if simple and is_bare(table, line, instants, limits, shift):
        return bare_loop(table, rows, line, x0)
    known = memory, observer, belief, state, preview
    return closed_loop.function(table, rows, *known, *run)


@kernel(plain=_in_python, large=LONG)
def closed_loop(
    table, rows, memory, observer, belief, state, preview, line, instants, limits, shift, x0
):
    """Run the loop over the samples 0, …, rows.row.size − 1 and on until an input is missing.

    table : `deadtime.plant.pieces.PieceTable`
    rows, line, instants : `Rows`, `DelayLine` and `MeasurementInstants` of `loop_arrays`
    memory, observer : `deadtime.feedback.memory.Memory` and its state, or None
    belief, state : `deadtime.feedback.belief.Belief` and its state, or None
    preview : `PreviewLaw` in place of rows, or None
    limits : `deadtime.imperfections.sensors_and_actuators.InputLimits`
    shift : (pieces, n), what disturbances add to x over each piece, or empty

    Returns (samples, path): how many samples were kept before |x| left the limit, and x at the
    start of every piece that was run and at the end of the last.
    """
    first, entry, Phi, Gamma, lag = table.first, table.entry, table.Phi, table.Gamma, table.lag
    inputs, asked, known_inputs = line.inputs, line.asked, line.known_inputs
    # Flat, the N latest inputs are one contiguous row, oldest first, to multiply with G.
    flat = known_inputs.reshape(-1)
    F, G, row, measured = rows.F, rows.G, rows.row, line.measured
    piece, way = instants.piece, instants.way
    low, high, relative = limits
    n, m, window, past, samples = x0.size, inputs.shape[1], G.shape[2], line.past, row.size
    spare, seen = np.empty(n), np.empty(measured.shape[1])
    known = seen if memory is None else np.empty(line.estimates.shape[1])
    acting, answer = np.empty(m), np.zeros(m)
    path, known_mode = np.empty((entry.size + 1, n)), np.full(1, -1)
    for i in range(n):
        path[0, i] = x0[i]
    for k in range(first.size - 1):
        if k < samples and k > 0 and not _within_limit(path[first[k]]):
            samples = k
        if k < samples:
            at, q = past + k, piece[k]
            # q is −1 where nothing is received; any row will do, as `_see` writes NaN then.
            for i in range(n):
                spare[i] = path[max(q, 0), i]
            if way[k] >= 0:
                _go_on(table, instants, k, path[q], inputs, past, spare)
            _see(instants, k, spare, measured, seen)
            if memory is not None:
                estimates = line.estimates
                run_observer(
                    memory, observer, rows.mode, known_mode, k, known_inputs, past, seen, estimates
                )
                for i in range(known.size):
                    known[i] = estimates[k, i]
            recent = flat[at * m - window : at * m]
            if preview is not None:
                answer_with_preview(preview, k, past, known_inputs, known, answer)
            elif belief is not None:
                run_belief(belief, state, k, past, known_inputs, measured, line.beliefs)
                _mean_row(rows, state.weight, recent, known, answer)
            else:
                for i in range(m):
                    own = _row_dot(F, row[k], i, known)
                    answer[i] = dot(G[row[k], i], recent) + own
            if memory is not None:
                # Before the limits: the sums of errors must see what those refuse.
                for i in range(m):
                    observer.asked[i] = answer[i]
            _apply(answer, is_held(seen, answer), at, asked, inputs, low, high, relative)
        for q in range(first[k], first[k + 1]):
            e = entry[q]
            for i in range(m):
                sample = k - lag[e, i]
                # Past the last sample the plant runs on only while it reads inputs that were sent.
                if sample >= samples:
                    return samples, path[: q + 1]
                acting[i] = inputs[past + sample, i]
            _move(Phi, Gamma, e, path, q, acting)
            if shift.size:
                for i in range(n):
                    path[q + 1, i] += shift[q, i]
    return samples, path
