"""`deadtime plot`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from deadtime.base.errors import ArgumentError
from deadtime.cli import options
from deadtime.cli.application import COMPARE, app, lines
from deadtime.cli.printing import output_folder, print_json, progress_bar, save_figure

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

Kind = Literal["heat", "bands", "wins", "regret", "all"]


@dataclass(frozen=True, eq=False)
class PlotPlan:
    """The cells to draw, the laws of heat maps and regret, and what laws are held against.

    `rivals` are the laws to choose the best of, `oracle` the law of the future; both are empty
    where such maps are not asked for, or the sweep has none. `left_out` says why bands cannot be
    drawn.
    """

    data: xr.Dataset
    kind: Kind
    metric: str
    laws: tuple[str, ...]
    sides: tuple[str | None, str | None]
    rivals: tuple[str, ...]
    oracle: str
    left_out: str

    @property
    def against_oracle(self) -> tuple[str, ...]:
        """The laws of regret; the oracle's own is 1 everywhere."""
        return tuple(law for law in self.laws if law != self.oracle) if self.oracle else ()

    @property
    def bands(self) -> bool:
        """Whether bands are drawn; with all kinds, only if they have not too many panels."""
        return self.kind == "bands" or (self.kind == "all" and not self.left_out)

    @property
    def count(self) -> int:
        """How many figures there will be."""
        heat = len(self.laws) if self.kind in ("heat", "all") else 0
        return heat + self.bands + bool(self.rivals) + len(self.against_oracle)


@app.command(
    group=COMPARE,
    help_epilogue=lines(
        "deadtime plot paper.zarr",
        "deadtime plot paper.zarr --kind bands --x delay",
        "deadtime plot paper.zarr --kind wins --out wins.svg",
        "deadtime plot paper.zarr --law mean --where delay=0.5 --where sojourn=uniform",
    ),
)
def plot(
    store: str,
    *,
    kind: Kind = "all",
    metric: str = "ise",
    law: str | None = None,
    x: str | None = None,
    y: str | None = None,
    where: Annotated[list[str] | None, Parameter(negative="")] = None,
    out: options.File = None,
    json_output: options.AsJson = False,
) -> None:
    """Draw a sweep's store: heat maps, quantile bands, the best law, regret against the oracle.

    Two axes span a panel, the others tell panels apart, and axes with one value stand in the
    title. What is not run yet is left out, so a sweep can be looked at while it runs.

    Parameters
    ----------
    store
        The store of a sweep.
    kind
        heat: the median of a metric under a law. bands: its median, 25 to 75 % and 5 to 95 % under
        every law, along one axis. wins: the best law, and how much the runner-up is worse. regret:
        a law over the oracle on the same signals. all: whatever of these the sweep has.
    metric
        ise, energy, cost, peak, settling_time, decay_rate or final_norm.
    law
        The law of heat and regret; every law, a file for each, by default.
    x
        The axis across; the last with more than one value by default.
    y
        The axis up; the last but one by default.
    where
        An axis and the value to hold it at, such as delay=0.5; may be given several times.
    out
        The figure, PNG, SVG, PDF or PGF, where there is one; or a folder for PNG files, by default
        next to where you are and named after the store.
    """
    from deadtime.scenarios.sweeps import open_sweep

    out = Path(f"{Path(store).stem}-plots") if out is None else out
    plan = _plan(open_sweep(store), kind, metric, law, (x, y), _where(where or []))
    single = _is_figure(out)
    if single and plan.count != 1:
        raise ArgumentError(
            f"out {str(out)!r} is one file, but there are {plan.count} figures: give a folder, or "
            "choose one of them with --kind and --law."
        )
    folder = output_folder("out", out.parent if single else out)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        reason = error.strerror
        raise ArgumentError(f"out {str(folder)!r} cannot be written: {reason}.") from None
    paths = []
    with progress_bar(plan.count, quiet=json_output) as advance:
        for name, figure in _figures(plan):
            paths.append(out if single else out / f"{name}.png")
            save_figure(figure, paths[-1])
            advance(name)
    if json_output:
        print_json({"store": store, "metric": metric, "left_out": plan.left_out or None}, paths)
        return
    print("\n".join(map(str, paths)))
    if plan.kind == "all" and plan.left_out:
        print(plan.left_out)


