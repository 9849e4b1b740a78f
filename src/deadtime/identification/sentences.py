"""Sentences on an estimate, and the verdict: whether a law tolerates all that a log allows."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float

from deadtime.base.wording import amount, number_of
from deadtime.identification.estimate import Estimate
from deadtime.identification.identifiability import counts_milliseconds, reasons
from deadtime.identification.levels import Rest
from deadtime.identification.log.recording import Recording
from deadtime.identification.parameters import SensorMatrix
from deadtime.plant import SwitchedSystem

if TYPE_CHECKING:
    from deadtime.feedback import Law
    from deadtime.identification.identified_plant import Findings


_EDGE = 1e-6  # of the range searched
_SINGULAR = 1e8  # condition number of A beyond which a mode, as an integrator, has no unique rest
_WIDE = 0.25  # of the range searched: a longer interval hardly identifies a delay
_DERIVATIVES = ("", "", " with its derivative", " with its first {} derivatives")
_OFTEN = 0.03  # share of rows at which a run of repeated values begins
_OWN = 0.9  # share of distinct values among those not repeated: rounded values have fewer
_NEVER = 1e-6  # significance level of the farthest row
_FAINT = 1e-3  # of a column's deviation: smaller errors are round-off
_COARSE = 0.8  # of half a turn per period: faster oscillations may be aliases


class OddReadings(NamedTuple):
    """Sentences on outputs that repeat earlier values, and on a row far from its prediction."""

    repeats: list[str]
    far_off: list[str]


def odd_readings(found: Estimate, recording: Recording, C: SensorMatrix) -> OddReadings:
    """Readings that no noise explains."""
    return OddReadings(_repeats(recording), _far_off(found, recording, C))


def sentences_of(
    found: Estimate,
    recording: Recording,
    why: str,
    rest: Rest | None,
    states: tuple[str, ...],
    odd: OddReadings,
) -> tuple[str, ...]:
    """Sentences on delays, operating point, noise, residuals, and assumptions."""
    said = [*_delays(found, recording), *_levels(found, recording, rest, states)]
    said += [*_noise(found), *_tests(found, recording, odd)]
    said += _period(found, recording)
    for name in recording.absent:
        said.append(
            f"Mode {name!r} is declared and never visited: nothing is known of it, and the plant "
            "has no such mode."
        )
    said += _states(found, recording)
    if recording.logged and not found.log.within:
        said.append("The mode is taken to change at samples only.")
    return (*said, *([why] if why else []))


def _delays(found: Estimate, recording: Recording) -> list[str]:
    low, high = _bounds(found, recording)
    names, said = delay_names(recording, found), []
    kinds = (_at_edge(found), _cut(found, recording), _open(found))
    each = zip(names, _values(found), found.intervals, *kinds, strict=True)
    for place, (name, D, (left, right), edge, cut, hardly) in enumerate(each):
        left = low if left <= found.log.bounds[0] else left
        digits = _digits(D, right - left)
        ends = f"{left:.{digits}g} … {right:.{digits}g} s"
        said.append(f"{name} is {D:.{digits}g} s, at 95 % within {ends}.")
        if edge:
            said.append(
                f"{name} lies at the edge of the range searched, {low:.4g} … {high:.4g} s: widen "
                "delay=(low, high), --delay LOW HIGH."
            )
        elif cut and not hardly:
            said.append(
                f"The interval of {name[0].lower()}{name[1:]} ends where the range searched does: "
                "if the delay may lie beyond, widen delay=(low, high), --delay LOW HIGH."
            )
        if hardly:
            several = bool(found.several[place])
            apart = ", and others that lie apart explain it nearly as well" if several else ""
            identified = f"The log hardly tells {name[0].lower()}{name[1:]}{apart}"
            why = reasons(recording, place % len(recording.inputs), high - low)
            advice = "" if why else ": move the input more, or log for longer"
            said += [f"{identified}{advice}{_beyond(right, high, _EDGE * (high - low))}.", *why]
        elif edge and counts_milliseconds(recording):
            said += reasons(recording, place % len(recording.inputs), high - low)
    return said


def _at_edge(found: Estimate) -> Bool[np.ndarray, " delay"]:
    """Which delays lie at the edge of the range searched."""
    low, high = found.log.bounds
    margin, D = _EDGE * (high - low), _values(found)
    return (low + margin > D) | (high - margin < D)


def _cut(found: Estimate, recording: Recording) -> Bool[np.ndarray, " delay"]:
    """Which intervals the range searched cuts; no delay is less than 0."""
    low, high = found.log.bounds
    least = -np.inf if _bounds(found, recording)[0] == 0.0 else low
    return (found.intervals[:, 0] <= least) | (found.intervals[:, 1] >= high)


def _open(found: Estimate) -> Bool[np.ndarray, " delay"]:
    low, high = found.log.bounds
    return found.several | (np.diff(found.intervals)[:, 0] > _WIDE * (high - low))


def doubts_of(found: Estimate, recording: Recording, odd: OddReadings) -> tuple[str, ...]:
    """Reasons why intervals may not contain the delays, as ends of a sentence."""
    names = delay_names(recording, found)
    names = [f"{name[0].lower()}{name[1:]}" for name in names] if len(names) == 1 else names
    kinds = (_at_edge(found), _cut(found, recording), _open(found))
    said = []
    for name, edge, ends, hardly in zip(names, *kinds, strict=True):
        if edge or ends:
            what = name if edge else f"the interval of {name}"
            where = "lies at the edge of" if edge else "ends at the edge of"
            said.append(f"{what} {where} the range searched")
        said += [f"the log hardly tells {name}"] if hardly else []
    if not found.tests.white:
        said.append("what is left of the log is not white, and intervals are too narrow then")
    if not found.tests.unrelated:
        said.append(f"what is left still has {recording.inputs[found.tests.input]} in it")
    if odd.far_off:
        said.append("a measurement lies farther off than chance makes it")
    if odd.repeats:
        said.append("measurements are repeated, so that their times are not known")
    return tuple(said)


def _bounds(found: Estimate, recording: Recording) -> tuple[float, float]:
    """The range searched as given: its shortest delay is 0 where the search replaced 0."""
    low, high = found.log.bounds
    return (low if low > _EDGE * recording.step * (1.0 + _EDGE) else 0.0), high


def _digits(D: float, width: float) -> int:
    """The number of digits of which two differ between the ends of an interval."""
    if not 0.0 < width < abs(D):
        return 4
    return min(max(4, 1 + int(np.ceil(np.log10(abs(D) / width)))), 12)


def _beyond(right: float, high: float, margin: float) -> str:
    """Advice where the interval ends at the longest delay searched."""
    if right < high - margin:
        return ""
    return f"; if it may be longer than {high:.4g} s, widen delay=(low, high), --delay LOW HIGH"


def _values(found: Estimate) -> np.ndarray:
    return found.best.theta[found.log.layout.at_delays]


def delay_names(recording: Recording, found: Estimate) -> list[str]:
    """Names of delays, as subjects of sentences."""
    layout = found.log.layout
    if layout.delays == 1:
        return ["The delay"]
    inputs = [f"The delay of {name}" for name in recording.inputs]
    if not layout.per_mode:
        return inputs
    return [f"{name} in mode {mode}" for mode in recording.modes for name in inputs]


def _levels(
    found: Estimate, recording: Recording, rest: Rest | None, states: tuple[str, ...]
) -> list[str]:
    """Sentences on the operating point and on assumptions about inputs."""
    said = []
    if rest is not None:
        names, values = (*states, *recording.inputs), (*rest.point.x, *rest.point.u)
        each = [
            f"{name} = {v:.{_digits(v, 2.0 * e)}g}"
            for name, v, e in zip(names, values, rest.error, strict=True)
        ]
        there, given = ", ".join(each[: len(states)]), ", ".join(each[len(states) :])
        said.append(
            f"The plant rests at {there} with {given}: its states and inputs are deviations from "
            "this operating point."
        )
        said += _apart(found, recording, rest, states)
    if any(part.rests for part in recording.parts):
        said.append(
            "Inputs before the log are taken for those of its first row, where it begins at rest: "
            "if they were others, say rest=False, --no-rest."
        )
    for name, value in recording.constants:
        said.append(
            f"{name} is {value:.6g} throughout: the log tells nothing of what it does, and the "
            "plant has no such input."
        )
    return said


def _apart(found: Estimate, recording: Recording, rest: Rest, states: tuple[str, ...]) -> list[str]:
    """Sentences on the rest of each mode with the same inputs, if they differ."""
    if not rest.offset.any():
        return []
    where = []
    for i, mode in enumerate(recording.modes):
        A, c = found.plant.A[i], rest.offset[i]
        if np.linalg.cond(A) < _SINGULAR:
            at = rest.point.x - np.linalg.solve(A, c)
            each = [f"{name} = {v:.4g}" for name, v in zip(states, at, strict=True)]
            where.append(f"mode {mode} at {', '.join(each)}")
    listed = f": {'; '.join(where)}" if where else ""
    return [f"With these inputs modes rest apart{listed}. What each adds there is its offset."]


def _noise(found: Estimate) -> list[str]:
    if not found.noise.any():
        return ["Measurements are taken as exact, and all noise as the plant's."]
    each = zip(found.noise.tolist(), found.sensor_intervals, strict=True)
    deviations = [
        amount(v) if low > 0.0 else f"less than {amount(high)}" for v, (low, high) in each
    ]
    return [f"Measurements are noisy: standard deviation {', '.join(deviations)}."]


def _tests(found: Estimate, recording: Recording, odd: OddReadings) -> list[str]:
    tests, said = found.tests, [*odd.repeats, *odd.far_off]
    if tests.white and tests.unrelated and not said:
        return ["What is left of the log looks like chance: it is white, and no input is in it."]
    if not tests.white:
        cause = "noise is not white." if found.noise.any() else "sensors are noisy (noise=True)."
        said.append(
            f"What is left is not white: its correlation over {number_of(tests.lag, 'sample')} is "
            f"{tests.correlation:+.2f}. Intervals are too narrow then: a state is missing"
            f"{_larger(found)}, the plant is not linear, or "
            f"{cause}"
        )
    if not tests.unrelated:
        name, (low, high) = recording.inputs[tests.input], _bounds(found, recording)
        outside = not low - recording.step < tests.input_delay < high + recording.step
        cause = (
            f"a delay outside the range searched, {low:.4g} … {high:.4g} s: widen "
            "delay=(low, high), --delay LOW HIGH; or a second path of that input."
            if outside
            else "a second path of that input, a delay that is not constant, or a state that is "
            "missing."
        )
        said.append(
            f"What is left still has {name} of {tests.input_delay:.4g} s before in it: {cause}"
        )
    return said


def _repeats(recording: Recording) -> list[str]:
    """Sentences on outputs that often repeat the value before, though values are not rounded."""
    said = []
    for column, name in enumerate(recording.outputs):
        each = [part.output[:, column] for part in recording.parts]
        same = [np.append(False, y[1:] == y[:-1]) for y in each]
        rows, again = sum(one.size for one in same), sum(int(one.sum()) for one in same)
        runs = sum(int((one[1:] & ~one[:-1]).sum()) for one in same)  # a rest without noise is one
        if runs < _OFTEN * rows:
            continue
        if len(np.unique(np.concatenate(each))) >= _OWN * (rows - again):
            said.append(
                f"{100.0 * again / rows:.0f} % of rows repeat the {name} before, as of a sensor "
                "slower than the rows: its times are not known. Leave those cells empty."
            )
    return said


def _far_off(found: Estimate, recording: Recording, C: SensorMatrix) -> list[str]:
    """A sentence on the row farthest from its prediction, if that is significant.

    Errors below a thousandth of a column's deviation are ignored: without noise they are round-off,
    which is not normal.
    """
    from scipy.stats import norm

    z = np.abs(np.nan_to_num(np.vstack(found.white)))
    far = np.argwhere(z > norm.isf(0.5 * _NEVER / z.size)).tolist()
    if not far:
        return []
    row, column = max(far, key=lambda at: z[*at])
    if [row - 1, column] in far:  # a wrong reading also spoils the prediction of the next one
        row -= 1
    moves = np.nanstd(np.vstack([part.output for part in recording.parts]), axis=0)
    size, W = z[:, column].max(), found.disturbance.max(axis=0)
    added = np.sqrt(C[column] @ W @ C[column] * recording.step)
    if size * np.hypot(added, found.noise[column]) < _FAINT * moves[column]:
        return []
    name, time = recording.outputs[column], np.concatenate([p.time for p in recording.parts])[row]
    return [
        f"{name} at t = {time:.10g} s lies {size:.0f} standard deviations off what the model "
        "foretells, farther than chance makes it: if it is a wrong reading, leave the cell empty, "
        "for it bends the estimate; else noise is not normal, or something else acts."
    ]


def _states(found: Estimate, recording: Recording) -> list[str]:
    """Sentences on states, where there are more of them than outputs."""
    shape = found.of_outputs and found.of_outputs.embedding
    if shape is None:
        return []
    each = zip(recording.outputs, shape.order, strict=True)
    named = [f"{name}{_DERIVATIVES[min(count, 3)].format(count - 1)}" for name, count in each]
    said = [f"The states are {' and '.join(named)}."]
    if shape.zeros and shape.upper.size:
        said = [
            f"The states are {' and '.join(named)}, less what inputs add to these: they act on all "
            "of them."
        ]
    if shape.jumps:
        said.append(
            f"So they are in mode {recording.modes[0]!r}; in other modes derivatives are sums of "
            "them, so that an output's derivative jumps at a switch. The log asks for that."
        )
    elif found.plant.modes > 1:
        tested = "" if found.log.within else ": the log does not say otherwise"
        said.append(
            "They are taken to be the same in all modes, and not to jump at a switch, as position "
            f"and speed do not{tested}."
        )
    return said


def _larger(found: Estimate) -> str:
    """Advice on the option for one more state."""
    shape = found.of_outputs and found.of_outputs.embedding
    if shape is None:
        return " (if not all states are logged, say how many each column has: order=2, --order 2)"
    more = tuple(count + 1 for count in shape.order)
    text = f"{more[0]}" if len(more) == 1 else f"up to {more}"
    return f" (raise order, --order, to {text})"


def _period(found: Estimate, recording: Recording) -> list[str]:
    """Sentences on uneven rows and on oscillations that may be aliases."""
    said = []
    if not recording.even:
        said.append(f"Rows are unevenly spaced, {recording.step:.4g} s apart by their median.")
    turn = np.abs(np.linalg.eigvals(found.plant.A).imag).max() * recording.step
    if turn > _COARSE * np.pi:
        said.append(
            f"A mode turns by {np.degrees(turn):.0f}° in a period: one that turns by "
            f"{np.degrees(2.0 * np.pi - turn):.0f}° the other way looks the same. Sample faster."
        )
    return said


_NO_SWITCHES = "; errors that differ while modes switch are for certify(…, delays=…)"
MOST_INPUTS = 4  # of a box whose 2^m corners are all tested


@runtime_checkable
class Margin(Protocol):
    """A margin of a law's delay, as `margins.DelayMargin` is."""

    @property
    def lower(self) -> float | None: ...
    @property
    def upper(self) -> float | None: ...
    @property
    def nominal(self) -> float: ...
    @property
    def input(self) -> int | None: ...
    @property
    def certified(self) -> bool: ...


