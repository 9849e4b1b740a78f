"""What a design for margin hands back."""

from __future__ import annotations

from deadtime.margins.delay import DelayMargin

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from deadtime.base.frozen import Frozen
from deadtime.feedback import Law
from deadtime.plant import Weight
from deadtime.synthesis.floors import Floors
from deadtime.synthesis.initial_states import InitialStates
from deadtime.synthesis.limits import DelayLimit
from deadtime.synthesis.stationary_noise import StationaryNoise


@dataclass(frozen=True, eq=False)
class TradeOff:
    """One design: what it tolerates and what it costs (immutable).

    Attributes
    ----------
    law : Law
        The law, with its gains and filter.
    step : float
        Its sampling period, seconds.
    margin : float
        The smallest error of the delay that loses a constant mode, relative to the delay, or to
        the shortest of several; 0 where one is unstable.
    cost : float
        ∫ xᵀQx + uᵀRu with one mode held, mean over |x₀| = 1, mean or worst over the modes; ∞
        where one is unstable.
    decay_rate : float
        How fast the slowest constant mode decays at the nominal delay, 1/s; negative where one
        grows.
    input_peak : (m,) or None
        What |u_j| stays at or below in every constant mode, from the states at the start that were
        asked about (`input_peak`); ∞ where one is unstable.
    """

    law: Law
    step: float
    margin: float
    cost: float
    decay_rate: float = 0.0
    input_peak: Float[np.ndarray, " m"] | None = None

    @property
    def time_constant(self) -> Float[np.ndarray, "m m"] | None:
        """T of the low-pass filter, seconds; None without one."""
        return getattr(self.law, "time_constant", None)


@dataclass(frozen=True, eq=False)
class Design(Frozen):
    """Gains and a law that meet a request, or come nearest to it (immutable).

    Attributes
    ----------
    law : Law
        The law, which holds `gains` and the low-pass filter, if it has one.
    gains : (modes, m, n)
        K_i of u = +K_i x; with a filter, of v in T du/dt = v − u.
    time_constant : (m, m) or None
        T, seconds; None without a filter.
    step : float
        The sampling period it is made for, seconds.
    margin : DelayMargin
        The exact margin of constant modes, as by `delay_margin(plant, law, step)`.
    asked : float
        The margin asked for, relative to the delay, or to the shortest of several; 0 for none.
    decay_asked : float
        The decay rate asked for, 1/s; 0 where none was.
    reached : bool
        Whether the margin is at least that, and the spectrum at both ends says so, too; the decay
        rate at least what was asked, and the inputs at most.
    growth : (2, modes)
        The growth rates at the true delays D (1 − asked) and D (1 + asked), 1/s.
    cost : float
        ∫ xᵀQx + uᵀRu, as in `TradeOff`.
    decay_rate : float
        How fast the slowest constant mode decays at the nominal delay, 1/s, as in `TradeOff`.
    plain : TradeOff
        The design to compare with: given gains, or LQR of the cost's weights, which are best for it
        when the mode never changes and the delay is right.
    limits : tuple of DelayLimit
        Per mode, what any linear controller could reach.
    points : tuple of TradeOff
        The best of what was tried, by growing margin: no other that decays as fast as asked
        tolerates more and costs less. The chosen one is always among them.
    evaluated : int
        How many designs were tried.
    message : str
        The same in sentences.
    weight : Weight or None
        Of the cost; None for the identity.
    input_peak : (m,)
        What |u_j| stays at or below in every constant mode, for `initial`.
    input_limit : (m,) or None
        What it was asked to stay below.
    initial : InitialStates or StationaryNoise
        The states at the start, or the noise, for which it does.
    """

    law: Law
    gains: Float[np.ndarray, "mode m n"]
    time_constant: Float[np.ndarray, "m m"] | None
    step: float
    margin: DelayMargin
    asked: float
    decay_asked: float
    reached: bool
    growth: Float[np.ndarray, "end mode"]
    cost: float
    decay_rate: float
    plain: TradeOff
    limits: tuple[DelayLimit, ...]
    points: tuple[TradeOff, ...]
    evaluated: int
    message: str
    weight: Weight | None = None
    input_peak: Float[np.ndarray, " m"] | None = None
    input_limit: Float[np.ndarray, " m"] | None = None
    initial: InitialStates | StationaryNoise = field(default_factory=InitialStates.ball)

    def missed(self, point: TradeOff) -> tuple[str, ...]:
        """What it falls short of: of "margin", "decay rate", "input limit" those asked in vain."""
        floors = Floors(self.asked, self.decay_asked, self.input_limit)
        return floors.shortfalls(point.margin, point.decay_rate, floors.load(point.input_peak))

    def __repr__(self) -> str:
        return f"Design({self.message})"
