"""State-dependent prediction where inputs or modes have delays of their own.

What is sent at t_k is first read at θ_j = min {θ ≥ 0: θ ≥ D_i,j, i = r(x(t_k + θ))}, and exact is
u_k,j = K_i,j x(t_k + θ_j) with the i of that instant. On the way there the model is moved over the
stretches of its periods under what every mode reads (`deadtime.plant.sampled_plant`): inputs in
flight, and, from where one of them is read for the first time that is computed at t_k or later,
that one, the same feedback of x as it is predicted then, held for as long as it is read.

A mode that is entered within a stretch may be the first to read a sample. What it reads depends on
x where it is entered, and whether it leads on there depends on what it reads. So the stretch is
moved over again with that known: how x came to the boundary has not changed by it. Along a boundary
that x slides along both modes read, for the plant then switches between them without end.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.errors import ChatteringError
from deadtime.plant import SampledPlant
from deadtime.plant.discretisation import TOLERANCE
from deadtime.plant.sampled_plant import EveryReading
from deadtime.switching import Rule
from deadtime.switching.rules.motion import Beside, Motion, Move


@dataclass(frozen=True, eq=False)
class RuleForecast:
    """A model, at its period, that runs a rule forward until all inputs are read.

    Attributes
    ----------
    every : EveryReading
    gains : (modes, m, n)
    longest : int
        N: no mode reads an input that is older than N periods.
    step : float
        h, seconds.
    motion : Motion
        Over the stretches of a period, and, last, 1e-9 of it: a switch that soon after an instant
        counts as at it.
    """

    every: EveryReading
    gains: Float[np.ndarray, "mode m n"]
    longest: int
    step: float
    motion: Motion

    @classmethod
    def of(cls, sampled: SampledPlant, gains: np.ndarray, rule: Rule) -> RuleForecast:
        """The prediction of a model whose periods are cut alike in all modes."""
        every, h = EveryReading.of(sampled), sampled.step
        lengths = [part.stop - part.start for part in every.stretches]
        motion = rule.motion(every.plant, (*lengths, TOLERANCE * h))
        return cls(every, gains, sampled.longest_lag, h, motion)

    @cached_property
    def sample(self) -> Int[np.ndarray, "stretch reader m"]:
        """The samples, counted from k, that every mode reads in the stretches from t_k on.

        One row where all modes read alike.
        """
        m = self.gains.shape[1]
        lag = np.stack([part.lag.reshape(-1, m) for part in self.every.stretches])
        ahead = np.arange(self.longest + 1)[:, None, None, None] - lag
        return ahead.reshape(-1, *lag.shape[1:])

    @cached_property
    def in_flight(self) -> int:
        """How many stretches read, in any mode, what was sent before t_k only."""
        return int(np.argmax((self.sample >= 0).any(axis=(1, 2))))

    def __call__(self, x: np.ndarray, past: np.ndarray, mode: int) -> Float[np.ndarray, " m"]:
        """u_k, from x_k, the past inputs, the latest last, and the sampled mode."""
        m, stretches = past.shape[1], len(self.every.stretches)
        # | u_{k−N} … u_{k−1} | u_k … u_{k+N} |: the right part is filled as inputs are first read.
        sent = np.concatenate((past[-self.longest :], np.zeros((self.longest + 1, m))))
        way, q = _Way(self, sent, np.full(m, -1)), self.in_flight
        acting = np.stack([way.acting(p) for p in range(q)])
        arrival = self.motion.follow(np.arange(q) % stretches, acting, x, mode)
        if arrival.chatter is not None:
            raise chattering_ahead(arrival.chatter.time, arrival.chatter.reason)
        x, place, beside = arrival.x, arrival.place, arrival.beside
        while True:
            place, beside = way.begin(q, x, place, beside)
            if way.arrived:
                return sent[self.longest]
            move = way.over(q, x, place, beside)
            if way.arrived:
                return sent[self.longest]
            x, place, beside, q = move.x, move.place, move.beside, q + 1


@dataclass(eq=False)
class _Way:
    """A prediction in progress, from stretch to stretch, with the inputs known so far.

    sent : (2 N + 1, m), u_{k−N}, …, u_{k−1} and what the law will send from t_k on
    newest : (m,), the newest samples that have been read, counted from k; −1 for none of them
    """

    ahead: RuleForecast
    sent: np.ndarray
    newest: np.ndarray
    _columns: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        self._columns = np.arange(self.newest.size)

    @property
    def arrived(self) -> bool:
        """Whether u_k has been read, of every input."""
        return bool((self.newest >= 0).all())

    def acting(self, q: int) -> np.ndarray:
        """The inputs that every mode reads in stretch q; those not read before are not known."""
        return self.sent[self.ahead.longest + self.ahead.sample[q], self._columns].ravel()

    def _samples(self, q: int, mode: int) -> np.ndarray:
        return self.ahead.sample[q, mode % self.ahead.every.readers]

    def is_new(self, q: int, mode: int) -> bool:
        """Whether a mode is the first to read an input in a stretch."""
        return bool((self._samples(q, mode) > self.newest).any())

    def read(self, q: int, mode: int, x: np.ndarray) -> None:
        """Let a mode begin to read in a stretch, at x: an input that it is first to read is K x."""
        samples, u = self._samples(q, mode), self.ahead.gains[mode] @ x
        for j in np.flatnonzero(samples > self.newest):
            first = self.ahead.longest + self.newest[j] + 1
            self.sent[first : self.ahead.longest + samples[j] + 1, j] = u[j]
            self.newest[j] = samples[j]

    def begin(
        self, q: int, x: np.ndarray, place: int, beside: Beside | None
    ) -> tuple[int, Beside | None]:
        """Read what is new at the start of a stretch; where the model goes on from there.

        On a boundary that the state slides along it goes on beyond, if what is read there leads on.
        """
        motion = self.ahead.motion
        here = [place] if beside is None else [place, beside.place]
        if not any(self.is_new(q, motion.mode_of(one)) for one in here):
            return place, beside
        if beside is None:
            soon = motion.advance(len(self.ahead.every.stretches), x, place, self.acting(q - 1))
            place, beside = soon.place, soon.beside
        if beside is not None:
            # On copies: whether x crosses depends on inputs that only the other mode would read.
            there = _Way(self.ahead, self.sent.copy(), self.newest.copy())
            there.read(q, motion.mode_of(beside.place), x)
            if motion.leads_on(x, beside, there.acting(q)):
                place, beside = beside.place, None
        for one in [place] if beside is None else [place, beside.place]:
            self.read(q, motion.mode_of(one), x)
        return place, beside

    def over(self, q: int, x: np.ndarray, place: int, beside: Beside | None) -> Move:
        """Move over a stretch, or up to where all inputs are read."""
        period, kind = divmod(q, len(self.ahead.every.stretches))
        while True:
            u = self.acting(q)
            move = self.ahead.motion.advance(kind, x, place, u, beside)
            if not self._reads_on(q, move, u) or self.arrived:
                break
        if move.chatter is not None and not self.arrived:
            start = period * self.ahead.step + self.ahead.every.stretches[kind].start
            raise chattering_ahead(start + move.chatter.time, move.chatter.reason)
        return move

    def _reads_on(self, q: int, move: Move, u: np.ndarray) -> bool:
        """Read what is new where modes are first met in a stretch; whether anything was."""
        motion = self.ahead.motion
        met = [
            (leg.x, motion.mode_of(at))
            for leg in move.legs
            for at in (leg.place, *(() if leg.beside is None else (leg.beside.place,)))
        ]
        if move.chatter is not None:
            last = move.legs[-1]
            stuck = motion.along(last, u, move.chatter.time - last.time)
            met += [(stuck, mode) for mode in move.chatter.modes]
        for x, mode in met:
            if self.is_new(q, mode):
                self.read(q, mode, x)
                return True
        return False


def chattering_ahead(seconds: float, reason: str) -> ChatteringError:
    """That a prediction cannot go on so many seconds ahead, and why."""
    return ChatteringError(
        f"chattering in the prediction of StateDependentPredictor, {seconds:.6g} s ahead: {reason}."
    )