def _where(texts: Sequence[str]) -> dict[str, str]:
    """Axes and what they are held at; values are text, which the selection understands."""
    held: dict[str, str] = {}
    for text in texts:
        axis, sign, value = map(str.strip, text.partition("="))
        if not (axis and sign and value):
            raise ArgumentError(f"where must be axis=value, such as delay=0.5, got {text!r}.")
        if axis in held:
            raise ArgumentError(
                f"where must hold an axis at one value, got {axis!r} twice: draw them one by one."
            )
        held[axis] = value
    return held


def _plan(
    data: xr.Dataset,
    kind: Kind,
    metric: str,
    law: str | None,
    sides: tuple[str | None, str | None],
    held: dict[str, str],
) -> PlotPlan:
    """The figures to draw; all that can be refused is refused here, before the store is read."""
    from deadtime.reports.figures.sweeps import selection
    from deadtime.reports.figures.sweeps.bands import panes
    from deadtime.reports.figures.sweeps.heat import grid_for

    kept = selection.select(data, metric, held)
    laws = selection.named_laws(kept, None if law is None else [law], selection.laws_of(kept))
    if kind in ("wins", "regret"):
        selection.quotients_of(metric)
    if kind == "regret" and selection.oracle_or_refuse(kept) == law:
        raise ArgumentError(f"law must be another one than the oracle, got {law!r}.")
    if kind == "wins" and law is not None:
        raise ArgumentError("law is of heat and regret: wins compare all laws.")
    if kind == "bands":
        panes(kept, sides[0])
    if kind != "bands":
        grid_for(kept, *sides)
    quotients = metric not in selection.RATES
    oracle = selection.oracle_of(kept) if quotients and kind in ("regret", "all") else ""
    rivals = selection.causal(kept) if quotients and kind in ("wins", "all") else []
    left_out = ""
    try:
        panes(kept, sides[0])
    except ArgumentError as error:
        left_out = f"bands are left out: {error}"
    return PlotPlan(kept, kind, metric, tuple(laws), sides, tuple(rivals), oracle, left_out)


def _is_figure(out: Path) -> bool:
    """Whether a path is that of a figure, by its ending, rather than of a folder."""
    from matplotlib.figure import Figure

    known = Figure().canvas.get_supported_filetypes()
    return out.suffix[1:].lower() in known and not out.is_dir()


def _figures(plan: PlotPlan) -> Iterator[tuple[str, Figure]]:
    """Figures with the names of their files, from one pass over the store."""
    from deadtime.reports.figures.sweeps.bands import bands
    from deadtime.reports.figures.sweeps.heat import heat, regret, wins
    from deadtime.reports.figures.sweeps.reduction import reduce

    metric, names = plan.metric, _file_names(plan.laws)
    found = reduce(plan.data, metric, plan.rivals, plan.oracle)
    if plan.kind in ("heat", "all"):
        for law in plan.laws:
            yield f"heat-{metric}-{names[law]}", heat(found, law, metric, *plan.sides)
    if plan.bands:
        yield f"bands-{metric}", bands(found, metric, plan.sides[0])
    if plan.rivals:
        yield f"wins-{metric}", wins(found, plan.rivals, metric, *plan.sides)
    for law in plan.against_oracle:
        yield f"regret-{metric}-{names[law]}", regret(found, law, metric, *plan.sides)


def _file_names(laws: Sequence[str]) -> dict[str, str]:
    """Laws in the names of files, no two the same."""
    from deadtime.base.wording import file_name

    names: dict[str, str] = {}
    for law in laws:
        name, count = file_name(law) or "law", 2
        while name in names.values():
            name, count = f"{file_name(law) or 'law'}-{count}", count + 1
        names[law] = name
    return names
