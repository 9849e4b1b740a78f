"""Problem files: what they mean, and every way to get them wrong."""

import json
import re
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

import deadtime as dt
from deadtime.problems.file import json_schema, load_problem
from deadtime.problems.toml.complaints import key_lines

TEMPLATES = Path(str(files("deadtime.problems"))) / "files"
PLAIN = """\
[plant]
delay = 0.35
A = [[[0.5, 1.0], [0.0, -0.2]], [[0.4, 1.0], [0.1, -0.3]]]
B = [[[0.0], [1.0]], [[0.0], [1.1]]]

[gains]
poles = [-1.0, -2.0]

[signal]
kind = "switches"
times = [0.0, 0.7, 1.55]
modes = [0, 1, 0]

[run]
x0 = [1.0, 0.0]
horizon = 4.0
step = 0.1
"""


def load(tmp_path, text, name="mine.toml"):
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return load_problem(path)


@pytest.mark.parametrize("name", dt.problems.NAMED)
def test_template_describes_the_named_problem_exactly(name):
    ours, theirs = dt.problems.NAMED[name](), load_problem(TEMPLATES / f"{name}.toml")
    for part in ("A", "B", "delay"):
        np.testing.assert_array_equal(getattr(ours.plant, part), getattr(theirs.plant, part))
    np.testing.assert_array_equal(ours.gains, theirs.gains)
    np.testing.assert_array_equal(ours.x0, theirs.x0)
    assert (ours.title, ours.source) == (theirs.title, theirs.source)
    assert (ours.horizon, ours.step) == (theirs.horizon, theirs.step)
    assert (ours.states, ours.modes) == (theirs.states, theirs.modes)
    assert list(ours.laws) == list(theirs.laws)
    for law in ours.laws:
        a, b = ours.simulate(law), theirs.simulate(law)
        np.testing.assert_array_equal(a.states, b.states)


def test_the_template_shows_every_section_that_a_file_may_have():
    text = (TEMPLATES / "paper.toml").read_text(encoding="utf-8")
    shown = set(re.findall(r"^(?:# )?\[+(\w+)\]+", text, re.M))
    keys = {key for key in json_schema()["properties"] if f"\n{key} = " not in text}
    assert shown == keys


def test_plain_file_runs_all_laws_of_the_paper(tmp_path):
    problem = load(tmp_path, PLAIN)
    assert problem.name == "mine"
    assert list(problem.laws) == [
        "averaged", "mode 0 only", "mode 1 only", "mean", "oracle", "delay ignored",
    ]  # fmt: skip
    np.testing.assert_array_equal(problem.gains, dt.place(problem.plant, [-1, -2]))
    np.testing.assert_array_equal(problem.signal.times, [0.0, 0.7, 1.55])


@pytest.mark.parametrize("step", ["1e10", "1e308"])
def test_a_step_beyond_all_is_what_a_message_is_about(tmp_path, step):
    """And not the signal, which has to last no longer than the run and the delay."""
    signal = 'kind = "random"\ndwell_time = 0.2\n'
    text = re.sub(r'kind = "switches"\n.*?\n\n', f"{signal}\n", PLAIN, flags=re.S)
    problem = load(tmp_path, text.replace("step = 0.1", f"step = {step}"))
    with pytest.raises(dt.ArgumentError, match=re.escape(f"step = {float(step):g} s")):
        problem.simulate("averaged")


def test_listed_laws_keep_their_order_names_and_models(tmp_path):
    laws = """
[[law]]
kind = "mean"
gain = [[-5.0, -3.0]]

[[law]]
kind = "averaged"
name = "wrong delay"
weights = [0.25, 0.75]
model = { delay = 0.4 }

[[law]]
kind = "single"
mode = 1
"""
    problem = load(tmp_path, PLAIN + laws)
    assert list(problem.laws) == ["mean", "wrong delay", "mode 1 only"]
    np.testing.assert_array_equal(problem.laws["mean"].gain, [[-5.0, -3.0]])
    wrong = problem.laws["wrong delay"]
    assert wrong.plant.delay == 0.4
    np.testing.assert_array_equal(wrong.weights, [0.25, 0.75])


