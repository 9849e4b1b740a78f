"""`identify` from outputs alone: the likeliest plant, and the order and zeros that the log shows.

Extensions of the model are kept if they are significant by likelihood ratio, and a smaller order is
proposed where BIC prefers it. The search begins at scans of the delays, for a long log on stretches
of it, which suffice to locate the maximum. Uneven logs are scanned on a grid.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from deadtime.base.checks import brief
from deadtime.base.errors import ArgumentError
from deadtime.base.wording import number_of
from deadtime.identification.delay_scan import DelayScan, largest_maximum
from deadtime.identification.estimate import Estimate, IdentifiedLog
from deadtime.identification.levels import near_zero
from deadtime.identification.likelihoods.likelihood import maximise
from deadtime.identification.likelihoods.noisy_log import Embedding, NoisyLog
from deadtime.identification.log.logged_states import fit_switching
from deadtime.identification.log.recording import Recording
from deadtime.identification.noisy_estimate import (
    estimate_at,
    require_measured,
    start_with_scan,
)
from deadtime.identification.outputs_maxima import (
    Guess,
    equivalent_delays,
    guess_of,
    scan_starts,
    starts_from_past,
    with_other_delays,
)
from deadtime.identification.parameters import Layout, Window
from deadtime.identification.residuals import CHANCE
from deadtime.identification.sampling import nodes_for
from deadtime.identification.scoring import Maximum
from deadtime.numerics.kernels import expect_many_calls

_FEW = 4_000  # samples that locate the maximum
_DOUBT = 0.05  # level at which zeros are plausible
_WIDE = 0.2  # relative standard error of an input's weight that suggests a spurious pole


class OutputsRequest(NamedTuple):
    """A recording with the states and the range of delays to identify.

    zeros : None to include them if significant; progress : called at every stage
    model : the name of a process model, if one was asked for
    """

    recording: Recording
    layout: Layout
    order: tuple[int, ...]
    zeros: bool | None
    bounds: Window
    within: bool
    progress: Callable[[str], None]
    model: str | None = None


class OutputsModel(NamedTuple):
    """The likeliest plant of a structure, with its likelihood and the last scan.

    added : the numbers of unknowns that jumps, zeros and a level added, as far as they were tried
    other : the likeliest plant with zeros if it has none, without if it has; None if not tried
    rise : 2 (log L with zeros − log L without); more : the number of unknowns that zeros add
    """

    log: NoisyLog
    best: Maximum
    scan: DelayScan
    added: tuple[int, ...] = ()
    other: Maximum | None = None
    rise: float = 0.0
    more: int = 0

    @property
    def shape(self) -> Embedding:
        assert self.log.embedding is not None
        return self.log.embedding

    @property
    def penalised(self) -> float:
        """2 log L less the significance threshold of each extension.

        So plants can be compared of which neither is a special case of the other: one with an
        operating point, and one with zeros that compensate for it.
        """
        from scipy.stats import chi2

        chance = sum(float(chi2.isf(CHANCE, count)) for count in self.added)
        return 2.0 * self.best.value - chance

    def adding(self, wider: OutputsModel) -> OutputsModel:
        """A wider plant with its number of additional unknowns recorded."""
        return wider._replace(added=(*self.added, wider.log.free.size - self.log.free.size))

    @property
    def bic(self) -> float:
        """−2 log L + q log N, of q unknowns and N measurements."""
        count = self.log.measured(self.log.starts(*self.log.bounds))
        return self.log.free.size * float(np.log(count)) - 2.0 * self.best.value


def choose_model(request: OutputsRequest, lead: tuple[int, ...] | None = None) -> OutputsModel:
    """The likeliest plant; `lead`: see `Embedding`."""
    expect_many_calls()
    recording, layout, order, zeros, bounds, within, progress, model = request
    guess = guess_of(recording.gridded(), layout, order, bounds, within)
    integrates = model == "integrating"
    shape = Embedding(order, zeros is True, guess.size, lead, integrates=integrates)
    if integrates:
        theta = guess.theta.copy()
        theta[layout.of_A[:, shape.last, shape.first]] = 0.0
        guess = guess._replace(theta=theta)
    nodes = nodes_for(recording.parts, layout.split(guess.theta)[0])
    some = recording.stretches(_FEW, recording.lag(bounds[1]))
    log = NoisyLog(some, layout, within, bounds, nodes, shape.C, shape)
    require_measured(log, log.free.size)
    before = "".join(f"{n} + " for n in order[:-1])
    progress(f"looking for the delay with {before}{number_of(order[-1], 'state')}")
    simple = _model_of(log, scan_starts(log, guess), starts_from_past(log, guess))
    if not shape.upper.size:
        return simple
    chosen = simple
    if layout.modes > 1 and not within and not integrates:
        progress("trying states that are an output's derivatives in one mode alone")
        free = replace(log, embedding=replace(shape, jumps=True))
        wider = _model_of(free, (), (simple.best.theta,))
        chosen = significant_of(simple, simple.adding(wider))
    if zeros is not None:
        return chosen
    progress("trying inputs that act on all states")
    wider = _with_zeros(chosen, guess)
    if wider.shape.zeros and wider.shape.jumps:  # zeros may have been mistaken for a jump
        alone = _with_zeros(simple, guess)
        return significant_of(alone, wider)
    return wider


def significant_of(simple: OutputsModel, wider: OutputsModel) -> OutputsModel:
    """The wider of two plants if it is significantly likelier, else the simple one."""
    return wider if wider.penalised > simple.penalised else simple


def _with_zeros(simple: OutputsModel, guess: Guess) -> OutputsModel:
    """A plant, or the one with zeros if that is significantly likelier."""
    log = replace(simple.log, embedding=replace(simple.shape, zeros=True))
    starts = *scan_starts(log, guess), simple.best.theta
    wider = simple.adding(_model_of(log, starts, starts_from_past(log, guess)))
    own = significant_of(simple, wider)
    rise = 2.0 * (wider.best.value - simple.best.value)
    other = (simple if own is wider else wider).best
    return own._replace(other=other, rise=rise, more=wider.added[-1])


def _model_of(
    log: NoisyLog, guesses: Sequence[np.ndarray], climbed: Sequence[np.ndarray]
) -> OutputsModel:
    """The likeliest plant: see `largest_maximum`."""
    given = log, guesses, climbed, lambda theta: equivalent_delays(log, theta)
    return OutputsModel(log, *largest_maximum(*given))


def zeros_in_doubt(chosen: OutputsModel, inputs: tuple[str, ...]) -> list[str]:
    """Sentences on the delays with, or without, zeros where both are plausible.

    A zero resembles a delay, so likelihood may rise by chance at any of many delays: a zero is
    certain at Bonferroni's level over all cells scanned.
    """
    from scipy.stats import chi2

    if chosen.other is None:
        return []
    cells = chosen.scan.curves.size
    least, most = (float(chi2.isf(p, chosen.more)) for p in (_DOUBT, CHANCE / cells))
    if not least < chosen.rise < most:
        return []
    D = chosen.other.theta[chosen.log.layout.at_delays]
    one = "the delay" if D.size == 1 else "delays"
    were = f"{one} would be {', '.join(f'{d:.4g}' for d in D)} s"
    whether = "the last derivative alone" if chosen.shape.zeros else "all states"
    acting = "inputs act" if inputs[1:] else f"{inputs[0]} acts"
    return [
        f"The log hardly shows whether {acting} on all states or on the last derivative alone: if "
        f"on {whether}, {were}. Say which by zeros=True or zeros=False, --zeros or --no-zeros."
    ]


def weights_are_uncertain(estimate: Estimate, shape: Embedding) -> bool:
    """Whether the order may be too high: in some chain no input's weight is well known.

    A spurious pole may lie anywhere far to the left, where it acts as a delay, or next to a zero;
    the weights of inputs depend on its place.
    """
    layout, theta = estimate.log.layout, estimate.best.theta
    error = np.sqrt(np.diagonal(estimate.spread.covariance))
    for last, count in zip(shape.last, shape.order, strict=True):
        place = layout.of_B[:, last].reshape(-1)
        if count > 1 and (error[place] > _WIDE * np.abs(theta[place])).all():
            return True
    return False


def order_too_high(request: OutputsRequest, chosen: OutputsModel) -> list[str]:
    """A sentence on a smaller order with lower BIC of the same measurements, if there is one."""
    order, fewer = request.order, []
    for j, count in enumerate(order):
        if count > 1:
            own = (*order[:j], count - 1, *order[j + 1 :])
            layout = replace(request.layout, n=sum(own))
            smaller = request._replace(layout=layout, order=own)
            fewer.append((choose_model(smaller, lead=order).bic, own))
    if not fewer or min(fewer)[0] >= chosen.bic:
        return []
    bic, own = min(fewer)
    say = f"say order={_text(own)}, --order {' '.join(map(str, own))}"
    say = 'say model="fopdt", --model fopdt' if request.model == "sopdt" else say
    return [
        f"An order of {_text(own)} explains the log better (BIC {bic:.1f}, against "
        f"{chosen.bic:.1f} with {_text(order)}): {say}."
    ]


def _text(order: tuple[int, ...]) -> str:
    return str(order[0]) if len(order) == 1 else str(order)


_MOST = 12  # states in all


def identify_outputs(
    recording: Recording,
    order: int | Sequence[int],
    zeros: bool | None,
    per_mode: bool,
    bounds: Window,
    within: bool,
    progress: Callable[[str], None],
    model: str | None = None,
) -> IdentifiedLog:
    """The likeliest plant with given numbers of states of each output."""
    counts = order_of(order, recording.outputs)
    _require_moving(recording)
    constant = recording.level is not None
    layout = Layout(len(recording.modes), sum(counts), len(recording.inputs), per_mode, constant)
    request = OutputsRequest(recording, layout, counts, zeros, bounds, within, progress, model)
    estimate, chosen = estimate_from_outputs(request)
    shape = chosen.shape
    names = state_names(recording.outputs, counts, shape.zeros or shape.jumps)
    high = order_too_high(request, chosen) if weights_are_uncertain(estimate, shape) else []
    estimate, others = with_other_delays(estimate)
    unsure = [] if high or others else zeros_in_doubt(chosen, recording.inputs)
    doubts = ("a smaller order explains the log better",) if high else ()
    doubts += ("the log hardly shows on which states inputs act",) if unsure else ()
    given = estimate, estimate.log.recording, *fit_switching(recording), shape.C, names
    return IdentifiedLog(*given, tuple(high or others or unsure), doubts)


def _require_moving(recording: Recording) -> None:
    """Refuse outputs that never move."""
    every = np.vstack([part.output for part in recording.parts])
    for name, column in zip(recording.outputs, every.T, strict=True):
        known = column[np.isfinite(column)]
        if not known.size or np.ptp(known) == 0.0:
            raise ArgumentError(
                f"{name} must move, got {known[0] if known.size else 'nothing'} throughout: leave "
                "it out by outputs=[…]."
            )


def _about_its_rest(request: OutputsRequest) -> tuple[OutputsModel, OutputsRequest]:
    """The likeliest plant that rests at 0, or elsewhere if that is significantly likelier.

    Each is searched on its own: a climb from a maximum of one may end at a lower one of the other.
    """
    if request.layout.constant and not near_zero(request.recording):
        return choose_model(request), request
    layout = replace(request.layout, constant=False)
    plain = request._replace(recording=request.recording.absolute(), layout=layout)
    chosen = choose_model(plain)
    if not request.layout.constant:
        return chosen, plain
    other = choose_model(request)
    level = (other.log.free.size - sum(other.added)) - (chosen.log.free.size - sum(chosen.added))
    other = other._replace(added=(*other.added, level))
    return (other, request) if significant_of(chosen, other) is other else (chosen, plain)


def estimate_from_outputs(request: OutputsRequest) -> tuple[Estimate, OutputsModel]:
    """The estimate of the requested plant, and how it was chosen."""
    chosen, request = _about_its_rest(request)
    recording = request.recording
    theta = chosen.best.theta
    nodes = nodes_for(recording.parts, request.layout.split(theta[: request.layout.size])[0])
    log = replace(chosen.log, recording=recording, nodes=nodes)
    request.progress("finding intervals")
    top, window = maximise(log, theta)
    start = start_with_scan(log, top, chosen.scan, chosen.log.recording.samples)
    try:
        return estimate_at(log, top, window, start), chosen
    except ArgumentError as error:
        raise ArgumentError(" ".join((str(error), *order_too_high(request, chosen)))) from None


def order_of(order: Any, outputs: tuple[str, ...]) -> tuple[int, ...]:
    """The number of states of each output; one number applies to every output.

    Examples
    --------
    >>> order_of(2, ("position", "angle")), order_of((2, 1), ("position", "heat"))
    ((2, 2), (2, 1))
    """
    several = isinstance(order, Iterable) and not isinstance(order, str)
    given: list[Any] = list(order) if several else [order] * len(outputs)
    whole = [isinstance(one, int | np.integer) and not isinstance(one, bool) for one in given]
    if not given or not all(whole) or min(given) < 1 or sum(given) > _MOST:
        raise ArgumentError(
            "order must be how many states each output has, such as 2 for a position, or (2, 1), "
            f"at least 1 each and {_MOST} in all, got {brief(order)}."
        )
    if len(given) != len(outputs):
        raise ArgumentError(
            f"order must have a number for each output, {len(outputs)} ({', '.join(outputs)}), "
            f"got {len(given)}: {brief(order)}."
        )
    return tuple(int(one) for one in given)


def require_logged(C: Any, noise: bool | None, hidden: bool) -> None:
    """Refuse arguments that do not go with `order`."""
    if C is not None:
        raise ArgumentError(
            "C must be left out beside order: the states are chosen so that outputs are the first "
            "of each chain."
        )
    if noise is False:
        raise ArgumentError(
            "noise must not be False with order: from outputs alone noise of the sensors is always "
            "estimated. Leave it out."
        )
    if hidden:
        raise ArgumentError(
            "modes must be logged where order is given, got a number of hidden ones: they can be "
            "identified from all states alone. Log the mode, or all states; of one mode say "
            "modes=None, --one-mode."
        )


def state_names(
    outputs: tuple[str, ...], order: tuple[int, ...], numbered: bool
) -> tuple[str, ...]:
    """Names of states: outputs with primes for their derivatives, or with numbers.

    Examples
    --------
    >>> state_names(("position", "heat"), (3, 1), False)
    ('position', "position'", "position''", 'heat')
    >>> state_names(("position",), (2,), True)
    ('position', 'position (2)')
    """
    each = [(name, k) for name, count in zip(outputs, order, strict=True) for k in range(count)]
    number = " ({})".format if numbered else lambda k: "'" * (k - 1)
    return tuple(name + (number(k + 1) if k else "") for name, k in each)
