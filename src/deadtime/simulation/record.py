"""What a digital run leaves behind: enough to evaluate it exactly at any time."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.checks import read_only
from deadtime.base.frozen import Frozen
from deadtime.plant import SwitchedSystem, Weight, Window
from deadtime.plant.steps import snap_all
from deadtime.simulation.slides import Slides
from deadtime.switching.grid import Cuts


@dataclass(frozen=True, eq=False)
class PhaseTable(Frozen):
    """The transitions of the steps of a run, as `numerics.exponential.phases` returns them."""

    index: Int[np.ndarray, "step 2"]
    Phi: Float[np.ndarray, "entry n n"]
    Gamma: Float[np.ndarray, "entry n m"]
    mode: Int[np.ndarray, " entry"]
    first: Int[np.ndarray, " entry"]
    stop: Int[np.ndarray, " entry"]

    @classmethod
    def of(cls, plant: SwitchedSystem, window: Window, cuts: Cuts, total: int) -> PhaseTable:
        """The table of the steps 0, …, total − 1."""
        from deadtime.numerics.exponential import phases

        return cls(
            *phases(
                plant.A,
                plant.B,
                window.step,
                window.phase,
                cuts.step,
                cuts.offset,
                cuts.mode,
                total,
            )
        )


@dataclass(frozen=True, eq=False)
class DigitalRecord(Frozen):
    """One digital run: the plant, how its time was cut, and the states and inputs on the grid.

    Attributes
    ----------
    states : (samples + N, n)
        x(t_k), the last N of them after the run's end, moved by the inputs still in the pipe.
    at_phase : (samples + N − 1, n)
        x(t_k + φ).
    inputs : (past + samples, m)
        Held inputs; u_k is inputs[past + k], the first `past` rows are the history.
    samples : int
        Samples 0, …, samples − 1 belong to the run.
    forces : (steps, 2, n) or None
        The force that disturbances hold over each phase of each step.
    slides : Slides or None
        The steps in which the plant slid along a boundary, if it did.
    """

    plant: SwitchedSystem
    window: Window
    cuts: Cuts
    table: PhaseTable
    states: Float[np.ndarray, "grid n"]
    at_phase: Float[np.ndarray, "grid-1 n"]
    inputs: Float[np.ndarray, "held m"]
    past: int
    samples: int
    forces: Float[np.ndarray, "step 2 n"] | None = None
    slides: Slides | None = None
    held: ClassVar[bool] = True

    @cached_property
    def driven(self) -> tuple[np.ndarray, np.ndarray]:
        """B (modes, n, q) and what acts through it, u and the forces, (steps, 2, q)."""
        A, B, steps = self.plant.A, self.plant.B, self.at_phase.shape[0]
        arriving = self.past - self.window.count
        acting = np.empty((steps + 1, 2, B.shape[2]))
        # The last phase 0 is that of a run that ends between samples, a delay later.
        for f, more in ((0, 1), (1, 0)):
            first = arriving + f
            acting[: steps + more, f] = self.inputs[first : first + steps + more]
        acting[steps, 1] = 0.0
        if self.forces is None:
            return B, read_only(acting)
        unit = np.broadcast_to(np.eye(A.shape[1]), A.shape)
        forced = read_only(np.concatenate((B, unit), axis=2))
        return forced, read_only(np.dstack((acting, self.forces[: steps + 1])))

    def grid(self, end: float) -> Float[np.ndarray, " T"]:
        """The samples, and the end of the run when that is no sample."""
        time = np.arange(self.samples) * self.window.step
        return time if end - time[-1] <= 1e-9 * self.window.step else np.append(time, end)

    def history(self, end: float) -> Float[np.ndarray, "m N"]:
        """The inputs in the pipe at the last sample, oldest first."""
        last = self.past + self.samples - 1
        return self.inputs[last - self.past : last].T.copy()

    def locate(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Step index and offset of each time, snapped to the samples."""
        ratio = snap_all(times / self.window.step)
        step = np.floor(ratio)
        offset = np.where(ratio == step, 0.0, times - step * self.window.step)
        return step.astype(np.int64), offset

    def states_at(self, times: np.ndarray) -> Float[np.ndarray, "time n"]:
        """x at any times from 0 to the end of the run plus the delay."""
        if self._at_samples(times):
            return self.states[: times.size]
        return self._propagated(times)

    def ahead_of(self, times: np.ndarray) -> Float[np.ndarray, "time n"]:
        """x a delay after any times from 0 to the end of the run."""
        if self._at_samples(times):
            return self.at_phase[self.window.count - 1 :][: times.size]
        return self._propagated(times + self.window.delay)

    def _at_samples(self, times: np.ndarray) -> bool:
        """Whether the times are the run's first samples, which are stored."""
        return times.size <= self.samples and np.array_equal(
            times, np.arange(times.size) * self.window.step
        )

    def _propagated(self, times: np.ndarray) -> Float[np.ndarray, "time n"]:
        from deadtime.simulation.kernel import states_at

        step, offset = self.locate(times)
        cuts, (B, acting) = self.cuts, self.driven
        result = states_at(
            self.plant.A,
            B,
            self.window.phase,
            cuts.step,
            cuts.offset,
            cuts.mode,
            step,
            offset,
            self.states,
            acting,
        )
        if self.slides is not None:
            for i in np.flatnonzero(np.isin(step, list(self.slides.steps))):
                k = int(step[i])
                result[i] = self.slides.state_at(k, float(offset[i]), acting[k])
        return result

    def inputs_at(self, times: np.ndarray) -> Float[np.ndarray, "time m"]:
        """u(t), held, at any times from 0 to the end of the run."""
        step, _ = self.locate(times)
        return self.inputs[self.past + step]

    def integrals(self, end: float, weight: Weight | None = None) -> tuple[float, float]:
        """∫xᵀQx and ∫uᵀRu over [0, end], exact."""
        step, rest = (part[0] for part in self.locate(np.array([end])))
        Q, R = (None, None) if weight is None else (weight.Q, weight.R)
        states = self._whole_steps(int(step), Q)
        held = self.inputs[self.past : self.past + step]
        inputs = self.window.step * float(np.vdot(held, held if R is None else held @ R))
        if rest > 0.0:
            u = self.inputs[self.past + step]
            inputs += rest * float(u @ u if R is None else u @ R @ u)
            states += self._within_step(int(step), float(rest), Q)
        return states, inputs

    def _whole_steps(self, steps: int, Q: np.ndarray | None) -> float:
        """∫xᵀQx over the steps 0, …, steps − 1."""
        from deadtime.simulation.kernel import form_integral, phase_gramians

        table, window, (B, acting) = self.table, self.window, self.driven
        M = phase_gramians(
            self.plant.A,
            B,
            window.step,
            window.phase,
            self.cuts.offset,
            self.cuts.mode,
            table.mode,
            table.first,
            table.stop,
            Q,
        )
        if self.slides is None:
            return form_integral(M, table.index, steps, self.states, self.at_phase, acting)
        slid = [k for k in self.slides.steps if k < steps]
        # Nothing moves in these steps as far as the quadratic forms go.
        still = [part.copy() for part in (self.states, self.at_phase, acting)]
        for part in still:
            part[slid] = 0.0
        forms = float(form_integral(M, table.index, steps, *map(read_only, still)))
        return forms + sum(self._within_slide(k, window.step, Q) for k in slid)

    def _within_slide(self, k: int, end: float, Q: np.ndarray | None) -> float:
        """`_within_step`, of a step that slides."""
        assert self.slides is not None
        rate = float(np.abs(self.plant.A).sum(axis=2).max())
        return self.slides.form_integral(k, end, self.driven[1][k], rate, Q)

    def _within_step(self, k: int, end: float, Q: np.ndarray | None) -> float:
        """∫xᵀQx over [t_k, t_k + end], end < h."""
        from deadtime.numerics.exponential import energy_between

        if self.slides is not None and k in self.slides.steps:
            return self._within_slide(k, end, Q)
        phase, cuts, (B, acting) = self.window.phase, self.cuts, self.driven
        stop = int(np.searchsorted(cuts.step, k + 1))
        total = 0.0
        for start, a, b in ((0, 0.0, min(end, phase)), (1, phase, end)):
            if b <= a:
                continue
            first = int(np.searchsorted(cuts.step, k))
            first += int(np.sum((cuts.step == k) & (cuts.offset <= a)))
            M = energy_between(
                self.plant.A,
                B,
                cuts.mode[first],
                cuts.offset,
                cuts.mode,
                first,
                stop,
                a,
                b,
                Q,
            )
            x = self.at_phase[k] if start else self.states[k]
            z = np.concatenate((x, acting[k, start]))
            total += float(z @ M @ z)
        return total
