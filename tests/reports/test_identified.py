"""The page on an identification: one file, with all that was found."""

import re

import numpy as np
import pandas as pd
import pytest

import deadtime as dt
from deadtime.cli.application import main
from deadtime.identification.identification_figure import figures_of
from deadtime.reports.identification_report import write_identification
from synthetic_logs import Plant

H = 0.05
MODES = Plant(
    [[[-1.0, 0.5], [0.0, -2.0]], [[-0.5, 0.0], [1.0, -1.0]], [[-2.0, 1.0], [-1.0, -1.0]]],
    np.tile([[[1.0, 0.2], [0.3, -1.0]]], (3, 1, 1)),
    [0.312, 0.174],
    1e-3 * np.eye(2),
)


@pytest.fixture(scope="module")
def log():
    rng, mode = np.random.default_rng(0), (np.arange(500) // 20) % 3
    x, u = MODES.log(H * np.arange(500), rng.standard_normal((500, 2)), rng, mode)
    table = {"t": H * np.arange(500), "x1": x[:, 0], "x2": x[:, 1], "u1": u[:, 0], "u2": u[:, 1]}
    return pd.DataFrame(table | {"mode": np.array(["ice", "<b>road</b>", "$mud"])[mode]})


@pytest.fixture(scope="module")
def fit(log):
    return dt.identify(log, delay=(0.0, 0.6))


def test_the_command_writes_one_page_that_needs_nothing_else(log, fit, tmp_path, capsys):
    log.to_csv(tmp_path / "log.csv", index=False)
    page = tmp_path / "found.html"
    with pytest.raises(SystemExit) as ended:
        main(["identify", str(tmp_path / "log.csv"), "--delay", "0", "0.6", "--report", str(page)])
    assert ended.value.code == 0
    assert str(page) in re.sub(r"\s", "", capsys.readouterr().out)
    text = page.read_text(encoding="utf-8")
    assert not re.findall(r'(?:src|href)="(?!data:)', text)
    assert text.count("<img src=") == 4
    assert "The delay of u2 is 0.17" in text
    assert "<b>road</b>" not in text
    named = text.rpartition("<code>")[2].partition("</code>")[0]
    assert named == f"deadtime identify {tmp_path / 'log.csv'} --delay 0 0.6 --report {page}"
    for name in ("A[2][1,0]", "delay[1]"):
        low, high = fit.interval(name)
        assert re.search(
            rf"{re.escape(name)}</td><td>[^<]+</td><td>{low:.5g}</td><td>{high:.5g}</td>", text
        )
    assert [path.name for path in tmp_path.iterdir()].count("found.html") == 1


def test_figures_show_what_the_log_holds(fit):
    figures = {name: figure for name, _, figure in figures_of(fit)}
    assert list(figures) == ["likelihood", "predictions", "whiteness", "inputs"]
    profile = figures["likelihood"].axes[0].lines
    shift, peak = (np.asarray(one, dtype=float) for one in profile[0].get_data())
    assert peak.max() == pytest.approx(0.0, abs=1e-3)
    low, high = 1e3 * (fit.delay_interval[0, 0] - fit.delays[0, 0])
    at_ends = np.interp([low, high], shift, peak)
    np.testing.assert_allclose(at_ends, -(1.96**2) / 2, rtol=0.1)  # χ² of one degree of freedom
    panels = figures["predictions"].axes
    assert len(panels) == 3
    shown, ahead, free = (np.asarray(line.get_ydata(), float) for line in panels[0].lines)
    known = np.isfinite(ahead)
    assert np.std((ahead - shown)[known]) < 0.3 * np.nanstd(shown)
    assert np.nanstd(free - shown) < 0.7 * np.nanstd(shown)
    assert [label.get_text() for label in panels[2].get_yticklabels()] == [
        name.replace("$", r"\$") for name in fit.modes
    ]


def test_bars_say_what_they_are_of_however_few_there_are():
    rng = np.random.default_rng(1)
    one = Plant([[[-1.0]]], [[[1.0]]], 0.312, 1e-3 * np.eye(1))
    y, u = one.log(H * np.arange(200), rng.standard_normal((200, 1)), rng)
    table = pd.DataFrame({"t": H * np.arange(200), "x": y[:, 0], "force": u[:, 0]})
    fit = dt.identify(table, modes=None, delay=(0.0, 0.6), inputs=["force"])
    figures = {name: figure for name, _, figure in figures_of(fit)}
    for name, label in (("whiteness", "x"), ("inputs", "force")):
        legend = figures[name].axes[0].get_legend()
        assert legend is not None
        assert [text.get_text() for text in legend.get_texts()] == [label]


@pytest.mark.long
def test_an_input_that_the_model_lacks_sticks_out(log):
    """u1 acts a second time, 0.2 s after the first: its correlation leaves the lines there."""
    again = log.copy()
    again["x1"] += 0.3 * np.concatenate((np.zeros(11), log["u1"][:-11]))
    fit = dt.identify(again, delay=(0.0, 0.6), noise=False)
    axes = {name: figure.axes[0] for name, _, figure in figures_of(fit)}["inputs"]
    bars, level = axes.collections[0], np.asarray(axes.lines[1].get_ydata(), dtype=float)
    ends = np.array([np.abs(np.asarray(path.vertices)[:, 1]).max() for path in bars.get_paths()])
    assert not fit.tests.unrelated
    assert ends.max() > 2.0 * level.max()


def test_a_page_that_cannot_be_written_is_refused(fit, tmp_path):
    with pytest.raises(dt.ArgumentError, match=r"report .* cannot be written: "):
        write_identification(fit, tmp_path / "nowhere" / "page.html")
