"""How a run ends: it falls, settles elsewhere, stays bounded, grows, or diverges.

A loop is judged by its free motion. Without a reference, disturbance or noise that is x itself.
With one, it is the difference from a second run with the same signal, forces and random numbers and
another x0: in a linear loop the forces cancel in the difference. A loop that decays under a
constant force comes to rest, but not at 0, and its settling time refers to that point. A run counts
as at rest only when its free motion has decayed, too: a slow loop hardly moves for a while, and yet
falls.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from deadtime.base.wording import amount
from deadtime.feedback import Law
from deadtime.imperfections import (
    Additive,
    ColouredDisturbance,
    Disturbance,
    Imperfection,
    Noise,
    StepDisturbance,
    WhiteDisturbance,
)
from deadtime.simulation.tracking import SETTLED
from deadtime.simulation.trajectory import Trajectory, settling_time

# Their mean is 0, so that they hold x nowhere else.
NOISES = WhiteDisturbance | ColouredDisturbance | Noise
_TAIL = 0.1  # the last share of a run, in which a run at rest stays settled
_NEARER = 0.9  # times the largest distance of the quarter before: less is a fall
_MORE = 1.001  # times the largest distance of the quarter before: more is growth

Kind = Literal["falls", "settles", "bounded", "grows", "diverged", "ends early"]


@dataclass(frozen=True, eq=False)
class Outcome:
    """How a run ends (immutable).

    Attributes
    ----------
    kind : str
        "falls": |x| ends no larger than it started, and no force or reference has brought it there;
        "settles": x comes to rest at a point other than 0; "bounded": neither, but the loop does
        not grow; "grows"; "diverged"; "ends early".
    start, final, peak : float
        |x| at time 0, at the end, and its maximum over the samples.
    rest : (n,) or None
        Where x comes to rest: 0 without forces; None where it does not.
    settling : float
        Time from which x stays within 2 % of its largest distance from there, seconds; ∞ if never.
    since : float
        Time of the last event before that (`events_of`), seconds; 0 for none.
    """

    kind: Kind
    start: float
    final: float
    peak: float
    rest: Float[np.ndarray, " n"] | None
    settling: float
    since: float = 0.0

    @property
    def lost(self) -> bool:
        """Whether the loop grows, or its run could not go on."""
        return self.kind in ("grows", "diverged", "ends early")

    @property
    def sentence(self) -> str:
        """The behaviour of x in words, without the law's name.

        Examples
        --------
        >>> Outcome("settles", 0.0, 2.0, 2.5, np.array([2.0]), 3.1).sentence
        'x settles in 3.1 s at |x| = 2.00, where a force or a reference holds it'
        """
        origin = amount(self.start) if self.start else f"a peak of {amount(self.peak)}"
        if self.kind == "falls":
            still = "" if self.settling < math.inf else " and has not settled when the run ends"
            return f"|x| falls from {origin} to {amount(self.final)}{still}"
        if self.kind == "settles" and self.rest is not None:
            when = f"in {self.settling:.3g} s"
            if self.since:
                after = self.settling - self.since
                when = f"{after:.3g} s after the last event, at {self.since:.4g} s,"
            place = f"|x| = {amount(_norm(self.rest))}"
            return f"x settles {when} at {place}, where a force or a reference holds it"
        if self.kind == "bounded":
            peak, final = amount(self.peak), amount(self.final)
            return f"x stays bounded, |x| ends at {final} after a peak of {peak}"
        origin = f" from {origin}" if self.start else ""
        return f"|x| grows{origin} to {amount(self.final)}"


def is_pushed(law: Law, imperfections: Sequence[Imperfection]) -> bool:
    """Whether something keeps a loop from 0: a force, noise, or a reference."""
    return law.servo is not None or bool(pushes(imperfections))


def pushes(imperfections: Sequence[Imperfection]) -> list[Imperfection]:
    """The imperfections that act whatever x is: forces and noise."""
    return [each for each in imperfections if isinstance(each, Disturbance | Additive)]


def elsewhere(x0: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Another x0, for the second run of a loop that is pushed."""
    return np.zeros(x0.size) if x0.any() else np.ones(x0.size) / math.sqrt(x0.size)


