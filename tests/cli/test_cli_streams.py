"""What goes to stdout and stderr, of real processes: JSON, colours, pipes, and nothing else."""

import io
import json
import os
import re
import shlex
import signal
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

from deadtime.cli.application import app, main
from deadtime.cli.printing import print_json
from terminal import on_a_terminal

PAGE = (Path(__file__).parents[2] / "docs" / "cli.md").read_text(encoding="utf-8")
LINES = [
    line for block in re.findall(r"```bash\n(.*?)```", PAGE, re.S) for line in block.split("\n")
]
ASKED = [shlex.split(line.partition(" > ")[0])[1:] for line in LINES if line.startswith("deadtime")]
COMMANDS = {name for name in app if not name.startswith("-")} - {"app"}  # it serves until stopped
# Half a minute of compiling and searching; what they print is the way of the others, too.
SLOW = {
    *("simulate", "reproduce", "robustness", "monte-carlo", "sweep", "plot", "study", "design"),
    *("experiment", "identify"),
}
QUICK = [command for command in ASKED if command[0] not in SLOW]
ANSI = b"\x1b["

# One process for all: it starts once, and a word of any command on stderr is still a word too many.
DRIVER = """
import contextlib, json, sys
from deadtime.cli import main

if __name__ == "__main__":
    with open("codes", "w") as codes:
        for number, command in enumerate(json.loads(sys.argv[1])):
            with open(f"{number}.out", "w") as out, contextlib.redirect_stdout(out):
                try:
                    main([*command, "--json"])
                except SystemExit as stopped:
                    print(stopped.code, file=codes)
"""


def refuse(token):
    raise AssertionError(f"{token} is no JSON")


@pytest.fixture(
    scope="module",
    params=[pytest.param(ASKED, marks=pytest.mark.long), QUICK],
    ids=["all", "quick"],
)
def ran(request, tmp_path_factory):
    """Commands of the page, with --json, in one folder; what is on stderr, codes, outputs."""
    folder, asked = tmp_path_factory.mktemp("page"), request.param
    (folder / "study.toml").write_text(re.search(r"```toml\n(.*?)```", PAGE, re.S)[1])
    (log,) = (line for line in LINES if line.startswith("python -c "))
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        exec(shlex.split(log)[2])
    (folder / "driver.py").write_text(DRIVER)
    result = subprocess.run(
        [sys.executable, "driver.py", json.dumps(asked)],
        cwd=folder,
        stdin=subprocess.DEVNULL,
        capture_output=True,
    )
    outputs = [(folder / f"{n}.out").read_text(encoding="utf-8") for n in range(len(asked))]
    return folder, asked, result, (folder / "codes").read_text().split(), outputs


def test_every_command_runs_without_a_word_on_stderr(ran):
    _, asked, result, codes, _ = ran
    assert (result.stderr, result.stdout, result.returncode) == (b"", b"", 0)
    assert codes == ["0"] * len(asked)


def test_every_command_is_on_the_page():
    assert {command[0] for command in ASKED} == COMMANDS
    assert {command[0] for command in QUICK} == COMMANDS - SLOW


def test_json_of_every_command_is_one_strict_document_with_the_keys_of_the_page(ran):
    folder, asked, _, _, outputs = ran
    told = dict(re.findall(r"^\| `([a-z-]+)` \| (`.*) \|$", PAGE, re.M))
    for (command, *arguments), output in zip(asked, outputs, strict=True):
        record = json.loads(output, parse_constant=refuse)
        if command == "schema":
            assert record["properties"].keys() >= {"plant", "law"}
            continue
        promised, _, sometimes = told[command].partition(";")
        keys = set(re.findall(r"`(\w+)`", promised))
        assert keys <= record.keys() <= keys | set(re.findall(r"`(\w+)`", sometimes))
        assert ("damaged" in record) == (command == "sweep" and "--status" not in arguments)
        for name in record.get("written", ()):
            assert (folder / name).exists()
        if command not in ("verify", "bound", "sweep", "completion"):
            assert record["written"]


def test_what_json_does_not_know_is_null(capsys):
    print_json({"a": float("nan"), "b": [float("inf"), (1.0, -float("inf"))]}, [Path("x")])
    record = json.loads(capsys.readouterr().out, parse_constant=refuse)
    assert record == {"a": None, "b": [None, [1.0, None]], "written": ["x"]}


# -- terminals and pipes -------------------------------------------------------------------------

# A help page, and the three ways in which all commands print results.
KINDS = """
from deadtime.cli import main
from deadtime.cli.printing import print_answer, print_table

def page():
    try:
        main(["--help"])
    except SystemExit as stopped:
        assert stopped.code == 0

for kind in (
    page,
    lambda: print_table(["law", "cost"], [["mean", "1.5"]]),
    lambda: print_answer("An answer.", "A title"),
    lambda: print("A line"),
):
    print("MARK", flush=True)
    kind()
"""


