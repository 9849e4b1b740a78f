"""The record of a digital run, which evaluates it exactly at any time.

No matrix exponential describes a period in which the plant slides along a boundary (`Slides`): such
periods are stored part by part, and integrated again to evaluate the state between samples.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, NamedTuple

import numpy as np
from jaxtyping import Float

from deadtime.base.checks import read_only
from deadtime.base.frozen import Frozen
from deadtime.numerics.polynomials import gauss
from deadtime.plant import SampledPlant, SwitchedSystem, Weight
from deadtime.plant.discretisation import TOLERANCE, Cuts, snap_all
from deadtime.plant.pieces import PieceTable, gramian_up_to, gramians
from deadtime.simulation.record_kernel import form_integral, states_at
from deadtime.switching.rules.motion import Leg, Motion

_NODES = 10  # of Gauss quadrature on a part that is shorter than 1/‖A‖
_JOINED = 1e-6  # of a step: slides that close are one


class SlidePart(NamedTuple):
    """A part of a step in one motion: seconds from the step's start, the motion, its inputs."""

    begin: float
    end: float
    leg: Leg
    u: np.ndarray


class Slide(NamedTuple):
    """One sliding motion, seconds from the run's start, between two modes."""

    begin: float
    end: float
    modes: tuple[int, int]


@dataclass(frozen=True, eq=False)
class Slides:
    """The steps that slide, by number; filled by the run."""

    motion: Motion
    steps: dict[int, list[SlidePart]]

    def state_at(self, k: int, offset: float) -> Float[np.ndarray, " n"]:
        """x at t_k + offset."""
        part = [part for part in self.steps[k] if part.begin <= offset][-1]
        return self.motion.along(part.leg, part.u, offset - part.begin)

    def form_integral(self, k: int, end: float, rate: float, Q: np.ndarray) -> float:
        """∫xᵀQx over [t_k, t_k + end] by Gauss quadrature; `rate` (1/s) is the modes' fastest."""
        nodes, total = gauss(_NODES), 0.0
        for part in self.steps[k]:
            length = min(part.end, end) - part.begin
            if length <= 0.0:
                continue
            count = int(np.ceil(max(1.0, rate * length)))
            short = length / count
            for i in range(count):
                for point, weight in zip(nodes.points, nodes.weights, strict=True):
                    x = self.motion.along(part.leg, part.u, short * (i + point))
                    total += short * weight * float(x @ Q @ x)
        return total

    def slides(self, step: float, end: float) -> list[Slide]:
        """The sliding motions that begin before `end`."""
        found = []
        for k in sorted(self.steps):
            for begin, until, leg, _ in self.steps[k]:
                if leg.beside is not None and k * step + begin < end:
                    modes = [self.motion.mode_of(p) for p in (leg.place, leg.beside.place)]
                    pair = min(modes), max(modes)
                    found.append(Slide(k * step + begin, min(k * step + until, end), pair))
        return join(found, _JOINED * step)


def join(slides: Iterable[Slide], tolerance: float) -> list[Slide]:
    """Sliding motions in order, those that continue within a tolerance joined."""
    joined: list[Slide] = []
    for slide in slides:
        last = joined[-1] if joined else None
        if last and last.modes == slide.modes and slide.begin - last.end <= tolerance:
            joined[-1] = last._replace(end=slide.end)
        else:
            joined.append(slide)
    return joined


def slides_in_words(slides: list[Slide]) -> str:
    """The sliding motions of a run in words, a sentence per pair of modes.

    Examples
    --------
    >>> slides_in_words([Slide(0.5, 0.52, (0, 1)), Slide(1.0, 1.01, (0, 1))])
    'slid along the boundary between modes 0 and 1, 2 times, for 0.03 s in all, first at t = 0.5 s.'
    """
    sentences = []
    for pair in sorted({slide.modes for slide in slides}):
        own = [slide for slide in slides if slide.modes == pair]
        total = sum(slide.end - slide.begin for slide in own)
        often = "once" if len(own) == 1 else f"{len(own)} times"
        sentences.append(
            f"slid along the boundary between modes {pair[0]} and {pair[1]}, {often}, for "
            f"{total:.4g} s in all, first at t = {own[0].begin:.6g} s."
        )
    return " ".join(sentences)


