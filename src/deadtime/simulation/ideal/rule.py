"""The ideal loop under a rule: exact prediction where the state switches the plant.

With the plant as its model the law knows x(t + D), and u(t) = K_σ(t+D) x(t + D) reaches the plant
as x gets there. So, with what is in the delay line held piece by piece,

    x' = A_σ x + B_σ u₀(t − D),    0 ≤ t < D,        x' = (A_σ + B_σ K_σ) x,    t ≥ D,

σ = r(x): two plants under held inputs, which a `Motion` moves from crossing to crossing. Along a
boundary at which both closed loops point σ jumps without end, u with it, and x follows Filippov's
mean of the two; the mode and the input that are reported there are those of the mode it came from.
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
from deadtime.simulation.digital import Outcome
from deadtime.simulation.ideal.breakpoints import subdivide
from deadtime.simulation.ideal.piecewise import Piecewise
from deadtime.simulation.ideal.run import NODES, IdealRecord
from deadtime.simulation.initial_input import InitialInput, input_function
from deadtime.simulation.slides import Slide, join, slides_in_words
from deadtime.switching import Rule, SwitchingSignal
from deadtime.switching.rules.motion import Beside, Leg, Motion

_PIECE, _SEGMENT = (
    4.0,
    1.0,
)  # lengths, times the fastest rate: of what is moved over, of polynomials
_MOST_PIECES = 1e6
_SAME = 1e-12  # of the time: switches that close are one


class _Part(NamedTuple):
    """A part of the run in one motion, seconds from its start, and the input held over it."""

    begin: float
    end: float
    motion: Motion
    leg: Leg
    u: np.ndarray

    @property
    def mode(self) -> int:
        return self.motion.mode_of(self.leg.place)


class _March(NamedTuple):
    """Parts of a run; state, place and boundary at their end; and what keeps it from going on."""

    parts: list[_Part]
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
) -> Outcome:
    """Solve the loop on [0, horizon]."""
    delay = plant.one_delay("a rule that switches the ideal loop")
    gains = _exact_gains(plant, law, rule)
    loops = plant.A + plant.B @ gains
    rate = max(_rate(plant.A), _rate(loops))
    if (horizon + delay) * rate > _PIECE * _MOST_PIECES:
        raise ArgumentError(
            f"horizon = {horizon:g} s is too long for the ideal loop, more than "
            f"{_MOST_PIECES:.0e} pieces of {_PIECE / rate:.1e} s: shorten it, or give a step."
        )
    line = _line(plant, u0, rate)
    open_loop = rule.motion(plant, (delay / len(line),))
    march = _march(open_loop, 0.0, delay, line, x0, open_loop.place_of(x0))
    if not march.stop:
        pieces = math.ceil(horizon * rate / _PIECE)
        unforced = np.zeros((pieces, plant.inputs))
        closed_loop = rule.motion(SwitchedSystem(loops, plant.B, delay), (horizon / pieces,))
        place = final_place(open_loop, gains, march.x, march.place, march.beside)
        rest = _march(closed_loop, delay, delay + horizon, unforced, march.x, place)
        march = rest._replace(parts=march.parts + rest.parts)
    return _outcome(plant, gains, march, line, horizon, rate)


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
    history = input_function(u0, plant.inputs, plant.delay)
    held = max(history.jumps.size, 1)
    middles = -plant.delay * (np.arange(held, 0, -1) - 0.5) / held
    each = math.ceil(plant.delay * rate / held / _PIECE)
    return np.repeat(history.function(middles), max(each, 1), axis=0)


def _march(
    motion: Motion, begin: float, end: float, inputs: np.ndarray, x: np.ndarray, place: int
) -> _March:
    """Move over equal pieces of [begin, end] under held inputs."""
    from deadtime.simulation.kernel import LIMIT

    edges = np.linspace(begin, end, len(inputs) + 1).tolist()
    parts: list[_Part] = []
    beside = None
    for a, b, u in zip(edges[:-1], edges[1:], inputs, strict=True):
        move = motion.advance(0, x, place, u, beside)
        if not np.abs(move.x).max() <= LIMIT:
            return _March(parts, x, place, None, f"diverged: |x| leaves 1e100 before t = {b:g} s")
        stop = ""
        if move.chatter is not None:
            b = a + move.chatter.time
            stop = f"chattering at t = {b:.12g} s: {move.chatter.reason}"
        starts = [min(a + leg.time, b) for leg in move.legs]
        ends = [*starts[1:], b]
        parts += [
            _Part(start, until, motion, leg, u)
            for start, until, leg in zip(starts, ends, move.legs, strict=True)
            if until > start
        ]
        x, place, beside = move.x, move.place, move.beside
        if stop:
            return _March(parts, x, place, None, stop)
    return _March(parts, x, place, beside)


def _outcome(
    plant: SwitchedSystem,
    gains: np.ndarray,
    march: _March,
    line: np.ndarray,
    horizon: float,
    rate: float,
) -> Outcome:
    """Lay the parts out as polynomials, and say what there is to say."""
    parts, delay, stop = march.parts, plant.delay, march.stop
    reached = parts[-1].end if parts else 0.0
    if stop and reached <= delay:
        raise ArgumentError(
            f"x0 leads to no ideal loop, {stop}, before the first input of the law arrives at "
            f"{delay:g} s: give a step for a run up to there."
        )
    end = reached - delay if stop else horizon
    edges, x, modes = _polynomials(parts, rate, end)
    first = int(np.searchsorted(edges, delay * (1.0 - 1e-15)))
    u = np.einsum("smn,spn->spm", gains[modes[first:]], x[first:])
    sent = np.concatenate((np.repeat(line[:, None], x.shape[1], axis=1), u))
    sent_at = np.concatenate((np.linspace(-delay, 0.0, len(line) + 1), edges[first + 1 :] - delay))
    record = IdealRecord(plant, Piecewise(edges, x), Piecewise(sent_at, sent))
    signal = _signal(parts, reached)
    slides = join(
        [_slide(part, end) for part in parts if part.leg.beside and part.begin < end],
        _SAME * max(1.0, reached),
    )
    diverged = stop.startswith("diverged")  # `simulate` says so itself
    notes = [f"{stop}, a delay ahead: the run ends at t = {end:g} s."]
    return Outcome(
        record,
        signal,
        lambda time: signal(time + record.states.slack),
        end if stop else None,
        diverged,
        " ".join(filter(None, [*notes[: bool(stop) and not diverged], slides_in_words(slides)])),
    )


def _polynomials(
    parts: list[_Part], rate: float, cut: float
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


def _signal(parts: list[_Part], reached: float) -> SwitchingSignal:
    """The switching signal that the parts are, known up to where they reach."""
    times, modes = [0.0], [parts[0].mode]
    for part in parts[1:]:
        if part.mode == modes[-1]:
            continue
        if part.begin - times[-1] <= _SAME * max(1.0, reached):
            modes[-1] = part.mode
            if modes[-1] in modes[-2:-1]:
                del times[-1], modes[-1]
        else:
            times.append(part.begin)
            modes.append(part.mode)
    return SwitchingSignal(times, modes, reached)


def _slide(part: _Part, end: float) -> Slide:
    """The sliding motion of a part, up to the end of the run."""
    assert part.leg.beside is not None
    mode, other = (part.motion.mode_of(p) for p in (part.leg.place, part.leg.beside.place))
    return Slide(part.begin, min(part.end, end), (min(mode, other), max(mode, other)))
