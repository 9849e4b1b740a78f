"""Pictures of a sweep: what stands in a cell, which law wins, bands, and what is refused."""

import json
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from matplotlib.colors import to_rgb

from deadtime.base.errors import ArgumentError
from deadtime.base.wording import file_names
from deadtime.cli.application import main
from deadtime.reports.figures.colours import colours_of
from deadtime.reports.figures.sweeps import plot_bands, plot_heat, plot_regret, plot_wins
from deadtime.reports.figures.sweeps.panels import NOT_BUILT, NOT_RUN
from deadtime.reports.figures.sweeps.reduction import LEVELS, quantiles, reduce
from deadtime.reports.figures.sweeps.selection import select

LAWS = ("averaged", "mean", "oracle")
AXES = {
    "sojourn": (["uniform", "fixed"], "sojourns", ""),
    "delay": ([0.25, 0.5, 1.0], "delay", "s"),
    "law.averaged.low_pass": ([0.1, 0.2], "time constant", "s"),
    "dwell_time": ([0.1, 0.2, 0.4, 0.8], "dwell time", "s"),
}


def sweep(*axes, laws=LAWS, scenarios=9, seed=0, oracle="oracle", **values):
    """A sweep over some of the axes, with random metrics."""
    shape = (*(len(AXES[name][0]) for name in axes), len(laws), scenarios)
    random = np.random.default_rng(seed)
    dims = (*axes, "law", "scenario")
    ise = values.get("ise", random.lognormal(1.0, 0.5, shape))
    variables = {
        "ise": (dims, np.array(ise, dtype=float), {"units": "x^2 s"}),
        "decay_rate": (dims, random.normal(0.5, 1.0, shape), {"units": "1/s"}),
        "diverged": (dims, np.zeros(shape, dtype=bool)),
        "reason": (dims[:-1], np.full(shape[:-1], "", dtype=object)),
        "done": (dims[:-2], np.ones(shape[:-2], dtype=bool)),
    }
    coordinates = {
        name: (name, AXES[name][0], {"long_name": AXES[name][1], "units": AXES[name][2]})
        for name in axes
    }
    return xr.Dataset(variables, coordinates | {"law": list(laws)}, {"oracle": oracle})


def panels(figure):
    """The panels of a map: all but the colour bar."""
    return [axes for axes in figure.axes if axes.get_label() != "<colorbar>"]


