"""Sentences on an estimate, and the verdict: whether a law tolerates all delays in the intervals.

The verdict compares intervals with a delay margin, and tests the corners of the box of intervals by
the growth rate of the loop in every constant mode.
"""

from __future__ import annotations

from itertools import compress, product
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from deadtime.base.wording import amount, number_of
from deadtime.identification.estimate import EDGE, Estimate
from deadtime.identification.identifiability import counts_milliseconds, reasons
from deadtime.identification.levels import Rest
from deadtime.identification.log.recording import Recording
from deadtime.identification.parameters import SensorMatrix
from deadtime.identification.process_models import process_sentences, processes_of
from deadtime.plant import SwitchedSystem

if TYPE_CHECKING:
    from deadtime.feedback import Law
    from deadtime.identification.departures import Departure, Departures
    from deadtime.identification.identified_plant import Findings
    from deadtime.margins import DelayMargin


_SINGULAR = 1e8  # condition number of A beyond which a mode, as an integrator, has no unique rest
_DERIVATIVES = ("", "", " with its derivative", " with its first {} derivatives")
_OFTEN = 0.03  # share of rows at which a run of repeated values begins
_OWN = 0.9  # share of distinct values among those not repeated: rounded values have fewer
_NEVER = 1e-6  # significance level of the farthest row
_FAINT = 1e-3  # of a column's deviation: smaller errors are round-off
_COARSE = 0.8  # of half a turn per period: faster oscillations may be aliases


