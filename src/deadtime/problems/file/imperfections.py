"""The imperfections of a problem file, and what they become."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Union

import numpy as np
from jaxtyping import Float
from pydantic import Field

from deadtime.base.checks import index, real_array, require_shape
from deadtime.base.errors import ArgumentError
from deadtime.imperfections import Imperfection, SensorImperfection, Sizes, require
from deadtime.plant import SwitchedSystem
from deadtime.problems.imperfection_registry import ENTRIES, ImperfectionSection, build_imperfection
from deadtime.problems.toml import Shape, section as _section
from deadtime.problems.toml.sections import Section, Vector

if TYPE_CHECKING:
    ImperfectionEntry = ImperfectionSection
else:
    ImperfectionEntry = Annotated[Union[ENTRIES], Field(discriminator="kind")]  # noqa: UP007


class OffsetSection(Section):
    """A constant force in one mode: dx/dt = A_σ x + B_σ u(t − D) + force, as of a load."""

    mode: int
    force: Annotated[Vector, Shape("(n,)", [0.0, 1.0])] = Field(
        description="Units of x per second."
    )


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


def offsets_of(
    sections: Sequence[OffsetSection], plant: SwitchedSystem
) -> Float[np.ndarray, "mode n"]:
    """The constant force of every mode, 0 where there is no section."""
    force, told = np.zeros((plant.modes, plant.states)), set()
    for i, one in enumerate(sections):
        with _section("offset", i):
            mode = index("mode", one.mode, plant.modes)
            if mode in told:
                raise ArgumentError(f"mode {mode} has an offset already: give one for each mode.")
            told.add(mode)
            given = real_array("force", one.force, "(n,)", 1)
            force[mode] = require_shape("force", given, (plant.states,), "(n,)")
    return force
