"""`Controller`: a running law, which can be exported as C or as an FMU."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from numpy.typing import ArrayLike

from deadtime.controller.running import RunningLaw

if TYPE_CHECKING:
    from deadtime.controller.export import Exported, ExportedFmu, Names
    from deadtime.controller.prediction import Prediction


class Controller(RunningLaw):
    """A running law: call `update` once per period.

    The controller keeps the past inputs and the modes, and predicts with the inputs *as
    applied*: saturated by its own limits, or as reported by `applied`. So the prediction remains
    valid if an actuator deviates or an operator takes over. The cost of a factorised table does not
    depend on the delay.

    Parameters
    ----------
    law : Law
        A law that is a table and does not need the future signal; or an `OutputFeedback` of
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
        The equilibrium of the plant, such as `Problem.operating_point`. With it x, y, reference,
        applied, u0, limits and u are in the units of sensors and actuators, not deviations.
        Without it the equilibrium is x = 0, u = 0.

    Attributes
    ----------
    status : Status
        The outcome of the last period.
    refused : int
        How many calls had a status that is an error; `LATE` is none.
    late : int
        How many periods had no call, by the times of calls.
    samples : int
        How many periods have passed, those without a call included.
    belief : (modes,) array or None
        The probability of each mode at the last sample, of a `BeliefPredictor`.

    Raises
    ------
    ArgumentError
        If the law is no table or needs the future signal, or limits are out of order.

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
        """The predicted state when the input of the last `update` arrives, with its covariance.

        Its tables are made at the first call, and take a few times as long as the law's. Raises
        `ArgumentError` before the first sample, after a sample whose state was not finite, and for
        a law without a forecast.
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
        """Write this controller as self-contained C99 with a self-check.

        The C behaves as `update`: limits, applied inputs, modes and their age, refusals, clock and
        status, the operating point; for an `OutputFeedback` also its observer, sums and references.
        Its state is not exported: `reset` in C takes the inputs before the first call and the age.

        Parameters
        ----------
        folder : path
            Created if missing. Files of the same names are replaced if they contain "Written by
            deadtime", otherwise refused.
        precision : "double" or "float"
            Type of all numbers except times; a `BeliefPredictor` needs "double".
        accuracy : float
            Allowed error of a compressed dense table, relative to the sum of the moduli of a row's
            taps; 1e-13 by default, 1e-7 in `float`; 0 keeps the table exactly.
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
            If the folder cannot be written, the tables exceed the budget (the message says what
            fits), the law's reference is a function of time, or the law has no prediction.

        Returns
        -------
        Exported
            The files, the form of the tables, their bytes and the result of the self-check.
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
        outputs u and the status. A `BeliefPredictor` has no mode input; its belief, the probability
        of every mode, is an output. Laws on outputs have the input y instead of x; an
        `OutputFeedback` also has the estimate as an output and, if `report_reference` is set, the
        reference as an input. It samples at the start and once a period, with the inputs set before
        the step. The FMU has sources and, where there is a compiler, a binary for this machine.

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
            self, path, version=version, precision=precision, accuracy=accuracy, u0=u0, names=names
        )