def sentences_of(
    estimate: Estimate,
    recording: Recording,
    C: SensorMatrix,
    why: str,
    rest: Rest | None,
    states: tuple[str, ...],
    departures: Departures,
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Sentences on delays, operating point, noise, residuals and assumptions; and doubts.

    why : there is no switching model
    """
    repeated, outliers = repeats(recording), _outliers(estimate, recording, C)
    sentences = _delays(estimate, recording)
    sentences += process_sentences(processes_of(estimate, recording, C), recording, len(C))
    sentences += _levels(estimate, recording, rest, states)
    sentences += _noise(estimate)
    # Coloured noise is said by the tests of whiteness, with what may colour it.
    white = estimate.tests.white
    named = tuple(one for one in departures.found if white or one.name != "coloured noise")
    sentences += _tests(estimate, recording, [*repeated, *outliers], named)
    sentences += departures.open
    sentences += _period(estimate, recording)
    for name in recording.absent:
        sentences.append(
            f"Mode {name!r} is declared and never visited: nothing is known of it, and the plant "
            "has no such mode."
        )
    sentences += _states(estimate, recording)
    if recording.logged and not estimate.log.within:
        sentences.append("The mode is taken to change at samples only.")
    sentences += [why] if why else []
    doubts = [departure.doubt for departure in named]
    doubts += _doubts(estimate, recording)
    if outliers:
        doubts.append("a measurement lies farther off than chance makes it")
    if repeated:
        doubts.append("measurements are repeated, so that their times are not known")
    return tuple(sentences), tuple(doubts)


def _delays(estimate: Estimate, recording: Recording) -> list[str]:
    low, high = estimate.searched
    names, sentences, values = delay_names(recording, estimate), [], estimate.delays
    missed = estimate.missed
    for name, D in compress(zip(names, values, strict=True), missed):
        sentences.append(_not_found(name, float(D), recording, (low, high)))
    each = zip(names, values, estimate.intervals, *estimate.range_flags, strict=True)
    for place, (name, D, (left, right), at_edge, cut, vague) in enumerate(each):
        if missed[place]:
            if vague or counts_milliseconds(recording):
                sentences += reasons(recording, place % len(recording.inputs), high - low)
            continue
        D = low if estimate.log.bounds[0] >= D else D
        digits = _digits(D, right - left)
        ends = f"{left:.{digits}g} … {right:.{digits}g} s"
        if cut and not vague:
            # The likelihood may be larger beyond the range, so that nothing is said without it.
            sentences.append(
                f"{name} is {D:.{digits}g} s if it lies in the range searched, which ends within "
                f"its 95 % interval ({ends}): widen delay=(low, high), --delay LOW HIGH."
            )
        else:
            sentences.append(f"{name} is {D:.{digits}g} s, at 95 % within {ends}.")
        if vague:
            several = bool(estimate.several[place])
            apart = ", and others that lie apart explain it nearly as well" if several else ""
            sentence = f"The log hardly tells {name[0].lower()}{name[1:]}{apart}"
            why = reasons(recording, place % len(recording.inputs), high - low)
            sentence += "" if why else ": move the input more, or log for longer"
            if right >= high - EDGE * (high - low):
                sentence += f"; if it may be longer than {high:.4g} s, widen delay=(low, high), "
                sentence += "--delay LOW HIGH"
            sentences += [f"{sentence}.", *why]
        elif at_edge and counts_milliseconds(recording):
            sentences += reasons(recording, place % len(recording.inputs), high - low)
    return sentences


def _not_found(name: str, D: float, recording: Recording, searched: tuple[float, float]) -> str:
    """The sentence on a delay D at an end of the range: widen it to 0, or a tenth of the log."""
    (low, high), end, first, last = searched, "shortest", 0.0, searched[1]
    if low + high < 2.0 * D:
        end, first = "longest", low
        length = max(float(np.ptp(part.time)) for part in recording.parts)
        last = float(f"{max(0.1 * length, 2.0 * high):.1g}")
    return (
        f"{name[4].upper()}{name[5:]} not found: the best fit is at the {end} delay of the range "
        f"searched, {low:.4g} … {high:.4g} s. Repeat with delay=({first:.4g}, {last:.4g}), "
        f"--delay {first:.4g} {last:.4g}."
    )


def _doubts(estimate: Estimate, recording: Recording) -> list[str]:
    """Reasons why intervals may not contain the delays, as ends of a sentence."""
    names, tests = delay_names(recording, estimate), estimate.tests
    names = [f"{name[0].lower()}{name[1:]}" for name in names] if len(names) == 1 else names
    doubts = []
    each = zip(names, *estimate.range_flags, strict=True)
    for name, at_edge, cut, vague in each:
        if at_edge:
            doubts.append(f"{name} lies at the edge of the range searched")
        elif cut:
            doubts.append(f"the interval of {name} ends at the edge of the range searched")
        doubts += [f"the log hardly tells {name}"] if vague else []
    if not tests.white:
        doubts.append("what is left of the log is not white, and intervals are too narrow then")
    if not tests.unrelated:
        doubts.append(f"what is left still has {recording.inputs[tests.input]} in it")
    return doubts


def _digits(D: float, width: float) -> int:
    """The number of digits of which two differ between the ends of an interval."""
    if not 0.0 < width < abs(D):
        return 4
    return min(max(4, 1 + int(np.ceil(np.log10(abs(D) / width)))), 12)


def delay_names(recording: Recording, estimate: Estimate) -> list[str]:
    """Names of delays, as subjects of sentences."""
    layout = estimate.log.layout
    if layout.delays == 1:
        return ["The delay"]
    inputs = [f"The delay of {name}" for name in recording.inputs]
    if not layout.per_mode:
        return inputs
    return [f"{name} in mode {mode}" for mode in recording.modes for name in inputs]


def _levels(
    estimate: Estimate, recording: Recording, rest: Rest | None, states: tuple[str, ...]
) -> list[str]:
    """Sentences on the operating point and on assumptions about inputs."""
    sentences = []
    if rest is not None:
        names, values = (*states, *recording.inputs), (*rest.point.x, *rest.point.u)
        each = [
            f"{name} = {v:.{_digits(v, 2.0 * e)}g}"
            for name, v, e in zip(names, values, rest.error, strict=True)
        ]
        there, given = ", ".join(each[: len(states)]), ", ".join(each[len(states) :])
        started = [part.rests for part in recording.parts]
        near = " near the log's first row" if all(started) else " near the log's mean input"
        if any(started) and not all(started):  # the level is that of the first log at rest
            near = " near the first row of a log that begins at rest"
        sentences.append(
            f"Balance point{near if estimate.plant.modes == 1 else ''}: {there} with {given}. "
            "States and inputs are deviations from it."
        )
        sentences += _apart(estimate, recording, rest, states)
    if any(part.rests for part in recording.parts):
        sentences.append(
            "Inputs before the log are taken for those of its first row, where it begins at rest: "
            "if they were others, say rest=False, --no-rest."
        )
    for name, value in recording.constants:
        sentences.append(
            f"{name} is {value:.6g} throughout: the log tells nothing of what it does, and the "
            "plant has no such input."
        )
    return sentences


def _apart(
    estimate: Estimate, recording: Recording, rest: Rest, states: tuple[str, ...]
) -> list[str]:
    """Sentences on the rest of each mode with the same inputs, if they differ."""
    if not rest.offset.any():
        return []
    where = []
    for i, mode in enumerate(recording.modes):
        A, c = estimate.plant.A[i], rest.offset[i]
        if np.linalg.cond(A) < _SINGULAR:
            at = rest.point.x - np.linalg.solve(A, c)
            each = [f"{name} = {v:.4g}" for name, v in zip(states, at, strict=True)]
            where.append(f"mode {mode} at {', '.join(each)}")
    listed = f": {'; '.join(where)}" if where else ""
    return [f"With these inputs modes rest apart{listed}. What each adds there is its offset."]


def _noise(estimate: Estimate) -> list[str]:
    if not estimate.noise.any():
        return ["Measurements are taken as exact, and all noise as the plant's."]
    each = zip(estimate.noise.tolist(), estimate.sensor_intervals, strict=True)
    deviations = [
        amount(v) if low > 0.0 else f"less than {amount(high)}" for v, (low, high) in each
    ]
    return [f"Measurements are noisy: standard deviation {', '.join(deviations)}."]


def _tests(
    estimate: Estimate,
    recording: Recording,
    odd: list[str],
    departures: tuple[Departure, ...],
) -> list[str]:
    """Sentences on residuals, after those on odd readings; causes unless departures are known."""
    tests, sentences = estimate.tests, odd
    if departures:
        return [*odd, *(f"{one.sentence} {one.advice}" for one in departures)]
    if tests.white and tests.unrelated and not sentences:
        return ["What is left of the log looks like chance: it is white, and no input is in it."]
    if not tests.white:
        cause = "noise is not white." if estimate.noise.any() else "sensors are noisy (noise=True)."
        sentences.append(
            f"What is left is not white: its correlation over {number_of(tests.lag, 'sample')} is "
            f"{tests.correlation:+.2f}. Intervals are too narrow then: a state is missing"
            f"{_larger(estimate)}, the plant is not linear, or "
            f"{cause}"
        )
    if not tests.unrelated:
        name, (low, high) = recording.inputs[tests.input], estimate.searched
        cause = (
            f"a delay outside the range searched, {low:.4g} … {high:.4g} s: widen "
            "delay=(low, high), --delay LOW HIGH; or a second path of that input."
            if estimate.outside
            else "a second path of that input, a delay that is not constant, or a state that is "
            "missing."
        )
        sentences.append(
            f"What is left still has {name} of {tests.input_delay:.4g} s before in it: {cause}"
        )
    return sentences


def repeats(recording: Recording) -> list[str]:
    """Sentences on outputs that often repeat the value before, though values are not rounded."""
    sentences = []
    for column, name in enumerate(recording.outputs):
        each = [part.output[:, column] for part in recording.parts]
        same = [np.append(False, y[1:] == y[:-1]) for y in each]
        rows, again = sum(one.size for one in same), sum(int(one.sum()) for one in same)
        runs = sum(int((one[1:] & ~one[:-1]).sum()) for one in same)  # a rest without noise is one
        if runs < _OFTEN * rows:
            continue
        if len(np.unique(np.concatenate(each))) >= _OWN * (rows - again):
            sentences.append(
                f"{100.0 * again / rows:.0f} % of rows repeat the {name} before, as of a sensor "
                "slower than the rows: its times are not known. Leave those cells empty."
            )
    return sentences


def _outliers(estimate: Estimate, recording: Recording, C: SensorMatrix) -> list[str]:
    """A sentence on the row farthest from its prediction, if that is significant.

    Errors below a thousandth of a column's deviation are ignored: without noise they are round-off,
    which is not normal.
    """
    from scipy.stats import norm

    z = np.abs(np.nan_to_num(np.vstack(estimate.white)))
    far = np.argwhere(z > norm.isf(0.5 * _NEVER / z.size)).tolist()
    if not far:
        return []
    row, column = max(far, key=lambda at: z[*at])
    if [row - 1, column] in far:  # a wrong reading also spoils the prediction of the next one
        row -= 1
    moves = np.nanstd(np.vstack([part.output for part in recording.parts]), axis=0)
    size, W = z[:, column].max(), estimate.disturbance.max(axis=0)
    added = np.sqrt(C[column] @ W @ C[column] * recording.step)
    if size * np.hypot(added, estimate.noise[column]) < _FAINT * moves[column]:
        return []
    name, time = recording.outputs[column], np.concatenate([p.time for p in recording.parts])[row]
    return [
        f"{name} at t = {time:.10g} s lies {size:.0f} standard deviations off what the model "
        "foretells, farther than chance makes it: if it is a wrong reading, leave the cell empty, "
        "for it bends the estimate; else noise is not normal, or something else acts."
    ]


def _states(estimate: Estimate, recording: Recording) -> list[str]:
    """Sentences on the states of outputs alone."""
    shape = estimate.of_outputs and estimate.of_outputs.embedding
    if shape is None or not shape.upper.size:
        return []
    each = zip(recording.outputs, shape.order, strict=True)
    named = [f"{name}{_DERIVATIVES[min(count, 3)].format(count - 1)}" for name, count in each]
    sentences = [f"The states are {' and '.join(named)}."]
    if shape.zeros and shape.upper.size:
        sentences = [
            f"The states are {' and '.join(named)}, less what inputs add to these: they act on all "
            "of them."
        ]
    if shape.jumps:
        sentences.append(
            f"So they are in mode {recording.modes[0]!r}; in other modes derivatives are sums of "
            "them, so that an output's derivative jumps at a switch. The log asks for that."
        )
    elif estimate.plant.modes > 1:
        tested = "" if estimate.log.within else ": the log does not say otherwise"
        sentences.append(
            "They are taken to be the same in all modes, and not to jump at a switch, as position "
            f"and speed do not{tested}."
        )
    return sentences


def _larger(estimate: Estimate) -> str:
    """Advice on the option for one more state."""
    shape = estimate.of_outputs and estimate.of_outputs.embedding
    if shape is None:
        return " (if not all states are logged, say how many each column has: order=2, --order 2)"
    more = tuple(count + 1 for count in shape.order)
    text = f"{more[0]}" if len(more) == 1 else f"up to {more}"
    return f" (raise order, --order, to {text})"


def _period(estimate: Estimate, recording: Recording) -> list[str]:
    """Sentences on uneven rows and on oscillations that may be aliases."""
    sentences = []
    if not recording.even:
        sentences.append(f"Rows are unevenly spaced, {recording.step:.4g} s apart by their median.")
    turn = np.abs(np.linalg.eigvals(estimate.plant.A).imag).max() * recording.step
    if turn > _COARSE * np.pi:
        sentences.append(
            f"A mode turns by {np.degrees(turn):.0f}° in a period: one that turns by "
            f"{np.degrees(2.0 * np.pi - turn):.0f}° the other way looks the same. Sample faster."
        )
    return sentences


_NO_SWITCHES = "; errors that differ while modes switch are for certify(…, delays=…)"
MOST_INPUTS = 4  # of a box whose 2^m corners are all tested


def verdict_of(fit: Findings, margin: DelayMargin, law: Law | None, step: float) -> str:
    """The text of `Identification.verdict`, of a law that acts every `step` seconds."""
    from deadtime.margins import drawn_stability

    if fit.delays_not_found:
        named = "the delay" if "delay" in fit.names else " and ".join(fit.delays_not_found)
        return (
            f"Nothing is known of {named}, not found in the range searched: the delays that the "
            "law tolerates are compared with nothing."
        )
    if fit.doubts:
        return delays_beside(fit.delays, fit.delay_interval, margin, doubt=fit.doubts[0])
    failure = None
    several = "delay" not in fit.names and fit.plant.inputs <= MOST_INPUTS
    if law is not None and several and margin.lower is not None:
        failure = failure_of(fit.plant, fit.delay_interval, law, step)
    text = delays_beside(fit.delays, fit.delay_interval, margin, failure)
    if law is None or margin.lower is None or not law.is_linear:
        return text
    drawn = drawn_stability(fit.uncertain, law, step)
    if drawn.stable == len(drawn.growth):
        return f"{text} {drawn.sentence}"
    return (
        f"{text} {drawn.sentence} Not enough: log for longer, or design a law that tolerates more."
    )


def delays_beside(
    delays: np.ndarray,
    interval: np.ndarray,
    margin: DelayMargin,
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
        text = f"Delay {D[0, 0]:.4g} s ({low:.4g} … {high:.4g})"
    else:
        off = ends - D[..., None]
        text = f"Delays are off by {off.min():+.2g} … {off.max():+.2g} s at 95 %"
    if margin.lower is None or margin.upper is None:
        return f"{text}; the law tolerates no delay at all, not even the likeliest: design another."
    shift = margin.lower - margin.nominal, margin.upper - margin.nominal
    left, right = float((ends[..., 0] - D).min()), float((ends[..., 1] - D).max())
    enough = shift[0] <= left and right <= shift[1] and not doubt
    why = f"not enough, for {doubt}" if doubt else _end(enough, interval.shape[1] > 1)
    if one:
        return f"{text}; the law tolerates {margin.lower:.4g} … {margin.upper:.4g} s: {why}."
    together = "" if j is not None else ", of all together"
    text = f"{text}; the law tolerates {shift[0]:+.2g} … {shift[1]:+.2g} s{together}"
    if failure is None or not enough:
        alike = (
            "enough if all err alike; nothing is said of errors that differ: verdict(margin, law) "
            "looks at them"
        )
        return f"{text}: {alike if enough else why}."
    if failure:
        return f"{text}, but errors differ: {failure}: {_end(False)}."
    return (
        f"{text}, in each mode held the error of every input's delay alone, and every corner of "
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
    for corner in product((0, 1), repeat=plant.inputs):
        delays = interval[:, np.arange(plant.inputs), corner]
        truth = SwitchedSystem(plant.A, plant.B, delays)
        for mode in range(plant.modes):
            if growth_rate(truth, law, mode, step) >= 0.0:
                at = ", ".join(f"{D:.4g}" for D in delays[mode])
                return f"with true delays of {at} s mode {mode} does not decay"
    return ""
