"""The segments of an ideal run: their edges, and how short they must be."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from deadtime.base.errors import ArgumentError
from deadtime.feedback import Forecast, Functional, Outlook
from deadtime.plant import SwitchedSystem
from deadtime.simulation.ideal.breakpoints import (
    FAINT,
    Shift,
    add_shifts,
    merge,
    pass_on,
    subdivide,
)
from deadtime.simulation.initial_input import InputHistory
from deadtime.switching import SwitchingSignal
from deadtime.switching.grid import first_reads

NODES = 10
_MOST_SEGMENTS = 1e6
_MOST_WORK = 6e10  # multiplications: a minute or so
_FLOW = 60.0  # of a window's exponentials on a segment, times the cube of its order
_OUTLOOK_FAINT = (
    1e-7  # weights are bounds: 1e-10 moves a run by 2e-12 and takes several times as long
)
_RESOLUTION = 1.5  # longest segment times the fastest rate


def _fastest_rate(plant: SwitchedSystem, forecast: Forecast, gains: np.ndarray) -> float:
    """A bound of |A| + |B||K| in units of the states in which they are balanced, 1/s.

    `gains` (times, branches, m, q) are the K_b at every time at which they may change.
    """
    K = np.abs(gains).sum(axis=1)
    if forecast.lift is None:
        return _rate(np.concatenate((plant.A, forecast.A)), forecast.B, K)
    return max(
        _rate(plant.A, plant.B, np.zeros((1, plant.inputs, plant.states))),
        _rate(forecast.A, forecast.B, K),
    )


def _rate(A: np.ndarray, B: np.ndarray, K: np.ndarray) -> float:
    """The bound for any of the A, with any of the B and any of the K ≥ 0."""
    from deadtime.numerics.exponential import balance

    t = balance(np.abs(A).max(axis=0) + np.abs(B).max(axis=0) @ K.max(axis=0))
    free, fed, gain = (
        np.linalg.norm(M, 2, axis=(1, 2)).max()
        for M in (A * t / t[:, None], np.abs(B) / t[:, None], K * t)
    )
    return float(free + fed * gain)


class _Speeds(NamedTuple):
    """How fast a loop is, 1/s: in all; what it makes, in u, of a jump of u that arrives; and what a
    law makes of one that enters or leaves a window, with the seconds to there.
    """

    fastest: float
    arriving: float
    windows: dict[float, float]


def _speeds(
    plant: SwitchedSystem, law: Forecast | Functional | Outlook, seeds: np.ndarray
) -> _Speeds:
    if isinstance(law, Forecast):
        rate = _fastest_rate(plant, law, law.gains(seeds[seeds >= 0.0]))
        return _Speeds(rate, rate, {law.lead: rate} if law.lead > 0.0 else {})
    if isinstance(law, Outlook):
        A, B = np.concatenate((plant.A, law.A)), np.concatenate((plant.B, law.B))
        rate = _rate(A, B, np.abs(law.gains).sum(axis=0))
        jumps = {float(end): rate for end in np.unique(law.delays)}
        # In a system an input is in flight on when another one has arrived, which it then moves.
        K = np.abs(law.gains).sum(axis=0).max(axis=0)
        for own, B_i in zip(law.delays, np.abs(law.B), strict=True):
            for j, k in zip(*np.nonzero(own[:, None] < own), strict=True):
                end = float(own[k] - own[j])
                jumps[end] = max(jumps.get(end, 0.0), float(K[j] @ B_i[:, k]))
        return _Speeds(rate, rate, jumps)
    from deadtime.numerics.exponential import discretise

    enter, ends = 0.0, {}
    for p, (S, R, near, far) in enumerate(zip(law.S, law.R, law.near, law.far, strict=True)):
        C = law.C[:, p]
        jump = _largest(C @ R)
        left = _largest(C @ discretise(S, R, far - near)[0] @ R)
        enter += jump * (near == 0.0)
        for end, size in ((float(near), jump), (float(far), left)):
            ends[end] = ends.get(end, 0.0) + size
    ends.pop(0.0, None)
    none = np.zeros((1, plant.inputs, plant.states))
    if law.S.shape[1] == plant.states:
        free = _rate(np.concatenate((plant.A, law.S)), plant.B, none)
    else:
        unfed = np.zeros((1, *law.C.shape[2:]))
        free = max(_rate(plant.A, plant.B, none), _rate(law.S, law.R, unfed))
    arriving = _largest(law.F[:, None] @ plant.B)
    return _Speeds(free + max(enter, arriving), arriving, ends)


def _largest(matrices: np.ndarray) -> float:
    """The largest of their 2-norms."""
    return float(np.linalg.norm(matrices, 2, axis=(-2, -1)).max())


def _reaches(law: Forecast | Functional | Outlook) -> np.ndarray:
    """How far ago what a law hears of was sent, where that begins and ends, seconds, increasing."""
    if isinstance(law, Forecast):
        return np.array([law.lead])
    return np.unique(law.delays if isinstance(law, Outlook) else np.append(law.near, law.far))


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
    law: Forecast | Functional | Outlook,
    signal: SwitchingSignal,
    horizon: float,
    history: InputHistory,
    rereads: bool = False,
) -> tuple[Float[np.ndarray, " edge"], int]:
    """The edges of all segments, and the index of the first after time 0.

    `rereads`: predictions read again, after a switch, what they have predicted themselves.
    """
    delays, reaches, breaks = np.unique(plant.delays), _reaches(law), np.empty(0)
    if not isinstance(law, Functional):
        breaks = np.concatenate([law.breaks, *(law.breaks - reach for reach in reaches)])
        if rereads and isinstance(law, Outlook):
            apart = np.unique(law.delays[:, None] - law.delays)
            longer = np.concatenate([law.breaks + more for more in apart if more > 0.0])
            breaks = np.concatenate([breaks, longer, *(longer - reach for reach in reaches)])
    # x is known until the plant reads what is not sent any more.
    high = float(first_reads(signal, plant.delays, np.array([horizon]), 0.0).min())
    low = -max(reaches[-1], delays[-1])
    before = np.concatenate((history.jumps, breaks, -reaches, -delays))
    seeds = np.concatenate(([0.0], signal.times, breaks, history.jumps))
    # Short enough for the polynomials, and for delayed inputs to lie in segments already done.
    speeds = _speeds(plant, law, seeds)
    shortest = min([delays[0], *reaches[reaches > 0.0].tolist()])
    longest = min(_RESOLUTION / max(speeds.fastest, np.finfo(float).tiny), shortest / 2.0)
    if isinstance(law, Functional) and shortest < delays[0]:
        _require_no_minutes(law, high - low, shortest, longest)
    if (high - low) / longest > _MOST_SEGMENTS:
        raise ArgumentError(
            f"horizon is too long for the ideal loop: it would take {(high - low) / longest:.0e} "
            f"segments of {longest:.1e} s; shorten it, or give a step."
        )
    if plant.has_one_delay and isinstance(law, Forecast):
        one, lead = float(delays[0]), law.lead
        reached = add_shifts(seeds, (one, lead) if lead > 0.0 else (one,), high)
    else:
        size = longest / (2 * NODES)
        through = [
            Shift(float(delay), i, speeds.arriving * size)
            for i in range(plant.modes)
            for delay in np.unique(plant.delays[i])
        ]
        through += [Shift(end, None, jump * size) for end, jump in speeds.windows.items()]
        faint = _OUTLOOK_FAINT if isinstance(law, Outlook) else FAINT
        reached = pass_on(seeds, through, signal, high, faint)
    after = np.concatenate((reached, [horizon]))
    past = subdivide(merge(before, low, 0.0), longest)
    future = subdivide(merge(after, 0.0, high), longest)
    return np.concatenate((past, future[1:])), past.size - 1
