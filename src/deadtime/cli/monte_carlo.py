"""`deadtime monte-carlo`."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from deadtime.base.errors import ArgumentError
from deadtime.cli import options
from deadtime.cli.application import COMPARE, app, lines
from deadtime.cli.printing import (
    TABLES,
    nominal_plant_sentence,
    output_file,
    print_answer,
    print_details,
    print_json,
    print_never,
    print_table,
    require_width,
    require_writable,
    save_figure,
    save_text,
)

if TYPE_CHECKING:
    import xarray as xr

    from deadtime.problems import Problem
    from deadtime.problems.switching_assumptions import SourcedTime
    from deadtime.reports.scenario_tables import Summary
    from deadtime.switching import SwitchingModel

_DATA = (".nc", ".csv")


@app.command(
    group=COMPARE,
    help_epilogue=lines(
        "deadtime monte-carlo paper",
        "deadtime monte-carlo problem.toml --scenarios 100000 --data all.nc",
    ),
)
def monte_carlo(
    problem: options.ProblemFile,
    *,
    law: options.AllLaws = None,
    scenarios: int = 10_000,
    dwell_time: float | None = None,
    mean_sojourn: float | None = None,
    seed: int = 0,
    step: float | None = None,
    out: options.Picture = None,
    width: options.FigureWidth = None,
    data: Path | None = None,
    table: Path | None = None,
    json_output: options.AsJson = False,
) -> int:
    """Run the laws of a problem over many random switching signals, the same for all laws.

    Signals are drawn from the file's [switching]. Without one, or with a dwell time or mean sojourn
    given here, sojourns are the dwell time plus an exponential time, and all other modes that the
    file allows are equally likely. Ctrl-C ends the run early and keeps the finished scenarios.

    Parameters
    ----------
    scenarios
        Number of switching signals.
    dwell_time
        Shortest sojourn, seconds; by default the problem's dwell time, or its signal's.
    mean_sojourn
        Mean of whole sojourns, seconds; by default the problem's, or twice the dwell time if it
        states none, or none longer than the dwell time.
    seed
        Seed of the signals.
    step
        Sampling period in seconds; the problem's by default.
    data
        A file for the metrics of every run: netCDF (.nc) or CSV (.csv).
    table
        A file for the table of the laws, with intervals, for LaTeX (.tex).
    """
    from deadtime.problems.file.switching import drawn_as
    from deadtime.reports.figures.monte_carlo import plot_monte_carlo
    from deadtime.reports.scenario_tables import summary
    from deadtime.scenarios.batch_run import compare
    from deadtime.switching import SignalClass

    chosen = options.with_law(options.problem_of(problem), law)
    period = _period(chosen, step)
    _require_signals(chosen)
    overridden = dwell_time is not None or mean_sojourn is not None
    model, sojourn = chosen.switching, None
    if model is None or overridden:
        sojourn = _sojourn(chosen, dwell_time, mean_sojourn)
        model = _model(chosen, sojourn, mean_sojourn)
    picture = output_file("out", out, f"{chosen.name}-monte-carlo")
    require_width(width)
    require_writable("data", data, _DATA)
    require_writable("table", table, TABLES)
    signals = chosen.signals
    if sojourn is not None:  # of the drawn signals
        longest = chosen.limits.maximum_dwell
        signals = SignalClass(sojourn.dwell.value or None, maximum_dwell=longest, at=signals.at)
    drawn = drawn_as(model, signals, period)
    result = compare(
        chosen.plant,
        chosen.laws,
        drawn,
        chosen.x0,
        chosen.horizon,
        period,
        scenarios,
        seed,
        progress=sys.stderr.isatty() and not json_output,
        imperfections=chosen.imperfections,
        weight=chosen.weight,
        share_compiling=True,
    )
    if not result.sizes["scenario"]:
        raise KeyboardInterrupt  # no block of scenarios is complete
    outcome = summary(result)
    written = [path for path in (picture, data, table) if path is not None]
    if json_output:
        print_json(_record(chosen, model, sojourn, result, outcome), written)
    else:
        _print(chosen, model, sojourn, result, outcome, rounded=drawn is not model)
    save_figure(plot_monte_carlo(result, chosen.title, width), picture)
    if data is not None:
        save_data(result, data)
    if table is not None:
        save_text("table", table, outcome.to_latex())
    if not json_output:
        named = {"Figure": picture, "Data": data, "Table": table}
        print("\n" + "\n".join(f"{what}: {path}" for what, path in named.items() if path))
    if not result.attrs["interrupted"]:
        return 0
    done = f"{outcome.scenarios:,} of {scenarios:,} scenarios"
    print(f"deadtime: interrupted after {done}; the results cover these", file=sys.stderr)
    return 130


def save_data(data: xr.Dataset, path: Path) -> None:
    """Metrics on disk: netCDF, or CSV with a row for each law and scenario.

    Attributes that are lists become text, parts separated by "; ": netCDF 3 has no lists of text.
    """
    from deadtime.base.files import replacing

    with replacing(path, "data") as place:
        if path.suffix.lower() == ".csv":
            frame = _flat(data).to_dataframe(dim_order=["law", "scenario"])
            frame.reset_index().to_csv(place, index=False)
            return
        texts = {
            name: "; ".join(map(str, value)) if isinstance(value, list) else value
            for name, value in data.attrs.items()
        }
        data.assign_attrs(texts).to_netcdf(place, engine="scipy")


def _flat(data: xr.Dataset) -> xr.Dataset:
    """Metrics of every tracked output as separate variables, RiseTime[0], …."""
    for name in [str(name) for name, one in data.items() if "output" in one.dims]:
        for output in range(data.sizes["output"]):
            data[f"{name}[{output}]"] = data[name].isel(output=output, drop=True)
        data = data.drop_vars(name)
    return data.drop_vars("output", errors="ignore")


def _period(problem: Problem, step: float | None) -> float:
    from deadtime.base.checks import positive

    if step is not None:
        return positive("step", step)
    if problem.step is None:
        raise ArgumentError(
            f"the loop of the problem {problem.name!r} is ideal, and Monte Carlo runs sampled "
            "loops: give a sampling period, --step 0.01."
        )
    return problem.step


class Sojourn(NamedTuple):
    """Dwell time and mean sojourn of the signals, and where each comes from."""

    dwell: SourcedTime
    mean: SourcedTime


def _require_signals(problem: Problem) -> None:
    """Refuse one mode, a rule, and settings that Monte Carlo does not run."""
    import numpy as np

    from deadtime.switching import SwitchingSignal

    if problem.plant.modes == 1:
        raise ArgumentError(
            f"the plant of the problem {problem.name!r} has one mode, so no signal switches it: "
            "use deadtime simulate."
        )
    if not isinstance(problem.signal, SwitchingSignal):
        raise ArgumentError(
            f"the plant of the problem {problem.name!r} is switched by its state, not by random "
            "signals: use deadtime simulate, or give the file a [signal] instead of the rule."
        )
    if np.any(problem.u0) or problem.predict != "applied":
        raise ArgumentError(
            f'the problem {problem.name!r} must have u0 = 0 and predict = "applied", as all Monte '
            f"Carlo runs have, got u0 = {np.asarray(problem.u0).tolist()} and predict = "
            f"{problem.predict!r}: change the file."
        )


def _sojourn(problem: Problem, dwell: float | None, mean: float | None) -> Sojourn:
    from deadtime.problems.switching_assumptions import (
        dwell_time_of,
        mean_sojourn_of,
        signals_of,
    )

    signal = problem.given_signal
    if dwell is None and problem.signals.chatter > 1:
        # The shortest sojourn of the file's signal says nothing: bursts may switch faster.
        shortest = signals_of(problem, signal).dwell
    elif dwell is None and problem.dwell_time is None and not math.isfinite(signal.dwell_time):
        raise ArgumentError(
            f"the signal of the problem {problem.name!r} never switches, so it has no dwell "
            "time: give one, --dwell-time 0.2."
        )
    else:
        shortest = dwell_time_of(problem, signal, dwell)
    least = shortest.value
    whole = mean_sojourn_of(problem, least, mean)
    if least < 0.0 or least == whole.value == 0.0:
        raise ArgumentError(
            f"dwell_time must be positive, in s, or 0 with a --mean-sojourn, got {least:g}."
        )
    if whole.value <= least:
        raise ArgumentError(
            f"mean_sojourn must be above the dwell time, {least:g} s, got {whole.value:g} "
            f"({whole.source}): give a longer one with --mean-sojourn."
        )
    return Sojourn(shortest, whole)


def _model(problem: Problem, sojourn: Sojourn, mean_sojourn: float | None) -> SwitchingModel:
    """Sojourns of dwell + Exp(mean − dwell), then any mode that may follow."""
    from deadtime.problems.switching_assumptions import AS_GIVEN, random_model, signals_of
    from deadtime.switching.models.semi_markov import SemiMarkov
    from deadtime.switching.models.sojourns import ShiftedExponential

    if not problem.limits.is_plain:
        given = [sojourn.dwell.value] if sojourn.dwell.source == AS_GIVEN else None
        signals = signals_of(problem, problem.signal, given).signals
        allowed = signals.limits(problem.plant.modes)
        mean = problem.mean_sojourn if mean_sojourn is None else mean_sojourn
        short = mean is not None and mean <= max(allowed.dwell_time)
        return random_model(allowed, None if short and mean_sojourn is None else mean)
    dwell, mean = sojourn.dwell.value, sojourn.mean.value
    return SemiMarkov(ShiftedExponential(dwell, mean - dwell), modes=problem.plant.modes)


def _print(
    problem: Problem,
    model: SwitchingModel,
    sojourn: Sojourn | None,
    data: xr.Dataset,
    outcome: Summary,
    rounded: bool,
) -> None:
    from deadtime.base.wording import with_names
    from deadtime.problems.unit_checks import unit_checks_of
    from deadtime.reports import metrics

    print_answer(outcome.answer, problem.title)
    limited, about = not problem.limits.is_plain, []
    if sojourn is None:
        what = f"drawn from [switching]: {with_names(model.in_words, problem.modes)}"
    elif limited:
        what = f"of {model!r}"
    else:
        (dwell, shortest), (mean, whole) = sojourn
        what = f"sojourns of {dwell:g} s + Exp({mean - dwell:g} s)"
        about = [f"Dwell time {dwell:g} s: {shortest}. Mean sojourn {mean:g} s: {whole}."]
    if limited:
        switches = with_names(problem.signals.in_words(problem.plant.modes)[1], problem.modes)
        about = [f"Every signal {switches}."]
    if rounded:
        about.append("Modes change at samples: sojourns are rounded up to whole periods.")
    print(
        f"{outcome.scenarios:,} random signal{'s' * (outcome.scenarios != 1)}, {what}, "
        f"{problem.horizon:g} s each, sampled every {data.attrs['step']:g} s, seed "
        f"{data.attrs['seed']}."
    )
    print(f"\n{metrics.measure_title(outcome.measure, problem.weight)}")
    ratio, intervals = outcome.notes
    print_table(outcome.headings, outcome.rows())
    print(f"{ratio}\n" if outcome.compares else "")
    print_table(outcome.interval_headings, outcome.interval_rows())
    print(intervals)
    other = "ise" if outcome.measure == "cost" else "cost"
    print(f"\n{metrics.measure_title(other, problem.weight)}")
    print_table(outcome.headings[:4], outcome.rows_of(other))
    shown = [metrics.rows_of_many(data, i) for i in range(len(problem.tracked))]
    for i, rows in enumerate(shown):
        print(f"\n{metrics.heading_of(problem, i)}, to the end of the run, medians")
        print_table(metrics.HEADINGS, rows)
    print_never(shown)
    checks = unit_checks_of(problem, data.attrs["step"])
    details = [*about, *nominal_plant_sentence(problem), *checks]
    if problem.imperfections:
        details.append(f"Imperfections: {', '.join(problem.imperfections_in_words)}.")
    reasons = dict(zip(data.attrs["one_by_one"], data.attrs["one_by_one_because"], strict=True))
    for reason in dict.fromkeys(reasons.values()):
        slow = ", ".join(name for name, why in reasons.items() if why == reason)
        details.append(f"Run one by one, which is slower: {slow}, because {reason}.")
    print()
    print_details([*details, *filter(None, [data.attrs["message"]])])


def _record(
    problem: Problem,
    model: SwitchingModel,
    sojourn: Sojourn | None,
    data: xr.Dataset,
    outcome: Summary,
) -> dict[str, object]:
    from deadtime.plant.weight import record_of
    from deadtime.reports import metrics

    return {
        "problem": problem.name,
        "scenarios": outcome.scenarios,
        "dwell_time": None if sojourn is None else sojourn.dwell.value,
        "mean_sojourn": None if sojourn is None else sojourn.mean.value,
        "model": repr(model) if sojourn is None or not problem.limits.is_plain else None,
        "horizon": problem.horizon,
        **{name: data.attrs[name] for name in ("step", "seed", "backend", "message")},
        "interrupted": bool(data.attrs["interrupted"]),
        "reference": outcome.reference,
        **record_of(problem.weight),
        "laws": outcome.records(),
        **metrics.record_of_many(problem, data),
    }
