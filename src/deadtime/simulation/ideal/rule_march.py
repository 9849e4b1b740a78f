"""The ideal loop under a rule: exact prediction where the state switches the plant.

With the plant as its model the law predicts x exactly: it sends to input j the K_i,j x of the
instant at which the input is first read, in the mode i of that instant. With one delay that is
x' = (A_σ + B_σ K_σ) x from D on, σ = r(x). Delays that differ between modes make a delay equation:
a mode with a longer delay than the one before reads inputs a second time, and for one with a
shorter delay inputs are overdue, and are set to K_i,j x of the instant of the switch. So x is
solved by the method of steps. On a piece every mode i reads input j either for the first time, as
K_i,j x, or again, as a known polynomial v of time,

    x' = (A_i + Σ_{j anew} b_i,j K_i,j) x + Σ_{j known} b_i,j v_j(t − D_i,j),

A polynomial solves w₀' = w₁, w₁' = w₂, …, w₀ = v. With these as further states, of which the rule
is independent, the plant is autonomous, and a `Motion` finds its crossings and slides. Pieces end
where an input that some mode reads is not smooth, and where the mode changes; a shorter piece is
the begin of a motion's. Both modes read while x slides along their boundary; the mode and the input
reported there are those of the mode before.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from deadtime.base.errors import ArgumentError
from deadtime.feedback import Law
from deadtime.laws import StateDependentPredictor
from deadtime.numerics.polynomials import gauss
from deadtime.plant import SwitchedSystem
from deadtime.simulation.digital import RunOutcome
from deadtime.simulation.ideal.ideal_run import NODES, IdealRecord
from deadtime.simulation.ideal.rule_parts import RulePart, Sent, no_loop, outcome_of, with_edge
from deadtime.simulation.ideal.segments import Piecewise, side_by_side
from deadtime.simulation.initial_input import InitialInput, input_function
from deadtime.simulation.loop_arrays import LIMIT
from deadtime.switching import Rule
from deadtime.switching.rules.motion import Beside, Leg, Motion, Move

_PIECE = 1.0  # longest, times the fastest rate; half of it where polynomials are read again
_LINE = 4.0  # longest piece of the inputs before time 0, likewise
_STRETCH = 4.0  # w_k = v⁽ᵏ⁾ (length/4)ᵏ, so that none is large
_NEAR = 1e-13  # of the time: instants that are closer are one
_MOST_TURNS = 20  # of the mode, at one instant
MOST_PIECES = 100_000
_ROUGH = 4  # nodes for the inputs of modes that are not in force
_SHORTEST = 40  # halvings of the longest piece
_FINEST = 64  # parts of the longest piece: no shorter for modes that are not in force


class _Known(NamedTuple):
    """A known part of input j, read `delay` seconds late; `size` is its number of states w."""

    j: int
    delay: float
    size: int


class _Readings(NamedTuple):
    """The readings of a piece.

    anew : (modes, m), whether a mode reads an input for the first time
    reader : (m,), the mode in force that does, −1 for none
    """

    anew: np.ndarray
    reader: np.ndarray


def run_ideal_rule(
    plant: SwitchedSystem,
    law: Law,
    rule: Rule,
    x0: Float[np.ndarray, " n"],
    horizon: float,
    u0: InitialInput,
) -> RunOutcome:
    """Solve the loop on [0, horizon]."""
    gains = _exact_gains(plant, law, rule)
    rate = _rate(np.abs(plant.A) + np.abs(plant.B) @ np.abs(gains))
    alike = plant.modes_share_delays
    longest = (_PIECE if alike else _PIECE / 2.0) / rate
    if horizon + plant.longest_delay > longest * MOST_PIECES:
        raise ArgumentError(
            f"horizon = {horizon:g} s is too long for the ideal loop, more than "
            f"{MOST_PIECES:.0e} pieces of {longest:.1e} s: shorten it, or give a step."
        )
    line = _line(plant, u0, rate)
    march = _RuleMarch(plant, gains, rule, x0, horizon, line, longest)
    while not march.stop and min(each.newest for each in march.sent) < horizon:
        march.read()
        march.advance()
    end = min(horizon, min(each.newest for each in march.sent))
    if march.stop and (not march.parts or end <= 0.0):
        raise no_loop(march.stop, plant.longest_delay)
    states = Piecewise(np.array(march.edges), np.array(march.states))
    inputs = side_by_side([each.until(end) for each in march.sent])
    record = IdealRecord(plant, with_edge(states, end), inputs)
    return outcome_of(record, march.parts, end, march.stop)


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
    """The inputs before time 0, over equal pieces, oldest first."""
    if callable(u0):
        raise ArgumentError(
            "u0 must be None, a number, (m,) or held samples (m, N), oldest first, where the ideal "
            "loop runs under a rule: sample the function, as many times as you like."
        )
    longest = plant.longest_delay
    history = input_function(u0, plant.inputs, longest)
    held = max(history.jumps.size, 1)
    middles = -longest * (np.arange(held, 0, -1) - 0.5) / held
    each = math.ceil(longest * rate / held / _LINE)
    return np.repeat(history.function(middles), max(each, 1), axis=0)


class _RuleMarch:
    """An ideal run under a rule up to t: x there, its place, the inputs sent, and the record."""

    def __init__(
        self,
        plant: SwitchedSystem,
        gains: np.ndarray,
        rule: Rule,
        x0: np.ndarray,
        horizon: float,
        line: np.ndarray,
        longest: float,
    ) -> None:
        self.plant, self.gains, self.rule = plant, gains, rule
        self.horizon, self.longest = horizon, longest
        self.t, self.x, self.stop = 0.0, x0.copy(), ""
        self.edges, self.states, self.parts = [0.0], [], []
        self.sent = [Sent.before(each, plant.longest_delay) for each in line.T]
        self._motions: dict[tuple, Motion] = {}
        self._places = rule.motion(plant, (longest,))
        self._turns, self._reader = 0, np.full(plant.inputs, -1)
        self._unit = _units_of_inputs(plant, longest)
        self._go(self._places.place_of(x0), None)

    def _go(self, place: int, beside: Beside | None) -> None:
        """Continue from t in a place; the inputs sent are not smooth there."""
        here = [place] if beside is None else [place, beside.place]
        self.place, self.beside, self._order = place, beside, 1
        self._modes = [self._places.mode_of(each) for each in here]

    @property
    def _near(self) -> float:
        return _NEAR * (1.0 + self.t)

    def read(self) -> None:
        """Let the modes in force read overdue inputs, which are K x(t)."""
        for i in self._modes:
            for j, sent in enumerate(self.sent):
                until = self.t - self.plant.delays[i, j]
                if until > sent.newest + self._near:
                    sent.bend(0)
                    value = float(self.gains[i, j] @ self.x)
                    sent.send(until, np.full(NODES + 2, value), held=True)
                    self._reader[j] = -1

    def _readings(self) -> _Readings:
        """The readings from t on, while the mode does not change."""
        delays = self.plant.delays
        newest = np.array([sent.newest for sent in self.sent]) - self._near
        first = delays[self._modes].argmin(axis=0)
        shortest = delays[self._modes].min(axis=0)
        moves = self.t - shortest >= newest
        anew = np.where(moves, delays <= shortest + self._near, self.t - delays >= newest)
        return _Readings(anew, np.where(moves, np.array(self._modes)[first], -1))

    def _until(self, readings: _Readings) -> tuple[float, int | None]:
        """The latest end of the piece from t on, and the derivative of x that jumps there."""
        cuts: list[tuple[float, int | None]] = [(self.t + self.longest, None), (self.horizon, None)]
        for j, sent in enumerate(self.sent):
            i = readings.reader[j]
            if i >= 0:
                cuts.append((self.horizon + self.plant.delays[i, j], None))
            here = self._delays_of_known(readings, j, self._modes)
            for delay in self._delays_of_known(readings, j, list(range(self.plant.modes))):
                cut = sent.newest + delay
                if delay in here:
                    cuts.append((cut, None if i >= 0 else 1))
                else:
                    # A mode that is not in force decides at boundaries only: no finer piece for it.
                    cuts.append((max(cut, self.t + self.longest / _FINEST), None))
            for delay in here:
                cuts += [(time + delay, order + 1) for time, order in sent.bends]
        ahead = [cut for cut in cuts if cut[0] > self.t + self._near]
        end = min(time for time, _ in ahead)
        orders = [order for time, order in ahead if time <= end + self._near and order is not None]
        return end, min(orders, default=None)

    def advance(self) -> None:
        """Move over one piece, or up to where the mode changes."""
        if len(self.parts) > MOST_PIECES:
            raise ArgumentError(
                "step must be given: the ideal loop under this rule takes more than "
                f"{MOST_PIECES} pieces: shorten the horizon, make delays that hardly differ equal, "
                "or give a step."
            )
        readings = self._readings()
        end, order = self._until(readings)
        known = self._known(readings, end)
        length = self.longest
        # Halvings of one length, so that motions, which are dear to build, are met again.
        while length * 0.5 >= end - self.t and length > self.longest * 0.5**_SHORTEST:
            length *= 0.5
        motion = self._motion(readings, known, length)
        z = np.concatenate([self.x, *(self._derivatives(each, end, length) for each in known)])
        move = motion.advance(0, z, self.place, np.zeros(self.plant.inputs), self.beside)
        self._take(motion, move, readings, end, order)

    def _delays_of_known(self, readings: _Readings, j: int, modes: list[int]) -> list[float]:
        """The delays with which some modes read known parts of input j, seconds."""
        own = self.plant.delays[modes, j]
        return np.unique(own[~readings.anew[modes, j]]).tolist()

    def _known(self, readings: _Readings, end: float) -> list[_Known]:
        """The known inputs that modes read up to `end`.

        Readings of modes that are not in force only decide to which side of a boundary those modes
        lead: a new piece begins when they are in force. Inputs after the newest known instant have
        its value.
        """
        known = []
        for j, sent in enumerate(self.sent):
            here = self._delays_of_known(readings, j, self._modes)
            for delay in self._delays_of_known(readings, j, list(range(self.plant.modes))):
                # A little less than half, as other pieces begin at the ends.
                middle, half = 0.5 * (self.t + end) - delay, 0.49 * (end - self.t)
                held = sent.is_held(middle - half, middle + half)
                known.append(_Known(j, delay, 1 if held else NODES if delay in here else _ROUGH))
        return known

    def _derivatives(self, known: _Known, end: float, length: float) -> np.ndarray:
        """The states w of a known input, at t."""
        points, size = gauss(known.size).points, end - self.t
        sent, times = self.sent[known.j], self.t + size * points - known.delay
        values = sent.at(np.minimum(times, sent.newest)) / self._unit[known.j]
        order = np.arange(known.size)
        terms = np.linalg.solve(points[:, None] ** order, values)
        factorials = np.array([math.factorial(k) for k in order.tolist()], dtype=float)
        # From powers of a share of the piece to the units in which `_motion` chains the w.
        return terms * factorials * (length / size / _STRETCH) ** order

    def _motion(self, readings: _Readings, known: list[_Known], length: float) -> Motion:
        """The motion of the plant with the known inputs as further states.

        A of a mode:
            x    A + Σ_anew b K |  b_j in the first column of each chain that the mode reads
            w        0          |  shifts, 4 / length above the diagonal of each chain
        """
        key = readings.anew.tobytes(), tuple(known), length
        if key not in self._motions:
            (modes, n, m), extra = self.plant.B.shape, sum(each.size for each in known)
            A, B = np.zeros((modes, n + extra, n + extra)), np.zeros((modes, n + extra, m))
            own = self.plant.B * readings.anew[:, None]
            A[:, :n, :n], B[:, :n] = self.plant.A + own @ self.gains, self.plant.B
            at = n
            for j, delay, size in known:
                reads = ~readings.anew[:, j] & (self.plant.delays[:, j] == delay)
                A[reads, :n, at] = self.plant.B[reads, :, j] * self._unit[j]
                chain = np.arange(at, at + size - 1)
                A[:, chain, chain + 1] = _STRETCH / length
                at += size
            self._motions[key] = self.rule.motion(self.plant.like(A, B), (length,), extra)
        return self._motions[key]

    def _take(
        self, motion: Motion, move: Move, readings: _Readings, end: float, order: int | None
    ) -> None:
        """Take the first leg of a move, up to `end`."""
        n, most = self.x.size, end - self.t
        now = max(k for k, leg in enumerate(move.legs) if leg.time <= 0.1 * self._near)
        leg, after = move.legs[now], move.legs[now + 1 : now + 2]
        beyond = None if leg.beside is None else leg.beside.place
        before = None if self.beside is None else self.beside.place
        if (leg.place, beyond) != (self.place, before):
            # The mode changes at t itself.
            self._turns += 1
            self.x = leg.x[:n].copy()
            self._go(leg.place, leg.beside)
            if self._turns > _MOST_TURNS:
                self.stop = f"chattering at t = {self.t:.12g} s: modes change without end"
            return
        self._turns = 0
        crosses = bool(after) and after[0].time <= most
        lasts = after[0].time if crosses else most
        if move.chatter is not None and move.chatter.time <= lasts:
            lasts, crosses = move.chatter.time, False
            self.stop = f"chattering at t = {self.t + lasts:.12g} s: {move.chatter.reason}"
        if lasts > 0.0:
            self._keep(motion, leg, readings, self.t + lasts if crosses or self.stop else end)
        if crosses:
            self.x = after[0].x[:n].copy()
            self._go(after[0].place, after[0].beside)
        else:
            self._order = order
            place = self._places.place_of(self.x)
            if self.beside is None and self._places.mode_of(place) == self._modes[0]:
                self.place = place

    def _keep(self, motion: Motion, leg: Leg, readings: _Readings, end: float) -> None:
        """Record x from t to `end`, and the inputs that this part reads for the first time."""
        n, support, none = self.x.size, gauss(NODES).support, np.zeros(self.plant.inputs)
        times = (end - self.t) * support
        x = np.array([motion.along(leg, none, time)[:n] for time in times.tolist()])
        self.parts.append(RulePart(self.t, end, motion, leg, none))
        self.edges.append(end)
        self.states.append(x)
        for j, (sent, i) in enumerate(zip(self.sent, readings.reader.tolist(), strict=True)):
            if i >= 0:
                sent.bend(0 if i != self._reader[j] else self._order)
                sent.send(end - self.plant.delays[i, j], x @ self.gains[i, j])
        self._reader = readings.reader
        self.t, self.x = end, x[-1].copy()
        if not np.abs(x[-1]).max() <= LIMIT:
            self.stop = f"diverged: |x| leaves 1e100 before t = {end:g} s"


def _units_of_inputs(plant: SwitchedSystem, time: float) -> Float[np.ndarray, " m"]:
    """Powers of two by which inputs, within a time, change states by about the states' units."""
    from deadtime.numerics.exponential import balance

    units = balance(np.abs(plant.A).sum(axis=0))
    moved = time * np.abs(plant.B / units[:, None]).max(axis=(0, 1))
    return 2.0 ** np.rint(-np.log2(np.where(moved > 0.0, moved, 1.0)))