@dataclass(frozen=True, eq=False)
class DigitalRecord(Frozen):
    """One digital run: the plant, the pieces of its time, and the states and inputs on the grid.

    Attributes
    ----------
    table : PieceTable
        The pieces of the run and on, until the first input that is not known.
    path : (pieces + 1, n)
        x at the start of every piece, and at the end of the last.
    inputs : (past + samples, m)
        Held inputs; u_k is inputs[past + k], the first `past` rows are the history.
    samples : int
        Samples 0, …, samples − 1 belong to the run.
    forces : (pieces, f) or None
        What disturbances hold over each piece.
    slides : Slides or None
        The steps in which the plant slid along a boundary, if it did.
    through : (modes, n, f) or None
        How the forces act on dx/dt in every mode.
    """

    sampled: SampledPlant
    cuts: Cuts
    table: PieceTable
    path: Float[np.ndarray, "start n"]
    inputs: Float[np.ndarray, "held m"]
    past: int
    samples: int
    forces: Float[np.ndarray, "piece f"] | None = None
    slides: Slides | None = None
    through: Float[np.ndarray, "mode n f"] | None = None
    held: ClassVar[bool] = True

    @property
    def plant(self) -> SwitchedSystem:
        """The plant that was run."""
        return self.sampled.plant

    @property
    def step(self) -> float:
        """The sampling period, seconds."""
        return self.sampled.step

    @property
    def last(self) -> float:
        """Up to when x is known, seconds: on past the run's end while all inputs are."""
        table, q = self.table, self.path.shape[0] - 1
        start = table.start[table.entry[q]] if q < table.entry.size else 0.0
        return float((np.searchsorted(table.first, q, "right") - 1) * self.step + start)

    @property
    def slack(self) -> float:
        """Seconds before a switch within which a time counts as at it."""
        return TOLERANCE * self.step

    @cached_property
    def states(self) -> Float[np.ndarray, "grid n"]:
        """x(t_k), on past the run's end while inputs are in flight."""
        first = self.table.first
        return read_only(self.path[first[: np.searchsorted(first, self.path.shape[0])]])

    @cached_property
    def driving_inputs(self) -> tuple[np.ndarray, np.ndarray]:
        """B (modes, n, q) and what acts through it, u and the forces, (pieces, q)."""
        B, pieces = self.plant.B, self.path.shape[0]
        # The path may end at the start of a piece whose inputs are not all known: 0 stands there.
        sample = self.past + self.table.sample[:pieces]
        known = np.minimum(sample, self.inputs.shape[0] - 1)
        acting = np.where(sample == known, self.inputs[known, np.arange(B.shape[2])], 0.0)
        if self.forces is None or self.through is None:
            return B, read_only(acting)
        forced = read_only(np.concatenate((B, self.through), axis=2))
        return forced, read_only(np.hstack((acting, self.forces[: acting.shape[0]])))

    def grid(self, end: float) -> Float[np.ndarray, " T"]:
        """The samples, and the end of the run when that is no sample."""
        time = np.arange(self.samples) * self.step
        return time if end - time[-1] <= 1e-9 * self.step else np.append(time, end)

    def history(self, end: float) -> Float[np.ndarray, "m N"]:
        """The inputs in flight at the last sample, oldest first."""
        last = self.past + self.samples - 1
        return self.inputs[last - self.past : last].T.copy()

    def locate(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Step index and offset of each time, snapped to the samples."""
        ratio = snap_all(times / self.step)
        step = np.floor(ratio)
        offset = np.where(ratio == step, 0.0, times - step * self.step)
        return step.astype(np.int64), offset

    def states_at(self, times: np.ndarray) -> Float[np.ndarray, "time n"]:
        """x at any times from 0 to the end of the run plus the delay."""
        if self._at_samples(times):
            return self.states[: times.size]
        return self._propagate(times)

    def ahead_of(self, times: np.ndarray) -> Float[np.ndarray, "time n"]:
        """x a delay after any times from 0 to the end of the run."""
        if self._at_samples(times):
            # A delay after sample k the input u_k begins to act, so a piece starts there.
            arrivals = np.searchsorted(self.table.sample[:, 0], np.arange(times.size))
            return self.path[arrivals]
        return self._propagate(times + self.sampled.window.delay)

    def _at_samples(self, times: np.ndarray) -> bool:
        """Whether the times are the run's first samples, which are stored."""
        samples = np.arange(times.size) * self.step
        return times.size <= self.samples and np.array_equal(times, samples)

    def _propagate(self, times: np.ndarray) -> Float[np.ndarray, "time n"]:
        step, offset = self.locate(times)
        (B, acting), cuts = self.driving_inputs, self.cuts
        given = self.plant.A, B, self.table, cuts.offset, cuts.mode
        result = states_at(*given, step, offset, self.path, acting)
        if self.slides is not None:
            for i in np.flatnonzero(np.isin(step, list(self.slides.steps))):
                result[i] = self.slides.state_at(int(step[i]), float(offset[i]))
        return result

    def inputs_at(self, times: np.ndarray) -> Float[np.ndarray, "time m"]:
        """u(t), held, at any times from 0 to the end of the run."""
        step, _ = self.locate(times)
        return self.inputs[self.past + step]

    def integrals(self, end: float, weight: Weight | None = None) -> tuple[float, float]:
        """∫xᵀQx and ∫uᵀRu over [0, end], exact."""
        step, rest = (part[0] for part in self.locate(np.array([end])))
        R = None if weight is None else weight.R
        Q = self.plant.identity if weight is None else weight.Q
        states = self._whole_steps(int(step), Q)
        held = self.inputs[self.past : self.past + step]
        inputs = self.step * float(np.vdot(held, held if R is None else held @ R))
        if rest > 0.0:
            u = self.inputs[self.past + step]
            inputs += rest * float(u @ u if R is None else u @ R @ u)
            states += self._within_step(int(step), float(rest), Q)
        return states, inputs

    def _whole_steps(self, steps: int, Q: np.ndarray) -> float:
        """∫xᵀQx over the steps 0, …, steps − 1."""
        table, (B, acting) = self.table, self.driving_inputs
        if self.forces is None:
            M = self.sampled.gramians_along(self.cuts, table.first.size - 1, Q)
        else:
            M = gramians(self.plant.A, B, table, self.cuts.offset, self.cuts.mode, Q)
        pieces = int(table.first[steps])
        if self.slides is None:
            return form_integral(M, table.entry, pieces, self.path, acting)
        slid = [k for k in self.slides.steps if k < steps]
        # With z = 0 in the pieces of these steps the quadratic forms add nothing there.
        path, acting = self.path.copy(), acting.copy()
        for k in slid:
            own = slice(table.first[k], table.first[k + 1])
            path[own] = acting[own] = 0.0
        still = read_only(path), read_only(acting)
        forms = float(form_integral(M, table.entry, pieces, *still))
        return forms + sum(self.slides.form_integral(k, self.step, self._rate, Q) for k in slid)

    @property
    def _rate(self) -> float:
        """The largest row sum of |A|, 1/s."""
        return float(np.abs(self.plant.A).sum(axis=2).max())

    def _within_step(self, k: int, end: float, Q: np.ndarray) -> float:
        """∫xᵀQx over [t_k, t_k + end], end < h."""
        if self.slides is not None and k in self.slides.steps:
            return self.slides.form_integral(k, end, self._rate, Q)
        table, cuts, (B, acting) = self.table, self.cuts, self.driving_inputs
        total = 0.0
        for q in range(table.first[k], table.first[k + 1]):
            e = table.entry[q]
            if table.start[e] < end:
                until = min(end, table.stop[e])
                M = gramian_up_to(self.plant.A, B, table, cuts.offset, cuts.mode, e, until, Q)
                z = np.concatenate((self.path[q], acting[q]))
                total += float(z @ M @ z)
        return total
