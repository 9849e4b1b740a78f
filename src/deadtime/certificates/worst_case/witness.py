"""`WorstCase`: a switching signal, the growth of the loop along it, and a run that shows it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from deadtime.base.checks import count
from deadtime.base.frozen import Frozen
from deadtime.certificates.worst_case.cycle_growth import Growth, SampledLoop
from deadtime.certificates.worst_case.cycles import Cycle, pattern_sizes
from deadtime.certificates.worst_case.growth_proof import GrowthProof, prove
from deadtime.feedback import Law
from deadtime.imperfections import Imperfection, ModeDelay, SensorImperfection
from deadtime.imperfections.base import Sizes
from deadtime.imperfections.received import ReceivedData, Relaying
from deadtime.plant import SwitchedSystem
from deadtime.simulation import Trajectory, simulate
from deadtime.spectrum import least_growth
from deadtime.switching import SignalClass, SwitchingSignal

DELAYS = 20  # the signal is at least this long
CYCLES = 10
SLACK = 1e-9  # of a period: round-off in a sojourn
NAMED = 8  # lost samples


@dataclass(frozen=True)
class LostAt(Relaying, SensorImperfection):
    """Loses the samples of a periodic pattern.

    Parameters
    ----------
    lost : tuple of int
        The samples of a cycle that are lost.
    periods : int
        The length of the cycle.
    """

    lost: tuple[int, ...]
    periods: int

    def relay(self, received: ReceivedData, sizes: Sizes, rng: np.random.Generator) -> ReceivedData:
        each = np.arange(received.samples)
        return received.at(np.where(np.isin(each % self.periods, self.lost), -1, each))


@dataclass(frozen=True, eq=False, repr=False)
class WorstCase(Frozen):
    """The worst admissible switching signal found, and the loop's growth along it (immutable).

    Attributes
    ----------
    signal : SwitchingSignal
        From time 0, several cycles long; constant, without end, where a constant mode is worst.
    growth_rate : float
        1/s, of the loop along the signal repeated periodically, computed in floating point.
    proven : bool
        Whether growth, and so instability, is proved in ball arithmetic.
    proof : GrowthProof
        `.rate`, a proved lower bound of the growth, 1/s, or `.reason`.
    modes : tuple of int, sojourns : tuple of float
        The cycle: the modes in turn and how long each lasts, seconds; one mode and inf if constant.
        A sojourn may be below the dwell time by as much as the clock's tolerance allows.
    x0 : (n,), u0 : (m, W)
        State at time 0 and inputs before it, held samples, the oldest first, along the direction
        that grows; as `simulate` takes them. A `law` with a state begins along it, too, except for
        its sums of errors, which begin at 0. If that direction is complex, x0 and u0 are its real
        part, and :math:`|x|` oscillates about the growth.
    message : str
        The result in a sentence.
    evaluated : int
        Number of cycles evaluated, most of them on a compressed loop.
    """

    signal: SwitchingSignal
    growth_rate: float
    modes: tuple[int, ...]
    sojourns: tuple[float, ...]
    x0: Float[np.ndarray, " n"]
    u0: Float[np.ndarray, "m W"]
    message: str
    evaluated: int
    proof: GrowthProof
    plant: SwitchedSystem = field(repr=False)
    law: Law = field(repr=False)
    signals: SignalClass = field(repr=False)
    step: float = field(repr=False)
    cycle: Cycle = field(repr=False)

    @property
    def proven(self) -> bool:
        """Whether it is proved that the loop grows."""
        return self.proof.proven

    @property
    def grows(self) -> bool:
        """Whether growth is proved, and fast enough to matter (`least_growth`)."""
        return self.proven and self.growth_rate > least_growth(self.plant)

    @property
    def phase(self) -> float:
        """Time from a sample to the start of the cycle's first mode, seconds; 0 if constant."""
        return 0.0 if self.cycle.constant else self.cycle.offset * self.step

    @property
    def length(self) -> float:
        """The length of the cycle, seconds; of a constant signal, about the delay."""
        return self.cycle.periods * self.step

    @property
    def lost(self) -> tuple[int, ...]:
        """The samples of the cycle that are lost, 0 at time 0; of every `length` seconds."""
        return self.cycle.lost

    def simulate(self, cycles: int = CYCLES) -> Trajectory:
        """Run the loop along some cycles of the signal, from x0 and u0.

        If the mode is reported late, the mode at time 0 is reported first, not that of the cycle
        before it, and if the first samples are lost no mode is reported: the run then reaches the
        growth after some cycles.
        """
        horizon = count("cycles", cycles) * self.cycle.periods * self.step
        signal = self.signal
        if not self.cycle.constant:
            least = self.signals.limits(self.plant.modes).dwell_time
            signal = repeat(self.cycle, cycles, least, self.step)
        late: list[Imperfection] = []
        if self.signals.mode_lag:
            late.append(ModeDelay(self.signals.mode_lag))
        if self.lost:
            late.append(LostAt(self.lost, self.cycle.periods))
        return simulate(
            self.plant, self.law, signal, self.x0, horizon, self.step, self.u0, imperfections=late
        )

    def __repr__(self) -> str:
        return (
            f"WorstCase(growth_rate={self.growth_rate:.4g}, modes={self.modes}, "
            f"sojourns={tuple(round(s, 6) for s in self.sojourns)})"
        )


