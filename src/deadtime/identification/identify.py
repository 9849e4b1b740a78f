"""`identify`: from a log to a plant."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from os import PathLike
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.base.checks import number, real_array
from deadtime.base.errors import ArgumentError
from deadtime.identification.delay_intervals import delay_intervals
from deadtime.identification.hidden.identified import Sensed, identify_hidden
from deadtime.identification.hidden.request import numbers_of
from deadtime.identification.identification import Identification
from deadtime.identification.intervals import spread_of
from deadtime.identification.logged_modes import fit_switching
from deadtime.identification.maximum import ExactLog, maximise
from deadtime.identification.noise import continuous, estimate_with_noise
from deadtime.identification.outputs.identified import identify_outputs
from deadtime.identification.outputs.request import require_logged
from deadtime.identification.over_peaks import ends_over_peaks
from deadtime.identification.parameters import Layout
from deadtime.identification.recording import Recording, read_recording
from deadtime.identification.regression import concentrated
from deadtime.identification.residuals import judge_residuals, residuals_of
from deadtime.identification.start import start_of
from deadtime.identification.uneven import gridded, nodes_for
from deadtime.identification.units import require_same_units, require_seconds
from deadtime.identification.untold import reasons
from deadtime.plant import SwitchedSystem

if TYPE_CHECKING:
    import pandas as pd

    from deadtime.identification.estimate import Estimate

_SAME = 1e-13  # of the least eigenvalue of the correlation of states
_SIZES = 1e-70, 1e70  # of what is measured, and of inputs
_SHORTEST = 1e-6  # of a period: the shortest delay


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
) -> Identification:
    """The plant that a log is likeliest of: matrices, delays and noise, each with its interval.

        dx/dt = A_σ x + Σ_j b_σ,j u_j(t − D_j) + white noise,    y_k = C x_k + v_k

    by maximum likelihood, exact at any fraction of a period: docs/theory/identification.md.

    Parameters
    ----------
    log : path, DataFrame, or list of them
        CSV with a header, or a table: columns t (seconds, rising), x1, x2, … (y1, y2, … with C or
        order), u1, u2, … and the mode. An input holds from its row's t to the next one's. A
        measurement that is missing is left empty. The rows need not be evenly spaced.
    modes : str, None, int or sequence of int
        The column of the mode, numbers or texts; None: the plant has one. Of modes that were not
        logged their number; of several, such as ``range(1, 4)``, the one of least BIC is taken.
    delay : (low, high)
        The range in which all delays are looked for, seconds.
    per_mode : bool
        Whether every mode has delays of its own.
    noise : bool, optional
        Whether measurements are noisy. By default that is tried where the residuals are not white.
    C : array_like, shape (p, n), optional
        Of the outputs y = C x, of rank n; without it the states themselves are logged.
    switches : "anywhere" or "samples"
        Whether the mode changes at any time, so that of a period in which it does nothing is known,
        or only at samples.
    states, inputs, outputs : sequence of str, optional
        The columns, where they have other names; outputs with C or order.
    order : int or sequence of int, optional
        How many states each output has, where there are fewer outputs than states: 2 of a position.
        Then the states are outputs and their derivatives: docs/theory/outputs.md.
    zeros : bool, optional
        Of `order`: whether inputs act on all states of an output, and not on the last derivative
        alone, so that the others are no derivatives. By default, where the log asks for it.

    Returns
    -------
    Identification

    Raises
    ------
    ArgumentError
        If the log is malformed (its line is named), too short, or does not tell an unknown; if
        modes that were not logged are too many for it; if outputs do not have so many states.

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
    if switches not in ("anywhere", "samples"):
        raise ArgumentError(f'switches must be "anywhere" or "samples", got {switches!r}.')
    low, high = _range(delay)
    numbers = numbers_of(modes)
    column = modes if isinstance(modes, str) else None
    letter = "x" if C is None and order is None and outputs is None else "y"
    recording = read_recording(
        log,
        column,
        states if outputs is None else outputs,
        inputs,
        letter,
        lambda parts, columns, *names: require_same_units(parts, columns, high, *names),
    )
    require_seconds(recording, high)
    bounds = max(low, _SHORTEST * recording.step), high
    within = switches == "anywhere"
    if order is not None:
        require_logged(C, noise, numbers is not None)
        of = identify_outputs(recording, order, zeros, per_mode, bounds, within)
        fit = Identification.of(of.estimate, recording, of.model, of.why, of.C, of.states)
        return replace(fit, sentences=(*fit.sentences, *of.sentences))
    _require_order_for(zeros, outputs, C)
    sensors = _sensors(C, recording)
    direct = _as_states(recording, sensors)
    count = sensors.shape[1]
    named = recording.outputs if C is None else tuple(f"x{i + 1}" for i in range(count))
    _require_sizes(recording)
    _require_states(direct, named)
    layout = Layout(len(recording.modes), sensors.shape[1], len(recording.inputs), per_mode)
    said: tuple[str, ...] = ()
    if numbers is not None:
        sensed = Sensed(direct, recording, sensors, True if C is not None else noise)
        hidden = identify_hidden(sensed, numbers, layout, bounds, within)
        if hidden.estimate is not None:
            return Identification.of_hidden(hidden, sensors, named)
        said = hidden.sentences
    found = _exact(direct, layout, bounds, within)
    if C is not None or noise or (noise is None and not found.tests.white):
        found = estimate_with_noise(recording, sensors, found, within, bounds)
    model, why = fit_switching(recording)
    fit = Identification.of(found, recording, model, why, sensors, named)
    return replace(fit, sentences=(*said, *fit.sentences))


