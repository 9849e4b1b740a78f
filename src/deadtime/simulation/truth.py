"""The plant of a run that goes step by step: along a known signal, or switched by its state."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from deadtime.base.checks import read_only
from deadtime.base.errors import ArgumentError
from deadtime.plant import SwitchedSystem, Window
from deadtime.plant.steps import TOLERANCE, snap
from deadtime.simulation.digital import Drawn
from deadtime.simulation.forcing import Forcing
from deadtime.simulation.record import PhaseTable
from deadtime.simulation.slides import Part, Slides
from deadtime.switching import Rule, SwitchingSignal
from deadtime.switching.grid import Cuts, modes_at
from deadtime.switching.rules.motion import Beside, Chatter, Leg

_SAME = 1e-10  # of a step: switches that close are one
_FAR = 1e200  # a diverged run is only moved on, whatever the rule says


class Truth(ABC):
    """The plant of a run, moved phase by phase.

    Attributes
    ----------
    mode : int
        σ(t_k), once phase 0 of step k is run.
    chatter : Chatter or None
        When the plant began to chatter; from there on its mode is held.
    forces : (steps, 2, n) or None
        The force that disturbances hold over each phase.
    slides : Slides or None
        The steps in which the plant slid along a boundary.
    """

    mode: int
    chatter: Chatter | None = None
    forces: np.ndarray | None = None
    slides: Slides | None = None

    @abstractmethod
    def move(self, k: int, phase: int, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """x at the end of phase 0 or 1 of step k, from x at its start."""

    @abstractmethod
    def within(self, k: int, offset: float, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """x at t_k + offset, 0 < offset < h, from x(t_k) and the inputs (2, m) of both phases."""

    @abstractmethod
    def signal(self, end: float) -> SwitchingSignal:
        """The plant's switching signal, known up to `end`."""

    @abstractmethod
    def cuts(self) -> Cuts:
        """Its switches, laid on the steps."""


class KnownTruth(Truth):
    """A plant along a given signal."""

    def __init__(
        self,
        plant: SwitchedSystem,
        signal: SwitchingSignal,
        window: Window,
        steps: int,
        disturbances: Drawn,
    ) -> None:
        self._plant, self._window = plant, window
        self._signal, self._cuts = signal, Cuts.of(signal, window)
        self._table = PhaseTable.of(plant, window, self._cuts, steps)
        self._modes = modes_at(signal, np.arange(steps) * window.step, window.step)
        self._shift = np.zeros((steps, 2, plant.states))
        if disturbances:
            forcing = Forcing(plant, window, steps, disturbances)
            self._shift, self.forces = forcing.along(self._table, self._cuts)

    def move(self, k: int, phase: int, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        self.mode = int(self._modes[k])
        entry = self._table.index[k, phase]
        return self._table.Phi[entry] @ x + self._table.Gamma[entry] @ u + self._shift[k, phase]

    def within(self, k: int, offset: float, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        from deadtime.numerics.exponential import between

        A, B, cuts, phase = self._plant.A, self._plant.B, self._cuts, self._window.phase
        if self.forces is not None:
            u = np.hstack((u, self.forces[k]))
            B = read_only(np.concatenate((B, np.broadcast_to(np.eye(x.size), A.shape)), axis=2))
        p, stop = np.searchsorted(cuts.step, k), np.searchsorted(cuts.step, k + 1)
        mode = cuts.mode[p]
        for f, a, b in ((0, 0.0, min(offset, phase)), (1, phase, offset)):
            if b > a:
                Phi, Gamma, p, mode = between(A, B, mode, cuts.offset, cuts.mode, p, stop, a, b)
                x = Phi @ x + Gamma @ u[f]
        return x

    def signal(self, end: float) -> SwitchingSignal:
        return self._signal

    def cuts(self) -> Cuts:
        return self._cuts


class RuleTruth(Truth):
    """A plant that switches by a rule."""

    def __init__(
        self,
        plant: SwitchedSystem,
        rule: Rule,
        window: Window,
        x0: np.ndarray,
        steps: int,
        disturbances: Drawn,
    ) -> None:
        self._window, self._forcing = window, None
        if disturbances:
            self._forcing = Forcing(plant, window, steps, disturbances)
            self.forces = np.zeros((steps, 2, plant.states))
            unit = np.broadcast_to(np.eye(plant.states), plant.A.shape)
            plant = SwitchedSystem(plant.A, np.concatenate((plant.B, unit), axis=2), plant.delay)
        self._motion = rule.motion(plant, (window.phase, window.step - window.phase))
        self._place = self._motion.place_of(x0)
        self._steps: list[int] = []
        self._offsets: list[float] = []
        self._modes = [self._motion.mode_of(self._place)]
        self._beside: Beside | None = None
        self._parts: list[Part] = []
        self.slides = Slides(self._motion, {})

    def move(self, k: int, phase: int, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        h, begin = self._window.step, self._window.phase if phase else 0.0
        if phase == 0:
            self.mode, self._parts = self._modes[-1], []
        elif begin == h:
            return x
        if self._forcing is not None and self.forces is not None:
            self.forces[k, phase] = self._forcing.of_mode(k, phase, self._modes[-1])
            u = np.concatenate((u, self.forces[k, phase]))
        if self.chatter is not None or not np.abs(x).max() <= _FAR:
            return self._motion.hold(phase, x, self._place, u)
        move = self._motion.advance(phase, x, self._place, u, self._beside)
        self._keep(k, phase, begin, move.legs)
        self._place, self._beside = move.place, move.beside
        for leg in move.legs:
            mode, offset = self._motion.mode_of(leg.place), begin + leg.time
            if mode == self._modes[-1]:
                continue
            self._steps.append(k if offset < h else k + 1)
            self._offsets.append(offset if offset < h else 0.0)
            self._modes.append(mode)
            # A switch within 1e-9 h after a sample counts as at it.
            if phase == 0 and offset <= TOLERANCE * h:
                self.mode = mode
        if move.chatter is not None:
            # Within 1e-9 h of a sample it begins there, as `DigitalRecord.locate` has it.
            time = k * h + begin + move.chatter.time
            ratio = snap(time / h)
            time = ratio * h if ratio == np.floor(ratio) else time
            self.chatter = move.chatter._replace(time=time)
        return move.x

    def _keep(self, k: int, phase: int, begin: float, legs: list[Leg]) -> None:
        """Keep the parts of a step if it slides in one of them."""
        h = self._window.step
        ends = [leg.time for leg in legs[1:]] + [(h if phase else self._window.phase) - begin]
        self._parts += [
            Part(begin + leg.time, begin + end, phase, leg)
            for leg, end in zip(legs, ends, strict=True)
        ]
        if self.slides is not None and any(leg.beside for leg in legs):
            self.slides.steps[k] = self._parts

    def within(self, k: int, offset: float, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        raise ArgumentError(
            "imperfections must measure at samples where a rule switches the plant: make the "
            f"measurement delay a multiple of the step, {self._window.step:g} s, without jitter."
        )

    def signal(self, end: float) -> SwitchingSignal:
        h = self._window.step
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