def verdict_of(fit: Findings, margin: Margin, law: Law | None, step: float) -> str:
    """The text of `Identification.verdict`, of a law that acts every `step` seconds."""
    from deadtime.margins import drawn_stability

    if fit.doubts:
        return delays_beside(fit.delays, fit.delay_interval, margin, doubt=fit.doubts[0])
    failure = None
    several = "delay" not in fit.names and fit.plant.inputs <= MOST_INPUTS
    if law is not None and several and margin.lower is not None:
        failure = failure_of(fit.plant, fit.delay_interval, law, step)
    said = delays_beside(fit.delays, fit.delay_interval, margin, failure)
    if law is None or margin.lower is None or not law.is_linear:
        return said
    drawn = drawn_stability(fit.uncertain, law, step)
    if drawn.stable == len(drawn.growth):
        return f"{said} {drawn.sentence}"
    return (
        f"{said} {drawn.sentence} Not enough: log for longer, or design a law that tolerates more."
    )


def delays_beside(
    delays: np.ndarray,
    interval: np.ndarray,
    margin: Margin,
    failure: str | None = None,
    doubt: str = "",
) -> str:
    """The intervals of delays compared with a margin, in words.

    A margin is for a common error of all delays. For several, `failure` names what fails with
    separate errors, "" if nothing does, None if it was not tested. `doubt` is a reason why
    intervals may not contain the delays: then nothing is enough.
    """
    j = margin.input
    column = slice(None) if j is None else slice(j, j + 1)
    D, ends = delays[:, column], interval[:, column]
    if (D[0] == D).all() and (ends[0] == ends).all():
        D, ends = D[:1], ends[:1]
    one = D.size == 1
    if one:
        low, high = ends[0, 0]
        said = f"Delay {D[0, 0]:.4g} s ({low:.4g} … {high:.4g})"
    else:
        off = ends - D[..., None]
        said = f"Delays are off by {off.min():+.2g} … {off.max():+.2g} s at 95 %"
    if margin.lower is None or margin.upper is None:
        return f"{said}; the law tolerates no delay at all, not even the likeliest: design another."
    shift = margin.lower - margin.nominal, margin.upper - margin.nominal
    left, right = float((ends[..., 0] - D).min()), float((ends[..., 1] - D).max())
    enough = shift[0] <= left and right <= shift[1] and not doubt
    why = f"not enough, for {doubt}" if doubt else _end(enough, interval.shape[1] > 1)
    if one:
        return f"{said}; the law tolerates {margin.lower:.4g} … {margin.upper:.4g} s: {why}."
    together = "" if j is not None else ", of all together"
    said = f"{said}; the law tolerates {shift[0]:+.2g} … {shift[1]:+.2g} s{together}"
    if failure is None or not enough:
        alike = (
            "enough if all err alike; nothing is said of errors that differ: verdict(margin, law) "
            "looks at them"
        )
        return f"{said}: {alike if enough else why}."
    if failure:
        return f"{said}, but errors differ: {failure}: {_end(False)}."
    return (
        f"{said}, in each mode held the error of every input's delay alone, and every corner of "
        f"the box of intervals: {_end(True)}{_NO_SWITCHES if margin.certified else ''}."
    )


