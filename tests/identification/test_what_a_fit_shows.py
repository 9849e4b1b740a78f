"""What is shown of an identification: its table, its figure, and columns that can be no log."""

import json
import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import deadtime as dt
from deadtime.base.errors import ArgumentError
from deadtime.cli import main
from deadtime.identification.identification_figure import quick_figures
from deadtime.reports.identification_report import interval_rows

H, X0, U0 = 0.1, 62.0, 30.0


def heated(count=450, rest=(X0, U0), seed=0):
    """dx/dt = −0.5 (x − x₀) + 0.4 (u(t − 0.3) − u₀), which rests before its inputs move."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.standard_normal(count // 10 + 1), 10)[:count]
    u[:20] = 0.0
    x, keep = np.zeros(count), np.exp(-0.05)
    for k in range(3, count - 1):
        x[k + 1] = keep * x[k] + 0.8 * (1.0 - keep) * u[k - 3] + 0.01 * rng.standard_normal()
    return pd.DataFrame({"t": H * np.arange(count), "level": x + rest[0], "feed": u + rest[1]})


COLUMNS = {"modes": None, "delay": (0.0, 1.0), "states": ["level"], "inputs": ["feed"]}


@pytest.fixture(scope="module")
def fit():
    return dt.identify(heated(), **COLUMNS)


def test_the_table_has_the_operating_point_with_its_interval_and_no_constant_terms(fit):
    feed, level = interval_rows(fit)[:2]
    assert feed == ("feed at rest", f"{fit.operating_point.u[0]:.5g}", "chosen", "")
    assert level[0] == "level at rest"
    low, high = map(float, level[2:])
    assert high - low == pytest.approx(2.0 * 1.96 * fit.rest_error[0], rel=0.05)
    assert low < X0 + 0.8 * (fit.operating_point.u[0] - U0) < high
    assert any(name.startswith("constant") for name in fit.names)
    assert not any(row[0].startswith("constant") for row in interval_rows(fit))


def test_a_plant_of_one_state_and_input_is_told_as_a_first_order_process(fit):
    (text,) = [one for one in fit.sentences if one.startswith("Gain ")]
    values = [float(re.search(rf"{name} ([\d.]+)", text)[1]) for name in ("Gain", "constant")]
    assert values == pytest.approx([0.8, 2.0], rel=0.05)
    assert f"dead time {fit.delays[0, 0]:.3f} s (" in text
    assert "Balance point near the log's mean input: level = " in fit.message


def test_rests_of_many_logs_scatter_about_the_true_one_as_their_standard_errors_say():
    """z of 24 logs: its mean square within what χ² of 24 leaves out once in a thousand."""
    z = []
    for seed in range(24):
        fit = dt.identify(heated(200, seed=seed), noise=False, **COLUMNS)
        true = X0 + 0.8 * (fit.operating_point.u[0] - U0)
        z.append((fit.operating_point.x[0] - true) / fit.rest_error[0])
    assert 8.0 < float(np.square(z).sum()) < 52.0


def test_where_many_states_rest_under_the_same_inputs_none_has_an_error(fit):
    plant = dt.SwitchedSystem(0.0 * fit.plant.A, fit.plant.B, fit.plant.delay)
    assert np.isfinite(fit.rest_error).all()
    assert np.isnan(replace(fit, plant=plant).rest_error).all()


def test_a_plant_that_rests_at_0_has_no_rows_of_rest():
    fit = dt.identify(heated(rest=(0.0, 0.0)), **COLUMNS)
    assert fit.operating_point is None
    assert np.isnan(fit.rest_error).all()
    assert not any("rest" in row[0] for row in interval_rows(fit))


def test_json_has_the_point_with_its_errors_and_no_interval_of_a_constant(tmp_path, capsys):
    heated().to_csv(tmp_path / "log.csv", index=False)
    options = ("--one-mode", "--states", "level", "--inputs", "feed", "--delay", "0", "1")
    with pytest.raises(SystemExit) as stopped:
        main(["identify", str(tmp_path / "log.csv"), *options, "--json"])
    assert stopped.value.code == 0
    record = json.loads(capsys.readouterr().out)
    assert not any(name.startswith("constant") for name in record["intervals"])
    point = record["operating_point"]
    assert abs(point["x"][0] - X0 - 0.8 * (point["u"][0] - U0)) < 3.0 * point["x_error"][0]


def curves(axes):
    return {str(line.get_label()): line.get_ydata() for line in axes.get_lines()}


def test_the_figure_is_in_the_log_s_own_units_and_says_how_much_of_it_is_shown(fit):
    log = heated()
    panel = fit.plot().axes[1]
    shown = curves(panel)
    np.testing.assert_allclose(shown["log"], log["level"][:400], rtol=1e-12)
    for name in ("a row ahead", "free run"):
        assert np.nanmax(np.abs(shown[name] - log["level"][:400])) < 0.5
    assert panel.get_xlabel() == "time (s), the first 400 of 450 rows"
    (_, caption, figure) = next(quick_figures(fit))
    assert "The log (the first 400 of 450 rows), the model" in caption
    assert figure.axes[-1].get_xlabel() == panel.get_xlabel()


@pytest.mark.parametrize("rest", [(0.0, 0.0), (-500.0, 3.0)])
def test_a_log_that_is_shown_whole_says_so_wherever_it_rests(rest):
    log = heated(300, rest, seed=4)
    panel = dt.identify(log, **COLUMNS).plot().axes[1]
    assert panel.get_xlabel() == "time (s), all rows"
    np.testing.assert_allclose(curves(panel)["log"], log["level"], rtol=1e-12, atol=1e-12)


def test_a_figure_of_outputs_alone_is_in_their_units_too():
    log = heated(300)
    options = {key: COLUMNS[key] for key in ("modes", "delay", "inputs")}
    fit = dt.identify(log, outputs=["level"], order=1, **options)
    np.testing.assert_allclose(curves(fit.plot().axes[1])["log"], log["level"], rtol=1e-12)


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"inputs": ["level"]}, "states and inputs must be different columns, got 'level' twice"),
        ({"states": ["feed"]}, "states and inputs must be different columns, got 'feed' twice"),
        ({"states": ["level", "level"]}, "states must be different columns, got 'level' twice"),
        ({"inputs": ["feed", "feed"]}, "inputs must be different columns, got 'feed' twice"),
        ({"inputs": ["t"]}, "time and inputs must be different columns, got 't' twice"),
        ({"states": ["t", "level"]}, "time and states must be different columns, got 't' twice"),
    ],
)
def test_a_column_is_one_thing_alone(columns, message):
    with pytest.raises(ArgumentError, match=message):
        dt.identify(heated(40), **(COLUMNS | columns))


def test_an_output_is_not_its_own_input_and_the_message_names_both_options():
    options = {"modes": None, "delay": (0.0, 1.0), "order": 1}
    with pytest.raises(
        ArgumentError, match=r"outputs=\[…\], --outputs, and inputs=\[…\], --inputs"
    ):
        dt.identify(heated(40), outputs=["level"], inputs=["level"], **options)
