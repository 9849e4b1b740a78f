"""`Controller`: a law that runs, and that can be written as C or as an FMU."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from numpy.typing import ArrayLike

from deadtime.controller.running import RunningLaw

if TYPE_CHECKING:
    from deadtime.controller.export import Exported, ExportedFmu, Names
    from deadtime.controller.prediction import Prediction


class Controller(RunningLaw):
    """A law that runs: call `update` once a period.

    The controller keeps the past inputs and the modes, and predicts with the inputs *as
    applied*: saturated by its own limits, or as reported by `applied`, so that an actuator that
    does something else, or an operator who takes over, does not mislead it. A factorised table
    costs the same whatever the delay.

    Parameters
    ----------
    law : Law
        A law that is a table, and not one that must know the future; or an `OutputFeedback` of
        such a law, at its observer's period, or a `BeliefPredictor`, at its filter's.
    step : float
        Sampling period h, in seconds.
    limits : (low, high), optional
        Saturation of the input, scalars or shape (m,).
    u0 : optional
        Inputs before the first call, as `simulate` takes them: None for those at rest.
    mode_age : int
        Age of the first mode in samples, for laws that read it.
    operating_point : OperatingPoint, optional
        Where the plant rests, such as `Problem.operating_point`. With it all that goes in and out
        is in the units of sensors and actuators, not in deviations: x, y, reference, applied, u0,
        limits and u. Without it x = 0 and u = 0 are rest.

    Attributes
    ----------
    status : Status
        What became of the last period.
    refused : int
        How many periods went by in which something that came in was unusable.
    late : int
        How many periods went by without a call, as the times of the calls tell.
    samples : int
        How many periods have run, those without a call included.
    belief : (modes,) array or None
        How likely each mode is at the last sample, of a `BeliefPredictor`.

    Raises
    ------
    ArgumentError
        If the law is no table or must know the future, or limits are out of order.

    Examples
    --------
    >>> import deadtime as dt
    >>> problem = dt.problems.paper()
    >>> law = dt.AveragedPredictor(problem.plant, problem.gains)
    >>> controller = Controller(law, step=0.01, limits=(-25.0, 25.0))
    >>> controller.update([-1.0, 1.0]).round(3), controller.status.name
    (array([20.058]), 'OK')
    >>> controller.update([float("nan"), 1.0]).round(3), controller.status.name
    (array([20.058]), 'BAD_STATE')
    """

    @property
    def prediction(self) -> Prediction:
        """The state that the input of the last `update` will meet, and how surely; see there.

        Its tables are made at the first call, and take a few times as long as the law's. Raises
        `ArgumentError` where there is nothing to predict from, as before the first sample and
        after one whose state was not finite, and of a law that has no forecast.
        """
        from deadtime.controller.prediction import prediction_of

        return prediction_of(self)

    def export_c(
        self,
        folder: str | Path,
        *,
        precision: Literal["double", "float"] = "double",
        accuracy: float | None = None,
        rom_budget: int | None = None,
        name: str = "controller",
        names: Names | None = None,
        prediction: bool = False,
    ) -> Exported:
        """Write this controller as self-contained C99, with a check of itself.

        The C does what `update` does: limits, applied inputs, modes and their age, refusals, clock
        and status, the operating point; of an `OutputFeedback` its observer, sums and references,
        too. It begins anew:
        u0 and mode_age are not written, its `reset` takes the inputs before the first call and the
        age.

        Parameters
        ----------
        folder : path
            Made if it is not there. Files of the same names are replaced if deadtime wrote
            them; one that lacks "Written by deadtime" is refused.
        precision : "double" or "float"
            Of all numbers but times; of a `BeliefPredictor` "double" alone.
        accuracy : float
            What a dense table may lose to take less room, of the sum of the moduli of a row's taps;
            1e-13 by default, 1e-7 in `float`; 0 loses nothing.
        rom_budget : int, optional
            Bytes that the tables may take.
        name : str
            Of the files, and the prefix of all names in them.
        names : deadtime.controller.export.Names, optional
            Of the law, its states and modes, for the header's comment.
        prediction : bool
            Whether the C also has `{name}_predict`, the `states` of `prediction`; its `by_mode`,
            `probabilities` and covariances are not in C.

        Raises
        ------
        ArgumentError
            If the folder cannot be written, the tables exceed the budget (it says what fits), the
            law's reference is a function of time, or a `prediction` is asked of a law without one.
        """
        from deadtime.controller.export import export_c

        return export_c(
            self,
            folder,
            precision=precision,
            accuracy=accuracy,
            rom_budget=rom_budget,
            name=name,
            names=names,
            prediction=prediction,
        )

    def export_fmu(
        self,
        path: str | Path,
        *,
        version: Literal["3.0", "2.0"] = "3.0",
        precision: Literal["double", "float"] = "double",
        accuracy: float | None = None,
        u0: ArrayLike = 0.0,
        names: Names | None = None,
    ) -> ExportedFmu:
        """Write this controller as an FMU for co-simulation, around the C of `export_c`.

        Its inputs are x, the mode and, if the parameter `report_applied` says so, `applied`; its
        outputs u and the status. Of a `BeliefPredictor` no mode comes in, and the belief goes out,
        the probability of every mode. Of laws that measure outputs y comes in instead of x; of an
        `OutputFeedback` the reference if `report_reference` says so, and the estimate goes out.
        Samples fall on the start and every period after it; a sample at the beginning of a step is
        taken in that step, with the inputs that hold there. The FMU has sources and, where there is
        a compiler, a binary for this machine.

        Parameters
        ----------
        path : path of the FMU, in .fmu
        version : "3.0" or "2.0"
            Of FMI.
        precision, accuracy, names
            As in `export_c`.
        u0 : number or (m,)
            The constant input before the start; parameters u0[i] of the FMU, too.

        Raises
        ------
        ArgumentError
            If the file cannot be written, or the law has no C (`export_c`).
        """
        from deadtime.controller.export import export_fmu

        return export_fmu(
            self,
            path,
            version=version,
            precision=precision,
            accuracy=accuracy,
            u0=u0,
            names=names,
        )
