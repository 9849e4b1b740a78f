"""Reasons why a log hardly identifies a delay or a mode: repeated inputs, feedback, short stays.

Each is a correlation or a linear regression over the rows of a log, compared with a threshold.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

from deadtime.base.errors import ArgumentError
from deadtime.base.wording import number_of
from deadtime.identification.log.recording import Part, Recording
from deadtime.identification.parameters import Layout

_LIKE = 0.95  # correlation at which an input repeats itself
_SAME = 1.0 - 1e-6  # correlation of inputs that are proportional
_FELL = 0.7  # correlation must fall below this first: a slow input resembles itself a moment later
_FOLLOWS = 0.99  # share of an input's variance explained by the states of the same row
_BRIEF = 2  # rows: a stay so short has at most one period in one mode
_MINUTE = 60.0  # s: periods of whole seconds divide a minute or are multiples of it
_JITTER = 0.1  # of a period: milliseconds differ from row to row, seconds usually do not
_PAST = 3  # past rows of measurements and of the input that a controller may use
_SHARE = 0.5  # share of an input's innovation explained by measurements in a closed loop
_MOVES = 1e-9  # least relative innovation of an input: an input known from its past is no feedback


def reasons(recording: Recording, j: int, longest: float) -> list[str]:
    """Sentences on input j, whose delay, up to `longest` seconds, is hardly identifiable."""
    sentences, name = [], recording.inputs[j]
    part = max(recording.parts, key=lambda one: one.time.size)
    repeat = _repeat(part, recording.step, j, longest) if recording.even else None
    if repeat is not None:
        time, sign = repeat
        opposite = " with the opposite sign" if sign < 0.0 else ""
        sentences.append(
            f"{name} repeats itself{opposite} every {time:.4g} s, and with it the delays that "
            "explain the log: send an input that does not repeat itself, or narrow "
            f"delay=(low, high), --delay LOW HIGH, to less than {time:.4g} s."
        )
    of = ""
    if _follows(recording, j):
        of = "is a function of the states of its row, as of a law u = K x and nothing else"
    elif fed_back(recording)[j]:
        of = "follows from what was measured in its row and before, as in a loop that regulates"
    if of:
        sentences.append(
            f"{name} {of}: the log determines A + B K rather than A and B. Add steps or noise to "
            "the commands of the law."
        )
    u = np.vstack([part.input for part in recording.parts])
    likeness = [abs(_likeness(column, u[:, j])) for column in u.T]
    alike = [other for i, other in enumerate(recording.inputs) if i != j and likeness[i] > _SAME]
    if alike:
        sentences.append(
            f"{name} moves as {', '.join(alike)} does throughout: the log hardly shows which of "
            "them acts, and when. Move them apart, or leave one out by inputs=[…], --inputs."
        )
    if counts_milliseconds(recording):
        sentences.append(
            f"t counts whole numbers, a row every {recording.step:g}: if these are milliseconds, "
            "divide it by 1,000."
        )
    return sentences


def counts_milliseconds(recording: Recording) -> bool:
    """Whether times look like milliseconds: whole numbers that are unusual for seconds.

    Logs in whole seconds usually have a period that divides a minute, or whole minutes, without
    jitter; an even period of 1, 2, 5, 10 or 60 may be seconds.
    """
    times = [part.time for part in recording.parts]
    if max(float(np.abs(t - np.rint(t)).max()) for t in times) > 1e-6:
        return False
    step = round(recording.step)
    off = np.abs(np.concatenate([np.diff(np.rint(t)) for t in times]) - step)
    odd = _MINUTE % step != 0.0 and step % _MINUTE != 0.0
    return odd or bool(((off > 0.0) & (off <= _JITTER * step)).any())


def _repeat(part: Part, step: float, j: int, longest: float) -> tuple[float, float] | None:
    """The period after which an input repeats itself, seconds, and the sign."""
    u = part.input[:, j]
    fallen = False
    for lag in range(1, min(int(longest / step), u.size // 2) + 1):
        r = _likeness(u[:-lag], u[lag:])
        if fallen and abs(r) > _LIKE:
            following = _likeness(u[: -lag - 1], u[lag + 1 :])
            best, r = (lag, r) if abs(r) >= abs(following) else (lag + 1, following)
            return best * step, r
        fallen = fallen or abs(r) < _FELL
    return None


def _likeness(before: np.ndarray, after: np.ndarray) -> float:
    """The cosine between samples, where both are known; 0 where either is 0."""
    known = np.isfinite(before) & np.isfinite(after)
    a, b = before[known], after[known]
    size = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / size if size > 0.0 else 0.0


def _follows(recording: Recording, j: int) -> bool:
    """Whether a linear law of the row's states, one per mode, explains an input."""
    rest = total = 0.0
    for i in range(len(recording.modes)):
        rows = [part.mode == i for part in recording.parts]
        each = list(zip(recording.parts, rows, strict=True))
        u = np.concatenate([part.input[own, j] for part, own in each])
        x = np.vstack([part.output[own] for part, own in each])
        known = np.isfinite(u) & np.isfinite(x).all(axis=1)
        u, x = u[known], np.column_stack((x[known], np.ones(int(known.sum()))))
        if u.size > 2 * x.shape[1]:
            rest += float(((u - x @ np.linalg.lstsq(x, u, rcond=None)[0]) ** 2).sum())
            total += float(((u - u.mean()) ** 2).sum())
    return total > 0.0 and rest < (1.0 - _FOLLOWS) * total


