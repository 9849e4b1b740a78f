"""Settings that a person has chosen or drawn on a page, and the problem file that they make."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field
from typing import Any

from deadtime.app.documents import Document
from deadtime.app.draft_facts import dwell_time_of, with_model
from deadtime.base.errors import ArgumentError
from deadtime.problems.imperfection_registry import SWEPT
from deadtime.problems.law_registry import MODEL_KINDS
from deadtime.scenarios.sweeps.axes import AXES, Draft, axis_of
from deadtime.switching.signal_class import Instants

Section = dict[str, Any]


@dataclass(frozen=True)
class DrawnSignal:
    """A signal drawn from the model of the switching."""

    seed: int = 0


@dataclass(frozen=True)
class GivenSignal:
    """A signal whose switches are known: drawn by hand, or found as the worst."""

    times: tuple[float, ...]
    modes: tuple[int, ...]
    about: str = ""
    at: Instants = "anywhere"


@dataclass(frozen=True)
class Settings:
    """All that differs from the file (immutable); None stands for what the file has.

    `values` are parameters by the names of `scenarios.sweeps.axes.AXES`, or by their paths in the
    file, such as ``run.x0.0``; `laws` the names of the laws that run.
    """

    values: Mapping[str, Any] = field(default_factory=dict)
    laws: tuple[str, ...] | None = None
    signal: DrawnSignal | GivenSignal | None = None


def draft_of(document: Document, offer: Mapping[str, Section], settings: Settings) -> Draft:
    """The problem file that the settings make, as nested dictionaries and lists.

    Examples
    --------
    >>> from deadtime.app.documents import open_named
    >>> paper = open_named("paper")
    >>> draft = draft_of(paper, {}, Settings({"delay": 0.5}, signal=DrawnSignal(3)))
    >>> draft["plant"]["delay"], draft["signal"]
    (0.5, {'kind': 'model', 'seed': 3})
    """
    draft: Draft = deepcopy(dict(document.draft))
    if settings.laws == ():
        raise ArgumentError("no law is chosen: choose at least one.")
    if settings.laws is not None:
        draft["law"] = [dict(offer[name]) for name in offer if name in settings.laws]
    values = dict(settings.values)
    if "sojourn" in values:
        values.setdefault("dwell_time", dwell_time_of(draft))
    wanted = any(law["kind"] in MODEL_KINDS for law in draft.get("law", []))
    if wanted or isinstance(settings.signal, DrawnSignal):
        draft = with_model(draft)
    paths = [name for name in values if name not in AXES]
    for name in [*paths, *(name for name in AXES if name in values)]:
        if name in SWEPT:  # what is moved replaces what the file has
            given = draft.get("imperfection", [])
            draft["imperfection"] = [one for one in given if one["kind"] != SWEPT[name].kind]
        axis_of(name).write(draft, values[name])
    if not draft.get("imperfection", True):
        del draft["imperfection"]
    match settings.signal:
        case DrawnSignal(seed):
            draft["signal"] = {"kind": "model", "seed": seed}
        case GivenSignal(times, modes, at=at):
            draft["signal"] = {"kind": "switches", "times": list(times), "modes": list(modes)}
            draft["signal"] |= {} if at == "anywhere" else {"at": at}
        case None:
            pass
    return draft


MOST = 500  # switches


def switch_at(
    times: Sequence[float], modes: Sequence[int], at: float, mode: int, count: int
) -> GivenSignal:
    """The signal that is in a mode, of `count`, from an instant on up to its next switch.

    Where it is in that mode already, the switch that began it is removed instead: the mode before
    goes on. `times` are the starts of the sojourns, the first 0, in seconds.

    Raises
    ------
    ArgumentError
        If the instant is negative, there is no such mode, or there are too many switches.

    Examples
    --------
    >>> switch_at([0.0], [0], 1.5, 1, 2)
    GivenSignal(times=(0.0, 1.5), modes=(0, 1), about='drawn by hand', at='anywhere')
    >>> switch_at([0.0, 1.5], [0, 1], 2.0, 1, 2)
    GivenSignal(times=(0.0,), modes=(0,), about='drawn by hand', at='anywhere')
    """
    if not 0 <= mode < count:
        raise ArgumentError(f"mode must be in 0..{count - 1}, got {mode}.")
    if not 0.0 <= at < float("inf"):
        raise ArgumentError(f"time of a switch must be ≥ 0, in s, got {at:g}.")
    pairs = list(zip(map(float, times), map(int, modes), strict=True))
    now = max(i for i, (time, _) in enumerate(pairs) if time <= at)
    if pairs[now][1] == mode:
        if now:
            del pairs[now]
    elif pairs[now][0] == at:
        pairs[now] = (at, mode)
    else:
        pairs.insert(now + 1, (float(at), mode))
    merged = [pair for i, pair in enumerate(pairs) if i == 0 or pair[1] != pairs[i - 1][1]]
    if len(merged) > MOST:
        raise ArgumentError(f"a drawn signal holds at most {MOST} sojourns: clear it first.")
    return GivenSignal(
        tuple(time for time, _ in merged), tuple(which for _, which in merged), "drawn by hand"
    )
