"""The plant of a digital run: along a known signal, or switched by its state."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from deadtime.base.checks import read_only
from deadtime.base.errors import ArgumentError
from deadtime.feedback import Law
from deadtime.feedback.table import OLDEST
from deadtime.plant import SampledPlant, SwitchedSystem
from deadtime.plant.discretisation import TOLERANCE, Cuts, snap
from deadtime.plant.pieces import PieceTable, up_to
from deadtime.plant.sampled_plant import EveryReading
from deadtime.simulation.digital_record import DigitalRecord, SlidePart, Slides
from deadtime.simulation.forcing import Drawn, Forcing
from deadtime.simulation.initial_input import InitialInput, held_samples
from deadtime.switching import Rule, SwitchingSignal
from deadtime.switching.grid import cuts_of, modes_at
from deadtime.switching.rules.motion import Beside, Chatter, Leg

_SAME = 1e-10  # of a step: switches that close are one
_FAR = 1e200  # of |x|: a diverged run is moved on in one mode, without looking for switches


@dataclass(frozen=True, eq=False)
class Grid:
    """The samples of a run: how many, the plant at its period, and the inputs, history first.

    Attributes
    ----------
    inputs : (past + samples, m)
        u_k is inputs[past + k]; filled by the run from row `past` on.
    """

    sampled: SampledPlant
    samples: int
    past: int
    inputs: np.ndarray

    @classmethod
    def of(
        cls, plant: SwitchedSystem, law: Law, horizon: float, step: float, u0: InitialInput
    ) -> Grid:
        """The grid of a run on [0, horizon], its history read from `simulate`'s u0."""
        sampled = SampledPlant.of(plant, step)
        samples = math.floor(snap(horizon / step)) + 1
        past = max(sampled.longest_lag, law.sampled_plant(step).longest_lag)
        inputs = np.zeros((past + samples, plant.inputs))
        longest = max(plant.longest_delay, law.plant.longest_delay)
        inputs[:past] = held_samples(u0, plant.inputs, past, step, longest)
        return cls(sampled, samples, past, inputs)

    @property
    def periods(self) -> int:
        """Periods over which the plant is moved: on until no input is in flight."""
        return self.samples + self.sampled.longest_lag

    def acting(self, k: int, lag: np.ndarray) -> np.ndarray:
        """The inputs that act in period k, of these lags in samples.

        Lags (m,), or those of several modes side by side (`deadtime.plant.sampled_plant`).
        """
        return self.inputs[self.past + k - lag, np.arange(lag.size) % self.inputs.shape[1]]

    def record(
        self,
        kept: int,
        cuts: Cuts,
        table: PieceTable,
        path: np.ndarray,
        forces: np.ndarray | None = None,
        slides: Slides | None = None,
        through: np.ndarray | None = None,
    ) -> DigitalRecord:
        """The record of the first `kept` samples along these pieces."""
        inputs = read_only(self.inputs[: self.past + kept])
        run = self.sampled, cuts, table, read_only(path), inputs, self.past, kept
        return DigitalRecord(*run, forces, slides, through)


