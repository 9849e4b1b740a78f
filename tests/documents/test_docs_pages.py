"""What the pages of docs/ say is run: their Python, their commands, and what they say is printed.

On a page, code blocks run in order, in one folder. A block `text` after one is what it prints, with
… for what does not matter; a block that begins with `# name` is a file. A file under src/ is one
that a reader adds to the library: commands run as if it stood there.
"""

import ast
import importlib
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import deadtime as dt
from deadtime.cli.application import app, as_command, main
from deadtime.controller.export.compiler import compiler
from shares import mostly_long

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
BLOCK = re.compile(r"^```([^\n`]*)\n(.*?)^```$", re.S | re.M)
# Commands of other programs: what sets a machine up, and a cluster that is not here.
NOT_RUN = ("python3 -m venv", "pip ", "dask ", "deadtime sweep study.toml --store /shared")


LANGUAGES = (
    *("python", "console", "text", "toml", "c", "bash"),
    *("{toctree}", "{eval-rst}", "{include} ../CHANGELOG.md"),
    *("{include} ../CONTRIBUTING.md", "{include} ../benchmarks/README.md"),
    "{include} ../../verifier/FORMAT.md",
)


def built(path):
    return {"_build", "walkthroughs", "gallery", "scripts"} & set(path.relative_to(DOCS).parts)


PAGES = {
    str(path.relative_to(DOCS)): path.read_text(encoding="utf-8")
    for path in sorted(DOCS.rglob("*.md"))
    if not built(path)
}
DOCUMENTS = ROOT / "tests/documents/test_documents.py"
# Pages with tests of their own, which know what must come out.
ELSEWHERE = set(
    re.findall(
        r'run_page\("([\w.-]+)"\)', (ROOT / "tests/documents/test_documents.py").read_text("utf-8")
    )
)


def has_code(text):
    return any(language in ("python", "console") for language, _ in BLOCK.findall(text))


RUN = [name for name, text in PAGES.items() if has_code(text) and name not in ELSEWHERE]
COMMANDS_ONLY = [name for name in sorted(ELSEWHERE) if "```console" in PAGES[name]]
# Those that compile laws that no other test needs, or start processes of their own.
LONG = (
    "howto/add-a-law.md",
    "howto/add-an-imperfection.md",
    "howto/choose-a-law.md",
    "howto/from-a-log.md",
    "theory/known-switching.md",
)


def pattern(said):
    """What is printed, blanks apart, as a pattern: … stands for anything."""
    parts = [re.escape("".join(part.split())) for part in said.split("…")]
    return ".*".join(parts)


def with_added_files(arguments):
    """Run Python with the files under src/ added to the library, and return what it prints."""
    path = os.pathsep.join([str(ROOT / "tests/overlay"), str(ROOT / "src")])
    added = {"PYTHONPATH": path, "DEADTIME_ADDED": str(Path("src").resolve())}
    done = subprocess.run(
        [sys.executable, *arguments], capture_output=True, text=True, env={**os.environ, **added}
    )
    assert (done.returncode, done.stderr) == (0, ""), arguments
    return done.stdout


def command(line, capsys):
    """Run a line of a shell, and return what it prints."""
    if line.startswith("deadtime ") and Path("src").is_dir():
        return with_added_files(["-m", *shlex.split(line)])
    if line.startswith("deadtime "):
        with pytest.raises(SystemExit) as stopped:
            main(line.split()[1:])
        out, err = capsys.readouterr()
        assert (stopped.value.code, err) == (0, ""), line
        return out
    done = subprocess.run(line.split(), capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, ""), line
    return done.stdout


def run(name, folder, monkeypatch, capsys, languages=LANGUAGES):
    """Run a page; return the names that its Python leaves, and what was printed."""
    monkeypatch.chdir(folder)
    for package in ("laws", "imperfections"):
        module = importlib.import_module(f"deadtime.{package}")
        own = [*module.__path__, str(folder / "src/deadtime" / package)]
        monkeypatch.setattr(module, "__path__", own)
    names, printed, everything = {"__name__": "page"}, None, ""
    for language, text in BLOCK.findall(PAGES[name]):
        if language not in languages:
            continue
        file = re.match(r"# ([\w/-]+\.\w+)\n", text)
        if file:
            (folder / file[1]).parent.mkdir(parents=True, exist_ok=True)
            (folder / file[1]).write_text(text, encoding="utf-8")
            importlib.invalidate_caches()
        if file and file[1].startswith("src/"):
            continue
        if language == "python":
            capsys.readouterr()
            exec(compile(text, name, "exec"), names)
            printed = capsys.readouterr().out
        elif language == "console":
            lines = [line[2:] for line in text.splitlines() if line.startswith("$ ")]
            here = [line for line in lines if not line.startswith(NOT_RUN)]
            printed = "".join(command(line, capsys) for line in here)
        elif language == "text":
            shown = "".join(printed.split())
            assert re.search(pattern(text), shown, re.S), (text, printed)
        everything += printed or ""
    return names, everything


