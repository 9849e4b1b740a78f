"""`identify`: the maximum-likelihood plant of a log, and which model of the log that needs.

States may be exact or noisy, in open or in closed loop, modes logged or hidden, and outputs fewer
than states; each case has a module of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from os import PathLike
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from deadtime.base.checks import number, reporter
from deadtime.base.errors import ArgumentError
from deadtime.identification.between_samples import degree_of, require_causal, with_hold_tested
from deadtime.identification.estimate import IdentifiedLog
from deadtime.identification.exact_estimate import estimate_exactly
from deadtime.identification.identifiability import fed_back
from deadtime.identification.identification import Identification
from deadtime.identification.identify_hidden import identify_hidden, numbers_of
from deadtime.identification.identify_outputs import identify_outputs, order_of, require_logged
from deadtime.identification.levels import level_of
from deadtime.identification.log.logged_states import (
    as_states,
    disproved,
    fit_switching,
    require_sizes,
    require_states,
    resting,
    sensors_of,
)
from deadtime.identification.log.read_options import ReadOptions
from deadtime.identification.log.read_recording import read_recording
from deadtime.identification.log.recording import Recording
from deadtime.identification.log.unit_changes import require_same_units, require_seconds
from deadtime.identification.noisy_estimate import (
    estimate_in_loop,
    estimate_with_noise,
    may_be_exact,
)
from deadtime.identification.parameters import SHORTEST, Layout
from deadtime.identification.process_models import (
    order_of_model,
    process_sentences,
    require_one_output,
)
from deadtime.identification.residuals import alternates
from deadtime.identification.validation import NOT_LOGGED, log_to_compare

if TYPE_CHECKING:
    import pandas as pd


def identify(
    log: str | PathLike[str] | pd.DataFrame | Sequence,
    modes: str | int | Sequence[int] | None = "mode",
    delay: tuple[float, float] = (0.0, 2.0),
    *,
    per_mode: bool = False,
    noise: bool | None = None,
    C: ArrayLike | None = None,
    switches: str = "anywhere",
    states: Sequence[str] | None = None,
    inputs: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
    order: int | Sequence[int] | None = None,
    zeros: bool | None = None,
    model: str | None = None,
    rest: bool | None = None,
    hold: str | None = None,
    test: str | PathLike[str] | float | pd.DataFrame | Sequence | None = None,
    time: str | None = None,
    step: float | None = None,
    sep: str | None = None,
    decimal: str | None = None,
    on_change: Sequence[str] = (),
    progress: Callable[[str], None] | None = None,
) -> Identification:
    r"""The maximum-likelihood plant of a log: matrices, delays and noise, with intervals.

    .. math::

        \dot x = A_\sigma x + \sum_j b_{\sigma,j} u_j(t - D_j) + \text{white noise},
        \quad y_k = C x_k + v_k

    The likelihood is exact for delays at any fraction of a period: docs/theory/identification.md.

    Parameters
    ----------
    log : path, DataFrame, or list of them
        A text file with a header, or a table: columns t (rising), x1, x2, … (y1, y2, … with C or
        order), u1, u2, … and the mode. An input is held until the next row: see `hold`. A
        missing measurement is an empty cell. The rows need not be evenly spaced.
    modes : str, None, int or sequence of int
        The column of the mode, numbers or texts; None for a plant of one mode, which it also has if
        there is no column mode and no other is named. For modes that were
        not logged their number, or several, such as ``range(1, 4)``, of which BIC selects one.
    delay : (low, high)
        The range in which all delays are searched, seconds.
    per_mode : bool
        Whether every mode has delays of its own.
    noise : bool, optional
        Whether measurements are noisy. By default noise is tried if the residuals are not white.
    C : array_like, shape (p, n), optional
        The matrix of the outputs y = C x, of rank n; without it the states themselves are logged.
    switches : "anywhere" or "samples"
        Whether the mode changes at any time, so that periods in which it does are left out, or only
        at samples.
    states, inputs, outputs : sequence of str, optional
        The columns, where they have other names; outputs with C or order.
    order : int or sequence of int, optional
        The number of states of each output, if there are fewer outputs than states: 2 for a
        position. The states are outputs and their derivatives: docs/theory/outputs.md.
    zeros : bool, optional
        With `order`: whether inputs act on all states of an output, which are then not derivatives,
        instead of the last derivative alone. By default, if the log shows it significantly.
    model : "fopdt", "sopdt" or "integrating", optional
        A process model of one output, in column y1 or x1 or chosen by `outputs`, with a gain and a
        dead time for each input: of first order (as order=1), of second order without zeros (as
        order=2, zeros=False), or an integrator with a velocity gain, with order=2 behind a lag.
        Other settings give the same results in `Identification.processes`.
    rest : bool, optional
        Whether inputs before the log equal those of its first row. By default, if inputs and states
        are constant at first and the residuals do not contradict it.
    hold : "held" or "linear", optional
        How inputs run between samples: held, as the output of a digital law is, or changing
        linearly, as a sampled measurement of an analog input nearly does. By default they are taken
        as held, and this is tested; a linear input that is taken as held makes a delay half a
        period too short.
    test : "half", float, path, DataFrame, or list of them, optional
        Another log to validate the plant with, or the share of the log to hold out for that, of
        every log its last rows; "half" is 0.5. The plant is identified from the rest.
    time : str, optional
        The column of times, if not t or time: seconds, stamps such as 2026-03-02 08:15:00.5 or
        02.03.2026 08:15, or a clock that counts from 1970.
    step : float, optional
        The sampling period of a log without times, seconds.
    sep, decimal : str, optional
        The separator of columns and the sign of decimals, as in pandas.read_csv; found by default.
    on_change : sequence of str
        Columns of inputs, or of the mode, in whose empty cells the value before still holds. By
        default those that never repeat a value where chance would.
    progress : callable, optional
        Called with a few words at every stage.

    Returns
    -------
    Identification

    Raises
    ------
    ArgumentError
        If the log is malformed (the message names the line), too short, or does not identify an
        unknown; if there are too many hidden modes for it; if outputs do not have so many states.

    References
    ----------
    Ljung, "System Identification", 2nd ed., Prentice Hall 1999, chapters 7 and 9, for the method;
    Dempster, Laird and Rubin, J. Royal Statistical Society B 39(1), 1977, for hidden modes.

    Examples
    --------
    >>> import deadtime as dt, numpy as np, pandas as pd
    >>> rng = np.random.default_rng(0)
    >>> x, u = np.zeros(300), rng.standard_normal(300)
    >>> for k in range(3, 299):    # dx/dt = −x + u(t − 0.27), sampled every 0.1 s
    ...     late, soon = np.exp(-0.03) - np.exp(-0.1), 1.0 - np.exp(-0.03)
    ...     x[k + 1] = np.exp(-0.1) * x[k] + late * u[k - 3] + soon * u[k - 2]
    ...     x[k + 1] += 0.01 * rng.standard_normal()
    >>> log = pd.DataFrame({"t": 0.1 * np.arange(300), "x": x, "u": u})
    >>> fit = dt.identify(log, modes=None, delay=(0.0, 1.0))
    >>> fit.delays.round(3), fit.delay_interval.round(3)
    (array([[0.27]]), array([[[0.269, 0.271]]]))
    >>> dt.identify(log, modes=range(1, 3), delay=(0.0, 1.0)).plant.modes    # how many are there?
    1
    """
    require_switches(switches)
    degree = degree_of(hold)
    progress = reporter("progress", progress)
    noise, zeros, rest = choice("noise", noise), choice("zeros", zeros), choice("rest", rest)
    low, high = range_of_delays(delay)
    if model is not None:
        order, zeros = order_of_model(model, order, zeros, C), False
    numbers = numbers_of(modes)
    column = modes if isinstance(modes, str) else None
    letter = "x" if C is None and order is None and outputs is None else "y"
    letter = letter if model is None else "yx"
    progress("reading the log")
    recording = read_recording(
        log,
        column,
        states if outputs is None else outputs,
        inputs,
        letter,
        lambda parts, columns, *names: require_same_units(parts, columns, high, *names),
        ReadOptions.of(time, step, sep, decimal, on_change),
    )
    recording = recording._replace(hold=degree or 0)
    require_seconds(recording, high)
    require_causal(recording, (low, high), noise)
    require_one_output(model, recording.columns.outputs)
    if test is not None and numbers is not None:
        raise ArgumentError(NOT_LOGGED)
    recording, compared = log_to_compare(test, recording, high + recording.step, rest)
    if order is None:
        require_order_for(zeros, outputs, C)
    else:
        require_logged(C, noise, numbers is not None)
        ones = set(order_of(order, recording.outputs)) == {1}
        if ones and model != "integrating":  # then outputs are the states
            order = None
    within = switches == "anywhere"

    def finished(log: IdentifiedLog) -> Identification:
        return Identification.of(with_hold_tested(log, degree))

    def from_recording(recording: Recording) -> Identification:
        bounds = max(low, SHORTEST * recording.step), high
        about = recording.about(level_of(recording))
        if order is not None:
            of = about, order, zeros, per_mode, bounds, within, progress, model
            return finished(identify_outputs(*of))
        sensors = sensors_of(C, recording)
        exact_states, n = as_states(about, sensors), sensors.shape[1]
        named = recording.outputs if C is None else tuple(f"x{i + 1}" for i in range(n))
        require_sizes(recording)
        require_states(as_states(recording, sensors), named)
        layout = Layout(len(recording.modes), n, len(recording.inputs), per_mode, constant=True)
        sentences: tuple[str, ...] = ()
        if numbers is not None:
            of = about, sensors, named, noise if C is None else True
            how = numbers, layout, bounds, within, progress
            hidden, sentences = identify_hidden(*of, *how)
            if hidden is not None:
                return finished(hidden)
        progress(f"looking for the delay between {low:g} and {high:g} s")
        estimate = estimate_exactly(exact_states, layout, bounds, within)
        sure, white = C is not None or bool(noise), list(estimate.white)
        loop = noise is not False and bool(fed_back(recording).any())
        if loop or sure or (noise is None and (not estimate.tests.white or alternates(white))):
            progress(f"taking sensors for noisy{', as inputs follow them' if loop else ''}")
            noisy_estimate = estimate_in_loop if loop else estimate_with_noise
            noisy = noisy_estimate(about, sensors, estimate)
            estimate = noisy if sure or not may_be_exact(estimate, noisy) else estimate
        switching = fit_switching(recording)
        given = estimate, estimate.log.recording, *switching, sensors, named
        fit = finished(IdentifiedLog(*given))
        if fit.delays_not_found:
            return replace(fit, sentences=(*fit.sentences, *sentences))
        return replace(fit, sentences=(*sentences, *fit.sentences))

    fit = from_recording(resting(recording, rest))
    if rest is None and disproved(fit._recording, fit._estimate.white, fit.plant.longest_delay):
        progress("looking again, as inputs before the log were others than its first")
        fit = from_recording(resting(recording, False))
    if compared is not None:
        progress(f"predicting the {compared.name}")
    fit, first = fit.validated(compared), []
    if model is not None:
        first = process_sentences(fit.processes, fit._recording, len(fit.C))
    every = (*first, *fit.sentences, *recording.read_as)
    return replace(fit, sentences=tuple(dict.fromkeys(every)))


def require_switches(switches: object) -> None:
    if switches not in ("anywhere", "samples"):
        raise ArgumentError(f'switches must be "anywhere" or "samples", got {switches!r}.')


def choice(name: str, value: object) -> bool | None:
    """A checked option: True, False, or None to decide by the log."""
    if value is None:
        return None
    if isinstance(value, bool | np.bool_):
        return bool(value)
    raise ArgumentError(
        f"{name} must be True, False, or None to find out from the log, got {value!r}."
    )


def range_of_delays(delay: object) -> tuple[float, float]:
    try:
        low, high = delay  # pyright: ignore[reportGeneralTypeIssues]
    except (TypeError, ValueError):
        raise ArgumentError(
            f"delay must be the range (low, high) to look in, in seconds, got {delay!r}."
        ) from None
    low, high = number("delay[0]", low), number("delay[1]", high)
    if not 0.0 <= low < high:
        raise ArgumentError(
            f"delay must be a range 0 ≤ low < high, in seconds, got ({low:g}, {high:g})."
        )
    return low, high


def require_order_for(zeros: object, outputs: object, C: object) -> None:
    """Refuse arguments that need `order`."""
    if zeros is not None:
        raise ArgumentError("zeros is of outputs alone: give order, too, or leave zeros out.")
    if outputs is not None and C is None:
        raise ArgumentError(
            "outputs needs order, the number of states of each, or C in y = C x; columns of the "
            "states themselves are states=[…]."
        )
