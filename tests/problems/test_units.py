"""Units of a problem file go wherever names go, and slips in them are refused by their line."""

import csv
import re

import pytest

import deadtime as dt
from deadtime.cli import main
from deadtime.controller.export import Names
from deadtime.problems.file import load_problem
from deadtime.simulation.run_figure import plot_run

PLANT = """\
[plant]
delay = [[0.34, 0.12], [0.3, 0.12], [0.34, 0.2]]
A = [[[0.0, 1.0], [0.0, -0.5]], [[0.0, 1.1], [0.0, 0.3]], [[0.0, 0.9], [0.0, -1.0]]]
B = [[[0.0, 0.5], [1.0, 0.0]], [[0.0, 0.4], [0.8, 0.0]], [[0.0, 0.5], [1.2, 0.1]]]
states = ["gap", "speed"]
inputs = ["force", "valve"]
units = UNITS
[gains]
lqr = { Q = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.5, 0.0], [0.0, 0.0, 0.0, 0.5]], R = [[1.0, 0.0], [0.0, 1.0]] }
[observer]
kind = "luenberger"
C = [[1.0, 0.0], [0.3, 1.0]]
outputs = ["gap", "wheel speed"]
poles = [-3.0, -4.0]
[servo]
tracked = ["wheel speed", "gap"]
reference = [0.5, 1.0]
[[law]]
kind = "averaged"
[signal]
kind = "periodic"
sojourns = [0.85, 1.13, 0.91]
modes = [0, 1, 2]
[run]
x0 = [0.2, 0.0]
horizon = 4.0
step = 0.1
"""  # noqa: E501
UNITS = '{ gap = "m", valve = "%", "wheel speed" = "rad/s" }'


@pytest.fixture
def write(tmp_path):
    def written(units=UNITS, text=PLANT):
        path = tmp_path / "mine.toml"
        path.write_text(text.replace("UNITS", units), encoding="utf-8")
        return path

    return written


def test_names_carry_their_units_and_what_has_none_stays(write):
    problem = load_problem(write())
    assert problem.states == ("gap (m)", "speed")
    assert problem.inputs == ("force", "valve (%)")
    assert problem.outputs == ("gap (m)", "wheel speed (rad/s)")
    assert problem.tracked == ("wheel speed (rad/s)", "gap (m)")
    same = load_problem(write(units="{}"))
    assert (same.states, same.tracked) == (("gap", "speed"), ("wheel speed", "gap"))
    runs = [one.simulate("averaged").states for one in (problem, same)]
    assert (runs[0] == runs[1]).all()


def test_units_are_on_the_axes_in_the_log_and_in_the_c(write, tmp_path, capsys):
    problem = write()
    drawn = load_problem(problem)
    figure = plot_run(drawn.simulate("averaged"), None, drawn.states, drawn.modes, drawn.inputs)
    titles = " ".join(axes.get_title(loc="left") for axes in figure.axes)
    assert "gap (m); dashed its reference" in titles
    assert "valve (%)" in titles
    out = ["--out", str(tmp_path / "run.png"), "--csv", str(tmp_path / "run.csv")]
    with pytest.raises(SystemExit) as stopped:
        main(["simulate", str(problem), *out])
    assert stopped.value.code == 0
    assert "wheel speed (rad/s) after the last step of its reference" in capsys.readouterr().out
    with (tmp_path / "run.csv").open(encoding="utf-8", newline="") as file:
        header = next(csv.reader(file))
    assert {"x[0]: gap (m)", "x[1]: speed", "u[1]: valve (%)", "r[1]: gap (m)"} <= {*header}
    with pytest.raises(SystemExit) as stopped:
        main(["export", str(problem), "--c", str(tmp_path / "c"), "--fmu", str(tmp_path / "a.fmu")])
    assert stopped.value.code == 0
    text = (tmp_path / "c" / "controller.h").read_text(encoding="utf-8")
    assert "   Outputs: y[0]: gap (m), y[1]: wheel speed (rad/s).\n" in text
    assert "   References: r[0]: wheel speed (rad/s), r[1]: gap (m).\n" in text
    assert "   Inputs: u[0]: force, u[1]: valve (%).\n" in text


def test_an_fmu_describes_outputs_and_references_by_their_names(write, tmp_path):
    import zipfile

    problem = load_problem(write())
    names = Names("mine", outputs=problem.outputs, tracked=problem.tracked)
    controller = dt.Controller(problem.laws["averaged"], 0.1)
    made = controller.export_fmu(tmp_path / "law.fmu", names=names)
    text = zipfile.ZipFile(made.path).read("modelDescription.xml").decode()
    found = dict(re.findall(r'name="(y|reference)\[2\]"[^>]*description="([^"]*)"', text))
    assert found == {
        "y": "output at the sample: wheel speed (rad/s)",
        "reference": "reference of a tracked output: gap (m)",
    }
    for wrong, said in (
        (Names(outputs=("gap",)), "names.outputs must be 2 names, got 1"),
        (Names(tracked=("a", "b", "c")), "names.tracked must be 2 names, got 3"),
    ):
        with pytest.raises(dt.ArgumentError, match=said):
            controller.export_fmu(tmp_path / "law.fmu", names=wrong)


def test_slips_are_refused_by_their_line(write):
    for units, said in (
        (
            '{ sped = "m/s" }',
            "units must belong to states, inputs or outputs, 'gap', 'speed', 'force'",
        ),
        ('{ gap = " " }', "units of 'gap' must not be empty"),
        ("{ gap = 3 }", "units"),
        ('"m"', "units: input should be a table"),
    ):
        with pytest.raises(dt.ProblemFileError, match=f"line 7.*{said}"):
            load_problem(write(units=units))
    twice = PLANT.replace('"gap", "speed"]', '"gap (m)", "speed"]')
    with pytest.raises(dt.ProblemFileError, match=r"'gap \(m\)' must not be given twice, got 'mm'"):
        load_problem(
            write('{ "gap (m)" = "mm" }', twice.replace('tracked = ["wheel speed", "gap"]', ""))
        )
