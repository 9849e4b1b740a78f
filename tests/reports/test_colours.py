"""One law, one colour, whatever figure it is in."""

import xarray as xr

import deadtime as dt
from deadtime.reports.figures.colours import GREY, looks_of
from deadtime.reports.figures.monte_carlo import plot_monte_carlo
from deadtime.reports.figures.runs import plot_laws, plot_norms

LAWS = ["averaged", "mode 0 only", "mean", "oracle", "delay ignored"]


def colours_in(lines):
    return {str(line.get_label()).partition(" (off")[0]: line.get_color() for line in lines}


def test_every_figure_gives_a_law_its_colour():
    problem = dt.problems.paper()
    runs = {law: problem.simulate(law) for law in LAWS}
    dims, cost = ("law", "scenario"), [[1.0 + i, 2.0 + i] for i in range(len(LAWS))]
    data = xr.Dataset(
        {"cost": (dims, cost), "diverged": (dims, [[False] * 2] * len(LAWS))}, {"law": LAWS}
    )
    expected = {law: look.colour for law, look in looks_of(LAWS).items()}
    assert expected["oracle"] == GREY
    assert len(set(expected.values())) == len(LAWS)
    assert colours_in(plot_norms(runs).axes[0].get_lines()) == expected
    assert colours_in(plot_laws(runs).axes[0].get_lines()) == expected
    assert colours_in(plot_monte_carlo(data).legends[0].get_lines()) == expected
