"""The [observer] and the [mode_filter] of a problem file: estimates of states and modes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Annotated, Any, Literal

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike
from pydantic import Field

from deadtime.base.errors import ArgumentError
from deadtime.base.wording import numbered
from deadtime.estimation import (
    ModeFilter,
    Observer,
    OutputFeedback,
    OutputModeFilter,
    Servo,
    kalman,
    luenberger,
)
from deadtime.feedback import Law
from deadtime.feedback.belief import BeliefFilter
from deadtime.plant import SwitchedSystem
from deadtime.problems.file.servo import FileServo, watching
from deadtime.problems.toml import Shape
from deadtime.problems.toml.sections import (
    Matrices,
    Matrix,
    Mode,
    ModeKey,
    Poles,
    PolesPerMode,
    Section,
    Texts,
    Vector,
)
from deadtime.switching import SwitchingModel


class _Measured(Section):
    """Measured outputs, y = C_σ x, and an observer of the state at the period of the run."""

    C: Annotated[Matrix | Matrices, Shape("(p, n), or one for each mode", [[1.0, 0.0]])] = Field(
        description="p × n, or one such matrix per mode."
    )
    outputs: Annotated[Texts, Shape("a list of texts", ["position"])] = Field(
        [], description="Names of the outputs, for figures; that of the state where one is output."
    )
    estimate: Annotated[Vector | None, Shape("(n,)", [1.0, 0.0])] = Field(
        None, description="Initial estimate of the state; 0 by default."
    )
    covariance: Annotated[Matrix | None, Shape("(n, n)", [[0.1, 0.0], [0.0, 0.1]])] = Field(
        None, description="Covariance of the initial estimate; every run draws its own."
    )
    model: Annotated[
        Literal["modes", "mean"] | Mode,
        ModeKey(("modes", "mean")),
        Shape('"modes", "mean", or a mode by its number or name', "mean"),
    ] = Field(
        "modes",
        description='The plant that it predicts with: "modes" the mode that is measured at each '
        'sample; "mean" the mean of all modes; or one mode, by its number or its name. The last '
        "two need no measured mode.",
    )


class LuenbergerObserver(_Measured):
    """An observer by pole placement."""

    kind: Literal["luenberger"]
    poles: Annotated[
        Poles | PolesPerMode, Shape("a list of poles, or one for each mode", [-4.0, -5.0])
    ] = Field(description="Poles of the error for all modes, or a list per mode, 1/s.")


class KalmanObserver(_Measured):
    """The steady-state Kalman filter of every mode."""

    kind: Literal["kalman"]
    process: Annotated[Matrix, Shape("(n, n)", [[1.0, 0.0], [0.0, 1.0]])] = Field(
        description="Intensity of the white process noise, n × n."
    )
    measurement: Annotated[Matrix, Shape("(p, p)", [[0.01]])] = Field(
        description="Covariance of the noise of a sample, p × p."
    )


ObserverSection = Annotated[LuenbergerObserver | KalmanObserver, Field(discriminator="kind")]


def add_observers(
    laws: dict[str, Law],
    section: LuenbergerObserver | KalmanObserver | None,
    step: float | None,
    numbers: Callable[[list], list],
    servos: Mapping[str, Servo],
    following: FileServo | None,
) -> dict[str, Law]:
    """The laws on the estimates of observers, each designed for its law's own model.

    A law on a mode belief that measures outputs itself is unchanged. A servo's law without an
    observer receives the whole state.
    """
    if section is None and not servos:
        return laws
    if step is None:
        raise ArgumentError(
            'an observer runs at samples: give [run] a step in seconds, not "ideal".'
        )
    observed = {}
    for name, law in laws.items():
        if law.outputs is not None:
            observed[name] = law
            continue
        servo, options = servos.get(name), {}
        if servo is not None and following is not None:
            options = {"servo": servo, "reference": following.reference}
        if section is None:
            assert servo is not None
            observed[name] = OutputFeedback(law, watching(servo, step), **options)
            continue
        if servo is None:
            observer = observer_of(law.plant, section, step, numbers)
        else:
            observer = observer_of(servo.model, section, step, numbers, servo.C)
        first = {"estimate": section.estimate, "covariance": section.covariance}
        observed[name] = OutputFeedback(law, observer, **first, **options)
    return observed


def names_of(C: Float[np.ndarray, "mode p n"], states: Sequence[str]) -> tuple[str, ...]:
    """Names of outputs: that of a state where they equal it in every mode, else numbered."""
    names = list(numbered("y", C.shape[1]))
    for i in range(len(names)):
        rows = np.unique(C[:, i], axis=0)
        if len(rows) == 1 and np.count_nonzero(rows) == 1 and rows.max() == 1.0:
            names[i] = states[int(np.argmax(rows[0]))]
    return tuple(names)


def observer_of(
    plant: SwitchedSystem,
    section: LuenbergerObserver | KalmanObserver,
    step: float,
    numbers: Callable[[list], list],
    C: ArrayLike | None = None,
) -> Observer:
    """The observer of a section, designed for a plant; with a C of its own where that is given."""
    C, model = section.C if C is None else C, section.model
    if isinstance(section, KalmanObserver):
        return kalman(plant, C, section.process, section.measurement, step, model=model)
    return luenberger(plant, C, numbers(section.poles), step, model=model)


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
    ] = Field(None, description="Of the initial state about the estimate of [observer]; x².")
    gains: Literal["kalman", "observer"] = Field(
        "kalman",
        description="Gains of the correction: Kalman's, sample by sample, or those of [observer].",
    )
    switches: Literal["anywhere", "samples"] | None = Field(
        None,
        description="Whether the mode may change within periods, or at samples only; by default as "
        "in the model of [switching].",
    )
    forgetting: float = Field(
        1e-9, description="Part of the belief, in (0, 1), that all modes share after every sample."
    )
    initial: Annotated[Vector | None, Shape("(modes,)", [0.5, 0.5])] = Field(
        None, description="Probability of each mode at time 0; that of [switching] by default."
    )
    ages: int | None = Field(
        None, description="Largest number of ages (samples) that are distinguished, if age matters."
    )
    allow_alike: bool = Field(False, description="Accept modes that are indistinguishable.")


def build_mode_filter(
    section: ModeFilterSection | None,
    plant: SwitchedSystem,
    model: SwitchingModel | None,
    step: float | None,
    observed: Observed | None,
) -> Callable[[SwitchedSystem], BeliefFilter] | None:
    """A function from the plant of a law to its mode filter; tried on the file's own first.

    `observed` is a function from a plant to its observer and the [observer] of the file, if any.
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
    filter_of = partial(_filter_of, section, model, step, observed)
    filter_of(plant)
    return filter_of