@pytest.mark.parametrize(
    ("gains", "expected"),
    [
        ('poles = ["-1+2j", "-1-2j"]', lambda p: dt.place(p, [-1 + 2j, -1 - 2j])),
        ("poles = [[-1.0, -2.0], [-2.0, -3.0]]", lambda p: dt.place(p, [[-1, -2], [-2, -3]])),
        ("lqr = { Q = [[1.0, 0.0], [0.0, 1.0]], R = [[2.0]] }",
         lambda p: dt.lqr(p, np.eye(2), [[2.0]])),
        ("K = [[[-3.0, -4.0]], [[-3.0, -4.0]]]", lambda p: np.full((2, 1, 2), [-3.0, -4.0])),
    ],
)  # fmt: skip
def test_gains_are_given_or_designed(tmp_path, gains, expected):
    problem = load(tmp_path, PLAIN.replace("poles = [-1.0, -2.0]", gains))
    np.testing.assert_array_equal(problem.gains, expected(problem.plant))


@pytest.mark.parametrize(
    ("signal", "times"),
    [
        ('kind = "constant"\nmode = 1', [0.0]),
        ('kind = "periodic"\nsojourns = [1.0, 2.0]\nmodes = [0, 1]', [0.0, 1.0, 3.0, 4.0]),
        ('kind = "log"\nfile = "log.csv"\nlabels = { idle = 0, busy = 1 }', [0.0, 0.5, 2.0]),
        ('kind = "random"\ndwell_time = 0.3\nseed = 4', None),
        ('kind = "random"\naverage_dwell_time = 0.3\nchatter = 3', None),
    ],
)
def test_signal_kinds(tmp_path, signal, times):
    (tmp_path / "log.csv").write_text("time,mode\n3.0,idle\n3.5,busy\n5.0,idle\n9.0,idle\n")
    text = re.sub(r'kind = "switches"\ntimes.*\nmodes.*', signal, PLAIN)
    problem = load(tmp_path, text)
    if times is None:
        assert problem.signal.end >= problem.horizon + problem.plant.delay
    else:
        np.testing.assert_allclose(problem.signal.times, times)
    assert not problem.simulate("oracle").diverged


def test_constant_initial_input_reaches_the_plant(tmp_path):
    problem = load(tmp_path, PLAIN.replace("step = 0.1", "step = 0.1\nu0 = 2.0"))
    law = problem.laws["averaged"]
    direct = dt.simulate(
        problem.plant, law, problem.signal, problem.x0, 4.0, step=0.1, u0=np.array([2.0])
    )
    np.testing.assert_array_equal(problem.simulate("averaged").states, direct.states)


def test_ideal_step_runs_the_ideal_loop(tmp_path):
    problem = load(tmp_path, PLAIN.replace("step = 0.1", 'step = "ideal"'))
    assert problem.step is None
    run = problem.simulate("averaged")
    assert run.time.size == 1001
    assert not run.record.held


