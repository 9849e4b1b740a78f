"""The imperfections of a problem file, and what they become."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Union

from pydantic import Field

from deadtime.imperfections import Imperfection, SensorImperfection, Sizes, require
from deadtime.problems.imperfection_registry import ENTRIES, ImperfectionSection, build_imperfection
from deadtime.problems.toml import section as _section

if TYPE_CHECKING:
    ImperfectionEntry = ImperfectionSection
else:
    ImperfectionEntry = Annotated[Union[ENTRIES], Field(discriminator="kind")]  # noqa: UP007


def build_imperfections(
    sections: Sequence[ImperfectionSection], sizes: Sizes, measured: int | None = None
) -> tuple[Imperfection, ...]:
    """The imperfections of a file, each checked against the sizes of its loop.

    `measured` is how many outputs a sensor gives, where it does not give the state.
    """
    sensors = sizes if measured is None else sizes._replace(states=measured)
    built = []
    for i, one in enumerate(sections):
        with _section("imperfection", i):
            made = build_imperfection(one)
            require(made, sensors if isinstance(made, SensorImperfection) else sizes)
            built.append(made)
    return tuple(built)