def _filter_of(
    section: ModeFilterSection,
    model: SwitchingModel,
    step: float,
    observed: Observed | None,
    plant: SwitchedSystem,
) -> BeliefFilter:
    """The filter of states, or with an [observer] that of outputs, with its noise by default."""
    names = ("switches", "forgetting", "initial", "ages", "allow_alike")
    options = {name: getattr(section, name) for name in names}
    given = {"disturbance": section.disturbance, "noise": section.noise}
    options |= {name: value for name, value in given.items() if value is not None}
    if section.initial is not None and len(section.initial) != plant.modes:
        raise ArgumentError(
            f"initial must have {plant.modes} entries, one for each mode, got "
            f"{len(section.initial)}."
        )
    if observed is None:
        return ModeFilter(plant, model, step, **options)
    if section.covariance is None:
        raise ArgumentError(
            "covariance must be given beside an [observer]: that of the initial state about its "
            "estimate, x²."
        )
    observer, own_section = observed
    if isinstance(own_section, KalmanObserver):
        options.setdefault("disturbance", own_section.process)
        if section.noise is None:
            options["noise"] = _deviations(np.array(own_section.measurement))
    C = observer(plant) if section.gains == "observer" else own_section.C
    first = {"covariance": section.covariance, "estimate": own_section.estimate}
    return OutputModeFilter(plant, model, step, C, **first, **options)


def _deviations(R: Float[np.ndarray, "p p"]) -> Any:
    """Standard deviations of outputs whose noise is independent; one number for one output."""
    variance = np.diagonal(R)
    if (np.diag(variance) != R).any() or (variance < 0.0).any():
        raise ArgumentError(
            "noise must be given: the measurement of [observer] is not diagonal, and a mode "
            "filter takes the noise of outputs to be independent."
        )
    return np.sqrt(variance) if R.shape != (1, 1) else np.sqrt(variance[0])
