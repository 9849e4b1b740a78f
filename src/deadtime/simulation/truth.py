"""The plant of a run that goes step by step: along a known signal, or switched by its state."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from deadtime.base.checks import read_only
from deadtime.base.errors import ArgumentError
from deadtime.plant import SampledPlant
from deadtime.plant.discretisation import TOLERANCE, Cuts, snap
from deadtime.plant.pieces import PieceTable, up_to
from deadtime.plant.sampled_plant import EveryReading
from deadtime.simulation.digital import Drawn
from deadtime.simulation.digital_record import SlidePart, Slides
from deadtime.simulation.forcing import Forcing
from deadtime.switching import Rule, SwitchingSignal
from deadtime.switching.grid import cuts_of, modes_at
from deadtime.switching.rules.motion import Beside, Chatter, Leg

_SAME = 1e-10  # of a step: switches that close are one
_FAR = 1e200  # a diverged run is only moved on, whatever the rule says


Acting = Callable[[int, np.ndarray], np.ndarray]  # the inputs that act in period k with these lags


class Truth(ABC):
    """The plant of a run, moved piece by piece.

    Attributes
    ----------
    mode : int
        σ(t_k), once the first piece of period k is run.
    chatter : Chatter or None
        When the plant began to chatter; from there on its mode is held.
    slides : Slides or None
        The periods in which the plant slid along a boundary.
    through : (modes, n, f) or None
        How disturbances act on dx/dt in every mode.
    """

    mode: int
    chatter: Chatter | None = None
    slides: Slides | None = None
    through: np.ndarray | None = None

    @abstractmethod
    def lags(self, k: int) -> list[np.ndarray]:
        """The lags of the inputs that act in the pieces of period k, in order: (m,), or those of
        all modes side by side where the mode is not known beforehand.
        """

    @abstractmethod
    def move(self, k: int, piece: int, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """x at the end of a piece of period k, from x at its start."""

    @abstractmethod
    def within(self, k: int, offset: float, path: list[np.ndarray], acting: Acting) -> np.ndarray:
        """x at t_k + offset, 0 < offset < h; `path` is x at the start of every piece so far."""

    @abstractmethod
    def along(
        self, table: PieceTable, path: np.ndarray
    ) -> tuple[Float[np.ndarray, "start n"], Float[np.ndarray, "piece f"] | None]:
        """x at the start of every piece of a table, from x at the start of those moved over, and
        the force that disturbances hold over each.
        """

    @abstractmethod
    def signal(self, end: float) -> SwitchingSignal:
        """The plant's switching signal, known up to `end`."""

    @abstractmethod
    def cuts(self) -> Cuts:
        """Its switches, on the grid of the steps."""


class KnownTruth(Truth):
    """A plant along a given signal."""

    def __init__(
        self, sampled: SampledPlant, signal: SwitchingSignal, steps: int, disturbances: Drawn
    ) -> None:
        self._plant, self._signal = sampled.plant, signal
        self._cuts = cuts_of(signal, sampled)
        self._table = sampled.along(self._cuts, steps)
        self._modes = modes_at(signal, np.arange(steps) * sampled.step, sampled.step)
        self._shift = np.zeros((self._table.entry.size, sampled.plant.states))
        self._forces: np.ndarray | None = None
        if disturbances:
            forcing = Forcing(sampled, steps, disturbances)
            self._shift, self._forces = forcing.along(self._table, self._cuts)
            self.through = forcing.through

    def lags(self, k: int) -> list[np.ndarray]:
        first, stop = self._table.first[k : k + 2]
        return list(self._table.lag[self._table.entry[first:stop]])

    def move(self, k: int, piece: int, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        self.mode = int(self._modes[k])
        q = self._table.first[k] + piece
        entry = self._table.entry[q]
        return self._table.Phi[entry] @ x + self._table.Gamma[entry] @ u + self._shift[q]

    def within(self, k: int, offset: float, path: list[np.ndarray], acting: Acting) -> np.ndarray:
        A, B, table, cuts = self._plant.A, self._plant.B, self._table, self._cuts
        entries = table.entry[table.first[k] : table.first[k + 1]]
        piece = int(np.searchsorted(table.start[entries], offset, "right")) - 1
        q, entry = table.first[k] + piece, entries[piece]
        u = acting(k, table.lag[entry])
        if self._forces is not None and self.through is not None:
            u = np.concatenate((u, self._forces[q]))
            B = read_only(np.concatenate((B, self.through), axis=2))
        Phi, Gamma = up_to(A, B, table, cuts.offset, cuts.mode, entry, offset)
        return Phi @ path[q] + Gamma @ u

    def along(self, table: PieceTable, path: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        return path, self._forces

    def signal(self, end: float) -> SwitchingSignal:
        return self._signal

    def cuts(self) -> Cuts:
        return self._cuts


class RuleTruth(Truth):
    """A plant that switches by a rule.

    It is moved over the stretches of a period, which are the same time in all modes, under what
    every mode reads: a switch to a mode of other delays cuts a stretch into pieces afterwards.
    """

    def __init__(
        self,
        sampled: SampledPlant,
        rule: Rule,
        x0: np.ndarray,
        steps: int,
        disturbances: Drawn,
    ) -> None:
        every, self._forcing = EveryReading.of(sampled), None
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
            # A switch within 1e-9 h after a sample counts as at it.
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
        """Keep the parts of a period if it slides in one of them."""
        begin, stop, _ = self._stretches[piece]
        ends = [leg.time for leg in legs[1:]] + [stop - begin]
        self._parts += [
            SlidePart(begin + leg.time, begin + end, leg, u)
            for leg, end in zip(legs, ends, strict=True)
        ]
        if self.slides is not None and any(leg.beside for leg in legs):
            self.slides.steps[k] = self._parts

    def within(self, k: int, offset: float, path: list[np.ndarray], acting: Acting) -> np.ndarray:
        raise ArgumentError(
            "imperfections must measure at samples where a rule switches the plant: make the "
            f"measurement delay a multiple of the step, {self._step:g} s, without jitter."
        )

    def along(self, table: PieceTable, path: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        starts, begin = np.array([part.start for part in self._stretches]), table.start[table.entry]
        place = np.searchsorted(starts, begin, "right") - 1
        stretch = table.period * starts.size + place
        forces = None if self._forces is None else self._forces[stretch]
        pieces = int(np.searchsorted(stretch, len(path) - 1))
        states = path[np.append(stretch[:pieces], len(path) - 1)]
        for q in np.flatnonzero(begin[:pieces] != starts[place[:pieces]]):
            states[q] = self._crossings[int(table.period[q]), float(begin[q])]
        return states, forces

    def signal(self, end: float) -> SwitchingSignal:
        h = self._step
        times, modes = [0.0], self._modes[:1]
        for k, offset, mode in zip(self._steps, self._offsets, self._modes[1:], strict=True):
            time = k * h + offset
            if time - times[-1] <= _SAME * h:
                modes[-1] = mode
                if modes[-1] in modes[-2:-1]:
                    del times[-1], modes[-1]
            elif time < end:
                times.append(time)
                modes.append(mode)
        return SwitchingSignal(times, modes, end if end > times[-1] else np.inf)

    def cuts(self) -> Cuts:
        return Cuts(
            np.array(self._steps, np.int64),
            np.array(self._offsets, np.float64),
            read_only(np.array(self._modes, np.int64)),
        )
