"""Whatever users call things, generated C compiles, XML parses and scripts run."""

import subprocess
import sys
import xml.etree.ElementTree as xml
import zipfile

import pytest

import deadtime as dt
import plants
from c_code import needs_compiler
from deadtime.app.script import SCRIPT, script_of
from deadtime.base.wording import file_name, one_line
from deadtime.controller.export import Names, compiler, export_plant_fmu
from deadtime.controller.export.c_text import in_comment
from deadtime.controller.export.compiler import self_check
from deadtime.problems.file import load_problem
from deadtime.simulation.run_figure import plot_run
from shares import mostly_long

NAMES = {
    "control": "a\x01b\x1bc\x7fd\x85e\x9f",
    "nul": "before\x00after",
    "lines": "one\ntwo\r\nthree\u2028four\x0bfive",
    "bidi": "plant \u202e desrever \u2066 isolate \u200f mark",
    "comment": "*/ #error /* // \\",
    "trigraph": "what??/",
    "markup": "<&> \"quoted\" 'single' ]]>",
    "no character": "\ufffe\uffff\ud800",
    "plain": "Größe in m/s², α",
}


@pytest.fixture(params=NAMES)
def called(request):
    return NAMES[request.param]


# What ends a line, a comment, a tag and a text.
FEW = pytest.mark.parametrize(
    "called", mostly_long(NAMES, "lines", "comment", "markup", "no character"), indirect=True
)


def test_what_is_left_of_a_text_is_one_line_that_prints(called):
    text = one_line(called)
    assert len(text.splitlines()) == 1
    assert text.encode("utf-8").decode() == text
    assert not {"\x00", "\x01", "\u202e", "\u2066", "\ufffe"} & set(text)
    assert one_line(text) == text


def test_ordinary_names_stay_as_they_are():
    for text in ("Größe in m/s² 温度", "x₁", "α, 5 %", "می\u200cخواهم", "👩\u200d🔬"):
        assert one_line(text) == text


@FEW
@needs_compiler
def test_c_with_any_names_compiles_and_passes(tmp_path, called):
    plant = plants.generic()
    names = Names(called, [called] * 3, [called] * 3, [called] * 2)
    run = dt.Controller(plants.LAWS["averaged"](plant), 0.1)
    exported = run.export_c(tmp_path, names=names)
    assert exported.check.passed, exported.check.message
    header = (tmp_path / "controller.h").read_text(encoding="utf-8")
    assert f"u[1]: {in_comment(called)}" in header


@pytest.mark.few(2)
@FEW
@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_an_fmu_with_any_names_is_well_formed(tmp_path, monkeypatch, called, version):
    monkeypatch.setattr(compiler, "compiler", lambda: None)
    plant = plants.generic()
    names = Names(called, [called] * 3, [called] * 3, [called] * 2)
    run = dt.Controller(plants.LAWS["averaged"](plant), 0.1)
    run.export_fmu(tmp_path / "c.fmu", version=version, names=names)
    export_plant_fmu(plant, tmp_path / "p.fmu", version=version, names=names)
    for file in ("c.fmu", "p.fmu"):
        text = zipfile.ZipFile(tmp_path / file).read("modelDescription.xml")
        told = [one.get("description") or "" for one in xml.fromstring(text).iter()]
        assert any(one.startswith("input, held") and one_line(called) in one for one in told)


def test_a_figure_with_any_names_is_well_formed(tmp_path, called):
    plant = plants.paper()
    law, signal = plants.LAWS["averaged"](plant), dt.SwitchingSignal.constant(0)
    run = dt.simulate(plant, law, signal, [1.0, 0.0], 0.5, step=0.1)
    figure = plot_run(run, called, ["a\x01", "b"], None, ["\x02"])
    figure.savefig(tmp_path / "run.svg")
    xml.parse(tmp_path / "run.svg")


FILE = """
title = "TITLE"
[plant]
delay = 0.2
A = [[[0.5, 1.0], [0.0, -1.0]]]
B = [[[1.0, 0.0], [0.0, 1.0]]]
inputs = ["throttle", "TITLE"]
[gains]
poles = [-1.0, -2.0]
[[law]]
kind = "averaged"
name = "TITLE"
[signal]
kind = "constant"
mode = 0
[run]
x0 = [1.0, 0.0]
horizon = 0.5
step = 0.1
"""
EVIL = '\\u0000 \\u202e \\u0001 \\\\ \\"\\"\\" \\n import os'


@pytest.mark.few(1)
@pytest.mark.parametrize(
    "name", mostly_long(["deadtime", "numpy", "two inputs", "ü"], "numpy", "ü")
)
def test_a_script_runs_under_its_own_name_in_an_empty_folder(tmp_path, name):
    """And deadtime still imports there, whatever the problem is called."""
    source, folder = tmp_path / f"{name}.toml", tmp_path / "empty"
    folder.mkdir()
    source.write_text(FILE.replace("TITLE", EVIL), encoding="utf-8")
    script = f"{file_name(source.stem)}{SCRIPT}"
    (folder / script).write_text(script_of(load_problem(source)), encoding="utf-8")
    assert not script.removesuffix(".py").isidentifier()
    for command in ([script], ["-c", "import deadtime, numpy, random; deadtime.__version__"]):
        done = subprocess.run(
            [sys.executable, *command], cwd=folder, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
    assert (folder / f"{file_name(name)}.png").stat().st_size > 10_000


@needs_compiler
@pytest.mark.parametrize("option", ["-ffast-math", "-ffinite-math-only"])
def test_mathematics_without_nan_is_refused_by_the_file_itself(tmp_path, monkeypatch, option):
    dt.Controller(plants.LAWS["averaged"](plants.generic()), 0.1).export_c(tmp_path)
    command = compiler.compiler()
    monkeypatch.setenv("CC", f"{' '.join(command)} {option}")
    check = self_check(tmp_path, "controller")
    assert check.passed is False
    assert "remove the checks for NaN" in check.message
