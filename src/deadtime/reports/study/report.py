"""The report of a study: answers, maps, data, and one HTML page that opens with the answers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from deadtime.base.wording import file_name
from deadtime.problems.law_registry import LEVELS, the_law
from deadtime.reports.report_folder import PAGE, save_figure, write_metrics, write_page, writing
from deadtime.reports.study import maps
from deadtime.reports.study.answers import answers
from deadtime.reports.study.phrases import Answer
from deadtime.reports.study.study_data import failures, record_of, run_study, write_cells
from deadtime.scenarios.sweeps.axes import AXES, FAMILIES, ORACLE, knowledge_of, within
from deadtime.scenarios.sweeps.file_study import FileStudy
from deadtime.scenarios.sweeps.run_sweep import Report

if TYPE_CHECKING:
    import xarray as xr

FEWER_KNOWN = {
    "nothing": "laws that know nothing of the switching",
    "the dwell time": "laws that know the dwell time at most",
    "the distribution": "all laws but the oracle",
}


@dataclass(frozen=True, eq=False)
class StudyReport:
    """The path of a study's report, its answers and its data."""

    path: Path
    answers: list[Answer]
    data: xr.Dataset
    record: dict[str, Any]


def write_study(
    study: FileStudy,
    folder: str | Path,
    workers: int | None = None,
    progress: Report | None = None,
    command: str = "",
    scheduler: str | None = None,
) -> StudyReport:
    """Run a study and write its report into a folder.

    Writes index.html (self-contained), figures/ (PNG and SVG), data/study.zarr (every run; what is
    there already is not computed again), data/cells.csv (a row per cell and law) and metrics.json;
    files of the same names are replaced, others are left alone.

    Parameters
    ----------
    study : FileStudy
        From `load_study`.
    folder : path
        Made if it does not exist, before anything is run.
    workers, progress, scheduler
        As in `sweep`.
    command : str
        How to make the report again, for its last line.

    Raises
    ------
    ArgumentError
        If the folder cannot be written, its store holds another study, or the grid is not that of
        the report's maps.
    DeadtimeError
        What `sweep` raises.
    """
    folder = Path(folder)
    with writing(folder):  # before an hour of runs
        pass
    data = run_study(study, folder / "data" / "study.zarr", workers, progress, scheduler)
    causal = [law for law in study.laws if law != ORACLE]
    caption = "∫|x|² over the oracle’s, geometric mean and 95 % interval, on one line of the grid."
    with writing(folder) as place:
        sections = answers(data)
        write_cells(data, place / "data" / "cells.csv")
        record = record_of(data, sections)
        write_metrics(record, place, indent=1)
        write_page(
            place,
            "study.html.j2",
            **_setting(study),
            command=command,
            answers=[(answer, list(_duels(data, answer, place))) for answer in sections],
            picture=save_figure(maps.plot_lines(data, causal), place, "lines", caption),
            winners=list(_winners(data, causal, place)),
            laws=[(law, the_law(law), list(_alone(data, law, place))) for law in study.laws],
            failures=failures(data),
        )
    return StudyReport(folder / PAGE, sections, data, record)


def _duels(data: xr.Dataset, answer: Answer, folder: Path) -> Iterator[dict[str, str]]:
    for first, second in answer.duels:
        caption = (
            f"∫|x|² under {the_law(first)} over that under {the_law(second)}: blue where the "
            "former is better. Hatched: the signals do not decide."
        )
        name = f"{file_name(first)}-over-{file_name(second)}"
        yield save_figure(maps.plot_duel(data, first, second), folder, name, caption)


def _winners(data: xr.Dataset, causal: Sequence[str], folder: Path) -> Iterator[dict[str, str]]:
    """A map for every level of knowledge that some law has."""
    for level, who in FEWER_KNOWN.items():
        if any(knowledge_of(law) == level for law in causal):
            laws = within(causal, level)
            caption = (
                f"The best of {who}. In the cell: ∫|x|² of the second best over that of the best. "
                "Pale and hatched: tied with it."
            )
            name = f"winners-{LEVELS.index(level)}"
            yield save_figure(maps.plot_winners(data, laws), folder, name, caption)


def _alone(data: xr.Dataset, law: str, folder: Path) -> Iterator[dict[str, str]]:
    if law != ORACLE:
        caption = f"∫|x|² under {the_law(law)} over the oracle’s, geometric mean over signals."
        figure = maps.plot_regret(data, law)
        yield save_figure(figure, folder, f"regret-{file_name(law)}", caption)
    caption = f"Signals that {the_law(law)} stabilises, %."
    figure = maps.plot_stabilised(data, law)
    yield save_figure(figure, folder, f"stabilised-{file_name(law)}", caption)


def _setting(study: FileStudy) -> dict[str, Any]:
    base = study.base
    return {
        "study": study,
        "plant": base.plant,
        "step": base.step,
        "horizon": base.horizon,
        "grid": [
            (AXES[name].label, ", ".join(map(_value, values)), AXES[name].unit)
            for name, values in study.grid.items()
        ],
        "families": [
            (name, FAMILIES[name][0]) for name in study.grid.get("sojourn", ("exponential",))
        ],
        "poles": ", ".join(_value(pole) for pole in study.poles or ()),
        "x0": ", ".join(f"{value:g}" for value in base.x0).replace("-", "−"),
    }


def _value(value: object) -> str:
    if isinstance(value, complex) and value.imag == 0.0:
        value = value.real
    return value if isinstance(value, str) else f"{value:g}".replace("-", "−")