BAD = [
    ("poles = [-1.0, -2.0]", "K = [[[1.0, 1.0]], [[1.0, 1.0]]]", r"\[gains\]: gains\[0\] leaves A \+ B K of mode 0"),
    ("poles = [-1.0, -2.0]", 'poles = ["-4+2i", "-4-2i"]', r'poles must be .*, got \'-4\+2i\': write "-4\+2j"'),
    ("[[[0.0], [1.0]], [[0.0], [1.1]]]", "[[[0.0, 1.0]], [[0.0, 1.1]]]", r"line 4, \[plant\]: B must have shape \(modes, n, m\) = \(2, 2, 1\), got \(2, 1, 2\): pass the transpose"),
    ("[[[0.0], [1.0]], [[0.0], [1.1]]]", "[[0.0, 1.0], [0.0, 1.1]]", r"line 4: plant\.B must have shape \(modes, n, m\), got \(2, 2\): .* such as B = \[\[\[0\.0\], \[1\.0\]\],"),
    ("[[[0.0], [1.0]], [[0.0], [1.1]]]", "0.0", r"line 4: plant\.B must have shape \(modes, n, m\), got \(\); such as B = "),
    ("x0 = [1.0, 0.0]", "x0 = [[1.0], [0.0]]", r"line 15: run\.x0 must have shape \(n,\), got \(2, 1\); such as x0 = \[1\.0, 0\.0\]"),
    ("x0 = [1.0, 0.0]", 'x0 = ["a"]', r"line 15: run\.x0 must hold real numbers, .* such as x0 = "),
    ("step = 0.1", 'step = 0.1\nu0 = "a"', r"line 18: run\.u0 must be a number or \(m,\), such as u0 = \[0\.0\], got 'a'"),
    ("[signal]", "[[signal]]", r"line 9: signal must be one table, begun by \[signal\], got a list"),
    ("step = 0.1", 'step = 0.1\n[law]\nkind = "mean"', r"line 18: law must be a list of tables, each begun by \[\[law\]\], got a table"),
    ("step = 0.1", "step = 0.1\n[tracking]\npoles = [-1.0]", r"line 18: tracking is not known: it can be one of title, source, plant"),
    ("step = 0.1", "step = 0.1\nreference = 1.0", r"line 18: run\.reference is not known: it can be one of x0, horizon, step"),
    ("step = 0.1", 'step = 0.1\n[switching]\nkind = "semi-markov"\nsojourn = { distribution = "expon", scale = {} }', r"line 20: switching\.sojourn\.scale: input should be a valid number"),
    ("[[0.5, 1.0]", "[[1e308, 1e308]", r"line 2, \[plant\]: delay must be short enough for e\^\(A·delay\)"),
    ("[[0.5, 1.0]", "[[1e300, 1e300]", r"line 7, \[gains\]: poles of mode 0 could not be placed: the plant.s numbers are too large, or too far apart"),
    ("delay = 0.35", "dealy = 0.35", r"line 2: plant\.dealy is not known: did you mean delay\?"),
    ("delay = 0.35", 'delay = 0.35\n"a[b]" = 1', r"line \d: plant\.a\[b\] is not known: it can be one of delay"),
    ("delay = 0.35", 'delay = 0.35\nfloat = 1', r"line 3: plant\.float is not known: it can be one of delay"),
    ("delay = 0.35\n", "", r"line 1: plant\.delay is missing: add it\."),
    ("[plant]\ndelay = 0.35", "[rnu]\n[gain]", r"line 1: rnu is not .* Line 2: gain is .*\? plant is missing: add it\."),
    ("[run]", "[rnu]", r"line 14: rnu is not known: did you mean run\?"),
    ("delay = 0.35", "delay = ", r"not valid TOML: .*line 2"),
    ("delay = 0.35", 'delay = "long"', r"line 2: plant\.delay must be a number, \(m,\), .*got 'long'"),
    ("delay = 0.35", "delay = nan", r"line 2, \[plant\]: delay must be finite, got nan"),
    ("delay = 0.35", "delay = 0.0", r"line 2, \[plant\]: delay must be positive"),
    ("[[0.0], [1.1]]", "[[1.1]]", r"line 4, \[plant\]: B must have shape"),
    ("delay = 0.35", 'delay = 0.35\nstates = ["x"]', r"\[plant\]: states must name all 2"),
    ("poles = [-1.0, -2.0]", "poles = [-1.0, -1.0]", r"line 7, \[gains\]: poles .* repeated 2 times"),
    ("poles = [-1.0, -2.0]", 'poles = ["x", -1.0]', r"line 7, \[gains\]: poles must be numbers"),
    ("poles = [-1.0, -2.0]", "poles = [1.0, -2.0]", r"line 7, \[gains\]: poles of mode 0 must have negative real parts"),
    ("poles = [-1.0, -2.0]", "", r"line 6: gains: give exactly one of K, poles and lqr"),
    ('kind = "switches"', 'kind = "swithces"', r"line 9: signal\.kind must be one of .*'switches'"),
    ('kind = "switches"\n', "", r"line 9: signal\.kind is missing"),
    ("times = [0.0, 0.7, 1.55]", "times = [0.0, 1.7, 1.55]", r"line 11, \[signal\]: times .* unsorted"),
    ("modes = [0, 1, 0]", "modes = [0, 2, 0]", r"\[signal\]: signal enters mode 2 at 0.7 s"),
    ("modes = [0, 1, 0]", "modes = [0, 1, 0]\ndwell_time = 0.8", r"line 13, \[signal\]: dwell_time is declared"),
    ("x0 = [1.0, 0.0]", "x0 = [1.0]", r"line 15, \[run\]: x0 must have shape \(n,\) = \(2,\), got \(1,\)"),
    ("step = 0.1", "step = 0.0", r"line 17, \[run\]: step must be positive"),
    ("step = 0.1", 'step = "fast"', r"line 17: run\.step: input should be"),
    ("horizon = 4.0", "horizon = inf", r"line 16, \[run\]: horizon must be finite"),
    ("step = 0.1", "step = 0.1\nu0 = [0.0, 0.0]", r"line 18, \[run\]: u0 must have shape"),
    ("step = 0.1", 'step = 0.1\n[[law]]\nkind = "averaged"\nwieghts = [1.0]',
     r"line 20: \[\[law\]\] 1, wieghts is not known: did you mean weights\?"),
    ("step = 0.1", 'step = 0.1\n[[law]]\nkind = "averaged"\nweights = [0.5, 0.6]',
     r"line 20, \[\[law\]\] 1: weights must be probabilities"),
    ("step = 0.1", 'step = 0.1\n[[law]]\nkind = "exact"\n[[law]]\nkind = "exact"',
     r"line 20, \[\[law\]\] 2: name 'oracle' is used twice"),
    ("step = 0.1", 'step = 0.1\n[[law]]\nkind = "single"\nmode = 2',
     r"line 20, \[\[law\]\] 1: mode must be in 0\.\.1, got 2"),
]  # fmt: skip