def _range(delay: object) -> tuple[float, float]:
    """The range of delays."""
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


def _require_order_for(zeros: object, outputs: object, C: object) -> None:
    """Refuse what only outputs alone have."""
    if zeros is not None:
        raise ArgumentError("zeros is of outputs alone: give order, too, or leave zeros out.")
    if outputs is not None and C is None:
        raise ArgumentError(
            "outputs needs order, how many states each has, or C, what they are of the states; "
            "columns that are the states are states=[…]."
        )


def _sensors(C: ArrayLike | None, recording: Recording) -> Float[np.ndarray, "p n"]:
    """C, the identity where states are logged."""
    count = len(recording.outputs)
    if C is None:
        return np.eye(count)
    given = real_array("C", C, "(p, n)", 2)
    p, n = given.shape
    if p != count:
        raise ArgumentError(f"C must have a row for each output, {count}, got {p}.")
    rank = np.linalg.matrix_rank(given)
    if rank < n:
        raise ArgumentError(
            f"C must have rank n = {n}, got {rank}: from fewer outputs than states the "
            "matrices are known only up to a change of states. Log all states, or leave C out and "
            "say how many states each output has: order=2 takes it and its derivative."
        )
    return given


def _as_states(recording: Recording, C: Float[np.ndarray, "p n"]) -> Recording:
    """The recording with states in place of outputs, by least squares."""
    if np.array_equal(C, np.eye(C.shape[0])):
        return recording
    back = np.linalg.pinv(C).T
    parts = tuple(part._replace(output=part.output @ back) for part in recording.parts)
    return recording._replace(parts=parts)


def _require_sizes(recording: Recording) -> None:
    """Refuse columns whose squares, and those of their ratios, leave the range of floats."""
    least, most = _SIZES
    for at, names in ((1, recording.outputs), (2, recording.inputs)):
        every = np.abs(np.vstack([part[at] for part in recording.parts]))
        for name, size in zip(names, np.nanmax(every, axis=0, initial=0.0), strict=True):
            if size > 0.0 and not least <= size <= most:
                raise ArgumentError(
                    f"{name} must be of a size between {least:g} and {most:g}, got {size:.3g}: "
                    "log it in another unit."
                )


def _require_states(recording: Recording, names: Sequence[str]) -> None:
    """Refuse states that never move, or that others say already."""
    every = np.vstack([part.output for part in recording.parts])
    every = every[np.isfinite(every).all(axis=1)]
    spread = every.std(axis=0) if len(every) else np.zeros(len(names))
    still = [name for name, one in zip(names, spread, strict=True) if not one > 0.0]
    if still:
        got = "the same in every row" if len(every) else "no row"
        raise ArgumentError(
            f"{still[0]} must move, got {got} where all states are known: leave it out by "
            "states=[…], --states, or log it."
        )
    values, vectors = np.linalg.eigh(np.corrcoef(every.T).reshape(len(names), -1))
    if values[0] < _SAME:
        part = [name for name, one in zip(names, vectors[:, 0], strict=True) if abs(one) > 0.1]
        raise ArgumentError(
            f"{', '.join(part)} must be states of their own, got such that one is a sum of the "
            "others: leave it out by states=[…], --states."
        )


def _exact(
    recording: Recording, layout: Layout, bounds: tuple[float, float], within: bool
) -> Estimate:
    """The estimate if states are measured without noise."""
    from deadtime.identification.estimate import Estimate

    start = start_of(gridded(recording), layout, bounds, within)
    nodes = nodes_for(recording.parts, layout.split(start.theta)[0])
    log = ExactLog(recording, layout, within, bounds, nodes)
    best, window = maximise(log, start.theta)
    terms = log.terms_in(*window)(log.cells(best.theta))(best.theta)
    F, covariances = concentrated(terms, layout.size)
    counts = np.array([term.periods for term in terms])
    spare = np.maximum(counts - layout.n - layout.m - 1, 1)
    parts = [concentrated([term], layout.size)[0].information for term in terms]
    known = np.einsum("i,iab->ab", spare / counts, parts)
    try:
        spread = spread_of(F.information, layout.names(), known, layout.of_each(spare))
    except ArgumentError as error:
        why = [reasons(recording, j, bounds[1] - bounds[0]) for j in range(layout.m)]
        said = dict.fromkeys(sentence for sentences in why for sentence in sentences)
        raise ArgumentError(" ".join((str(error), *said))) from None
    intervals, several = delay_intervals(log, best, window, spread, start)
    A, B, delays = layout.split(best.theta)
    plant = SwitchedSystem(A, B, delays)
    covariances = covariances * (counts / spare)[:, None, None]
    white = residuals_of(recording, plant, nodes, within, np.linalg.cholesky(covariances))
    return Estimate(
        log=log,
        best=best,
        window=window,
        plant=plant,
        spread=spread,
        intervals=intervals,
        several=several,
        start=start,
        disturbance=continuous(A, covariances, recording.step),
        noise=np.zeros(layout.n),
        spare=spare,
        tests=judge_residuals(white, recording, float(delays.max())),
        white=tuple(white),
        ends=ends_over_peaks(log, best, spread, start),
    )
