"""The page and its figure draw references, a mismatch where there is one, and names as they are."""

import io

import numpy as np
import pytest
from bokeh.models import PlainText
from matplotlib import cbook, rc_context

from deadtime.app.documents import open_named
from deadtime.app.page import Page
from deadtime.reports.figures.runs import frame, plot_laws
from mixer import OWN

TANK = """
[plant]
delay = 0.4
A = [[[-1.0, 0.2], [0.0, -0.5]], [[-0.8, 0.1], [0.0, -0.6]]]
B = [[[0.0], [1.0]], [[0.1], [0.9]]]
states = ["level", "flow"]
units = { level = "m" }
[gains]
poles = [-1.0, -1.2, -1.4]
[observer]
kind = "luenberger"
poles = [-4.0, -5.0]
C = OUTPUTS
[servo]
tracked = [[1.0]]
reference = { times = [0.0, 2.0], values = [1.0, -3.0] }
[[law]]
kind = "averaged"
[[law]]
kind = "delayed"
[signal]
kind = "switches"
times = [0.0, 1.3]
modes = [0, 1]
dwell_time = 1.0
[run]
x0 = [0.2, 0.0]
horizon = 4.0
step = 0.05
"""
# What follows is a state in every mode, a sum, a multiple, or a state in one mode alone.
OUTPUTS = {
    "a state": ("[[1.0, 0.0]]", "x0"),
    "a sum": ("[[1.0, 1.0]]", "y0"),
    "a multiple": ("[[2.0, 0.0]]", "y0"),
    "another in every mode": ("[[[1.0, 0.0]], [[1.0, 0.1]]]", "y0"),
}


def opened(text, tmp_path):
    path = tmp_path / "tank.toml"
    path.write_text(text, encoding="utf-8")
    return open_named(str(path))


@pytest.mark.few(2)
@pytest.mark.parametrize("kind", list(OUTPUTS))
def test_a_reference_is_drawn_beside_what_follows_it(kind, tmp_path):
    output, row = OUTPUTS[kind]
    page = Page(opened(TANK.replace("OUTPUTS", output), tmp_path), None)
    panel = page.figures.panels[row]
    (curve,) = panel.select(name="reference")
    time, r = (np.asarray(curve.data_source.data[name]) for name in ("t", row))
    np.testing.assert_array_equal(r, np.where(time < 2.0, 1.0, -3.0))
    assert panel.y_range.start < -3.0
    assert panel.y_range.end > 1.0
    assert panel.title.text.text.endswith("; dashed its reference")
    run = page.outcome.runs["averaged"]
    (drawn,) = panel.select(name="averaged")
    followed = run.tracked[0] if row == "y0" else run.states[0]
    np.testing.assert_allclose(drawn.data_source.data[row], followed, rtol=1e-6)
    problem = page.outcome.problem
    figure = plot_laws(page.outcome.runs, problem.states, tracked=problem.tracked)
    assert len(figure.axes) == len(page.figures.all) == 4 + (row == "y0")
    axes = figure.axes[0 if row == "x0" else 2]
    r = axes.get_lines()[-1].get_ydata()
    np.testing.assert_array_equal(r, run.reference[0])
    assert [one.get_text() for one in figure.legends[0].get_texts()] == [
        *page.outcome.runs,
        "reference",
    ]
    assert figure.axes[-1].get_xlabel() == "time (s)"


def test_of_a_state_that_has_no_panel_the_output_has_one(tmp_path):
    page = Page(opened(TANK.replace("OUTPUTS", "[[1.0, 0.0]]"), tmp_path), None)
    page._draw(page.outcome, [1])
    assert list(page.figures.panels) == ["x1", "y0", "u0"]
    assert page.figures.panels["y0"].select(name="reference")


def test_a_reference_stays_in_a_frame_that_a_diverging_run_leaves():
    low, high = frame([np.array([0.0, 0.1]), np.array([0.0, 1e9])], 0.0, np.array([40.0, -2.0]))
    assert low < -2.0
    assert 40.0 < high < 50.0


def test_laws_on_outputs_have_no_panel_of_a_mismatch(tmp_path):
    page = Page(opened(TANK.replace("OUTPUTS", "[[1.0, 0.0]]"), tmp_path), None)
    assert "w" not in page.figures.panels
    assert page.figures.strip.xaxis.axis_label == "time (s)"
    assert page.figures.strip.xaxis.visible


def test_the_panel_of_the_mismatch_comes_and_goes_with_the_laws_that_have_one(own):
    page = Page(own, None)
    page.controls.sliders["horizon"].value = 2.0
    page.controls.laws.value = ["optimal"]  # without a gain per mode
    assert list(page.outcome.runs) == ["optimal"]
    assert "w" not in page.figures.panels
    assert "|mismatch|" not in {one.get_ylabel() for one in plot_laws(page.outcome.runs).axes}
    assert page.figures.strip.xaxis.axis_label == "time (s)"
    page.controls.laws.value = ["averaged", "optimal"]
    assert page.figures.all[-1] is page.figures.panels["w"]
    assert len(page.figures.panels["w"].select(name="averaged")) == 1


@pytest.mark.few(3)
@pytest.mark.parametrize("name", ["cost $x$", "$$", "$$u^2$$", r"\(a\)", r"$\frac", r"\[x\]", "_$"])
def test_names_are_shown_as_they_are_and_never_as_formulas(name, tmp_path):
    quoted = name.replace("\\", "\\\\")
    text = OWN.replace('["level", "flow"]', f'["{quoted}", "flow"]\ninputs = ["{quoted}", "u"]')
    text = text.replace("inputs", f'modes = ["{quoted}", "b", "c"]\ninputs').replace(
        "middle", quoted
    )
    page = Page(opened(text.replace('title = "Mixer"', f'title = "{quoted}"'), tmp_path), None)
    labels = [*page.figures.strip.yaxis.major_label_overrides.values()]
    labels += [panel.title.text for panel in page.figures.panels.values()]
    assert all(isinstance(one, PlainText) for one in labels)
    assert [one.text for one in labels] == [name, "b", "c", name, "flow", name, "u", "|mismatch|"]
    page.actions.figure()
    problem = page.outcome.problem
    names = {"states": problem.states, "modes": problem.modes, "inputs": problem.inputs}
    figure = plot_laws(page.outcome.runs, title=name, **names)
    file = io.StringIO()
    with rc_context({"svg.fonttype": "none"}):
        figure.savefig(file, format="svg")
    written = "\u200b" * name.startswith("_") + name  # which no legend then hides
    assert file.getvalue().count(f">{written}<") == 4 + (name in page.outcome.runs)
    assert not any(cbook.is_math_text(one.get_text()) for one in figure.findobj(match=has_text))


def has_text(artist):
    return hasattr(artist, "get_text")
