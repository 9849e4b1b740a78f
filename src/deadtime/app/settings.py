"""What a person has moved on a page, and the problem file that it makes of the one opened."""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass, field
from typing import Any

from deadtime.app.assumed_switching import dwell_time_of, with_model
from deadtime.app.documents import Document
from deadtime.app.offered_laws import Section
from deadtime.base.errors import ArgumentError
from deadtime.problems.imperfection_registry import SWEPT
from deadtime.problems.law_registry import MODEL_KINDS
from deadtime.scenarios.sweeps.axes import AXES, Draft, axis_of


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


@dataclass(frozen=True)
class Settings:
    """All that differs from the file (immutable); untouched, the problem is the file's.

    Attributes
    ----------
    values : mapping
        Parameters that were moved, by the names of `scenarios.sweeps.axes.AXES`, or by their
        paths in the file, such as ``run.x0.0``.
    laws : tuple of str, or None
        Names of the laws that run; None: the file's.
    signal : Drawn, Given or None
        What takes the place of the file's signal.
    """

    values: Mapping[str, Any] = field(default_factory=dict)
    laws: tuple[str, ...] | None = None
    signal: DrawnSignal | GivenSignal | None = None


def draft_of(document: Document, offer: Mapping[str, Section], settings: Settings) -> Draft:
    """What a problem file of the settings says.

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
        case GivenSignal(times, modes):
            draft["signal"] = {"kind": "switches", "times": list(times), "modes": list(modes)}
        case None:
            pass
    return draft