def worst_case(
    loop: SampledLoop,
    plant: SwitchedSystem,
    law: Law,
    signals: SignalClass,
    cycle: Cycle,
    growth: Growth,
    evaluated: int,
) -> WorstCase:
    """The result for the worst cycle of a table; a law's state begins along the direction, too."""
    feedback, q = loop.feedback, loop.feedback.memory
    aged = feedback.ages * loop.step if feedback.context == "mode_age" else 0.0
    x0, outputs = _direction(growth.vector, plant.states, q + plant.inputs)
    start = x0, outputs[q:]
    law = law.beginning_at(outputs[:q, -1])
    proof = prove(loop, cycle, growth.rate)
    about = plant, law, replace(signals, mode_lag=loop.lag), loop.step
    return of_cycle(*about, cycle, growth.rate, proof, start, aged, evaluated)


def of_cycle(
    plant: SwitchedSystem,
    law: Law,
    signals: SignalClass,
    step: float,
    cycle: Cycle,
    rate: float,
    proof: GrowthProof,
    start: tuple[np.ndarray, np.ndarray],
    aged: float,
    evaluated: int,
) -> WorstCase:
    """The result for a cycle, its rate, its start (x0, u0), and the age of a constant mode, s."""
    (x0, u0), dwell_time = start, signals.limits(plant.modes).dwell_time
    if cycle.constant:
        signal = SwitchingSignal([0.0], [cycle.modes[0]], initial_age=aged)
        sojourns = (math.inf,)
    else:
        number = max(CYCLES, math.ceil(DELAYS * plant.longest_delay / (cycle.periods * step)))
        signal = repeat(cycle, number, dwell_time, step)
        least = [dwell_time[mode] for mode in cycle.modes]
        missing = [low - gap * step for low, gap in zip(least, cycle.gaps, strict=True)]
        sojourns = tuple(
            low if 0.0 < t < SLACK * step else low - t
            for low, t in zip(least, missing, strict=True)
        )
    size = next(pattern_sizes(cycle.modes, sojourns, rtol=1e-9), len(sojourns))
    modes, sojourns = cycle.modes[:size], sojourns[:size]
    how = _how(modes, sojourns, cycle.offset * step, dwell_time) + _losses(cycle)
    message = _message(rate, proof, how)
    return WorstCase(
        signal, rate, modes, sojourns, x0, u0, message, evaluated, proof,
        plant, law, signals, step, cycle,
    )  # fmt: skip


