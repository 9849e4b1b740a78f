"""The [mode_filter] of a problem file: what laws on a belief take the noise to be."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Annotated, Any, Literal

import numpy as np
from jaxtyping import Float
from pydantic import Field

from deadtime.base.errors import ArgumentError
from deadtime.estimation import ModeFilter, Observer, OutputModeFilter
from deadtime.plant import SwitchedSystem
from deadtime.problems.file.observer import KalmanObserver, ObserverSection
from deadtime.problems.toml import Shape
from deadtime.problems.toml.sections import Matrices, Matrix, Section, Vector
from deadtime.switching import SwitchingModel

Observed = tuple[Callable[[SwitchedSystem], Observer], ObserverSection]


class ModeFilterSection(Section):
    """A belief over the modes from measured states, or outputs, for laws of kind "belief".

    With an [observer] it takes the outputs y = C x and the first estimate of that.
    """

    disturbance: Annotated[
        float | Vector | Matrix | Matrices | None,
        Shape("a number, (n,), (n, n), or (n, n) for each mode", [1e-4, 1e-4]),
    ] = Field(
        None,
        description="Intensity of white process noise, x² per second; as of white-disturbance. 0 "
        "by default, or the process of a Kalman [observer].",
    )
    noise: Annotated[float | Vector | None, Shape("a number, (n,) or (p,)", [0.01, 0.01])] = Field(
        None,
        description="Standard deviation of the noise of a sample, as of noise. 0 by default, or "
        "that of the measurement of a Kalman [observer].",
    )
    covariance: Annotated[
        float | Vector | Matrix | None, Shape("a number, (n,) or (n, n)", [1.0, 1.0])
    ] = Field(
        None, description="Of the first state about the estimate of [observer], which needs it; x²."
    )
    gains: Literal["kalman", "observer"] = Field(
        "kalman",
        description="What corrects estimates: Kalman's gains, sample by sample, or those of "
        "[observer].",
    )
    switches: Literal["anywhere", "samples"] | None = Field(
        None,
        description="Whether the mode may change within periods, or at samples only; as the model "
        "of [switching] does by default.",
    )
    forgetting: float = Field(
        1e-9, description="Part of the belief, in (0, 1), that all modes share after every sample."
    )
    initial: Annotated[Vector | None, Shape("(modes,)", [0.5, 0.5])] = Field(
        None, description="Probability of each mode at time 0; that of [switching] by default."
    )
    ages: int | None = Field(
        None, description="Most ages (samples) that are told apart where age matters."
    )
    allow_alike: bool = Field(False, description="Accept modes that nothing tells apart.")


def build_mode_filter(
    section: ModeFilterSection | None,
    plant: SwitchedSystem,
    model: SwitchingModel | None,
    step: float | None,
    observed: Observed | None,
) -> Callable[[SwitchedSystem], ModeFilter | OutputModeFilter] | None:
    """What makes the filter of a law that believes in a plant; tried on the file's own first.

    `observed` is the [observer] of the file and what makes it for a plant, where it has one.
    """
    if section is None:
        return None
    if model is None:
        raise ArgumentError("a mode filter needs a [switching] section: how the mode switches.")
    if step is None:
        raise ArgumentError(
            'a mode filter runs at samples: give [run] a step in seconds, not "ideal".'
        )
    if observed is None:
        for name, left in (("covariance", None), ("gains", "kalman")):
            if getattr(section, name) != left:
                raise ArgumentError(
                    f"{name} is for outputs: give an [observer], or leave out {name}."
                )
        filter_of = partial(_mode_filter, section, model, step)
    else:
        filter_of = partial(_output_filter, section, observed, model, step)
    filter_of(plant)
    return filter_of


def _mode_filter(
    section: ModeFilterSection, model: SwitchingModel, step: float, plant: SwitchedSystem
) -> ModeFilter:
    disturbance, noise = section.disturbance, section.noise
    return ModeFilter(
        plant,
        model,
        step,
        disturbance=0.0 if disturbance is None else disturbance,
        noise=0.0 if noise is None else noise,
        **_options(section, plant),
    )


def _output_filter(
    section: ModeFilterSection,
    observed: Observed,
    model: SwitchingModel,
    step: float,
    plant: SwitchedSystem,
) -> OutputModeFilter:
    if section.covariance is None:
        raise ArgumentError(
            "covariance must be given beside an [observer]: how well its estimate of the first "
            "state is known, x²."
        )
    observer, given = observed
    disturbance, noise = _noise_of(given)
    return OutputModeFilter(
        plant,
        model,
        step,
        observer(plant) if section.gains == "observer" else given.C,
        covariance=section.covariance,
        disturbance=disturbance if section.disturbance is None else section.disturbance,
        noise=_deviations(noise) if section.noise is None else section.noise,
        estimate=given.estimate,
        **_options(section, plant),
    )


def _noise_of(given: ObserverSection) -> tuple[Any, Any]:
    """Intensity of the process noise and covariance of the outputs' that an observer is for."""
    if isinstance(given, KalmanObserver):
        return given.process, np.array(given.measurement)
    return 0.0, np.zeros((1, 1))


def _deviations(R: Float[np.ndarray, "p p"]) -> Any:
    """Standard deviations of outputs whose noise is independent."""
    variance = np.diagonal(R)
    if (np.diag(variance) != R).any() or (variance < 0.0).any():
        raise ArgumentError(
            "noise must be given: the measurement of [observer] is not diagonal, and a mode "
            "filter takes the noise of outputs to be independent."
        )
    return np.sqrt(variance) if R.shape != (1, 1) else float(np.sqrt(variance[0]))


def _options(section: ModeFilterSection, plant: SwitchedSystem) -> dict[str, Any]:
    """What both kinds of filter take alike."""
    initial = section.initial
    if initial is not None and len(initial) != plant.modes:
        raise ArgumentError(
            f"initial must have {plant.modes} entries, one for each mode, got {len(initial)}."
        )
    names = ("switches", "forgetting", "initial", "ages", "allow_alike")
    return {name: getattr(section, name) for name in names}
