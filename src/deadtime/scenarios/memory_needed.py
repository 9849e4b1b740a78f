"""What a comparison needs in memory, asked before it starts."""

from __future__ import annotations

import os

from deadtime.base.errors import ArgumentError

_SHARE = 0.8  # of the memory that is free


def free_memory() -> float:
    """Bytes of memory that are free, or all there are where the system does not tell."""
    for name in ("SC_AVPHYS_PAGES", "SC_PHYS_PAGES"):
        if name in getattr(os, "sysconf_names", {}):
            return float(os.sysconf(name)) * float(os.sysconf("SC_PAGE_SIZE"))
    return float("inf")


def require_memory(what: str, needed: float, advice: str) -> None:
    """Refuse what would take more than four fifths of the free memory."""
    free = free_memory()
    if needed > _SHARE * free:
        raise ArgumentError(
            f"{what} would take {needed / 2**30:,.1f} GiB, and {free / 2**30:,.1f} GiB of memory "
            f"are free: {advice}."
        )