@pytest.mark.parametrize(("old", "new", "message"), BAD, ids=range(len(BAD)))
def test_bad_file_is_refused_by_line_and_key(tmp_path, old, new, message):
    assert old in PLAIN
    with pytest.raises(dt.ProblemFileError, match=message) as caught:
        load(tmp_path, PLAIN.replace(old, new, 1))
    assert "\n" not in str(caught.value)


def test_all_faults_of_a_file_are_told_at_once_in_its_order(tmp_path):
    text = PLAIN.replace("delay = 0.35", 'delay = "long"').replace("x0 = [1.0, 0.0]", "x0 = 1.0")
    text = (
        text.replace("step = 0.1", "setp = 0.1")
        .replace("[1, 0]", "[1, 0]")
        .replace("A = [", "A = [1.0, ")
    )
    with pytest.raises(dt.ProblemFileError) as caught:
        load(tmp_path, text)
    found = re.findall(r"[Ll]ine (\d+): ([a-z0-9]+\.\w+)", str(caught.value))
    assert found == [("2", "plant.delay"), ("3", "plant.A"), ("15", "run.x0"), ("17", "run.setp")]
    assert "more" not in str(caught.value)


def test_more_faults_than_anybody_reads_are_counted(tmp_path):
    with pytest.raises(dt.ProblemFileError, match=r"\(and 10 more\)$") as caught:
        load(tmp_path, "".join(f"a{i} = 1\n" for i in range(60)) + PLAIN)
    assert len(str(caught.value)) < 10_000


def test_missing_and_binary_files_are_refused(tmp_path):
    with pytest.raises(dt.ProblemFileError, match="cannot be read: No such file"):
        load_problem(tmp_path / "none.toml")
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(dt.ProblemFileError, match="not UTF-8 text"):
        load_problem(tmp_path / "binary.toml")


def test_lines_see_through_multiline_arrays_strings_and_comments():
    text = (
        '# [no]\na = [ # ]\n  "]", 1,\n]\n["q.r"]\nb = "[x"\n[[s.t]]\nc = {d = 1}\n[[s.t]]\nc = 2\n'
    )
    lines = key_lines(text)
    assert lines[("a",)] == 2
    assert lines[("s", "t", 0, "c")] == 8
    assert lines[("s", "t", 1, "c")] == 10
    assert ("no",) not in lines


def test_committed_schema_is_current():
    path = Path(__file__).parents[2] / "docs" / "problem.schema.json"
    assert json.loads(path.read_text(encoding="utf-8")) == json_schema(), "run: make schema"
