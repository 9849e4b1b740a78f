"""The text of a problem file of an identified plant, and the process noise of its observer.

If a disturbance is not significant, its likeliest intensity may be nearly 0. A Kalman filter
designed on it trusts its model alone: its error decays at the rate of the plant, or not at all.
Such a filter is of no use in a loop, and the log does not require it.

The states are chains of derivatives. White noise of intensity q on the last state of each chain
reaches all of its states through integrators, without zeros. So the error decays faster for larger
q, like q^(1/2k) in a chain of k states, up to the limit of sampling.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from deadtime.base.checks import positive
from deadtime.base.errors import ArgumentError
from deadtime.base.wording import amount, one_line
from deadtime.estimation import kalman
from deadtime.gains import lqr
from deadtime.identification.parameters import Square
from deadtime.plant import SwitchedSystem

if TYPE_CHECKING:
    from deadtime.identification.identified_plant import Findings


_LEFT_OUT = "# Noise of the sensors is left out: it is of y = C x, and the file's would be of x."
_DELAYS = 20.0  # longest delays in a run, at least
_SOJOURNS = 5.0  # mean sojourns in the mode that lasts longest, at least
_MOST = 60  # factors of 4


def problem_text(fit: Findings, title: str = "", horizon: float | None = None) -> str:
    """The problem file of an identification, with its intervals as comments."""
    plant, n, m = fit.plant, fit.plant.states, fit.plant.inputs
    filtered = filter_noise(fit) if _alone(fit) else (fit.disturbance[0], "")
    if horizon is None:  # many delays, and several sojourns of every mode
        sojourn = 0.0 if fit.model is None else float(fit.model.mean.max())
        length = max(_DELAYS * plant.longest_delay, _SOJOURNS * sojourn)
    else:
        length = positive("horizon", horizon)
    length = round(fit.step * float(np.ceil(length / fit.step - 1e-9)), 12)
    numbers = tuple(map(str, range(plant.modes)))  # the names that a file gives modes by default
    named = _text(title or f"Identified from {fit.samples} samples")
    lines = [f"# {one_line(sentence)}" for sentence in fit.sentences]
    if len(fit.C) > 1:  # of one output the sentences say it
        lines += [f"# {one.label(plant.modes)}: {one}." for one in fit.processes]
    lines += ["", f"title = {named}", "", "[plant]", *_delay_lines(fit)]
    for name, matrices in (("A", plant.A), ("B", plant.B)):
        lines += [f"{name} = [", *(f"  {_lists(one)}," for one in matrices), "]"]
    lines += [
        f"states = {_texts(fit.states)}",
        f"inputs = {_texts(fit.inputs)}",
        *([] if fit.modes == numbers else [f"modes = {_texts(fit.modes)}"]),
        "",
        *_operating_point(fit),
        *_uncertainty(fit),
        "[gains]    # of least ∫|x|² + |u|²: change them to yours",
        f"lqr = {{Q = {_lists(np.eye(n))}, R = {_lists(np.eye(m))}}}",
        "",
        *_observer(fit, filtered),
        *_switching(fit, filtered),
        "[run]",
        f"x0 = {_lists(np.round(fit.largest_states, 12))}    # the largest in the log",
        f"horizon = {_number(length)}",
        f"step = {_number(fit.step)}",
    ]
    lines += _noise(fit)
    return "\n".join([*lines, ""])


def _delay_lines(fit: Findings) -> list[str]:
    """The delays, and their intervals as a comment."""
    D, ends = fit.delays, fit.delay_interval
    same = (D[0] == D).all()
    value = _number(D[0, 0]) if D[0].size == 1 and same else _lists(D[0] if same else D)
    rows = ends[:1] if same else ends
    within = "; ".join(f"{low:.6g} … {high:.6g}" for low, high in rows.reshape(-1, 2))
    about = "not found: see above" if fit.delays_not_found else f"at 95 %: {within}"
    return [f"delay = {value}    # s; {about}"]


def _operating_point(fit: Findings) -> list[str]:
    """The operating point, and the offsets of modes there, unless they are 0."""
    if (point := fit.operating_point) is None:
        return []
    lines = ["[operating_point]    # all states and inputs of this file are deviations from it"]
    lines += [f"x = {_lists(point.x)}", f"u = {_lists(point.u)}", ""]
    for i, force in enumerate(fit.offset):
        if force.any():
            lines += ["[[offset]]", f"mode = {i}", f"force = {_lists(force)}", ""]
    return lines


def _uncertainty(fit: Findings) -> list[str]:
    """The covariance of all that was identified, to seven digits; nothing if a delay is missing."""
    if fit.delays_not_found:
        return []
    rows = fit.uncertain.covariance
    lines = ["[uncertainty]    # of A row by row, mode by mode, then B, then the delays"]
    lines += ["covariance = [", *(f"  [{', '.join(f'{v:.6e}' for v in row)}]," for row in rows)]
    return [*lines, "]", ""]


def _switching(fit: Findings, filtered: tuple[np.ndarray, str]) -> list[str]:
    """The switching: the fitted model, or a constant mode without one."""
    if fit.model is None:
        return ["[signal]", 'kind = "constant"', "mode = 0", ""]
    lines = [fit.model.section(), ""]
    lines += ['[mode_filter]    # for laws of kind "belief", which do not read the mode']
    raised, why = filtered
    lines += [f"disturbance = {_lists(raised)}"] if why else _disturbance("disturbance", fit)
    if _alone(fit):
        size = np.round(fit.largest_states**2, 12)
        lines += [f"noise = {_lists(fit.noise)}", f"covariance = {_lists(size)}"]
    elif fit.noise.any():
        lines += [f"noise = {_lists(fit.noise)}" if _of_states(fit) else _LEFT_OUT]
    return [*lines, "", "[signal]", 'kind = "model"', ""]


def _noise(fit: Findings) -> list[str]:
    """Imperfections of the file's runs: the noise of the log."""
    lines = ["", "[[imperfection]]", 'kind = "white-disturbance"']
    lines += _disturbance("intensity", fit)
    if fit.noise.any() and (_of_states(fit) or _alone(fit)):
        lines += ["", "[[imperfection]]", 'kind = "noise"', f"std = {_lists(fit.noise)}"]
    elif fit.noise.any():
        lines += ["", _LEFT_OUT]
    return lines


