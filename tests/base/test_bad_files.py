"""Files that nobody means: each is refused in one line, by name, at a cost that is bounded."""

import os
import time

import pytest

import deadtime as dt
from deadtime.base.errors import CertificateFileError
from deadtime.base.files import read_text
from deadtime.cli.application import main
from deadtime.problems.file import load_problem
from deadtime.scenarios.sweeps import load_study
from fuzzing.seeds import PLAIN

READERS = {
    "problem": (load_problem, dt.ProblemFileError),
    "study": (load_study, dt.StudyFileError),
    "log": (dt.SwitchingSignal.from_csv, dt.ArgumentError),
    "certificate": (dt.verify, CertificateFileError),
}
every_reader = pytest.mark.parametrize(("read", "kind"), READERS.values(), ids=READERS)


def refused(read, kind, path):
    """The one line of a refusal."""
    with pytest.raises(kind) as caught:
        read(path)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@every_reader
@pytest.mark.parametrize("name", ["no\0name", "n" * 5000, "\ud800", "", "/dev/zero", "/dev/null"])
def test_a_name_of_no_file_is_refused(read, kind, name):
    refused(read, kind, name)


@every_reader
def test_a_folder_a_lack_of_rights_and_a_foreign_encoding_are_refused(read, kind, tmp_path):
    assert "Is a directory" in refused(read, kind, tmp_path)
    path = tmp_path / "file"
    path.write_bytes("é".encode("latin-1"))
    other = "must have the columns" if kind is dt.ArgumentError else "is not UTF-8 text"
    assert other in refused(read, kind, path)  # logs are read in other encodings, too
    path.chmod(0)
    if not os.access(path, os.R_OK):  # root may read all
        assert "Permission denied" in refused(read, kind, path)


@every_reader
def test_a_file_without_end_is_refused_by_its_size(read, kind, tmp_path):
    path = tmp_path / "large"
    with path.open("wb") as file:
        file.truncate(2**40)
    assert "MB: it is no file of this kind" in refused(read, kind, path)


def test_a_pipe_is_read_to_its_bound(tmp_path):
    for size, enough in ((1000, True), (1001, False)):
        source, sink = os.pipe()
        os.write(sink, b"x" * size)
        os.close(sink)
        if enough:
            assert read_text(f"/dev/fd/{source}", 1000) == "x" * size
        else:
            with pytest.raises(dt.ArgumentError, match="has more than"):
                read_text(f"/dev/fd/{source}", 1000)
        os.close(source)


