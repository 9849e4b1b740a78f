"""What the documents say is run: the README's Python, its commands, the how-to scripts."""

import inspect
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

import deadtime as dt
from c_code import needs_compiler
from deadtime import imperfections
from deadtime.controller import Status
from deadtime.scenarios.sweeps.axes import AXES

ROOT = Path(__file__).parents[2]
DOCS = sorted(str(p.relative_to(ROOT)) for p in (ROOT / "docs").rglob("*.md"))
README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_python_of_the_readme_runs_and_draws(tmp_path, monkeypatch, capsys):
    (code,) = re.findall(r"```python\n(.*?)```", README, re.S)
    monkeypatch.chdir(tmp_path)
    exec(compile(code, "README.md", "exec"), {})
    cost, diverged = capsys.readouterr().out.split()
    assert float(cost) > 0.0
    assert diverged == "False"
    assert (tmp_path / "run.png").stat().st_size > 10_000


@pytest.mark.long
def test_python_of_the_page_on_certificates_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    page, names = run_page("certificates.md")
    for cell in re.findall(r"^\| [^`|]*\| `(lambda .*?)` \|$", page, re.M):
        value = 1.0 if cell.startswith(("lambda a", "lambda D")) else 0.1
        plant, law = eval(cell, names)(value)
        assert law.plant.modes == plant.modes == 2
    assert names["certificate"].proven
    assert names["worst"].growth_rate > 0.0
    assert (tmp_path / "chart.png").stat().st_size > 10_000


def run_page(name):
    """What the Python of a page leaves behind."""
    page, names = (ROOT / "docs" / name).read_text(encoding="utf-8"), {}
    for code in re.findall(r"```python\n(.*?)```", page, re.S):
        exec(compile(code, name, "exec"), names)
    return page, names


def test_python_of_the_page_on_many_signals_runs(capsys):
    _, names = run_page("monte-carlo.md")
    assert names["data"].sizes == {"law": 3, "scenario": 200}
    printed = capsys.readouterr().out
    assert f"{names['worst']} True" in printed
    assert (
        "trajectories of 10,000,000 scenarios of 1,001 samples under 3 laws would take" in printed
    )


