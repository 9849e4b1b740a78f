"""A problem as a page first shows it: the laws on offer, and the outcome of those in its file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from deadtime.app.documents import Document
from deadtime.app.draft_facts import dwell_time_of, with_model
from deadtime.app.page_outcome import ProblemOutcome, run_draft
from deadtime.app.settings import Section, Settings, draft_of
from deadtime.problems.file.load import build_what_can
from deadtime.problems.law_registry import LAWS
from deadtime.switching import SwitchingSignal


def laws_on_offer(document: Document) -> tuple[dict[str, Section], tuple[str, ...]]:
    """Laws by name, as sections of a problem file; and the names of those that the file runs.

    Laws of the file that cannot be built are offered under their names too: a page says why they
    do not run. What is added to them is left out where it cannot be built.
    """
    draft = with_model(document.draft)
    own = list(document.draft.get("law", []))
    modes = len(document.draft["plant"]["A"])
    _, problem, _ = build_what_can(document.draft, document.source)
    rule = not isinstance(problem.signal, SwitchingSignal)
    others = _standard(modes, dwell_time_of(document.draft), rule)
    found = _sections_by_name(document, {**draft, "law": [*own, *others]})
    names = [name for name, _ in found]
    chosen = tuple(names[: len(own)] if own else [n for n in problem.laws if n in names])
    laws = dict(found[: len(own)])
    for name, section in found[len(own) :]:
        laws.setdefault(name, section)
    return laws, chosen


def _standard(modes: int, dwell_time: float, rule: bool) -> list[Section]:
    """A section for each law of the registry that a page offers."""
    sections: list[Section] = []
    for name, known in LAWS.items():
        needs = known.entry.needs
        if not known.named.on_page or ("signal" if rule else "rule") in needs:
            continue
        # With one mode there is no switching that a law could know.
        if modes == 1 and (known.named.several or "model" in needs):
            continue
        own = {} if known.usual else {"name": name}
        sections += [
            {"kind": known.kind, **own, **known.keys(mode, dwell_time)}
            for mode in known.modes(modes)
        ]
    return sections


def _sections_by_name(document: Document, draft: Mapping[str, Any]) -> list[tuple[str, Section]]:
    """Every section with the name of its law; sections that name no law are left out."""
    found = []
    for i, section in enumerate(draft["law"]):
        try:
            _, problem, _ = build_what_can({**draft, "law": [section]}, document.source)
        except ValueError:
            if i < len(document.draft.get("law", [])):
                found.append((section.get("name") or section["kind"], section))
            continue
        found.append((next(iter(problem.laws)), section))
    return found


@dataclass(frozen=True, eq=False)
class FirstView:
    """A document as a page first shows it (immutable): all pages that begin with it share one.

    `offer` are the laws on offer by name, `chosen` those of the file, whose `outcome` is shown.
    """

    document: Document
    offer: Mapping[str, Section]
    chosen: tuple[str, ...]
    outcome: ProblemOutcome

    @classmethod
    def of(cls, document: Document) -> FirstView:
        """Run the laws of a document as it stands."""
        offer, chosen = laws_on_offer(document)
        outcome = run_draft(draft_of(document, offer, Settings()), document.source)
        return cls(document, offer, chosen, outcome)
