"""A problem as a page first shows it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from deadtime.app.documents import Document
from deadtime.app.offered_laws import Section, laws_on_offer
from deadtime.app.page_run import ProblemOutcome, run_draft
from deadtime.app.settings import Settings, draft_of


@dataclass(frozen=True, eq=False)
class Opening:
    """A document as a page first shows it (immutable): all pages that begin with it share one.

    Attributes
    ----------
    document : Document
    offer : dict
        The laws on offer, by name.
    chosen : tuple of str
        The laws of the file.
    outcome : Outcome
        What its laws do.
    """

    document: Document
    offer: Mapping[str, Section]
    chosen: tuple[str, ...]
    outcome: ProblemOutcome

    @classmethod
    def of(cls, document: Document) -> Opening:
        """Run the laws of a document as it stands."""
        offer, chosen = laws_on_offer(document)
        outcome = run_draft(draft_of(document, offer, Settings()), document.source)
        return cls(document, offer, chosen, outcome)