def _alone(fit: Findings) -> bool:
    """Whether there are fewer outputs than states, so that the file's laws need an observer."""
    return len(fit.C) < fit.plant.states


def _observer(fit: Findings, filtered: tuple[np.ndarray, str]) -> list[str]:
    """Kalman's filter where outputs alone are measured, of noise that leaves it fast enough."""
    if not _alone(fit):
        return []
    W, why = filtered
    return [
        "[observer]    # laws get its estimate of the states",
        'kind = "kalman"',
        f"C = {_lists(fit.C)}",
        f"outputs = {_texts(fit._recording.outputs)}",
        *([f"# {why}", f"process = {_lists(W)}"] if why else _disturbance("process", fit)),
        f"measurement = {_lists(np.diag(fit.noise**2))}",
        "",
    ]


def _of_states(fit: Findings) -> bool:
    """Whether sensors measure the states themselves, so that their noise is one of states."""
    return np.array_equal(fit.C, np.eye(fit.plant.states))


def _disturbance(key: str, fit: Findings) -> list[str]:
    """W of every mode, or the one that all have."""
    W = fit.disturbance
    if (W[0] == W).all():
        return [f"{key} = {_lists(W[0])}"]
    return [f"{key} = [    # of every mode", *(f"  {_lists(one)}," for one in W), "]"]


def _number(value: float) -> str:
    return repr(float(value))


def _lists(array: np.ndarray) -> str:
    return str(np.asarray(array, dtype=float).tolist())


def _text(text: str) -> str:
    escaped = one_line(text).replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'


def _texts(names: tuple[str, ...]) -> str:
    return f"[{', '.join(map(_text, names))}]"


def filter_noise(fit: Findings) -> tuple[Square, str]:
    """W for the observer, and the reason in a sentence if it is not the likeliest.

    Noise on the last derivative of every output is raised from the upper end of its interval by the
    smallest power of 4 for which the observer's error decays, in every constant mode, at least as
    fast as the loop with the file's gains.
    """
    W, shape = fit.disturbance[0], fit._estimate.of_outputs and fit._estimate.of_outputs.embedding
    if shape is None or not fit.noise.all():
        return W, ""
    ends = np.array([fit.interval(f"disturbance[0][{a},{a}]") for a in shape.last])
    pace = _loop_pace(fit.plant)
    if pace is None or ends[:, 0].all() or not np.isfinite(ends).all():
        return W, ""
    for factors in range(_MOST):
        raised = W.copy()
        raised[shape.last, shape.last] = 4.0**factors * ends[:, 1]
        decay = _decay(fit, raised)
        if decay < pace:
            continue
        each = zip(shape.last, np.diag(raised)[shape.last], strict=True)
        values = ", ".join(f"{amount(value)} for {fit.states[a]}" for a, value in each)
        likeliest, here, loop = (amount(max(r, 0.0)) for r in (_decay(fit, W), decay, pace))
        return raised, (
            "The log cannot show whether there is process noise. An observer tuned to the best "
            f"estimate would settle at {likeliest} /s, so the file's is tuned to {values} and "
            f"settles at {here} /s, at least as fast as the loop, {loop} /s."
        )
    return W, ""


def _loop_pace(plant: SwitchedSystem) -> float | None:
    """The decay rate of the slowest mode with the file's gains, 1/s; None without gains."""
    try:
        gains = lqr(plant, np.eye(plant.states), np.eye(plant.inputs))
    except ArgumentError:
        return None
    return -float(np.linalg.eigvals(plant.A + plant.B @ gains).real.max())


def _decay(fit: Findings, W: np.ndarray) -> float:
    """The decay rate of the error of an observer designed on W in the slowest mode, 1/s; or 0."""
    try:
        return -float(kalman(fit.plant, fit.C, W, np.diag(fit.noise**2), fit.step).rates.max())
    except ArgumentError:
        return 0.0
