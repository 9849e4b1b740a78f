"""The segments of an ideal run: their edges, and how short they must be."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from deadtime.base.errors import ArgumentError
from deadtime.feedback import Forecast, Functional
from deadtime.plant import SwitchedSystem
from deadtime.simulation.ideal.breakpoints import Shift, merge, pass_on, subdivide
from deadtime.simulation.initial_input import InputHistory
from deadtime.switching import SwitchingSignal
from deadtime.switching.grid import first_reads

NODES = 10
_MOST_SEGMENTS = 1e6
_MOST_WORK = 6e10  # multiplications: a minute or so
_FLOW = 60.0  # of a window's exponentials on a segment, times the cube of its order
_RESOLUTION = 1.5  # longest segment times the fastest rate


def _require_no_minutes(law: Functional, time: float, shortest: float, longest: float) -> None:
    """Refuse delays that differ by so little that windows are summed over very many segments."""
    count, windows, order = time / longest, law.near.size, law.S.shape[1]
    summed = float((law.far - law.near).sum()) / longest
    if count * (summed * order**2 + _FLOW * windows * order**3) > _MOST_WORK:
        raise ArgumentError(
            f"step must be given: delays that differ by {shortest:.3g} s take {count:,.0f} "
            f"segments of {longest:.2g} s, and minutes for the law's {windows} windows: make them "
            "equal, shorten the horizon, or give a step."
        )


def segments_of(
    plant: SwitchedSystem,
    law: Functional | Forecast,
    signal: SwitchingSignal,
    horizon: float,
    history: InputHistory,
    rereads: bool = False,
) -> tuple[Float[np.ndarray, " edge"], int]:
    """The edges of all segments, and the index of the first after time 0.

    `rereads`: predictions read again, after a switch, what they have predicted themselves.
    """
    delays, reaches = np.unique(plant.delays), law.reaches
    breaks = np.concatenate([law.breaks, *(law.breaks - reach for reach in reaches)])
    if rereads:
        apart = np.unique(reaches[:, None] - reaches)
        longer = np.concatenate([law.breaks + more for more in apart if more > 0.0])
        breaks = np.concatenate([breaks, longer, *(longer - reach for reach in reaches)])
    # x is known until the plant reads what is not sent any more.
    high = float(first_reads(signal, plant.delays, np.array([horizon]), 0.0).min())
    low = -max(reaches[-1], delays[-1])
    before = np.concatenate((history.jumps, breaks, -reaches, -delays))
    seeds = np.concatenate(([0.0], signal.times, breaks, history.jumps))
    # Short enough for the polynomials, and for delayed inputs to lie in segments already done.
    speeds = law.speeds(plant)
    shortest = min([delays[0], *reaches[reaches > 0.0].tolist()])
    longest = min(_RESOLUTION / max(speeds.fastest, np.finfo(float).tiny), shortest / 2.0)
    if isinstance(law, Functional) and shortest < delays[0]:
        _require_no_minutes(law, high - low, shortest, longest)
    if (high - low) / longest > _MOST_SEGMENTS:
        raise ArgumentError(
            f"horizon is too long for the ideal loop: it would take {(high - low) / longest:.0e} "
            f"segments of {longest:.1e} s; shorten it, or give a step."
        )
    size = longest / (2 * NODES)
    alike = (plant.delays == plant.delays[0]).all()
    through = [
        Shift(float(delay), i, speeds.arriving * size)
        for i in ([None] if alike else range(plant.modes))
        for delay in np.unique(plant.delays[i or 0])
    ]
    through += [Shift(end, None, jump * size) for end, jump in speeds.windows.items()]
    reached = pass_on(seeds, through, signal, high, speeds.faint)
    after = np.concatenate((reached, [horizon]))
    past = subdivide(merge(before, low, 0.0), longest)
    future = subdivide(merge(after, 0.0, high), longest)
    return np.concatenate((past, future[1:])), past.size - 1