def events_of(run: Trajectory, imperfections: Sequence[Imperfection]) -> list[float]:
    """Times of the switches and of the steps of references and disturbances, seconds.

    Examples
    --------
    >>> import deadtime as dt
    >>> problem = dt.problems.paper()
    >>> step = dt.imperfections.StepDisturbance([0.0, 1.0], start=0.125)
    >>> 0.125 in events_of(problem.simulate("averaged"), [step])
    True
    """
    found = set(run.signal.times[1:].tolist())
    if run.followed is not None:
        outputs = range(run.followed.rows.shape[1])
        found |= {t for i in outputs for t in run.followed.changes(run.end, i)}
    for one in imperfections:
        if isinstance(one, StepDisturbance):
            found |= {float(one.start), float(one.end)}
    return sorted(t for t in found if 0.0 < t < run.end)


def outcome_of(
    run: Trajectory,
    horizon: float,
    again: Callable[[], Trajectory] | None = None,
    imperfections: Sequence[Imperfection] = (),
) -> Outcome:
    """How a run ends.

    Parameters
    ----------
    run : Trajectory
        The run.
    horizon : float
        Its intended length, seconds.
    again : callable, optional
        Makes the same run from `elsewhere`, for a loop that `is_pushed`; called only if needed.
    imperfections : sequence of Imperfection
        Of the run: disturbances that begin or end are events, and may hold x off 0.

    Examples
    --------
    >>> import deadtime as dt
    >>> problem = dt.problems.paper()
    >>> outcome_of(problem.simulate("averaged"), problem.horizon).kind
    'falls'
    """
    time = run.record.grid(run.end)
    states = run.record.states_at(time)
    norm = np.linalg.norm(states, axis=1)
    start, final, peak = float(norm[0]), float(norm[-1]), float(norm.max())
    kind: Kind
    rest, settling = None, settling_time(time, norm)
    if run.diverged or run.end < horizon:
        kind = "diverged" if run.diverged else "ends early"
        return Outcome(kind, start, final, peak, rest, settling)
    if again is None:
        calm = final <= (start or 0.5 * peak)
        kind = "falls" if calm else "grows" if _grows(time, norm) else "bounded"
        rest = np.zeros(states.shape[1]) if calm else None
    else:
        own = _difference(run, again(), time)
        if _grows(time, norm if own is None else own):
            return Outcome("grows", start, final, peak, None, math.inf)
        kind, (rest, until) = "bounded", _rest(time, states)
        if own is not None and not _stays(time, own):
            rest = None
            if final <= start and 0.5 * final < own[-1]:  # x is mostly free motion at the end
                kind, until = "falls", settling
        elif rest is not None and _norm(rest) <= SETTLED * peak:
            kind = "falls"
        elif rest is not None:
            forced = any(not isinstance(each, NOISES) for each in pushes(imperfections))
            kind = "settles" if forced or run.followed is not None else kind
        settling = math.inf if kind == "bounded" else until
    events = [t for t in events_of(run, imperfections) if t < settling < math.inf]
    return Outcome(kind, start, final, peak, rest, settling, max(events, default=0.0))


def keeps_up(run: Trajectory, perfect: Trajectory) -> bool:
    """Whether a run ends like that of a perfect loop.

    Where the perfect run comes to rest, the run must have come to rest at the same point. Where it
    does not, the run must differ from it, over the last quarter, by less than it moves itself.

    Examples
    --------
    >>> import deadtime as dt
    >>> problem = dt.problems.paper()
    >>> run = problem.simulate("averaged")
    >>> keeps_up(run, run), keeps_up(problem.simulate("delay ignored"), run)
    (True, False)
    """
    time = run.record.grid(min(run.end, perfect.end))
    states, rest = run.record.states_at(time), at_rest(perfect)
    if rest is not None:
        return _stays(time, np.linalg.norm(states - rest, axis=1))
    model = perfect.record.states_at(time)
    apart = np.linalg.norm(states - model, axis=1)[time >= 0.75 * time[-1]]
    return not perfect.diverged and bool(apart.max() <= _norm(np.ptp(model, axis=0)))


