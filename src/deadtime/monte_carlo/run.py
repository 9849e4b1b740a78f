"""`monte_carlo`: several laws over many switching signals, as a labelled dataset."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from deadtime.checks import positive, real_array, shaped
from deadtime.errors import ArgumentError
from deadtime.imperfections import Imperfection
from deadtime.laws.base import Law
from deadtime.monte_carlo.signals import SignalAt, SwitchingModel, signals_of
from deadtime.plant import SwitchedSystem
from deadtime.simulation import simulate
from deadtime.switching import SwitchingSignal
from deadtime.version import __version__

if TYPE_CHECKING:
    import xarray as xr

    Laws = Sequence[Law] | Mapping[str, Law]
    Model = SwitchingModel | Sequence[SwitchingSignal]
else:
    Laws = Model = object  # `_named` and `signals_of` check them, with better messages

BACKENDS = ("numba",)

# Metric: (unit, long name), in the order and under the names of `Trajectory.metrics()`.
METRICS = {
    "ise": ("x^2 s", "integral of |x|^2"),
    "energy": ("u^2 s", "integral of |u|^2"),
    "cost": ("x^2 s + u^2 s", "integral of |x|^2 + |u|^2"),
    "peak": ("x", "maximum of |x| over the samples"),
    "settling_time": ("s", "time from which |x| stays within 2 % of its peak, inf if never"),
    "decay_rate": ("1/s", "minus the slope of log|x| over the second half"),
    "final_norm": ("x", "|x| at the end"),
}
DIVERGED = "|x| left 1e100 and the run ended there; its metrics are those up to that end"

Progress = Callable[[int, int], None]


def monte_carlo(
    plant: SwitchedSystem,
    laws: Laws,
    model: Model,
    x0: ArrayLike,
    horizon: float,
    step: float = 0.01,
    scenarios: int = 1000,
    seed: int = 0,
    backend: str = "numba",
    progress: Progress | None = None,
    imperfections: Sequence[Imperfection] = (),
) -> xr.Dataset:
    """Run several laws over many switching signals, every law on the same ones.

    The signal of scenario i depends on the model, on `seed` and on i only: not on the number
    of scenarios or of laws. Inputs before time 0 are 0.

    Parameters
    ----------
    plant : SwitchedSystem
        The truth, as in `simulate`.
    laws : list of Law, or mapping of names to laws
        A list is named by the laws' labels, which must differ.
    model : switching model, or list of SwitchingSignal
        Something with a method ``sample(horizon, seed)``; it is asked for signals that reach
        the horizon plus the longest delay. Or the signals themselves, one per scenario. One
        that ends before the horizon goes on in its last mode, as in `simulate`, and
        ``attrs["message"]`` counts these.
    x0 : array_like, shape (n,)
        State at time 0.
    horizon : float
        Length of every run, in seconds.
    step : float
        Sampling period h, in seconds.
    scenarios : int
        Number of signals to draw, ≥ 1; with a list of signals its length counts instead.
    seed : int
        At least 0. The same seed gives the same signals.
    backend : str
        How to compute; "numba" is the only one so far.
    progress : callable, optional
        Called as ``progress(done, total)`` after each scenario.
    imperfections : sequence of Imperfection
        What sensors and actuators do, as in `simulate`; scenario i draws the same for every law,
        whatever the number of scenarios.

    Returns
    -------
    xarray.Dataset
        Dimensions (law, scenario); one variable per metric of `Trajectory.metrics`, with its
        unit, and `diverged`. A run that diverges leaves its metrics up to its end, and the
        other runs untouched.

    Raises
    ------
    ArgumentError
        If an argument is malformed, or laws, plant and signals do not belong together.

    Examples
    --------
    >>> import deadtime as dt
    >>> from deadtime.monte_carlo import monte_carlo
    >>> problem = dt.problems.paper()
    >>> laws = [problem.laws["averaged"], problem.laws["mean"]]
    >>> signals = [dt.SwitchingSignal.random(2, 16, dwell_time=0.2, seed=i) for i in range(20)]
    >>> data = monte_carlo(problem.plant, laws, signals, problem.x0, horizon=15)
    >>> dict(data.sizes), int(data.diverged.sum())
    ({'law': 2, 'scenario': 20}, 0)
    >>> data.ise.median("scenario").sel(law="mean").item() < 1000
    True
    """
    horizon, step = positive("horizon", horizon), positive("step", step)
    named = _named(laws)
    scenarios, seed = _whole("scenarios", scenarios, 1), _whole("seed", seed, 0)
    if backend not in BACKENDS:
        raise ArgumentError(f"backend must be one of {list(BACKENDS)}, got {backend!r}.")
    x0 = shaped("x0", real_array("x0", x0, "(n,)", 1), (plant.states,), "(n,)")
    delay = max(plant.delay, *(law.plant.delay for law in named.values()))
    signal_at, scenarios = signals_of(model, scenarios, seed, horizon + delay, plant.modes)

    def run(law: Law, signal: SwitchingSignal, scenario: int):
        drawn = int(np.random.SeedSequence([seed, scenario]).generate_state(1)[0])
        return simulate(
            plant, law, signal, x0, horizon, step, imperfections=imperfections, seed=drawn
        )

    values, diverged, continued = _loop(named, signal_at, scenarios, horizon, run, progress)
    attributes = {
        "seed": seed,
        "step": step,
        "horizon": horizon,
        "modes": plant.modes,
        "states": plant.states,
        "inputs": plant.inputs,
        "delay": plant.delay,
        "backend": backend,
        "imperfections": [repr(one) for one in imperfections],
        "message": _message(continued, scenarios),
    }
    return _dataset(list(named), values, diverged, attributes)


def _loop(
    laws: Mapping[str, Law],
    signal_at: SignalAt,
    scenarios: int,
    horizon: float,
    run: Callable[[Law, SwitchingSignal, int], Any],
    progress: Progress | None,
) -> tuple[dict[str, np.ndarray], np.ndarray, int]:
    """Metrics and divergence of every law on every signal; how many signals ended early."""
    values = {name: np.empty((len(laws), scenarios)) for name in METRICS}
    diverged = np.zeros((len(laws), scenarios), dtype=bool)
    continued = 0
    for i in range(scenarios):
        signal = signal_at(i)
        continued += signal.end < horizon
        for row, law in enumerate(laws.values()):
            trajectory = run(law, signal, i)
            diverged[row, i] = trajectory.diverged
            for name, value in trajectory.metrics().items():
                values[name][row, i] = value
        if progress is not None:
            progress(i + 1, scenarios)
    return values, diverged, continued


def _dataset(
    names: list[str],
    values: Mapping[str, np.ndarray],
    diverged: np.ndarray,
    attributes: Mapping[str, Any],
) -> xr.Dataset:
    import xarray as xr

    dims = ("law", "scenario")
    variables: dict[str, Any] = {
        name: (dims, value, {"units": METRICS[name][0], "long_name": METRICS[name][1]})
        for name, value in values.items()
    }
    variables["diverged"] = (dims, diverged, {"long_name": DIVERGED})
    coordinates = {
        "law": ("law", names, {"long_name": "law"}),
        "scenario": ("scenario", np.arange(diverged.shape[1]), {"long_name": "scenario"}),
    }
    attributes = {**attributes, "version": __version__}
    return xr.Dataset(variables, coordinates, attributes)


def _named(laws: object) -> dict[str, Law]:
    """Laws by name, in their order."""
    if isinstance(laws, Mapping):
        pairs = list(laws.items())
    elif isinstance(laws, Sequence) and not isinstance(laws, str):
        pairs = [(getattr(law, "label", ""), law) for law in laws]
    else:
        hint = ": for one law, write [law]" if isinstance(laws, Law) else ""
        raise ArgumentError(
            f"laws must be a list of laws, or a dict of names to laws, got "
            f"{type(laws).__name__}{hint}."
        )
    if not pairs:
        raise ArgumentError("laws must hold at least one law, got none.")
    named: dict[str, Law] = {}
    for name, law in pairs:
        if not isinstance(law, Law):
            raise ArgumentError(f"laws must hold laws only, got {type(law).__name__}.")
        if not isinstance(name, str):
            raise ArgumentError(f"laws must have names that are strings, got {name!r}.")
        if name in named:
            raise ArgumentError(
                f"laws must have different labels, got {name!r} twice: "
                "name them yourself, with a dict of names to laws."
            )
        named[name] = law
    return named


def _whole(name: str, value: object, least: int) -> int:
    """An integer ≥ `least`."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
        raise ArgumentError(f"{name} must be an integer ≥ {least}, got {value!r}.")
    return int(value)


def _message(continued: int, scenarios: int) -> str:
    if not continued:
        return ""
    return (
        f"{continued} of {scenarios} signals end before the horizon and were continued in "
        "their last mode."
    )
