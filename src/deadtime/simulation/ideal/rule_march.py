"""The ideal loop under a rule: exact prediction where the state switches the plant.

With the plant as its model the law knows x(t + D), and u(t) = K_σ(t+D) x(t + D) reaches the plant
as x gets there. So, with what is in the delay line held piece by piece,

    x' = A_σ x + B_σ u₀(t − D),    0 ≤ t < D,        x' = (A_σ + B_σ K_σ) x,    t ≥ D,

σ = r(x): two plants under held inputs, which a `Motion` moves from crossing to crossing. Where
every input has its own delay, the same D_j in all modes, u_j(t) = K_σ,j x(t + D_j) with the σ of
t + D_j reaches it likewise, and there is one plant more for every further delay,

    x' = A_σ x + Σ_{j: D_j ≤ t} b_σ,j K_σ,j x + Σ_{j: D_j > t} b_σ,j u₀,j(t − D_j).

(Where an input's delay differs between modes a mode may read once more what was read already, as
K x of then: a delay equation, see `rule_rereading`.) Along a boundary at which both closed loops
point σ jumps without end, u with it, and x follows Filippov's mean of the two; the mode and the
input that are reported there are those of the mode it came from.
States are kept as polynomials on segments, as those of every ideal loop.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from deadtime.base.errors import ArgumentError
from deadtime.feedback import Law
from deadtime.laws import StateDependentPredictor
from deadtime.laws.state_dependent import final_place
from deadtime.numerics.collocation import gauss
from deadtime.plant import SwitchedSystem
from deadtime.simulation.digital import RunOutcome
from deadtime.simulation.ideal.breakpoints import merge, subdivide
from deadtime.simulation.ideal.ideal_run import NODES, IdealRecord
from deadtime.simulation.ideal.piecewise import Piecewise, side_by_side
from deadtime.simulation.ideal.rule_parts import RulePart, no_loop, outcome_of
from deadtime.simulation.initial_input import InitialInput, input_function
from deadtime.switching import Rule
from deadtime.switching.rules.motion import Beside, Motion

_PIECE, _SEGMENT = (
    4.0,
    1.0,
)  # lengths, times the fastest rate: of what is moved over, of polynomials
_MOST_PIECES = 1e6
_SAME = 1e-12  # of the time: edges that close are one


class _InputStage(NamedTuple):
    """A stretch of time over which the same inputs have arrived.

    arrived : (m,)
        Whether what an input reads is the law's own.
    edges : (pieces + 1,)
        Of the pieces over which what has been in the line is held, seconds.
    lengths, kinds : tuple, (pieces,)
        The lengths that pieces have, and which of them each has.
    held : (pieces, m)
        What is read from the line, 0 for inputs that have arrived.
    """

    arrived: np.ndarray
    edges: np.ndarray
    lengths: tuple[float, ...]
    kinds: np.ndarray
    held: np.ndarray


class _RuleMarch(NamedTuple):
    """Parts of a run; state, place and boundary at their end; and what keeps it from going on."""

    parts: list[RulePart]
    x: np.ndarray
    place: int
    beside: Beside | None
    stop: str = ""


def run_ideal_rule(
    plant: SwitchedSystem,
    law: Law,
    rule: Rule,
    x0: Float[np.ndarray, " n"],
    horizon: float,
    u0: InitialInput,
) -> RunOutcome:
    """Solve the loop on [0, horizon]."""
    delays, gains = plant.delays[0], _exact_gains(plant, law, rule)
    if not (plant.delays == delays).all():
        from deadtime.simulation.ideal.rule_rereading import (
            MOST_PIECES,
            PIECE,
            run_rereading_rule,
        )

        rate = _rate(np.abs(plant.A) + np.abs(plant.B) @ np.abs(gains))
        _require_room(plant, horizon, PIECE / rate, MOST_PIECES)
        return run_rereading_rule(plant, gains, rule, x0, horizon, _line(plant, u0, rate), rate)
    arrivals = np.unique(delays).tolist()
    arrived = [delays <= time for time in (0.0, *arrivals)]
    loops = [plant.A + plant.B @ (gains * own[:, None]) for own in arrived]
    rate = max(_rate(A) for A in loops)
    _require_room(plant, horizon, _PIECE / rate, _MOST_PIECES)
    line = _line(plant, u0, rate)
    stages = [
        *(_waiting(line, delays, *ends) for ends in pairwise((0.0, *arrivals))),
        _closed(plant, horizon, rate),
    ]
    motions = [
        rule.motion(plant.like(A, plant.B), stage.lengths)
        for A, stage in zip(loops, stages, strict=True)
    ]
    march = _march(motions[0], stages[0], x0, motions[0].place_of(x0))
    for q, stage in enumerate(stages[1:], 1):
        if march.stop:
            break
        fresh = gains * (stage.arrived & ~stages[q - 1].arrived)[:, None]
        at = march.x, march.place, march.beside
        place = final_place(motions[q - 1], fresh, *at, stage.held[0])
        rest = _march(motions[q], stage, march.x, place)
        march = rest._replace(parts=march.parts + rest.parts)
    return _outcome(plant, gains, march, line, horizon, rate)


def _require_room(plant: SwitchedSystem, horizon: float, piece: float, most: float) -> None:
    """Refuse a horizon that takes too many pieces."""
    if horizon + plant.longest_delay > piece * most:
        raise ArgumentError(
            f"horizon = {horizon:g} s is too long for the ideal loop, more than "
            f"{most:.0e} pieces of {piece:.1e} s: shorten it, or give a step."
        )


def _exact_gains(plant: SwitchedSystem, law: Law, rule: Rule) -> np.ndarray:
    """The gains of a law that knows the plant and its rule; an error for any other."""
    if not isinstance(law, StateDependentPredictor):
        raise ArgumentError(
            "step must be given where a rule switches the plant: of the laws only "
            "StateDependentPredictor, which runs the rule forward, has an ideal loop there, and "
            f"{type(law).__name__} has none."
        )
    model = law.plant
    for name, mine, its in (
        ("A", plant.A, model.A),
        ("B", plant.B, model.B),
        ("delay", plant.delays, model.delays),
    ):
        if not np.array_equal(mine, its):
            raise ArgumentError(
                f"step must be given where the {name} of the law's model is not the plant's: the "
                "ideal loop of StateDependentPredictor is known where its prediction is exact."
            )
    if not law.rule.same(rule):
        raise ArgumentError(
            "step must be given where the law's rule is not the plant's: the ideal loop of "
            "StateDependentPredictor is known where its prediction is exact."
        )
    return law.gains


def _rate(A: np.ndarray) -> float:
    """|A| of all modes, in units of the states in which they are balanced, 1/s."""
    from deadtime.numerics.exponential import balance

    unit = balance(np.abs(A).sum(axis=0))
    return max(float((np.abs(A) * unit / unit[:, None]).sum(axis=2).max()), 1e-300)


def _line(plant: SwitchedSystem, u0: InitialInput, rate: float) -> Float[np.ndarray, "piece m"]:
    """What is in the delay line at time 0, over equal pieces, oldest first."""
    if callable(u0):
        raise ArgumentError(
            "u0 must be None, a number, (m,) or held samples (m, N), oldest first, where the ideal "
            "loop runs under a rule: sample the function, as many times as you like."
        )
    longest = plant.longest_delay
    history = input_function(u0, plant.inputs, longest)
    held = max(history.jumps.size, 1)
    middles = -longest * (np.arange(held, 0, -1) - 0.5) / held
    each = math.ceil(longest * rate / held / _PIECE)
    return np.repeat(history.function(middles), max(each, 1), axis=0)


def _waiting(line: np.ndarray, delays: np.ndarray, begin: float, end: float) -> _InputStage:
    """The stage from one arrival to the next: some inputs still read what was in the line."""
    arrived, longest = delays <= begin, delays.max()
    sent = np.linspace(-longest, 0.0, len(line) + 1)
    edges = merge(np.add.outer(delays[~arrived], sent).ravel(), begin, end)
    lengths, kinds = tuple(np.diff(edges).tolist()), np.arange(edges.size - 1)
    even = np.linspace(begin, end, edges.size)
    if np.abs(edges - even).max() <= _SAME * longest:
        edges, lengths, kinds = even, ((end - begin) / kinds.size,), np.zeros_like(kinds)
    ago = delays - (edges[:-1] + edges[1:])[:, None] / 2.0
    place = np.floor((1.0 - ago / longest) * len(line)).astype(int)
    read = np.take_along_axis(line, np.clip(place, 0, len(line) - 1), axis=0)
    return _InputStage(arrived, edges, lengths, kinds, np.where(arrived, 0.0, read))


def _closed(plant: SwitchedSystem, horizon: float, rate: float) -> _InputStage:
    """The stage from the last arrival on, up to that of what is sent at the horizon."""
    pieces = math.ceil(horizon * rate / _PIECE)
    edges = np.linspace(plant.longest_delay, plant.longest_delay + horizon, pieces + 1)
    held, kinds = np.zeros((pieces, plant.inputs)), np.zeros(pieces, dtype=int)
    return _InputStage(np.ones(plant.inputs, dtype=bool), edges, (horizon / pieces,), kinds, held)


def _march(motion: Motion, stage: _InputStage, x: np.ndarray, place: int) -> _RuleMarch:
    """Move over the pieces of a stage."""
    from deadtime.simulation.loop_arrays import LIMIT

    edges = stage.edges.tolist()
    parts: list[RulePart] = []
    beside = None
    pieces = zip(edges[:-1], edges[1:], stage.kinds.tolist(), stage.held, strict=True)
    for a, b, kind, u in pieces:
        move = motion.advance(kind, x, place, u, beside)
        if not np.abs(move.x).max() <= LIMIT:
            return _RuleMarch(
                parts, x, place, None, f"diverged: |x| leaves 1e100 before t = {b:g} s"
            )
        stop = ""
        if move.chatter is not None:
            b = a + move.chatter.time
            stop = f"chattering at t = {b:.12g} s: {move.chatter.reason}"
        starts = [min(a + leg.time, b) for leg in move.legs]
        ends = [*starts[1:], b]
        parts += [
            RulePart(start, until, motion, leg, u)
            for start, until, leg in zip(starts, ends, move.legs, strict=True)
            if until > start
        ]
        x, place, beside = move.x, move.place, move.beside
        if stop:
            return _RuleMarch(parts, x, place, None, stop)
    return _RuleMarch(parts, x, place, beside)


def _outcome(
    plant: SwitchedSystem,
    gains: np.ndarray,
    march: _RuleMarch,
    line: np.ndarray,
    horizon: float,
    rate: float,
) -> RunOutcome:
    """Lay the parts out as polynomials, and say what there is to say."""
    parts, longest, stop = march.parts, plant.longest_delay, march.stop
    reached = parts[-1].end if parts else 0.0
    if stop and reached <= longest:
        raise no_loop(stop, longest)
    end = reached - longest if stop else horizon
    edges, x, modes = _polynomials(parts, rate, end)
    sent = _sent(plant.delays[0], edges, np.einsum("smn,spn->spm", gains[modes], x), line)
    record = IdealRecord(plant, Piecewise(edges, x), sent)
    return outcome_of(record, parts, end, stop)


def _polynomials(
    parts: list[RulePart], rate: float, cut: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Edges of segments, one of them at `cut`, x at the nodes of each, and its mode."""
    nodes = gauss(NODES)
    edges, values, modes = [parts[0].begin], [], []
    for part in parts:
        ends = [part.begin, cut, part.end] if part.begin < cut < part.end else part[:2]
        for a, b in pairwise(subdivide(np.array(ends), _SEGMENT / rate).tolist()):
            times = a + (b - a) * nodes.support - part.begin
            values.append([part.motion.along(part.leg, part.u, time) for time in times.tolist()])
            modes.append(part.mode)
            edges.append(b)
    return np.array(edges), np.array(values), np.array(modes)


def _sent(
    delays: np.ndarray, edges: np.ndarray, feedback: np.ndarray, line: np.ndarray
) -> Piecewise:
    """All inputs: what was in the line, and K_σ x (segments, nodes, m) sent a delay before."""
    before = np.linspace(-delays.max(), 0.0, len(line) + 1)
    held = np.repeat(line[:, None], feedback.shape[1], axis=1)
    each = []
    for j, delay in enumerate(delays.tolist()):
        first = int(np.searchsorted(edges, delay * (1.0 - 1e-15)))
        times = np.concatenate((before, edges[first + 1 :] - delay))
        each.append(Piecewise(times, np.concatenate((held, feedback[first:]))[..., j : j + 1]))
    return side_by_side(each)
