"""The laws that a study can name, and what each of them knows about the switching."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from deadtime.base.errors import ArgumentError
from deadtime.feedback import Law
from deadtime.problems.law_registry import LAWS, LEVELS, LawSetting, NamedLaw

ORACLE, AWARE = "oracle", ", dwell-aware"
COARSE = 20  # sampling periods per delay at which minimax laws are sought
INPUT_WEIGHT = 1e-3  # of ∫|u|² beside ∫|x|² in what the optimal law minimises


@dataclass(frozen=True)
class Kind:
    """A law of the registry, of one of the modes if there is one for each."""

    known: NamedLaw
    mode: int | None = None

    @property
    def knows(self) -> str:
        """One of `LEVELS`."""
        return self.known.named.knows

    def make(self, setting: LawSetting, dwell_time: float | None = None) -> Law:
        """The law for one cell; τ_d for those that are told it."""
        if self.known.is_told and dwell_time is None:
            raise ArgumentError("a dwell-aware law is told τ_d: give grid.dwell_time.")
        return self.known.build(setting, self.mode, dwell_time)


# Signals of a study are drawn: no rule decides the mode. The less a law knows, the earlier.
KINDS: Mapping[str, Kind] = {
    known.named.name: Kind(known)
    for known in sorted(LAWS.values(), key=lambda known: LEVELS.index(known.named.knows))
    if "rule" not in known.entry.needs and not known.per_mode
}
DEFAULT = tuple(name for name, kind in KINDS.items() if kind.known.named.in_studies)


def kinds_of(modes: int) -> dict[str, Kind]:
    """The laws by name for a plant with so many modes, the single-mode ones among them.

    Examples
    --------
    >>> [name for name in kinds_of(2) if name.endswith("only")]
    ['mode 0 only', 'mode 1 only']
    """
    own = {
        known.named.name.format(mode=mode): Kind(known, mode)
        for known in LAWS.values()
        if known.per_mode
        for mode in range(modes)
    }
    return {**KINDS, **own}


def within(laws: Sequence[str], knows: str) -> list[str]:
    """Those of the named laws that know no more than one of `LEVELS`, in their order.

    Examples
    --------
    >>> within(("averaged", "expected", "mode 0 only"), "the dwell time")
    ['averaged', 'mode 0 only']
    """
    most = LEVELS.index(knows)
    return [law for law in laws if LEVELS.index(knowledge_of(law)) <= most]


def knowledge_of(law: str) -> str:
    """What a named law knows of the switching, one of `LEVELS`."""
    return KINDS[law].knows if law in KINDS else "nothing"