def repeat(
    cycle: Cycle, cycles: int, dwell_time: tuple[float, ...], step: float
) -> SwitchingSignal:
    """The cycle over and over, no sojourn shorter than its mode's dwell time by round-off, s."""
    starts = cycle.periods * np.arange(cycles)[:, None]
    times = ((starts + cycle.instants()) * step).ravel()
    modes, age = np.tile(cycle.modes, cycles), 0.0
    if cycle.offset > 0.0:
        times, modes = np.append(0.0, times), np.append(cycle.modes[-1], modes)
        age = (cycle.gaps[-1] - cycle.offset) * step
        least = dwell_time[modes[0]]
        # Rounding of `times[1] + age` may still be below: go up until it is not.
        while 0.0 < least - (times[1] + age) < SLACK * step:
            age = float(np.nextafter(age + 1e-16 * least, np.inf))
    for i in range(1 if age == 0.0 else 2, times.size):
        least = dwell_time[modes[i - 1]]
        if 0.0 < least - (times[i] - times[i - 1]) < SLACK * step:
            times[i] = times[i - 1] + least
            while times[i] - times[i - 1] < least:
                times[i] = np.nextafter(times[i], np.inf)
    return SwitchingSignal(times, modes, cycles * cycle.periods * step, initial_age=age)


def _direction(vector: np.ndarray, n: int, m: int) -> tuple[np.ndarray, np.ndarray]:
    """x0 and u0 from a complex eigenvector, turned so that x0 is largest, |x0| = 1."""
    x = vector[:n]
    # Re(e^{iθ} x) is longest where xᵀx e^{2iθ} is real and positive.
    square = (x**2).sum()
    turned = (vector * np.exp(-0.5j * np.angle(square))).real
    size = float(np.linalg.norm(turned[:n]))
    if size <= 1e-9 * np.abs(turned).max():
        size = float(np.abs(turned).max()) or 1.0
    turned = turned / size
    x0, u0 = turned[:n].copy(), turned[n:].reshape(-1, m).T.copy()
    x0.flags.writeable = u0.flags.writeable = False
    return x0, u0


def _how(
    modes: tuple[int, ...], sojourns: tuple[float, ...], phase: float, dwell_time: tuple[float, ...]
) -> str:
    """The signal in words; a sojourn below the dwell time with enough digits to show it."""
    if len(modes) == 1:
        return f"mode {modes[0]} is constant"
    parts = [
        f"mode {i} for {s:{'.10g' if s < dwell_time[i] else '.4g'}} s"
        for i, s in zip(modes, sojourns, strict=True)
    ]
    how = ", ".join(parts[:-1]) + f" and {parts[-1]} "
    how += "alternate" if len(modes) == 2 else "follow each other"
    after = f"{phase:.3g} s after a sample" if phase > 0.0 else "at a sample"
    return f"{how}, mode {modes[0]} beginning {after}"


def _losses(cycle: Cycle) -> str:
    """Which samples are lost, in words; nothing where none is.

    Examples
    --------
    >>> _losses(Cycle((0,), (3.0,), lost=(1, 2)))
    ', and of every 3 samples, 0 the first, 1 and 2 are lost'
    """
    if not cycle.lost:
        return ""
    if len(cycle.lost) > NAMED:
        return f", and {len(cycle.lost)} of every {cycle.periods} samples are lost (`lost`)"
    *some, last = map(str, cycle.lost)
    which = f"{', '.join(some)} and {last} are" if some else f"{last} is"
    return f", and of every {cycle.periods} samples, 0 the first, {which} lost"


def _message(rate: float, proof: GrowthProof, how: str) -> str:
    if proof.proven:
        return f"The loop grows at +{rate:.3g} /s when {how}."
    if rate > 0.0:
        return (
            f"Growth of +{rate:.3g} /s was computed when {how}, but it could not be proved: "
            f"{proof.reason}."
        )
    none = "No admissible switching signal was found that grows"
    if rate == 0.0:
        return f"{none}; the loop keeps its size when {how}."
    return f"{none}; the worst decays at {-rate:.3g} /s, when {how}."