class Truth(ABC):
    """The plant of a run, moved piece by piece.

    Attributes
    ----------
    grid : Grid
    age : int
        Age of its first mode at time 0, samples.
    mode : int
        σ(t_k), once the first piece of period k is run.
    chatter : Chatter or None
        The time at which the plant began to chatter; from there on its mode is held.
    slides : Slides or None
        The periods in which the plant slid along a boundary.
    through : (modes, n, f) or None
        Multiplies the forces of disturbances in dx/dt, mode by mode.
    """

    grid: Grid
    mode: int
    age: int = 0
    chatter: Chatter | None = None
    slides: Slides | None = None
    through: np.ndarray | None = None

    @abstractmethod
    def lags(self, k: int) -> list[np.ndarray]:
        """The lags of the inputs in each piece of period k: (m,), or of all modes side by side if
        the mode is not known beforehand.
        """

    @abstractmethod
    def move(self, k: int, piece: int, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """x at the end of a piece of period k, from x at its start."""

    @abstractmethod
    def within(self, k: int, offset: float, path: list[np.ndarray]) -> np.ndarray:
        """x at t_k + offset, 0 < offset < h; `path` is x at the start of every piece so far."""

    @abstractmethod
    def signal(self, end: float) -> SwitchingSignal:
        """The plant's switching signal, known up to `end`."""

    @abstractmethod
    def record(self, path: np.ndarray, kept: int) -> DigitalRecord:
        """The record of the first `kept` samples, from x at the start of every piece run."""


class KnownTruth(Truth):
    """A plant along a given signal.

    Attributes
    ----------
    switching : SwitchingSignal
    cuts, table : Cuts, PieceTable
        Its switches on the grid, and the pieces of all periods.
    modes : (periods,)
        σ(t_k).
    shift : (pieces, n), or (0, n) without disturbances
        Their effect on x over each piece.
    forces : (pieces, f) or None
        Their force over each piece, constant.
    """

    def __init__(self, grid: Grid, signal: SwitchingSignal, disturbances: Drawn = ()) -> None:
        sampled, steps, step = grid.sampled, grid.periods, grid.sampled.step
        self.grid, self.switching = grid, signal
        self.age = math.floor(snap(min(signal.initial_age / step, OLDEST)))
        self.cuts = cuts_of(signal, sampled)
        self.table = sampled.along(self.cuts, steps)
        self.modes = modes_at(signal, np.arange(steps) * step, step)
        self.shift, self.forces = np.zeros((0, sampled.plant.states)), None
        if disturbances:
            forcing = Forcing(sampled, steps, disturbances)
            self.shift, self.forces = forcing.along(self.table, self.cuts)
            self.through = forcing.through

    def lags(self, k: int) -> list[np.ndarray]:
        first, stop = self.table.first[k : k + 2]
        return list(self.table.lag[self.table.entry[first:stop]])

    def move(self, k: int, piece: int, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        self.mode = int(self.modes[k])
        q = self.table.first[k] + piece
        entry = self.table.entry[q]
        moved = self.table.Phi[entry] @ x + self.table.Gamma[entry] @ u
        return moved + self.shift[q] if self.shift.size else moved

    @property
    def driven(self) -> tuple[np.ndarray, np.ndarray]:
        """A, and B with `through` beside it."""
        plant = self.grid.sampled.plant
        if self.through is None:
            return plant.A, plant.B
        return plant.A, read_only(np.concatenate((plant.B, self.through), axis=2))

    def within(self, k: int, offset: float, path: list[np.ndarray]) -> np.ndarray:
        table, cuts = self.table, self.cuts
        entries = table.entry[table.first[k] : table.first[k + 1]]
        piece = int(np.searchsorted(table.start[entries], offset, "right")) - 1
        q, entry = table.first[k] + piece, entries[piece]
        u = self.grid.acting(k, table.lag[entry])
        if self.forces is not None:
            u = np.concatenate((u, self.forces[q]))
        Phi, Gamma = up_to(*self.driven, table, cuts.offset, cuts.mode, entry, offset)
        return Phi @ path[q] + Gamma @ u

    def signal(self, end: float) -> SwitchingSignal:
        return self.switching

    def record(self, path: np.ndarray, kept: int) -> DigitalRecord:
        own = self.cuts, self.table, path, self.forces
        return self.grid.record(kept, *own, through=self.through)


class RuleTruth(Truth):
    """A plant that switches by a rule.

    It moves over the stretches of a period, which have the same times in all modes, under the
    inputs that each mode reads: a switch to a mode of other delays cuts a stretch into pieces when
    the record is made.
    """

    def __init__(self, grid: Grid, rule: Rule, x0: np.ndarray, disturbances: Drawn = ()) -> None:
        sampled, steps = grid.sampled, grid.periods
        self.grid, every, self._forcing = grid, EveryReading.of(sampled), None
        plant, self._step, self._stretches = every.plant, sampled.step, every.stretches
        self._forces: np.ndarray | None = None
        if disturbances:
            self._forcing = Forcing(sampled, steps, disturbances)
            self.through = self._forcing.through
            size = self.through.shape[2]
            self._forces = np.zeros((steps * len(self._stretches), size))
            pushed = np.concatenate((plant.B, self.through), axis=2)
            plant = plant.like(plant.A, pushed, np.full(pushed.shape[::2], plant.longest_delay))
        lengths = tuple(part.stop - part.start for part in self._stretches)
        self._motion = rule.motion(plant, lengths)
        self._place = self._motion.place_of(x0)
        self._steps: list[int] = []
        self._offsets: list[float] = []
        self._modes = [self._motion.mode_of(self._place)]
        self._beside: Beside | None = None
        self._crossings: dict[tuple[int, float], np.ndarray] = {}
        self._parts: list[SlidePart] = []
        self.slides = Slides(self._motion, {})

    def lags(self, k: int) -> list[np.ndarray]:
        return [part.lag for part in self._stretches]

    def move(self, k: int, piece: int, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        h, begin = self._step, self._stretches[piece].start
        if piece == 0:
            self.mode, self._parts = self._modes[-1], []
        if self._forcing is not None and self._forces is not None:
            force = self._forcing.of_mode(k, piece, self._modes[-1])
            self._forces[k * len(self._stretches) + piece] = force
            u = np.concatenate((u, force))
        if self.chatter is not None or not np.abs(x).max() <= _FAR:
            return self._motion.hold(piece, x, self._place, u)
        move = self._motion.advance(piece, x, self._place, u, self._beside)
        self._keep(k, piece, move.legs, u)
        self._place, self._beside = move.place, move.beside
        for leg in move.legs:
            mode, offset = self._motion.mode_of(leg.place), begin + leg.time
            if mode == self._modes[-1]:
                continue
            self._steps.append(k if offset < h else k + 1)
            self._offsets.append(offset if offset < h else 0.0)
            self._modes.append(mode)
            self._crossings[k, offset] = leg.x
            # As in `Cuts`: within 1e-9 h after a sample a switch is at the sample.
            if piece == 0 and offset <= TOLERANCE * h:
                self.mode = mode
        if move.chatter is not None:
            # Within 1e-9 h of a sample it begins there, as `DigitalRecord.locate` has it.
            time = k * h + begin + move.chatter.time
            ratio = snap(time / h)
            time = ratio * h if ratio == np.floor(ratio) else time
            self.chatter = move.chatter._replace(time=time)
        return move.x

    def _keep(self, k: int, piece: int, legs: list[Leg], u: np.ndarray) -> None:
        """Record the parts of a period; if the plant slides in one of them, all are kept."""
        begin, stop, _ = self._stretches[piece]
        ends = [leg.time for leg in legs[1:]] + [stop - begin]
        self._parts += [
            SlidePart(begin + leg.time, begin + end, leg, u)
            for leg, end in zip(legs, ends, strict=True)
        ]
        if self.slides is not None and any(leg.beside for leg in legs):
            self.slides.steps[k] = self._parts

    def within(self, k: int, offset: float, path: list[np.ndarray]) -> np.ndarray:
        raise ArgumentError(
            "imperfections must measure at samples where a rule switches the plant: make the "
            f"measurement delay a multiple of the step, {self._step:g} s, without jitter."
        )

    def record(self, path: np.ndarray, kept: int) -> DigitalRecord:
        cuts = Cuts(
            np.array(self._steps, np.int64),
            np.array(self._offsets, np.float64),
            read_only(np.array(self._modes, np.int64)),
        )
        sampled = self.grid.sampled
        table = sampled.along(cuts, kept + sampled.longest_lag)
        starts, begin = np.array([part.start for part in self._stretches]), table.start[table.entry]
        place = np.searchsorted(starts, begin, "right") - 1
        stretch = table.period * starts.size + place
        forces = None if self._forces is None else self._forces[stretch]
        pieces = int(np.searchsorted(stretch, len(path) - 1))
        states = path[np.append(stretch[:pieces], len(path) - 1)]
        # Pieces that begin at a switch within a stretch: x there was found by the rule's motion.
        for q in np.flatnonzero(begin[:pieces] != starts[place[:pieces]]):
            states[q] = self._crossings[int(table.period[q]), float(begin[q])]
        slides = self.slides if self.slides and self.slides.steps else None
        return self.grid.record(kept, cuts, table, states, forces, slides, self.through)

    def signal(self, end: float) -> SwitchingSignal:
        h = self._step
        times, modes = [0.0], self._modes[:1]
        for k, offset, mode in zip(self._steps, self._offsets, self._modes[1:], strict=True):
            time = k * h + offset
            if time - times[-1] <= _SAME * h:
                # Two switches at one instant are one, or none where they lead back.
                modes[-1] = mode
                if modes[-1] in modes[-2:-1]:
                    del times[-1], modes[-1]
            elif time < end:
                times.append(time)
                modes.append(mode)
        return SwitchingSignal(times, modes, end if end > times[-1] else np.inf)
