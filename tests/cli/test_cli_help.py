"""Help pages, suggestions and completion of the command line."""

import os
import pty
import re
import select
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest

from deadtime.cli.application import app, main

COMMANDS = sorted(name for name in app if not name.startswith("-"))
needs_bash = pytest.mark.skipif(shutil.which("bash") is None, reason="no bash")


def run(capsys, *arguments):
    with pytest.raises(SystemExit) as stopped:
        main(arguments)
    captured = capsys.readouterr()
    return stopped.value.code, captured.out, captured.err


def commands_below(page, title):
    """The commands that a help page shows below a title, a line each."""
    below = page.split(f"\n{title} ", 1)[1].splitlines()[1:]
    return [line.rstrip() for line in below if line.startswith("deadtime")]


@pytest.mark.few(4)
@pytest.mark.parametrize("command", COMMANDS)
def test_help_of_a_command_ends_with_examples_that_can_be_copied(capsys, command):
    code, out, err = run(capsys, command, "--help")
    assert (code, err) == (0, "")
    examples = commands_below(out, "Examples")
    assert examples
    assert out.rstrip().endswith(examples[-1])
    for example in examples:
        assert example.startswith(f"deadtime {command}")
        # A line that ends where the page does may have been broken.
        assert len(example) < 80
        words = shlex.split(example.partition(" > ")[0], comments=True)[1:]
        function, *_ = app.parse_args(words, exit_on_error=False, print_error=False)
        assert function.__name__ == command.replace("-", "_")


@pytest.mark.few(4)
@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_takes_json(capsys, command):
    _, out, _ = run(capsys, command, "--help")
    assert re.search(r"^│ +--json ", out, re.M), out


def test_help_of_all_says_where_to_start_and_groups_every_command(capsys):
    code, out, err = run(capsys)
    assert (code, err) == (0, "")
    start = [line.split()[1] for line in commands_below(out, "Start here")]
    assert start == ["init", "simulate", "certify", "app"]
    panels = re.findall(r"^╭─ (.*?) ─*╮$(.*?)^╰", out, re.M | re.S)
    grouped = {title: re.findall(r"^│ ([a-z][a-z-]+) ", body, re.M) for title, body in panels}
    assert list(grouped) == [
        "Start",
        "Judge one loop",
        "Compare laws on many signals",
        "Build a controller",
        "Files and shell",
        "Options",
    ]
    assert sorted(name for names in grouped.values() for name in names) == COMMANDS
    assert "Exit codes: 0 done, 1 the answer is no, 2 the request is wrong" in out


@pytest.mark.few(1)
@pytest.mark.parametrize("other", [["--help"], ["-h"], ["help"]])
def test_help_is_found_by_whatever_name_it_is_called(capsys, other):
    expected = run(capsys)
    assert run(capsys, *other) == expected
    assert run(capsys, *other, "bound" if other == ["help"] else "--help")[0] == 0
    assert run(capsys, "help", "bound") == run(capsys, "bound", "--help")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["simulat", "paper"], 'Unknown command "simulat". Did you mean "simulate"?'),
        (["montecarlo", "paper"], 'Unknown command "montecarlo". Did you mean "monte-carlo"?'),
        (["help", "certfy"], 'Unknown command "certfy". Did you mean "certify"?'),
        (["certify", "paper", "--dwelltime", "1"], "Unknown option: --dwelltime. Did you mean --d"),
        (["bound", "papr"], "or a file that exists, got 'papr'. Did you mean paper?"),
        (
            ["certify", "motor"],
            "write it with deadtime init motor.toml -e motor, and give motor.toml",
        ),
        (["bound"], 'Command "bound" parameter --problem requires an argument. See deadtime bound'),
        (["design"], "requires an argument"),
        (["certify", "paper", "--delays", "0.3"], "--delays [0.3,0.1] [0.32,0.12]. See deadtime"),
        (["identify", "log.csv", "--delay"], "Such as: deadtime identify log.csv --one-mode --del"),
        (["bound", "paper", "mine"], "unexpected argument 'mine'. See deadtime bound --help."),
        (["bound", "paper", "--dwell-time", "long"], 'unable to convert "long" into float'),
        (["completion", "tcsh"], "tcsh"),
        (["bound", "none.toml"], "none.toml cannot be read: No such file or directory"),
        (["verify", "none.json"], "No such file"),
        (["sweep", "none.toml"], "none.toml cannot be read: No such file or directory"),
        (["study", "none.toml"], "none.toml cannot be read: No such file or directory"),
        (["fit", "none.csv"], "none.csv cannot be read: No such file or directory"),
        (["plot", "none.zarr"], "none.zarr' does not exist"),
    ],
)
@pytest.mark.parametrize("json", [[], ["--json"]], ids=["text", "json"])
def test_wrong_requests_get_one_line_that_helps_and_no_output(capsys, arguments, message, json):
    code, out, err = run(capsys, *arguments, *json)
    assert (code, out) == (2, "")
    assert err.startswith("deadtime: error: ")
    assert err.count("\n") == 1
    assert message in err


