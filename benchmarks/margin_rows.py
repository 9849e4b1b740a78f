"""A row of a table on proof and refutation: how far apart they are, and what the search took."""

from __future__ import annotations

import time
from collections.abc import Callable

from deadtime.margins import StabilityMargin

HEADINGS = "certified α | refuted α | ratio | processor time |"


def margin_row(about: str, bracket: Callable[[], StabilityMargin]) -> str:
    """The row of a search, which has to end with a proof, after the cells that say what it is."""
    start = time.process_time()
    margin = bracket()
    spent = time.process_time() - start
    assert margin.proven
    refuted = ratio = "–"
    if margin.refuted is not None:
        refuted, ratio = f"{margin.refuted:.4f}", f"{margin.refuted / margin.certified:.4f}"
    return f"| {about} | {margin.certified:.4f} | {refuted} | {ratio} | {spent:.0f} s |"