def kinds(tmp_path, terminal, **environment):
    """What each kind of output is, on a terminal or in a pipe."""
    inherited = {k: v for k, v in os.environ.items() if k not in ("NO_COLOR", "FORCE_COLOR")}
    command = [sys.executable, "-c", KINDS]
    options = {"cwd": tmp_path, "env": inherited | {"TERM": "xterm"} | environment}
    if not terminal:
        result = subprocess.run(command, capture_output=True, check=True, **options)
        assert result.stderr == b""
        return result.stdout.split(b"MARK\n")[1:]
    seen, _ = on_a_terminal(command, **options)
    return seen.split(b"MARK\r\n")[1:]


def test_on_a_terminal_output_is_styled(tmp_path):
    page, table, heading, plain = kinds(tmp_path, terminal=True)
    assert ANSI in page
    assert ANSI in table
    assert ANSI in heading
    assert ANSI not in plain


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("terminal", "environment"),
    [(False, {}), (True, {"NO_COLOR": "1"}), (False, {"NO_COLOR": "1", "FORCE_COLOR": "1"})],
    ids=["pipe", "NO_COLOR", "NO_COLOR over FORCE_COLOR"],
)
def test_elsewhere_or_where_it_is_not_wanted_there_is_no_escape_sequence(
    tmp_path, terminal, environment
):
    for output in kinds(tmp_path, terminal, **environment):
        assert output
        assert b"\x1b" not in output


def deadtime(line, **options):
    """A line of shell with the command on its PATH."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environment = os.environ | {"PATH": path} | options
    command = ["bash", "-o", "pipefail", "-c", line]
    return subprocess.run(
        command, env=environment, stdin=subprocess.DEVNULL, capture_output=True, text=True
    )


@pytest.mark.few(2)
@pytest.mark.parametrize("reader", ["true", "head -1"])
@pytest.mark.parametrize("what", ["schema", "completion bash --json", "--help"])
def test_a_reader_that_goes_ends_the_command_in_silence(reader, what):
    result = deadtime(f"deadtime {what} | {reader}")
    assert result.stderr == ""
    # `head` may be slower than the output.
    assert result.returncode in ((141,) if reader == "true" else (0, 141))
    assert result.stdout.count("\n") == (reader == "head -1")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")
def test_a_full_disk_is_told_in_one_line():
    result = deadtime("deadtime schema > /dev/full")
    assert result.returncode == 2
    assert result.stderr == "deadtime: error: No space left on device\n"


def test_an_encoding_without_infinity_is_no_reason_to_fail(monkeypatch):
    """Text has a question mark instead; JSON escapes, and is the same when it is read."""
    printed = {}
    for encoding in ("ascii", "utf-8"):
        for options in ((), ("--json",)):
            stream = io.TextIOWrapper(io.BytesIO(), encoding)
            monkeypatch.setattr(sys, "stdout", stream)
            with pytest.raises(SystemExit) as stopped:
                main(["bound", "paper", *options])
            assert stopped.value.code == 0
            printed[encoding, *options] = stream.buffer.getvalue().decode(encoding)
    assert "its modes and gains differ by ? = \n0.79" in printed["ascii",]
    assert "its modes and gains differ by ε = \n0.79" in printed["utf-8",]
    assert "ε" in printed["utf-8", "--json"]
    assert json.loads(printed["ascii", "--json"]) == json.loads(printed["utf-8", "--json"])


def test_an_interrupted_command_says_so_and_stops_with_130(tmp_path):
    code = """
import os, signal, time
from deadtime.cli import main, options
signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored in the background of a shell
def interrupted(place):
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(60.0)
options.problem_of = interrupted
main(["certify", "paper"])
"""
    command = [sys.executable, "-c", code]
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert (result.returncode, result.stdout) == (130, "")
    assert result.stderr == "deadtime: interrupted\n"


def test_an_interrupted_command_leaves_at_once_those_who_are_at_work(tmp_path):
    """Compiled code that returns to a Python that is being taken down aborts the process."""
    code = """
import atexit, threading
from deadtime.base import threads
from deadtime.cli import main, options
atexit.register(print, "Python's own end")
threads.processors = lambda: 2
def interrupted(place):
    for _ in threads.in_order(lambda i: i or threading.Event().wait(60.0), [1, 0]):
        raise KeyboardInterrupt
options.problem_of = interrupted
main(["certify", "paper"])
"""
    command = [sys.executable, "-c", code]
    result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert (result.returncode, result.stdout) == (130, "")
    assert result.stderr == "deadtime: interrupted\n"


def test_an_error_of_the_system_is_one_line_with_its_file(capsys, monkeypatch):
    def full(*arguments):
        raise OSError(28, "No space left on device", "bounds.txt")

    monkeypatch.setattr(import_module("deadtime.reports.certificate_tables"), "bounds_of", full)
    with pytest.raises(SystemExit) as stopped:
        main(["bound", "paper"])
    captured = capsys.readouterr()
    assert (stopped.value.code, captured.out) == (2, "")
    assert captured.err == "deadtime: error: bounds.txt: No space left on device\n"
