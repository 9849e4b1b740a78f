"""`deadtime plot`."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from deadtime.cli.entry import AsJson, app
from deadtime.cli.printing import progress_bar, save_figure
from deadtime.errors import ArgumentError

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

Kind = Literal["heat", "bands", "wins", "regret", "all"]
Job = tuple[str, Callable[[], "Figure"]]  # the name of a file without its ending, and its figure


@app.command
def plot(
    store: str,
    *,
    kind: Kind = "all",
    metric: str = "ise",
    law: str | None = None,
    x: str | None = None,
    y: str | None = None,
    where: Annotated[list[str] | None, Parameter(negative="")] = None,
    out: Annotated[Path | None, Parameter(alias="-o")] = None,
    json_output: AsJson = False,
) -> None:
    """Draw a sweep's store: heat maps, quantile bands, the best law, regret against the oracle.

    Two axes span a panel, the others tell panels apart, and axes with one value stand in the
    title. What is not run yet is left out, so a sweep can be looked at while it runs.

    Examples: `deadtime plot sweep.zarr`, `deadtime plot sweep.zarr --kind bands --x delay`,
    `deadtime plot sweep.zarr --kind heat --law mean --where delay=0.5 --where sojourn=uniform`.

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
        Folder for the PNG files; next to where you are, named after the store, by default.
    json_output
        Print the paths as JSON instead of text.
    """
    data = _open(store)
    held = _where(where or [])
    folder = Path(f"{Path(store).stem}-plots") if out is None else out
    jobs = list(_jobs(data, kind, metric, law, (x, y), held))
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ArgumentError(
            f"out {str(folder)!r} cannot be written ({error.strerror}): choose another folder."
        ) from None
    paths = []
    with progress_bar(len(jobs), quiet=json_output) as advance:
        for name, draw in jobs:
            paths.append(folder / f"{name}.png")
            save_figure(draw(), paths[-1])
            advance(name)
    if json_output:
        print(json.dumps({"store": store, "metric": metric, "figures": list(map(str, paths))}))
        return
    print("\n".join(map(str, paths)))


def _open(store: str) -> xr.Dataset:
    """The store as a dataset, lazily."""
    from deadtime.sweep import open_sweep

    return open_sweep(store)


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


def _jobs(
    data: xr.Dataset,
    kind: Kind,
    metric: str,
    law: str | None,
    sides: tuple[str | None, str | None],
    held: dict[str, str],
) -> Iterator[Job]:
    """What to draw, from one pass over the store; all that can be refused is refused before."""
    from deadtime.sweep_plots import selection
    from deadtime.sweep_plots.bands import bands, panes
    from deadtime.sweep_plots.heat import grid_for, heat, regret
    from deadtime.sweep_plots.reduction import reduced
    from deadtime.sweep_plots.wins import wins

    kept = selection.selected(data, metric, held)
    everything, quotients = kind == "all", metric not in selection.RATES
    if kind in ("wins", "regret"):
        selection.quotients_of(metric)
    if kind == "regret":
        selection.oracle_or_refuse(kept)
    oracle = selection.oracle_of(kept) if quotients and kind in ("regret", "all") else ""
    rivals = selection.causal(kept) if quotients and kind in ("wins", "all") else []
    chosen = selection.named_laws(kept, None if law is None else [law], selection.laws_of(kept))
    if kind == "bands" or everything:
        panes(kept, sides[0])
    if kind != "bands":
        grid_for(kept, *sides)
    found = reduced(kept, metric, rivals, oracle)
    names = _file_names(chosen)
    if kind == "heat" or everything:
        for one in chosen:
            yield f"heat-{metric}-{names[one]}", partial(heat, found, one, metric, *sides)
    if kind == "bands" or everything:
        yield f"bands-{metric}", partial(bands, found, metric, sides[0])
    if rivals:
        yield f"wins-{metric}", partial(wins, found, rivals, metric, *sides)
    if oracle:
        for one in chosen:
            if one != oracle:
                yield f"regret-{metric}-{names[one]}", partial(regret, found, one, metric, *sides)


def _file_names(laws: Sequence[str]) -> dict[str, str]:
    """Laws in the names of files, no two the same."""
    from deadtime.wording import file_name

    names: dict[str, str] = {}
    for law in laws:
        name, count = file_name(law) or "law", 2
        while name in names.values():
            name, count = f"{file_name(law) or 'law'}-{count}", count + 1
        names[law] = name
    return names
