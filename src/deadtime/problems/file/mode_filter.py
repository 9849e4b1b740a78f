"""The [mode_filter] of a problem file: what laws on a belief take the noise to be."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Annotated, Literal

from pydantic import Field

from deadtime.base.errors import ArgumentError
from deadtime.estimation import ModeFilter
from deadtime.plant import SwitchedSystem
from deadtime.problems.law_registry import Model
from deadtime.problems.toml import Shape
from deadtime.problems.toml.table import Matrix, Section, Vector


class ModeFilterSection(Section):
    """A belief over the modes from measured states, for laws of kind "belief"."""

    disturbance: Annotated[
        float | Vector | Matrix, Shape("a number, (n,) or (n, n)", [1e-4, 1e-4])
    ] = Field(
        0.0, description="Intensity of white process noise, x² per second; as of white-disturbance."
    )
    noise: Annotated[float | Vector, Shape("a number or (n,)", [0.01, 0.01])] = Field(
        0.0, description="Standard deviation of the noise of a sample, as of noise."
    )
    switches: Literal["anywhere", "samples"] = Field(
        "anywhere", description="Whether the mode may change within periods, or at samples only."
    )
    forgetting: float = Field(
        1e-9, description="Part of the belief, in (0, 1), that all modes share after every sample."
    )
    initial: Annotated[Vector | None, Shape("(modes,)", [0.5, 0.5])] = Field(
        None, description="Probability of each mode at time 0; that of [switching] by default."
    )
    ages: int | None = Field(
        None, description="Most ages (samples) of a semi-Markov mode that are told apart."
    )
    allow_alike: bool = Field(False, description="Accept modes that no state tells apart.")


def build_mode_filter(
    section: ModeFilterSection | None,
    plant: SwitchedSystem,
    model: Model | None,
    step: float | None,
    observed: bool,
) -> Callable[[SwitchedSystem], ModeFilter] | None:
    """What makes the filter of a law that believes in a plant; tried on the file's own first."""
    if section is None:
        return None
    if model is None:
        raise ArgumentError("a mode filter needs a [switching] section: how the mode switches.")
    if step is None:
        raise ArgumentError(
            'a mode filter runs at samples: give [run] a step in seconds, not "ideal".'
        )
    if observed:
        raise ArgumentError(
            "a mode filter reads the states themselves: leave out [observer], or [mode_filter]."
        )
    filter_of = partial(_mode_filter, section, model, step)
    filter_of(plant)
    return filter_of


def _mode_filter(
    section: ModeFilterSection, model: Model, step: float, plant: SwitchedSystem
) -> ModeFilter:
    initial = section.initial
    if initial is not None and len(initial) != plant.modes:
        raise ArgumentError(
            f"initial must have {plant.modes} entries, one for each mode, got {len(initial)}."
        )
    return ModeFilter(
        plant,
        model,
        step,
        disturbance=section.disturbance,
        noise=section.noise,
        switches=section.switches,
        forgetting=section.forgetting,
        initial=initial,
        ages=section.ages,
        allow_alike=section.allow_alike,
    )
