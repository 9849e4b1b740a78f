"""What `monte_carlo` asks of an engine, and which engines there are."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

from deadtime.base.errors import ArgumentError
from deadtime.feedback import Feedback
from deadtime.scenarios.figures import Figures, Path
from deadtime.scenarios.loop import Laid, Loop

BACKENDS = ("numba", "jax")
LANES = 8  # scenarios whose rows per sample, or whose trajectories, are handed over at a time


class Engine(Protocol):
    """Runs tables along signals that are laid on a loop."""

    def table(self, feedback: Feedback) -> Any:
        """A law's rows in the form that the engine reads."""
        ...

    def tables(self, feedbacks: Sequence[Feedback]) -> Any:
        """Rows per sample, one table for each of up to eight scenarios."""
        ...

    def run(self, table: Any, laid: Laid, first: int = 0, count: int | None = None) -> Figures:
        """Run a table along the scenarios first, …, first + count − 1."""
        ...

    def path(
        self, table: Any, laid: Laid, first: int, count: int, keep: int = 0
    ) -> tuple[Figures, Path]:
        """The same for up to eight of them, with states and inputs from sample `keep` on."""
        ...


def engine_of(backend: str, loop: Loop) -> Engine:
    """The engine of a backend."""
    if backend == "numba":
        from deadtime.scenarios.cpu import CpuEngine

        return CpuEngine(loop)
    if backend == "jax":
        from deadtime.scenarios.jax_engine import JaxEngine

        return JaxEngine(loop)
    raise ArgumentError(f"backend must be one of {list(BACKENDS)}, got {backend!r}.")