def still_falls(
    run: Trajectory, other: Trajectory, perfect: Trajectory, perfect_other: Trajectory
) -> bool:
    """Whether only decaying free motion separates a run of a linear loop from the perfect one.

    The differences from the other runs, which start elsewhere, are the free motions. That of the
    run must fall by a tenth from each quarter to the next; at the end the two free motions together
    must be at least half of the distance between the runs.

    Examples
    --------
    >>> import deadtime as dt
    >>> plant = dt.SwitchedSystem([[[-0.1]]], [[[1.0]]], delay=0.3)
    >>> slow, fast = (dt.AveragedPredictor(plant, [[[K]]]) for K in (0.0, -1.0))
    >>> held = dt.SwitchingSignal.constant(0)
    >>> runs = [dt.simulate(plant, k, held, [x], 20.0, 0.1) for k in (slow, fast) for x in (1, 0)]
    >>> still_falls(*runs)
    True
    """
    time = run.record.grid(run.end)
    own, of_perfect = _difference(run, other, time), _difference(perfect, perfect_other, time)
    off = _difference(run, perfect, time)
    if own is None or of_perfect is None or off is None or run.diverged:
        return False
    quarter = np.minimum(4.0 * time / time[-1], 3.0).astype(int)
    second, third, last = (own[quarter == i].max() for i in (1, 2, 3))
    falls = last <= _NEARER * third <= _NEARER**2 * second
    return bool(falls and off[-1] <= 2.0 * (own + of_perfect)[_tail(time)].max())


def at_rest(run: Trajectory) -> Float[np.ndarray, " n"] | None:
    """Where a run has come to rest; None where it has not."""
    time = run.record.grid(run.end)
    return None if run.diverged else _rest(time, run.record.states_at(time))[0]


def why_untested(run: Trajectory, outcome: Outcome) -> str:
    """A sentence if the signal's first switch comes after x has settled; else empty."""
    switches, settled = run.signal.times[1:], outcome.settling
    if outcome.peak == 0.0 or switches.size == 0 or not settled <= switches[0] < run.end:
        return ""
    return (
        f"The first switch, at {switches[0]:.4g} s, comes after x has settled ({settled:.3g} s): "
        "this signal has not tested the law by switching. Take a signal that switches earlier, "
        "or begin the run shortly before a switch."
    )


def _grows(time: np.ndarray, size: np.ndarray) -> bool:
    """Whether a size ends above its start, and its last quarter exceeds the quarter before."""
    half, most = time >= 0.5 * time[-1], time >= 0.75 * time[-1]
    before = size[half & ~most].max(initial=0.0)
    return bool(size[-1] > size[0] and size[most].max() > _MORE * before)


def _difference(run: Trajectory, other: Trajectory, time: np.ndarray) -> np.ndarray | None:
    """The distance of two runs; None where they do not compare."""
    same = np.array_equal(run.signal.times, other.signal.times)
    if other.end < time[-1] or not same:  # a rule switched them at instants of their own
        return None
    apart = run.record.states_at(time) - other.record.states_at(time)
    return np.linalg.norm(apart, axis=1)


def _rest(time: np.ndarray, states: np.ndarray) -> tuple[np.ndarray | None, float]:
    """The point at which x stays over the last tenth of a run, and since when; None if it moves."""
    rest = states[_tail(time)].mean(axis=0)
    distance = np.linalg.norm(states - rest, axis=1)
    return (rest, settling_time(time, distance)) if _stays(time, distance) else (None, math.inf)


def _stays(time: np.ndarray, distance: np.ndarray) -> bool:
    """Whether a distance is settled all through the last tenth of a run."""
    return bool(distance[_tail(time)].max() <= SETTLED * distance.max())


def _tail(time: np.ndarray) -> np.ndarray:
    return time >= (1.0 - _TAIL) * time[-1]


def _norm(x: np.ndarray) -> float:
    return float(np.linalg.norm(x))
