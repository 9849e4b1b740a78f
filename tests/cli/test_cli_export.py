"""`deadtime export`, driven as a user would."""

import json

import pytest

from c_code import needs_compiler
from deadtime.cli.application import main
from deadtime.controller.export import compiler

SATURATION = '\n[[imperfection]]\nkind = "saturation"\nlow = -20.0\nhigh = 30.0\n'
SATURATION += '\n[[imperfection]]\nkind = "saturation"\nlow = -25.0\nhigh = 20.0\n'


def run(capsys, *arguments):
    with pytest.raises(SystemExit) as stopped:
        main(arguments)
    captured = capsys.readouterr()
    return stopped.value.code, captured.out, captured.err


@needs_compiler
def test_export_of_a_problem_file_writes_c_and_fmus_and_checks_itself(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    run(capsys, "init")
    text = (tmp_path / "problem.toml").read_text()
    (tmp_path / "problem.toml").write_text(text + SATURATION)
    names = ("--fmu", "law.fmu", "--plant-fmu", "plant.fmu")
    code, out, err = run(capsys, "export", "problem.toml", "--c", "out/", *names)
    assert (code, err) == (0, "")
    assert "inputs limited to -20 to 20" in out
    assert "0 differ" in out
    assert "FMU of the plant: plant.fmu: FMI 3.0; sources and binaries/" in out
    assert "LOW[1] =\n{-20.0}" in (tmp_path / "out" / "controller_tables.h").read_text()
    for name in names[1::2]:
        assert (tmp_path / name).read_bytes().startswith(b"PK")


def test_json_says_what_was_written(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(compiler, "compiler", lambda: None)
    options = ("--law", "mode 0 only", "--float", "--name", "law", "--json")
    code, out, err = run(capsys, "export", "paper", "--c", "out", *options)
    assert (code, err) == (0, "")
    record = json.loads(out)
    assert record["step"] == 0.01
    assert record["law"] == "mode 0 only"
    header = (tmp_path / "out" / "law.h").read_text()
    assert 'Controller of the law "mode 0 only"' in header
    assert "   States: x[0]: x" in header
    assert "   Limits of the inputs: none." in header
    assert record["c"]["passed"] is None
    assert "typedef float law_real;" in (tmp_path / "out" / "law.h").read_text()
    assert record["c"]["rom"] < 200


@pytest.mark.few(2)
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "nothing to write: give --c FOLDER, --fmu FILE or --plant-fmu FILE"),
        (["--c", "out", "--law", "best"], "law must be one of averaged, "),
        (["--c", "out", "--law", "oracle"], "ExactPredictor needs a preview"),
        (["--c", "out", "--rom-budget", "20"], "rom_budget = 20 bytes is too small: the tables"),
        (["--c", "/proc/out"], "folder '/proc/out' cannot be written"),
        (["--fmu", "/proc/law.fmu"], "path '/proc/law.fmu' cannot be written"),
        (["--c", "out", "--step", "0"], "step must be positive"),
    ],
)
def test_bad_requests_get_one_line_and_code_2(tmp_path, monkeypatch, capsys, arguments, message):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(compiler, "compiler", lambda: None)
    code, _, err = run(capsys, "export", "paper", *arguments)
    assert code == 2
    assert err.startswith("deadtime: error: ")
    assert err.count("\n") == 1
    assert message in err


def test_export_of_a_prediction_is_one_of_the_c_alone(tmp_path, capsys):
    code, _, _ = run(capsys, "export", "paper", "--c", str(tmp_path), "--prediction")
    assert code == 0
    assert "controller_predict(" in (tmp_path / "controller.h").read_text()
    code, _, err = run(capsys, "export", "paper", "--fmu", str(tmp_path / "a.fmu"), "--prediction")
    assert code != 0
    assert "--prediction is for the C: give --c FOLDER, too." in " ".join(err.split())