def _end(enough: bool, others: bool = False) -> str:
    if not enough:
        return "not enough, so design a law with a wider margin or log for longer"
    return "enough, if the other delays are what they are taken for" if others else "enough"


def failure_of(
    plant: SwitchedSystem, interval: Float[np.ndarray, "mode m 2"], law: Law, step: float
) -> str:
    """The failure of a law with separate errors of delays, in words; "" if none.

    In a constant mode its own delays alone act, so corners are taken in all modes at once.
    """
    from deadtime.margins import delay_margin
    from deadtime.spectrum import growth_rate

    for j in range(plant.inputs):
        margin = delay_margin(plant, law, step, input=j)
        if margin.lower is None or margin.upper is None:
            return "a mode grows at the likeliest delays"
        off = interval[:, j] - plant.delays[:, j, None]
        short, long = margin.lower - margin.nominal, margin.upper - margin.nominal
        if off[:, 0].min() < short or off[:, 1].max() > long:
            return f"that of input {j} alone is tolerated from {short:+.2g} to {long:+.2g} s"
    for corner in itertools.product((0, 1), repeat=plant.inputs):
        delays = interval[:, np.arange(plant.inputs), corner]
        truth = SwitchedSystem(plant.A, plant.B, delays)
        for mode in range(plant.modes):
            if growth_rate(truth, law, mode, step) >= 0.0:
                at = ", ".join(f"{D:.4g}" for D in delays[mode])
                return f"with true delays of {at} s mode {mode} does not decay"
    return ""
