"""`deadtime plot`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from deadtime.base.errors import ArgumentError
from deadtime.base.wording import file_names
from deadtime.cli import options
from deadtime.cli.application import COMPARE, app, lines
from deadtime.cli.printing import output_folder, print_json, progress_bar, save_figure

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

Kind = Literal["heat", "bands", "wins", "regret", "all"]


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

    Two axes span a panel, the others distinguish panels, and axes with one value are in the title.
    Cells without results are left out, so that a sweep can be plotted while it runs.

    Parameters
    ----------
    store
        The store of a sweep.
    kind
        heat: the median of a metric under a law. bands: its median, 25 to 75 % and 5 to 95 % under
        every law, along one axis. wins: the best law, and its lead over the second. regret: a law
        over the oracle on the same signals. all: all of these that the sweep allows.
    metric
        ise, energy, cost, peak, settling_time, decay_rate or final_norm.
    law
        The law of heat and regret; every law, a file for each, by default.
    x
        The horizontal axis; the last with more than one value by default.
    y
        The vertical axis; the last but one by default.
    where
        A fixed value of an axis, such as delay=0.5; may be repeated.
    out
        A file for one figure, PNG, SVG, PDF or PGF; or a folder for PNG files, by default in the
        current folder and named after the store.
    """
    from deadtime.scenarios.sweeps import open_sweep

    out = Path(f"{Path(store).stem}-plots") if out is None else out
    fixed = _where(where or [])
    reduced, drawings, left_out = _plan(open_sweep(store), kind, metric, law, (x, y), fixed)
    single = _is_figure(out)
    if single and len(drawings) != 1:
        raise ArgumentError(
            f"out {str(out)!r} is one file, but there are {len(drawings)} figures: give a folder, "
            "or choose one of them with --kind and --law."
        )
    folder = output_folder("out", out.parent if single else out)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        reason = error.strerror
        raise ArgumentError(f"out {str(folder)!r} cannot be written: {reason}.") from None
    paths = []
    with progress_bar(len(drawings), quiet=json_output) as advance:
        data = reduced()
        for name, draw in drawings.items():
            paths.append(out if single else out / f"{name}.png")
            save_figure(draw(data), paths[-1])
            advance(name)
    if json_output:
        print_json({"store": store, "metric": metric, "left_out": left_out or None}, paths)
        return
    print("\n".join(map(str, paths)))
    if kind == "all" and left_out:
        print(left_out)


def _where(texts: Sequence[str]) -> dict[str, str]:
    """Axes and their fixed values, as text."""
    fixed: dict[str, str] = {}
    for text in texts:
        axis, sign, value = map(str.strip, text.partition("="))
        if not (axis and sign and value):
            raise ArgumentError(f"where must be axis=value, such as delay=0.5, got {text!r}.")
        if axis in fixed:
            raise ArgumentError(
                f"where must hold an axis at one value, got {axis!r} twice: draw them one by one."
            )
        fixed[axis] = value
    return fixed


def _plan(
    data: xr.Dataset,
    kind: Kind,
    metric: str,
    law: str | None,
    sides: tuple[str | None, str | None],
    fixed: dict[str, str],
) -> tuple[Callable[[], xr.Dataset], dict[str, Callable[[xr.Dataset], Figure]], str]:
    """A reader of the store in one pass, its figures, and the reason if bands are left out.

    The keys of the figures are file names. Whatever can be refused is refused here.
    """
    from deadtime.reports.figures.sweeps import selection
    from deadtime.reports.figures.sweeps.bands import bands, panes
    from deadtime.reports.figures.sweeps.heat import grid_for, heat, regret, wins
    from deadtime.reports.figures.sweeps.reduction import reduce

    chosen = selection.select(data, metric, fixed)
    laws = selection.named_laws(chosen, None if law is None else [law], selection.laws_of(chosen))
    if kind in ("wins", "regret"):
        selection.quotients_of(metric)
    if kind == "regret" and selection.oracle_or_refuse(chosen) == law:
        raise ArgumentError(f"law must be another one than the oracle, got {law!r}.")
    if kind == "wins" and law is not None:
        raise ArgumentError("law is for heat and regret: leave it out, wins compare all laws.")
    left_out = ""
    try:
        panes(chosen, sides[0])
    except ArgumentError as error:
        if kind == "bands":
            raise
        left_out = f"bands are left out: {error}"
    if kind != "bands":
        grid_for(chosen, *sides)
    quotients = metric not in selection.RATES
    oracle = selection.oracle_of(chosen) if quotients and kind in ("regret", "all") else ""
    rivals = selection.causal(chosen) if quotients and kind in ("wins", "all") else []
    names, given = file_names(laws), {"metric": metric, "x": sides[0], "y": sides[1]}
    drawings: dict[str, Callable[[xr.Dataset], Figure]] = {}
    if kind in ("heat", "all"):
        drawings |= {f"heat-{metric}-{names[one]}": partial(heat, law=one, **given) for one in laws}
    if kind == "bands" or (kind == "all" and not left_out):
        drawings[f"bands-{metric}"] = partial(bands, metric=metric, x=sides[0])
    if rivals:
        drawings[f"wins-{metric}"] = partial(wins, rivals=rivals, **given)
    drawings |= {
        f"regret-{metric}-{names[one]}": partial(regret, law=one, **given)
        for one in laws
        if oracle and one != oracle  # whose regret is 1 everywhere
    }
    return partial(reduce, chosen, metric, rivals, oracle), drawings, left_out


def _is_figure(out: Path) -> bool:
    """Whether a path is that of a figure, by its ending, rather than of a folder."""
    from matplotlib.figure import Figure

    known = Figure().canvas.get_supported_filetypes()
    return out.suffix[1:].lower() in known and not out.is_dir()