def require_enough(
    recording: Recording,
    layout: Layout,
    count: Int[np.ndarray, " mode"] | Float[np.ndarray, " mode"],
    window: float,
) -> None:
    """Refuse a log with too few periods of a mode."""
    least = layout.least_periods
    for i in np.flatnonzero(count < least):
        name = recording.modes[i]
        whole = max(float(np.ptp(part.time)) for part in recording.parts)
        hint = " Log for longer." if layout.modes == 1 else " Log longer stays in it."
        if whole < 2.0 * window:
            lasts = "The log" if len(recording.parts) == 1 else "Its longest stretch without a gap"
            hint = (
                f" {lasts} lasts {whole:g} s, and delays of up to {window:g} s are looked for: "
                "is t in seconds? Narrow delay=(low, high), in seconds, or log for longer"
            )
            hint += "." if len(recording.parts) == 1 else ", with no row lost."
        if lost := sum(int((~part.logged).sum()) for part in recording.parts):
            hint = (
                f" {lost:,} rows are lost, and a period is of use only if no input is lost that "
                "may act in it: narrow delay=(low, high), --delay LOW HIGH, or log without gaps."
            )
        if (rows := _longest_stay(recording, int(i))) <= _BRIEF and layout.modes > 1:
            hint = (
                f" It stays for {number_of(rows, 'row')} at a time, at most: put rows right whose "
                "mode is a slip of the log; of a mode that changes at samples only say "
                'switches="samples", --switches samples.'
            )
        what = "the log" if layout.modes == 1 else f"mode {name!r}"
        raise ArgumentError(
            f"{what} has {number_of(int(count[i]), 'period')} whose inputs and ends are known, at "
            f"least {least} are needed for {number_of(layout.n, 'state')} and "
            f"{number_of(layout.m, 'input')}: it is too short.{hint}"
        )


def _longest_stay(recording: Recording, mode: int) -> int:
    """The largest number of consecutive rows in a mode."""
    stays = [0]
    for part in recording.parts:
        there = np.concatenate(([False], part.mode == mode, [False]))
        ends = np.flatnonzero(there[1:] != there[:-1])
        stays += (ends[1::2] - ends[::2]).tolist()
    return max(stays)


def fed_back(recording: Recording, past: int = _PAST) -> Bool[np.ndarray, " m"]:
    """Which inputs are feedback of the measurements of their row and the last ones.

    The residuals of an input predicted from its own past, by linear regression in each mode, are
    compared with the residuals when measurements are used, too. If the `past` rows of the input are
    fewer than in a delay, measurements may predict a smooth input because they show older values.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> y, r = rng.standard_normal((2, 200, 1))
    >>> def log(u):
    ...     part = Part(np.arange(200.0), y, u, np.zeros(200, int))
    ...     return Recording((part,), 1.0, True, ("y",), ("u",), ("mode 0",), True)
    >>> [bool(fed_back(log(u))[0]) for u in (-2.0 * y, -2.0 * np.cumsum(y, axis=0), r - 0.5 * y)]
    [True, True, False]
    """
    grid = recording.gridded()
    m = grid.parts[0].input.shape[1]
    new, left, total = np.zeros(m), np.zeros(m), np.zeros(m)
    for i in range(len(grid.modes)):
        rows = [_rows(part, i, past) for part in grid.parts]
        y, u = (np.concatenate(each) for each in zip(*rows, strict=True))
        if len(u) < 2 * (y.shape[1] + past * m + 1):
            continue
        for j in range(m):
            own = np.column_stack((u[:, 1:, j], np.ones(len(u))))
            new[j] += _rest(own, u[:, 0, j])
            left[j] += _rest(np.hstack((own, y)), u[:, 0, j])
            total[j] += float(((u[:, 0, j] - u[:, 0, j].mean()) ** 2).sum())
    return (new > _MOVES * total) & (left < _SHARE * new)


def _rows(part: Part, mode: int, past: int) -> tuple[np.ndarray, np.ndarray]:
    """Measurements (rows, lags × p) and inputs (rows, lags, m) of rows that stay in a mode."""
    k = np.arange(past, part.time.size)
    lags = k[:, None] - np.arange(past + 1)
    y, u = part.output[lags[:, : _PAST + 1]], part.input[lags]
    y = y.reshape(k.size, (_PAST + 1) * part.output.shape[1])
    known = np.isfinite(y).all(axis=1) & np.isfinite(u).all(axis=(1, 2))
    own = known & (part.mode[lags] == mode).all(axis=1)
    return y[own], u[own]


def _rest(z: np.ndarray, u: np.ndarray) -> float:
    unit = np.maximum(np.sqrt((z**2).sum(axis=0)), 1e-300)
    return float(((u - z @ (np.linalg.lstsq(z / unit, u, rcond=1e-13)[0] / unit)) ** 2).sum())