# -- completion ----------------------------------------------------------------------------------


@pytest.fixture
def script(capsys, tmp_path):
    code, out, err = run(capsys, "completion", "bash")
    assert (code, err) == (0, "")
    path = tmp_path / "deadtime.bash"
    path.write_text(out)
    return path


@pytest.mark.few(2)
@needs_bash
@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        (["cert"], ["certify"]),
        (["s"], ["schema", "simulate", "study", "sweep"]),
        (["certify", "--dw"], ["--dwell-time"]),
        (["certify", "prob"], ["problem.toml"]),
        (["export", "paper", "--fmi", ""], ["3.0", "2.0"]),
        (["completion", "z"], ["zsh"]),
    ],
    ids=" ".join,
)
def test_bash_completes_commands_options_choices_and_files(script, tmp_path, typed, offered):
    (tmp_path / "problem.toml").touch()
    subprocess.run(["bash", "-n", str(script)], check=True)
    words = shlex.join(["deadtime", *typed])
    drive = f"source {script}; COMP_WORDS=({words}); COMP_CWORD={len(typed)}; _deadtime"
    shell = ["bash", "--norc", "-c", f'{drive}; printf "%s\\n" "${{COMPREPLY[@]}}"']
    result = subprocess.run(shell, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert result.stderr == ""
    assert sorted(result.stdout.split()) == sorted(offered)


@needs_bash
def test_tab_in_a_bash_that_somebody_types_into_completes_certify(script):
    pid, terminal = pty.fork()
    if pid == 0:
        os.environ.update(TERM="dumb", PS1="$ ")
        os.execvp("bash", ["bash", "--norc", "--noprofile", "-i"])
    os.write(terminal, f"source {script}; echo rea''dy\n".encode())
    seen = read_until(terminal, b"ready")
    os.write(terminal, b"echo deadtime cer; deadtime cert\t")
    seen = read_until(terminal, b"certify ")
    os.write(terminal, b"\x15exit\n")
    os.waitpid(pid, 0)
    os.close(terminal)
    assert b"deadtime certify " in seen


def read_until(terminal, wanted):
    seen = b""
    while wanted not in seen:
        assert select.select([terminal], [], [], 20.0)[0], seen
        seen += os.read(terminal, 4096)
    return seen


@pytest.mark.few(1)
@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_scripts_name_every_command_and_pass_their_shell(capsys, tmp_path, shell):
    code, out, err = run(capsys, "completion", shell)
    assert (code, err) == (0, "")
    for command in COMMANDS:
        assert command in out
    if shutil.which(shell) is not None:
        (tmp_path / "script").write_text(out)
        subprocess.run([shell, "-n", str(tmp_path / "script")], check=True)


@pytest.mark.parametrize("spelling", [["completion", "--install"], ["--install-completion"]])
def test_installing_completion_writes_the_script_where_bash_looks(
    capsys, tmp_path, monkeypatch, spelling
):
    monkeypatch.setenv("HOME", str(tmp_path))
    code, out, err = run(capsys, *spelling, "--shell", "bash")
    path = tmp_path / ".local/share/bash-completion/completions/deadtime"
    assert (code, out, err) == (0, f"Wrote {path}. Next: open a new bash.\n", "")
    assert path.read_text() == run(capsys, "completion", "bash")[1]
    assert str(path) in (tmp_path / ".bashrc").read_text()


def test_where_no_shell_is_known_completion_asks_for_one(capsys, monkeypatch):
    from cyclopts.completion import detect

    def unknown():
        raise detect.ShellDetectionError

    monkeypatch.setattr(detect, "detect_shell", unknown)
    code, out, err = run(capsys, "completion")
    assert (code, out) == (2, "")
    assert "shell must be one of bash, zsh, fish" in err


def test_a_home_that_cannot_be_written_is_told(capsys, monkeypatch):
    monkeypatch.setenv("HOME", "/proc")
    code, out, err = run(capsys, "completion", "bash", "--install")
    assert (code, out) == (2, "")
    assert "the script cannot be written" in err
    assert Path.home() == Path("/proc")