def test_a_byte_order_mark_is_no_fault(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_bytes(b"\xef\xbb\xbf" + PLAIN.encode())
    assert load_problem(path).horizon == 4.0


HOSTILE = {
    "an integer of many digits": ("a = " + "1" * 5000, "thousands of digits"),
    "brackets": ("a = " + "[" * 500 + "]" * 500, "nested too deeply"),
    "tables in tables": ("a = " + "{b = " * 500 + "1" + "}" * 500, "nested too deeply"),
    "a key of many parts": ("a" + ".a" * 20_000 + " = 1", "nested too deeply"),
    "a header of many parts": ("[a" + ".a" * 20_000 + "]", "nested too deeply"),
    "quoted parts": ('"a"' + '."a"' * 20_000 + " = 1", "nested too deeply"),
    "many dotted keys": ("\n".join(f"a.b{i} = 1" for i in range(20_001)), "20,000 keys"),
    "many tables": ("\n".join(f"[a{i}]" for i in range(20_001)), "20,000 keys"),
    "a header of spaces": ("[plant" + " " * 3000 + "x" + " " * 3000, "not valid TOML"),
    "spaces": (" " * 900_000 + "a = 1", "a is not known"),
    "a time of day": ("title = 07:32:00", "title: input should be a valid string"),
    "quotes": ('title = "' + '\\"' * 400_000, "not valid TOML"),
    "many wrong items": ("poles = [" + '[""],' * 150_000 + "]", "poles"),
}


@pytest.mark.few(4)
@pytest.mark.parametrize(("text", "message"), HOSTILE.values(), ids=HOSTILE)
@pytest.mark.parametrize("kind", ["problem", "study"])
def test_a_hostile_text_is_refused_within_five_seconds_of_work(kind, text, message, tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(text)
    began = time.process_time()
    found = refused(*READERS[kind], path)
    assert time.process_time() - began < 5.0
    if kind == "problem" and message != "poles":
        assert message in found


def test_brackets_and_dots_in_strings_and_comments_are_no_nesting(tmp_path):
    path = tmp_path / "mine.toml"
    marks = "[{." * 100
    path.write_text(f'title = """\n{marks}"""\nsource = \'{marks}\' # {marks}\n{PLAIN}')
    assert load_problem(path).title == marks


LOGS = {
    "a field of many letters": ("time,mode\n0," + "1" * 140_000, "line 2: field larger than"),
    "a mode of many digits": ("time,mode\n0," + "1" * 5000, "line 2: mode must be an integer in"),
    "a time of many letters": ("time,mode\n" + "x" * 5000 + ",0", "line 2: time must be a number"),
    "no finite time": ("time,mode\nsNaN,0", "time must be finite"),
    "a time beyond all": ("time,mode\n1e999999,0", "time must be finite, got 1e999999"),
    "many columns": (",".join(["a"] * 5000), "must have the columns t (or time) and mode"),
}


@pytest.mark.parametrize(("text", "message"), LOGS.values(), ids=LOGS)
def test_a_hostile_log_is_refused_in_a_short_line(text, message, tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(text)
    found = refused(dt.SwitchingSignal.from_csv, dt.ArgumentError, path)
    assert message in found
    assert len(found) < 500


@pytest.mark.parametrize(
    ("start", "step"),
    [("17323000000.0", "0.1"), ("1732300000.123456789", "0.001"), ("-99999999999", "1e-7")],
)
def test_a_log_keeps_every_digit_that_its_clock_has_after_the_first_row(start, step, tmp_path):
    from decimal import Decimal

    rows = [Decimal(start) + k * Decimal(step) for k in range(5)]
    path = tmp_path / "log.csv"
    path.write_text("time,mode\n" + "".join(f"{t},{k % 2}\n" for k, t in enumerate(rows)))
    expected = [float(k * Decimal(step)) for k in range(5)]
    assert dt.SwitchingSignal.from_csv(path).times.tolist() == expected
    assert dt.SwitchingSignal.from_csv(path, dwell_time=float(step)).switches == 4


# -- the last guard of the command line ----------------------------------------------------------


def crash(*_):
    raise RuntimeError("first line\nsecond line")


def test_a_bug_is_one_line_with_code_70_and_a_traceback_on_request(monkeypatch, capsys):
    monkeypatch.setattr("deadtime.cli.options.problem_of", crash)
    for debug in ("", "1"):
        monkeypatch.setenv("DEADTIME_DEBUG", debug)
        with pytest.raises(SystemExit) as stopped:
            main(["bound", "paper"])
        captured = capsys.readouterr()
        *above, line = captured.err.splitlines()
        assert (stopped.value.code, captured.out) == (70, "")
        assert line.startswith("deadtime: internal error: RuntimeError: first line second line")
        assert "please report it" in line
        assert bool(above) == bool(debug)
        assert ("Traceback" in captured.err) == bool(debug)


def test_too_little_memory_is_no_bug(monkeypatch, capsys):
    def large(*_):
        raise MemoryError("Unable to allocate 7 TiB")

    monkeypatch.setattr("deadtime.cli.options.problem_of", large)
    with pytest.raises(SystemExit) as stopped:
        main(["bound", "paper"])
    assert stopped.value.code == 2
    assert "out of memory (Unable to allocate 7 TiB)" in capsys.readouterr().err
