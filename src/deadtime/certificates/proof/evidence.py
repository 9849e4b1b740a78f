"""The evidence for a certificate: numbers, exact as stored, that are enough to check the proof.

The loop. ξ_k = (x_k, w_k, u_{k−1}, …, u_{k−W}) of order d = n + q + W m, where w is the law's own
state (q = 0 if it has none):

    ξ:  | x (n) | w (q) | u_{k−1} (m) | u_{k−2} (m) | … | u_{k−W} (m) |

A period under the rows c of the table and the plant's rows E is

    (w⁺, u_k) = row_c ξ,    x⁺ = E y,    y = (x, the inputs read),    the rest of ξ is shifted.

With a centre E₀, row₀ this is one linear system with a small feedback Δ around it,

    ξ⁺ = M₀ ξ + B w,    v = C ξ + D w,    v = (y, r, ψ),  r = R ξ,  ψ = Ψ ξ,
    w = (w_x, w_u),    w_x = (E − E₀) y,    w_u = (row_c − row₀) ξ = T_c (y, r):    w = Δ v,

(no w_u if all rows are equal; y depends on w_u if u_k itself reaches the plant in the period).

The Lyapunov function is V_{i,a}(ξ) = ξᵀ(P + Ψᵀ S_{i,a} Ψ) ξ, S linear in the age a between
knots. If ψ⁺ = F (v, w) and

    K = [P 0; 0 0] − [M₀ B]ᵀ P [M₀ B]/ρ² − [C D; 0 I]ᵀ Π [C D; 0 I] ≻ 0,
    [I; Δ]ᵀ (Π + [S_{i,a} 0; 0 0]_ψ − Fᵀ S_{j,b} F/ρ²) [I; Δ] ≻ 0 for every step (i, a) → (j, b),

then their sum gives V_{j,b}(ξ⁺) < ρ² V_{i,a}(ξ) along every admissible signal. One large inequality
of order d + w thus serves all modes, ages, rows and instants; each of these costs a small one only.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from deadtime.base.frozen import Frozen
from deadtime.certificates.proof.box import Box
from deadtime.certificates.proof.delays import Delays
from deadtime.certificates.proof.family import Family
from deadtime.certificates.proof.transitions import SwitchGraph, interpolation, least_periods
from deadtime.plant.plant_set import PlantSet
from deadtime.switching import SignalClass
from deadtime.switching.constraint import SwitchingConstraint

if TYPE_CHECKING:
    from deadtime.feedback.table import Context


@dataclass(frozen=True, eq=False)
class Setting(Frozen):
    """The loop of a certificate: plants, table and signals (immutable).

    Attributes
    ----------
    plants : PlantSet
    delays : Delays
    F : (rows, o, n), G : (rows, taps, o, o)
        The law's table, with outputs o = q + m: its own state, then the inputs.
    context, ages, step
        As in `Feedback`.
    signals : SignalClass
        The admissible signals. Their `mode_lag` is 0 where no row depends on the mode, or there is
        one mode. With `lost_samples` of 1 or more, the table has the rows of lost samples, equally
        many, after those of measured samples.
    memory : int
        q: the first q outputs of the table are the law's own state, which it reads one period
        later; G reads them at its first tap only.

    With a table of zeros no input acts: then m = 0, and B and the delay have no effect.
    """

    plants: PlantSet
    delays: Delays
    F: Float[np.ndarray, "row o n"]
    G: Float[np.ndarray, "row tap o o"]
    context: Context
    ages: int
    step: float
    signals: SignalClass
    memory: int = 0

    @cached_property
    def family(self) -> Family | Box:
        """The steps of the plant."""
        # Without inputs any delay will do; a whole period has the fewest parts, one.
        delays = self.delays if self.inputs else Delays(np.array([self.step, self.step]))
        return delays.family(self.plants.with_inputs(self.inputs), self.step)

    @cached_property
    def transitions(self) -> SwitchGraph:
        """The graph of the admissible signals."""
        return SwitchGraph.of(self.modes, self.signals, self.step, self.context, self.ages)

    @cached_property
    def limits(self) -> SwitchingConstraint:
        """The sojourns and the switches of the signals."""
        return self.signals.limits(self.modes)

    @cached_property
    def periods_per_switch(self) -> Fraction | None:
        """r of an average dwell time: k periods have N₀ + k/r switches at most; else None."""
        if self.transitions.bucket is None:
            return None
        tolerance = self.signals.clock_tolerance
        return least_periods(self.limits.dwell_time[0], self.step, tolerance)

    @property
    def modes(self) -> int:
        """How many."""
        return self.plants.sizes[0]

    @property
    def states(self) -> int:
        """n."""
        return self.plants.sizes[1]

    @cached_property
    def inputs(self) -> int:
        """m; 0 where the table is all zero."""
        return self.plants.sizes[2] if np.any(self.F) or np.any(self.G) else 0

    @property
    def outputs(self) -> int:
        """o = q + m."""
        return self.memory + self.inputs

    @property
    def past(self) -> int:
        """W, the past inputs in ξ."""
        return max(self.family.count, self.G.shape[1] if self.inputs else 0)

    @property
    def order(self) -> int:
        """d = n + q + W m."""
        return self.states + self.memory + self.past * self.inputs

    @cached_property
    def rows(self) -> Float[np.ndarray, "row o order"]:
        """row_c; every entry is an entry of the table.

        Columns: | F | G tap 1, own state | G tap 1, inputs | G tap 2, inputs | … | 0 |
        """
        count, m, q, taps = len(self.F), self.inputs, self.memory, self.G.shape[1]
        result = np.zeros((count, self.outputs, self.order))
        if m:
            stacked = self.G[:, :, :, q:].transpose(0, 2, 1, 3).reshape(count, q + m, taps * m)
            parts = (self.F, self.G[:, 0, :, :q], stacked)
            result[:, :, : self.states + q + taps * m] = np.concatenate(parts, axis=2)
        return result

    def period(
        self, row: Float[np.ndarray, "o order"]
    ) -> tuple[Float[np.ndarray, "k order"], Float[np.ndarray, "rest order"]]:
        """(seen, rest) of a period under a row: ξ⁺ = [E seen; rest] ξ, for any plant rows E.

        x⁺                     = E y,  y = seen ξ
        w⁺, u_k                | row                       |
        u_{k−1} … u_{k−W+1}    | ones: the inputs shifted  |
        """
        unit = np.eye(self.order)
        places = [(lag, self.input_at(lag, j)) for lag, j in self.family.reads]
        read = [(unit if lag else row)[[at]] for lag, at in places]
        shifted = unit[self.states + self.memory : self.order - self.inputs]
        return np.concatenate((unit[: self.states], *read)), np.concatenate((row, shifted))

    def input_at(self, lag: int, channel: int) -> int:
        """Index of u_{k−lag} of an input in ξ; for lag 0, not in ξ, its index among the outputs."""
        if not lag:
            return self.memory + channel
        return self.states + self.memory + (lag - 1) * self.inputs + channel

    @cached_property
    def rows_differ(self) -> bool:
        """Whether the rows are not all equal, so that w_u exists."""
        return bool(np.any(self.F[0] != self.F) or np.any(self.G[0] != self.G))

    @property
    def numbers(self) -> int:
        """Number of entries of the table, and of the set of plants besides its vertices."""
        return sum(X.size for X in (self.F, self.G, *self.plants.arrays.values()))


@dataclass(frozen=True, eq=False)
class Centre(Frozen):
    """The system around which the loop is written (immutable); any numbers make a valid centre.

    Attributes
    ----------
    E : (n, k)
        E₀.
    row : (o, d)
        row₀.
    R : (r, d), T : (rows, o, y + r)
        (row_c − row₀) ξ = T_c (y, r) up to a residual that the check bounds.
    Psi : (s, d)
        Ψ.
    F : (s, v + w)
        The filter ψ⁺ = F (v, w), up to a residual that the check bounds.
    """

    E: Float[np.ndarray, "n k"]
    row: Float[np.ndarray, "o order"]
    R: Float[np.ndarray, "r order"]
    T: Float[np.ndarray, "row o yr"]
    Psi: Float[np.ndarray, "s order"]
    F: Float[np.ndarray, "s vw"]


@dataclass(frozen=True, eq=False)
class Evidence(Frozen):
    """A certificate's numbers (immutable): the setting, the centre, and P, Π, S, ρ.

    Attributes
    ----------
    P : (d, d)
    Pi : (v + w, v + w)
    S : (places, knots, s, s)
        The modes in turn; then, where samples may be lost, the modes after one lost sample, ….
    knots : tuple of int
        Ages of S, ascending from 0.
    rho : float
        ρ, the decay over a period.
    """

    setting: Setting
    centre: Centre
    P: Float[np.ndarray, "order order"]
    Pi: Float[np.ndarray, "vw vw"]
    S: Float[np.ndarray, "place knot s s"]
    knots: tuple[int, ...]
    rho: float

    @property
    def numbers(self) -> int:
        """Number of entries, without those of the centre but Ψ: the measure of allowed work."""
        return self.setting.numbers + sum(X.size for X in (self.P, self.S, self.centre.Psi))

    def lyapunov(self, mode: int, age: int, lost: int = 0) -> Float[np.ndarray, "order order"]:
        """V_{mode,age} after some lost samples, in floats; constant past the last age."""
        place = self.setting.transitions.place(mode, lost)
        Psi = self.centre.Psi
        weights = interpolation(self.knots, age)
        S = sum(float(weight) * self.S[place, knot] for knot, weight in weights)
        return self.P + Psi.T @ S @ Psi


@dataclass(frozen=True, eq=False)
class Channels:
    """Matrices of the loop in floats, every entry exact but those of E₀ D.

    C (v, d), D (v, w), and [M₀ B]'s first n + o rows as a product: top = left · right.

    top ζ = (x⁺, the law's outputs) of ζ = (ξ, w). All entries of `left` and `right` are entries of
    the centre, ones and zeros, so the product can be formed in balls without a rounded factor.
    """

    C: Float[np.ndarray, "v order"]
    D: Float[np.ndarray, "v w"]
    left: Float[np.ndarray, "top inner"]
    right: Float[np.ndarray, "inner dw"]

    @classmethod
    def of(cls, setting: Setting, centre: Centre) -> Channels:
        """The channels of a centre."""
        n, o, d = setting.states, setting.outputs, setting.order
        reads = setting.family.reads
        w = n + o * setting.rows_differ
        k = n + len(reads)
        C, D = np.zeros((k, d)), np.zeros((k, w))
        C[:n, :n] = np.eye(n)
        for place, (lag, j) in enumerate(reads, n):
            at = setting.input_at(lag, j)
            if lag:
                C[place, at] = 1.0
            else:  # u_k itself is read: row₀ ξ + w_u, so v depends on w
                C[place] = centre.row[at]
                D[place, n:] = np.eye(o)[at, : w - n]
        # (x⁺, (w⁺, u)) = [E₀ I 0; 0 0 I] (y, w_x, row₀ ξ + w_u), and the right factor is
        #
        #              ξ       w_x   w_u
        #     y     [  C           D     ]
        #     w_x   [  0        I     0  ]
        #     out   [ row₀      0     I  ]
        left, right = np.zeros((n + o, k + n + o)), np.zeros((k + n + o, d + w))
        left[:n, :k], left[:n, k : k + n], left[n:, k + n :] = centre.E, np.eye(n), np.eye(o)
        right[:k, :d], right[:k, d:] = C, D
        right[k : k + n, d : d + n] = np.eye(n)
        right[k + n :, :d] = centre.row
        right[k + n :, d + n :] = np.eye(o)[:, : w - n]
        more = np.concatenate((C, centre.R, centre.Psi))
        return cls(more, np.concatenate((D, np.zeros((len(more) - k, w)))), left, right)

    @property
    def wide(self) -> Float[np.ndarray, "vw dw"]:
        """Y = [C D; 0 I], from ζ to (v, w)."""
        w = self.D.shape[1]
        bottom = np.concatenate((np.zeros((w, self.C.shape[1])), np.eye(w)), axis=1)
        return np.concatenate((np.concatenate((self.C, self.D), axis=1), bottom))

    def shift(self, m: int) -> Float[np.ndarray, "order dw"]:
        """[M₀ B]."""
        d = self.C.shape[1]
        top = self.left @ self.right
        result = np.zeros((d, top.shape[1]))
        result[: len(top)] = top
        keep = d - len(top)
        n = len(top) - m
        result[len(top) :, n : n + keep] = np.eye(keep)
        return result