@pytest.mark.few(4)
@pytest.mark.parametrize("name", mostly_long(RUN, *(name for name in RUN if name not in LONG)))
def test_code_of_a_page_runs_and_prints_what_the_page_says(name, tmp_path, monkeypatch, capsys):
    if "export" in PAGES[name] and compiler() is None:
        pytest.skip("needs a C compiler")
    names, _ = run(name, tmp_path, monkeypatch, capsys)
    if name == "howto/add-a-law.md":
        the_law_agrees_with_a_runge_kutta_method(names["CurrentModePredictor"])
        data = names["data"].ise.median("scenario")
        assert 20 * float(data.sel(law="current mode")) < float(data.sel(law="averaged"))
        assert float(data.sel(law="current mode")) < 1.2 * float(data.sel(law="expected"))
        assert names["exported"].check.passed
        with_added_files(["-c", KNOWN_EVERYWHERE])
    if name == "howto/add-an-imperfection.md":
        with_added_files(["-c", IMPERFECTION_ON_THE_PAGE])


@pytest.mark.parametrize("name", COMMANDS_ONLY)
def test_commands_of_a_page_print_what_the_page_says(name, tmp_path, monkeypatch, capsys):
    run(name, tmp_path, monkeypatch, capsys, ("console", "text"))


KNOWN_EVERYWHERE = """
from deadtime.app.documents import open_named
from deadtime.app.first_view import laws_on_offer
from deadtime.app.script import script_of
from deadtime.reports.figures.colours import colour_of
from deadtime.problems.law_registry import the_law
from deadtime.base.figure_style import SLATE
from deadtime.problems import json_schema, load_problem
from deadtime.scenarios.sweeps.axes import kinds_of

assert laws_on_offer(open_named("paper"))[0]["current mode"] == {"kind": "current-mode"}
assert colour_of("current mode") == SLATE
assert the_law("current mode") == "the current-mode law"
assert "CurrentModeLaw" in json_schema()["$defs"]
assert "current mode" in kinds_of(2)
code = script_of(load_problem("mine.toml"))
assert "from deadtime.laws.current_mode import CurrentModePredictor" in code
compile(code, "script", "exec")
"""

IMPERFECTION_ON_THE_PAGE = """
from deadtime.app.documents import open_named
from deadtime.app.controls import ranges_of
from deadtime.app.script import script_of
from deadtime.app.settings import Settings, draft_of
from deadtime.problems import json_schema, load_problem

paper = open_named("paper")
assert [one.label for one in ranges_of(paper)][-1] == "Valve, slower to open (u/s)"
draft = draft_of(paper, {}, Settings({"valve": 30.0}))
assert draft["imperfection"] == [{"kind": "valve", "opens": 30.0, "closes": 60.0}]
assert "ValveSection" in json_schema()["$defs"]
code = script_of(load_problem("mine.toml"))
assert "from deadtime.imperfections.valve import Valve" in code
compile(code, "script", "exec")
"""


def the_law_agrees_with_a_runge_kutta_method(law_of):
    """K_i x_i(t + D), x_i integrated in mode i over the inputs on their way, D = 5.4 periods."""
    paper, step = dt.problems.paper().plant, 0.1
    plant = dt.SwitchedSystem(paper.A, paper.B, delay=0.54)
    gains = dt.place(plant, [-1.0, -2.0])
    table = law_of(plant, gains).digital(step)
    assert table.context == "mode"
    rng = np.random.default_rng(0)
    x, past = rng.normal(size=2), rng.normal(size=6)  # past: u_{k−1} first
    for i in (0, 1):
        ahead = x
        for u, length in zip(past[::-1], [0.04, *[step] * 5], strict=True):
            ahead = solve_ivp(
                lambda _, y, i=i, u=u: plant.A[i] @ y + plant.B[i, :, 0] * u,
                (0.0, length),
                ahead,
                method="DOP853",
                rtol=1e-12,
                atol=1e-12,
            ).y[:, -1]
        u = table.state_gain[i] @ x + table.input_gain[i, :, 0, 0] @ past
        np.testing.assert_allclose(u, gains[i] @ ahead, rtol=1e-9)
    np.testing.assert_allclose(table.factor.taps(6), table.input_gain, atol=1e-13)


def test_every_page_with_python_is_run():
    with_python = {name for name, text in PAGES.items() if "```python" in text}
    assert with_python <= ELSEWHERE | set(RUN)
    assert len(with_python) > 15
    for name, text in PAGES.items():
        for language, code in BLOCK.findall(text):
            assert language in LANGUAGES, (
                f"{name}: a block that nobody runs: {language}: {code[:60]}"
            )
            if language == "python":
                ast.parse(code)


def test_the_law_of_the_page_is_about_fifty_lines():
    (code,) = re.findall(
        r"```python\n(# src/deadtime/laws/current_mode.py.*?)```", PAGES["howto/add-a-law.md"], re.S
    )
    assert len(code.strip().splitlines()) <= 55


INDENTED = re.compile(r"^(?:    |\$ )(deadtime (?!error).*?)\s*(?:#.*)?$", re.M)
COMMANDS = [
    pytest.param(line, id=f"{name}: {line}")
    for name, text in PAGES.items()
    for line in INDENTED.findall(text)
    if "SLURM" not in line
]


@pytest.mark.parametrize("line", COMMANDS)
def test_the_command_line_knows_the_commands_of_the_pages(line):
    words = shlex.split(line.partition(" > ")[0])[1:]
    app.parse_args(as_command(words), exit_on_error=False, print_error=False)


def test_a_wrong_option_would_be_found():
    with pytest.raises(Exception, match="Unknown option"):
        app.parse_args(["certify", "paper", "--speed"], exit_on_error=False, print_error=False)