@pytest.mark.long
def test_python_and_axes_of_the_page_on_sweeps_are_there(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    page, names = run_page("sweeps.md")
    assert names["data"].sizes == {"delay": 3, "weight": 3, "law": 2, "scenario": 100}
    assert (names["regret"].median("scenario") < 1.5).all()
    table = re.findall(r"^\| (`\w+`(?:, `\w+`)*) \|", page, re.M)
    assert {name.strip("`") for row in table for name in row.split(", ")} >= set(AXES)


def test_python_of_the_page_on_the_controller_runs(capsys):
    page, _ = run_page("controller.md")
    assert capsys.readouterr().out.splitlines()[-1] == "True"
    for status in Status:
        assert f"| {status.value} `{status.name}` |" in page


@needs_compiler
def test_python_of_the_page_on_the_export_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    page, names = run_page("export.md")
    assert names["exported"].check.passed
    assert names["close"]
    header = (tmp_path / "out" / "controller.h").read_text()
    for number, name in re.findall(r"^\| (\d+) `(\w+)` \|", page, re.M):
        assert f"CONTROLLER_{name} = {number}," in header or f"_{name} = {number} " in header
    for name in re.findall(r"^\| `(\S+)` \|", page, re.M):
        assert (tmp_path / "out" / name).exists(), name
    printed = capsys.readouterr().out
    assert f"tables (ROM) {names['exported'].rom} bytes" in printed
    axis = (tmp_path / "axis" / "axis.h").read_text()
    for line in ("AXIS_BAD_REFERENCE = 6,", "AXIS_TRACKED 1", "AXIS_SUMS 1", "AXIS_ESTIMATES 3"):
        assert line in axis
    assert printed.count(" 0 differ") == 2


def test_python_of_the_page_on_imperfections_runs_and_names_them_all():
    page, names = run_page("imperfections.md")
    assert not names["run"].diverged
    public = [getattr(imperfections, name) for name in dir(imperfections)]
    classes = [one for one in public if inspect.isclass(one) and not inspect.isabstract(one)]
    kinds = {one for one in classes if issubclass(one, imperfections.Imperfection)}
    kinds -= {imperfections.Imperfection}
    assert len(kinds) == 12
    for kind in kinds:
        assert f"| `{kind.__name__}(" in page


def test_python_of_the_page_on_output_feedback_runs(capsys):
    _, names = run_page("output-feedback.md")
    printed = capsys.readouterr().out.splitlines()
    assert any(line.endswith("BAD_STATE") for line in printed)
    assert abs(names["run"].measured[0, -1] - 3.0) < 1e-5


def test_python_of_the_page_on_robustness_runs(capsys):
    page, names = run_page("robustness.md")
    sentences, printed = list(names["result"].sentences), capsys.readouterr().out.splitlines()
    assert printed[: len(sentences)] == sentences
    states, lag = printed[len(sentences) :]
    assert states.split()[0] == states.split()[1] == str(names["L"].nstates)
    assert 0.0 < float(lag) < 180.0
    paper = dt.problems.paper().plant
    alone = dt.SwitchedSystem(paper.A[:1], paper.B[:1], paper.delay)
    law = dt.SingleModePredictor(alone, dt.place(alone, [-1.0, -2.0]), 0)
    margin = dt.gain_margin(alone, law)
    low, high = (100.0 * (end - 1.0) for end in (margin.lower, margin.upper))
    assert f"−{-low:.1f} to +{high:.1f} % in the\ngain" in page


@pytest.mark.long
def test_python_of_the_page_on_design_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    _, names = run_page("design.md")
    found, exact = names["found"], names["exact"]
    assert found.reached
    assert found.cost < 2.0 * found.plain.cost
    assert exact.relative >= 0.02
    assert names["certificate"].stable is not False
    assert (tmp_path / "design.png").stat().st_size > 10_000


def test_quick_start_of_the_readme_runs_line_by_line_in_an_empty_folder(tmp_path):
    set_up, use = re.findall(r"```bash\n(.*?)```", README, re.S)
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    assert set_up.splitlines()[-1] == "pip install ."
    for target in ("reproduce", "test"):
        assert f"`make {target}`" in README
        assert re.search(rf"^{target}:", makefile, re.M)
    result = subprocess.run(
        ["bash", "-e"],
        input=f'export PATH="{Path(sys.executable).parent}:$PATH"\n{use}',
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert (result.returncode, result.stderr) == (0, "")
    assert "Next: deadtime simulate problem.toml" in result.stdout
    assert "\nValid: " in result.stdout
    names = {path.name for path in tmp_path.iterdir()}
    assert names >= {"problem.png", "problem-all-laws.png", "cert.json", "out"}


def test_commands_of_the_page_on_them_are_those_there_are(monkeypatch):
    """Each is understood as it stands; tests/cli/test_cli_streams.py runs one of every kind."""
    from deadtime.cli.application import app

    monkeypatch.chdir(ROOT)
    page = (ROOT / "docs" / "cli.md").read_text(encoding="utf-8")
    commands = re.findall(r"^deadtime ([^>\n]*)", page, re.M)
    for command in commands:
        function, *_ = app.parse_args(shlex.split(command), exit_on_error=False, print_error=False)
        assert function.__name__ == command.split()[0].replace("-", "_")
    used = {command.split()[0] for command in commands}
    assert used | {"app"} == {name for name in app if not name.startswith("-")}


# Pages and the command line's tests, which run always, do the same with smaller budgets.
LONG = (
    "barrier", "belief_maps", "design", "from_a_log", "known_switching", "mode_sensor", "mpc",
    "output_feedback", "robustness", "saturated_servo",
)  # fmt: skip
MARKS = dict.fromkeys(LONG, pytest.mark.long) | {"processor_in_the_loop": needs_compiler}
SCRIPTS = [
    pytest.param(path, id=path.stem, marks=MARKS.get(path.stem, ()))
    for path in sorted((ROOT / "examples" / "howto").glob("*.py"))
]


@pytest.mark.few(1)
@pytest.mark.parametrize("script", SCRIPTS)
def test_how_to_script_runs_without_a_word_on_stderr_and_leaves_a_picture(tmp_path, script):
    result = subprocess.run(
        [sys.executable, str(script)], cwd=tmp_path, capture_output=True, text=True
    )
    assert (result.returncode, result.stderr) == (0, "")
    assert (tmp_path / f"{script.stem}.png").stat().st_size > 10_000


@pytest.mark.parametrize("page", ["README.md", "CONTRIBUTING.md", *DOCS])
def test_links_between_documents_lead_somewhere(page):
    source = ROOT / page
    for target in re.findall(r"\]\(([^)#]+)\)", source.read_text(encoding="utf-8")):
        if not target.startswith("http"):
            assert (source.parent / target).exists(), target