def texts(panel, rows):
    """What stands in the cells, row by row from below."""
    found = [text.get_text() for text in panel.texts]
    return [found[i : i + len(found) // rows] for i in range(0, len(found), len(found) // rows)]


def shade(panel, row, column):
    """The colour of one cell."""
    return tuple(panel.collections[0].get_array()[row, column])


def hatched(panel):
    """The (row, column) of every tied cell."""
    paths = [path for ties in panel.collections if ties.get_hatch() for path in ties.get_paths()]
    return [tuple(path.vertices.min(axis=0)[::-1] + 0.5) for path in paths]


def title(figure):
    """The title of a figure, spaces all alike."""
    return figure.get_suptitle().replace("\u00a0", " ")


# Heat maps


def test_a_cell_shows_the_median_that_numpy_has():
    data = sweep("delay", "dwell_time")
    figure = plot_heat(data, "mean")
    (panel,) = panels(figure)
    expected = np.median(data.ise.sel(law="mean"), axis=-1)
    assert texts(panel, 3) == [[f"{value:.2f}" for value in row] for row in expected]
    assert (panel.get_xlabel(), panel.get_ylabel()) == ("dwell time (s)", "delay (s)")
    assert [tick.get_text() for tick in panel.get_xticklabels()] == ["0.1", "0.2", "0.4", "0.8"]
    assert figure.axes[-1].get_ylabel() == "median ∫|x|² (x² s)"
    assert title(figure) == "Law “mean”"


def test_more_of_a_figure_is_darker_and_less_of_a_rate():
    data = sweep("delay", "dwell_time")
    for metric, sign in (("ise", 1.0), ("decay_rate", -1.0)):
        (panel,) = panels(plot_heat(data, "mean", metric))
        middle = sign * np.median(data[metric].sel(law="mean"), axis=-1)
        shades = [sum(shade(panel, *at)) for at in np.ndindex(3, 4)]
        assert np.all(np.diff(np.array(shades)[np.argsort(middle.ravel())]) <= 0.0)


def test_a_diverged_run_counts_as_infinite():
    data = sweep(scenarios=4, ise=[[1.0, 2.0, 3.0, 4.0]] * 3)
    data.diverged[1, 0] = True
    (panel,) = panels(plot_heat(data, "mean"))
    assert texts(panel, 1) == [["3.50"]]
    data.diverged[1, 1:3] = True
    assert texts(panels(plot_heat(data, "mean"))[0], 1) == [["∞"]]
    assert texts(panels(plot_heat(data, "mean", "decay_rate"))[0], 1) == [["−∞"]]


def test_a_cell_not_run_and_a_law_not_built_are_told_apart():
    data = sweep("delay", "dwell_time")
    data.ise[0, 1, 1] = np.nan  # the law could not be built
    data.ise[2, 3] = np.nan
    data.done[2, 3] = False
    figure = plot_heat(data, "mean")
    (panel,) = panels(figure)
    assert (texts(panel, 3)[0][1], texts(panel, 3)[2][3]) == ("–", "…")
    assert shade(panel, 0, 1) == NOT_BUILT
    assert shade(panel, 2, 3) == NOT_RUN
    keys = [text.get_text() for text in figure.legends[0].get_texts()]
    assert keys == ["–  could not be built", "…  not run yet"]
    assert not plot_heat(data, "averaged", where={"delay": 0.25}).legends


@pytest.mark.few(1)
@pytest.mark.parametrize("count", range(5))
def test_any_number_of_axes_is_drawn_with_every_cell_in_its_place(count):
    names = list(AXES)[4 - count :]
    data = sweep(*names, scenarios=3)
    figure = plot_heat(data, "averaged")
    shown = panels(figure)
    sizes = [data.sizes[name] for name in names]
    assert len(shown) == np.prod(sizes[:-2], dtype=int)
    middle = np.median(data.ise.sel(law="averaged"), axis=-1)
    rows = sizes[-2] if count > 1 else 1
    if count == 4:  # delays side by side, sojourns below each other
        middle = middle.reshape(6, rows, -1)
    for panel, values in zip(shown, middle.reshape(len(shown), rows, -1), strict=True):
        assert texts(panel, rows) == [[f"{value:.2f}" for value in row] for row in values]
    if count == 4:
        heads = [panel.get_title(loc="left").split("\n") for panel in shown[:3]]
        assert heads == [["delay 0.25 s", "uniform sojourns"], ["delay 0.5 s", ""],
                         ["delay 1 s", ""]]  # fmt: skip


def test_an_axis_of_text_may_stand_across_or_up():
    data = sweep("sojourn", "delay", "dwell_time")
    figure = plot_heat(data, "mean", x="sojourn", y="delay", where={"dwell_time": 0.4})
    (panel,) = panels(figure)
    assert [tick.get_text() for tick in panel.get_xticklabels()] == ["uniform", "fixed"]
    expected = np.median(data.ise.sel(law="mean", dwell_time=0.4), axis=-1).T
    assert texts(panel, 3) == [[f"{value:.2f}" for value in row] for row in expected]
    assert title(figure) == "Law “mean”: dwell time 0.4 s"


def test_many_cells_have_colours_only():
    ise = np.random.default_rng(0).lognormal(size=(30, 40, 1, 3))
    dims = ("a", "b", "law", "scenario")
    lost = np.zeros(ise.shape, dtype=bool)
    values = {"ise": (dims, ise), "diverged": (dims, lost)}
    data = xr.Dataset(values, {"a": np.arange(30), "b": np.linspace(0, 1, 40), "law": ["mean"]})
    (panel,) = panels(plot_heat(data, "mean"))
    (image,) = panel.collections
    assert (len(panel.texts), image.get_array().shape) == (0, (30, 40, 3))
    assert len(panel.get_xticks()) == len(panel.get_xticklabels()) == 20
    worst = np.unravel_index(np.median(ise[:, :, 0], axis=-1).argmax(), (30, 40))
    assert image.get_array()[worst].sum() == image.get_array().sum(axis=-1).min()


# The best law


def told_apart():
    """Averaged wins in the first cell, mean in the second; the third is a tie."""
    base = np.geomspace(1.0, 50.0, 30)
    wave = np.where(np.arange(30) % 2, 0.8, 1.25)
    ise = [[2.0 * base, 4.0 * base, base], [3.0 * base, 2.0 * base, base],
           [1.19 * wave * base, 1.2 * base, base]]  # fmt: skip
    return sweep("delay", scenarios=30, ise=ise)


def test_a_cell_has_the_winner_s_colour_and_the_runner_up_s_quotient():
    figure = plot_wins(told_apart())
    (panel,) = panels(figure)
    assert [text.get_text() for text in panel.texts] == ["2.00", "1.50", "1.01"]
    colours = colours_of(LAWS)
    for column, law in enumerate(("averaged", "mean")):
        assert shade(panel, 0, column) == to_rgb(colours[law])
    keys = [text.get_text() for text in figure.legends[0].get_texts()]
    assert keys == ["averaged", "mean", "tied"]


def test_a_tie_is_pale_and_hatched_and_nothing_else_is():
    (panel,) = panels(plot_wins(told_apart()))
    assert hatched(panel) == [(0, 2)]
    pale = 0.6 + 0.4 * np.array(to_rgb(colours_of(LAWS)["averaged"]))
    np.testing.assert_allclose(shade(panel, 0, 2), pale, atol=1e-12)


def test_the_winner_does_not_depend_on_whether_the_oracle_is_there():
    data = sweep("delay", "dwell_time", laws=("a", "b", "c", "oracle"), scenarios=5)
    data.diverged[0, 0, :2, 0] = True
    kept = select(data, "ise")
    ise = kept.ise.where(~kept.diverged, 1e300).values
    means = np.log(ise[..., :3, :] / ise[..., 3:, :]).clip(max=np.log(1e12)).mean(axis=-1)
    found = reduce(kept, "ise", ["a", "b", "c"], "oracle")
    np.testing.assert_array_equal(found.winner, means.argmin(axis=-1))
    alone = reduce(select(data.drop_sel(law="oracle"), "ise"), "ise", ["a", "b", "c"])
    xr.testing.assert_equal(found[["winner", "ratio"]], alone[["winner", "ratio"]])
    assert "oracle" not in {text.get_text() for text in plot_wins(data).legends[0].get_texts()}


def test_regret_is_the_geometric_mean_of_quotients_on_the_same_signal():
    data = sweep("delay", "dwell_time")
    figure = plot_regret(data, "averaged")
    quotients = data.ise.sel(law="averaged") / data.ise.sel(law="oracle")
    expected = np.exp(np.log(quotients.values).mean(axis=-1))
    (panel,) = panels(figure)
    assert texts(panel, 3) == [[f"{value:.2f}" for value in row] for row in expected]
    assert figure.axes[-1].get_ylabel() == "∫|x|² over the oracle's"


# Bands


def test_bands_are_numpy_s_quantiles():
    data = sweep("delay", "dwell_time")
    figure = plot_bands(data, laws=["mean"], where={"delay": 0.5})
    low, high, lower, upper, middle = (line.get_ydata() for line in figure.axes[0].lines)
    runs = data.ise.sel(law="mean", delay=0.5)
    expected = np.quantile(runs, LEVELS, axis=-1)
    np.testing.assert_allclose([low, lower, middle, upper, high], expected, rtol=1e-12)
    assert [text.get_text() for text in figure.legends[0].get_texts()] == [
        "mean", "25–75 %", "5–95 %",
    ]  # fmt: skip
    assert title(figure) == "delay 0.5 s"


def test_quantiles_of_runs_that_diverged_are_infinite_from_where_these_begin():
    values = np.array([3.0, 1.0, 2.0, np.inf, np.inf])
    np.testing.assert_array_equal(quantiles(values), [1.2, 2.0, 3.0, np.inf, np.inf])
    below = [-np.inf, -np.inf, -3.0, -2.0, -1.2]
    np.testing.assert_allclose(quantiles(-values), below, rtol=1e-12)
    assert np.isnan(quantiles(np.array([1.0, np.nan]))).all()


def test_each_panel_of_bands_is_one_place_on_the_other_axes():
    data = sweep("sojourn", "delay", "dwell_time")
    figure = plot_bands(data, x="dwell_time")
    heads = [axes.get_title(loc="left").replace("\u00a0", " ") for axes in figure.axes]
    assert heads == [f"{kind} sojourns, delay {delay:g} s"
                     for kind in ("uniform", "fixed") for delay in (0.25, 0.5, 1.0)]  # fmt: skip
    last = figure.axes[-1].lines[4].get_ydata()
    runs = data.ise.sel(law="averaged", sojourn="fixed", delay=1.0)
    np.testing.assert_allclose(last, np.median(runs, axis=-1), rtol=1e-12)


@pytest.mark.parametrize("axes", [(), ("sojourn",)])
def test_values_without_an_order_have_bars_and_no_line_joins_them(axes):
    data = sweep(*axes)
    (panel,) = plot_bands(data).axes
    assert all(line.get_linestyle() == "None" for line in panel.lines)
    heights = [line.get_ydata() for line in panel.lines]
    middle = np.median(data.ise, axis=-1).reshape(-1, 3).T
    np.testing.assert_allclose(heights, middle, rtol=1e-12)


def test_a_law_that_is_nowhere_in_the_frame_is_named_so():
    data = sweep("dwell_time")
    data.diverged[:, 0] = True
    keys = [text.get_text() for text in plot_bands(data).legends[0].get_texts()]
    assert keys[:2] == ["averaged (off the axes)", "mean"]


# Stores, selections, refusals


def test_chunks_change_nothing():
    data = sweep("delay", "dwell_time")
    lazy = data.chunk({"delay": 1, "dwell_time": 2})
    arguments = ("ise", ["averaged", "mean"], "oracle")
    xr.testing.assert_identical(
        reduce(select(lazy, "ise"), *arguments), reduce(select(data, "ise"), *arguments)
    )


@pytest.mark.parametrize("value", [0.5, 0.5 * (1.0 + 1e-10), "0.5", "0.50"])
def test_where_finds_a_value_by_its_number_or_its_text(value):
    data = sweep("delay", "dwell_time")
    kept = select(data, "ise", {"delay": value})
    xr.testing.assert_identical(kept.ise, data.ise.isel(delay=[1]))


def empty():
    data = sweep("delay")
    return data.assign(done=data.done & False)


MANY = xr.concat([sweep("delay", "dwell_time")] * 13, "seed").assign_coords(seed=range(13))
REFUSED = [
    (lambda d: plot_heat(d, "meen"), "law must be one of averaged, mean, oracle, got 'meen': did"),
    (lambda d: plot_heat(d, "mean", "isee"), "metric must be one of ise, decay_rate, got 'isee'"),
    (lambda d: plot_heat(d, "mean", x="dealy"), "x must be one of delay, dwell_time, got 'dealy'"),
    (lambda d: plot_heat(d, "mean", x="delay", y="delay"), "x and y must be different axes, got"),
    (lambda d: plot_heat(d, "mean", where={"dely": 1}), "where must be one of .* did you mean 'd"),
    (lambda d: plot_heat(d, "mean", where={"delay": 0.51}), "where.'delay'. must be one of 0.25, "),
    (lambda d: plot_heat(sweep(), "mean", x="delay"), "x must be left out, as there is none, got"),
    (lambda d: plot_heat(empty(), "mean"), "data must hold a cell that is done, got none: run the"),
    (lambda d: plot_heat(d.drop_vars("diverged"), "mean"), "got a dataset without diverged: open"),
    (lambda d: plot_bands(d, laws=[]), "laws must be a list of at least one name, got"),
    (lambda d: plot_bands(MANY), r"takes 12 panels at most, got 39 \(13 of seed × 3 of delay\): h"),
    (lambda d: plot_wins(d, "decay_rate"), "metric must not be 'decay_rate', which may be neg"),
    (lambda d: plot_wins(d.sel(law=["oracle"])), "laws must be given where the oracle is the only"),
    (lambda d: plot_regret(d.drop_sel(law="oracle"), "mean"), "data must hold a law that knows"),
]  # fmt: skip


@pytest.mark.parametrize(("draw", "message"), REFUSED, ids=range(len(REFUSED)))
def test_what_cannot_be_drawn_is_refused_by_name(draw, message):
    with pytest.raises(ArgumentError, match=message):
        draw(sweep("delay", "dwell_time"))


# The command


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    """The command on a sweep in memory."""
    monkeypatch.chdir(tmp_path)

    def command(data, *arguments):
        monkeypatch.setattr("deadtime.scenarios.sweeps.open_sweep", lambda store: data)
        with pytest.raises(SystemExit) as stopped:
            main(("plot", "mine.zarr", *arguments))
        printed = capsys.readouterr()
        return stopped.value.code, printed.out, printed.err

    return command


def test_the_command_draws_whatever_a_sweep_has_and_prints_the_paths(run):
    code, out, err = run(sweep("delay", scenarios=3), "--where", "delay=0.5")
    assert (code, err) == (0, "")
    assert out.splitlines() == [
        f"mine-plots/{name}.png"
        for name in ("heat-ise-averaged", "heat-ise-mean", "heat-ise-oracle", "bands-ise",
                     "wins-ise", "regret-ise-averaged", "regret-ise-mean")
    ]  # fmt: skip
    assert all(Path(path).read_bytes().startswith(b"\x89PNG") for path in out.splitlines())


def test_json_and_files_of_laws_that_are_spelled_alike(run):
    data = sweep("delay", laws=("a b", "a-b"), scenarios=3, oracle="")
    code, out, err = run(data, "--kind", "heat", "--metric", "decay_rate", "--json", "-o", "there")
    assert (code, err) == (0, "")
    assert json.loads(out) == {
        "store": "mine.zarr",
        "metric": "decay_rate",
        "left_out": None,
        "written": ["there/heat-decay_rate-a-b.png", "there/heat-decay_rate-a-b-2.png"],
    }


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--kind", "regret"), "data must hold a law that knows the future, got none: sweep"),
        (("--kind", "wins", "--metric", "decay_rate"), "metric must not be 'decay_rate'"),
        (("--law", "meen"), "did you mean 'mean'?"),
        (("--where", "delay"), "where must be axis=value, such as delay=0.5, got 'delay'."),
        (("--where", "delay=0.5", "--where", "delay=1"), "got 'delay' twice"),
        (("--kind", "bands", "--x", "dealy"), "x must be one of delay, got 'dealy'"),
        (("--out", "/proc/x"), "out '/proc/x' cannot be written"),
    ],
)
def test_bad_requests_get_one_line_and_code_2(run, arguments, message):
    code, out, err = run(sweep("delay", laws=("averaged", "mean"), oracle=""), *arguments)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert message in err


@pytest.mark.few(1)
@pytest.mark.parametrize("ending", ["png", "svg", "pdf"])
def test_out_may_be_a_figure_where_there_is_one(run, ending):
    data = sweep("delay", laws=("averaged", "mean"), oracle="")
    code, out, err = run(data, "--kind", "bands", "--out", f"new/x.{ending}")
    assert (code, out, err) == (0, f"new/x.{ending}\n", "")
    begins = {"png": b"\x89PNG", "svg": b"<?xml", "pdf": b"%PDF"}[ending]
    assert Path(f"new/x.{ending}").read_bytes().startswith(begins)


def test_of_several_figures_one_file_is_refused_before_any_is_drawn(run):
    code, out, err = run(sweep("delay", laws=("averaged", "mean"), oracle=""), "--out", "x.png")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert "out 'x.png' is one file, but there are" in err
    assert not Path("x.png").exists()


def test_a_law_that_is_added_renames_no_file():
    before = file_names(["+ only", "only 2", "?"])
    assert before == {"+ only": "only", "only 2": "only-2", "?": "law"}
    after = file_names([*before, "- only", "mean", "!"])
    assert after == before | {"- only": "only-3", "mean": "mean", "!": "law-2"}
