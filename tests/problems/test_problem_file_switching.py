"""Problem files that say how the mode switches: models, rules, the laws that use them, `fit`."""

import json
import re

import numpy as np
import pytest
from scipy import stats

import deadtime as dt
from deadtime.cli.application import main
from deadtime.problems.comparison import compare
from deadtime.problems.file import load_problem
from deadtime.reports.verdict import verdict

PLANT = """\
[plant]
delay = 0.35
A = [[[0.5, 1.0], [0.0, -0.2]], [[0.4, 1.0], [0.1, -0.3]]]
B = [[[0.0], [1.0]], [[0.0], [1.1]]]
[gains]
poles = [-1.0, -2.0]
[run]
x0 = [1.0, 0.0]
horizon = 4.0
step = 0.1
"""
SEMI_MARKOV = """\
[switching]
kind = "semi-markov"
sojourn = [{ distribution = "gamma", a = 3.0, scale = 0.2 }, 0.5]
"""
FROM_MODEL = '[signal]\nkind = "model"\nseed = 3\n'
HALF_SPACE = '[signal]\nkind = "half-space"\nnormal = [1.0, 0.2]\noffset = 0.3\n'
CONSTANT = '[signal]\nkind = "constant"\nmode = 0\n'


def load(tmp_path, *parts):
    path = tmp_path / "mine.toml"
    path.write_text("".join((PLANT, *parts)), encoding="utf-8")
    return load_problem(path)


def law(kind, *lines):
    return "\n".join((f'[[law]]\nkind = "{kind}"', *lines)) + "\n"


# -- what the sections mean --------------------------------------------------------------------


def test_a_signal_is_drawn_from_the_model_and_the_expected_law_joins_the_others(tmp_path):
    problem = load(tmp_path, SEMI_MARKOV, FROM_MODEL)
    model = dt.SemiMarkov([stats.gamma(3.0, scale=0.2), 0.5])
    drawn = model.sample(4.0 + 0.35 + 0.1, seed=3)
    assert np.array_equal(problem.signal.times, drawn.times)
    assert np.array_equal(problem.signal.modes, drawn.modes)
    assert list(problem.laws)[-1] == "expected"
    same = dt.ExpectedPredictor(problem.plant, problem.gains, model).digital(0.1)
    assert np.array_equal(problem.laws["expected"].digital(0.1).input_gain, same.input_gain)


def test_a_markov_model_runs_the_ideal_loop_too(tmp_path):
    text = '[switching]\nkind = "markov"\nrates = [[0, 1.0], [2.0, 0]]\n'
    problem = load(tmp_path, text, FROM_MODEL, law("expected", "model = { delay = 0.3 }"))
    (expected,) = problem.laws.values()
    assert np.array_equal(expected.model.rates, [[0, 1.0], [2.0, 0]])
    assert expected.plant.delay == 0.3
    ideal = PLANT.replace("step = 0.1", 'step = "ideal"')
    (tmp_path / "ideal.toml").write_text(ideal + text + FROM_MODEL)
    run = load_problem(tmp_path / "ideal.toml").simulate("expected")
    assert not run.record.held


def test_a_chain_at_samples_runs_laws_and_filters_which_take_its_switches_to_be_there(tmp_path):
    text = '[switching]\nkind = "markov-chain"\nP = [[0.9, 0.1], [0.2, 0.8]]\nstep = 0.1\n'
    problem = load(tmp_path, text, FROM_MODEL, "[mode_filter]\ndisturbance = 1e-4\n")
    model = dt.MarkovChain([[0.9, 0.1], [0.2, 0.8]], 0.1)
    assert np.array_equal(problem.signal.times, model.sample(4.0 + 0.35 + 0.1, seed=3).times)
    assert problem.dwell_time == 0.1
    assert problem.laws["belief"].filter.switches == "samples"
    same = dt.ExpectedPredictor(problem.plant, problem.gains, model).digital(0.1)
    assert np.array_equal(problem.laws["expected"].digital(0.1).input_gain, same.input_gain)
    anywhere = '[mode_filter]\ndisturbance = 1e-4\nswitches = "anywhere"\n'
    assert load(tmp_path, text, FROM_MODEL, anywhere).laws["belief"].filter.switches == "anywhere"
    other = load(tmp_path, text.replace("step = 0.1", "step = 0.04"), FROM_MODEL, law("expected"))
    with pytest.raises(dt.ArgumentError, match=r"step = 0\.1 s must be that of the MarkovChain"):
        other.simulate("expected")


@pytest.mark.few(2)
@pytest.mark.parametrize(
    ("lines", "same"),
    [
        ("averaged\ndwell_time = 0.3", lambda p, K: dt.AveragedPredictor(p, K, None, 0.3)),
        ("mean\ndwell_time = 0.3", lambda p, K: dt.MeanPredictor(
            p, dt.place(p.mean(), [-1, -2])[0], K, 0.3)),
        ('averaged\nweights = "minimax"', lambda p, K: dt.AveragedPredictor.minimax(p, K, 0.1)),
        pytest.param('averaged\nweights = "minimax"\ncommon_gain = true', lambda p, K:
            dt.AveragedPredictor.minimax(p, K, 0.1, common_gain=True), marks=pytest.mark.long),
        ("expected\nages = 3", lambda p, K: dt.ExpectedPredictor(
            p, K, dt.SemiMarkov([stats.gamma(3.0, scale=0.2), 0.5]), ages=3)),
        ("optimal", lambda p, K: dt.OptimalPredictor(
            p, dt.SemiMarkov([stats.gamma(3.0, scale=0.2), 0.5]), np.eye(2), [[1.0]])),
        ("optimal\nR = [[0.1]]", lambda p, K: dt.OptimalPredictor(
            p, dt.SemiMarkov([stats.gamma(3.0, scale=0.2), 0.5]), np.eye(2), [[0.1]])),
    ],
)  # fmt: skip
def test_every_law_that_knows_the_switching_is_reached_from_a_file(tmp_path, lines, same):
    kind, *rest = lines.split("\n")
    problem = load(tmp_path, SEMI_MARKOV, CONSTANT, law(kind, *rest))
    (ours,) = problem.laws.values()
    reference = same(problem.plant, problem.gains)
    assert np.array_equal(ours.digital(0.1).input_gain, reference.digital(0.1).input_gain)
    assert ours.label == reference.label


def test_a_rule_switches_by_the_state_and_its_law_comes_first(tmp_path):
    problem = load(tmp_path, HALF_SPACE)
    assert next(iter(problem.laws)) == "state-dependent"
    assert "oracle" not in problem.laws
    run = problem.simulate("state-dependent")
    assert run.signal.switches == 1
    assert np.abs(run.mismatch).max() <= 1e-10


def test_the_verdict_compares_no_runs_that_chattering_ended(tmp_path):
    text = """\
[plant]
delay = 0.3
A = [[[1.0]], [[1.2]]]
B = [[[1.0]], [[1.0]]]
[gains]
poles = [-2.0]
[signal]
kind = "polyhedra"
regions = [
  { H = [[1.0]], h = [1.0], mode = 0 },
  STRIPES
  { H = [[-1.0]], h = [-1.08], mode = 1 },
]
[run]
x0 = [0.9]
horizon = 2.0
step = 0.3
u0 = 1.0
"""
    stripes = (
        f"{{ H = [[-1.0], [1.0]], h = [{-1 - k / 1000}, {1 + (k + 1) / 1000}], mode = {k % 2} }},"
        for k in range(80)
    )
    (tmp_path / "chatter.toml").write_text(text.replace("STRIPES", "\n  ".join(stripes)))
    sentences = verdict(compare(load_problem(tmp_path / "chatter.toml")))
    assert len(sentences) == 2
    assert "ends early: chattering" in sentences[0]
    assert sentences[1].startswith("Runs that chatter end early: state-dependent, averaged,")


QUADRATIC = """\
[signal]
kind = "quadratic"
S = [[[1.0, 0.3], [0.3, -1.0]], [[-1.0, 0.0], [0.0, 1.0]]]
"""


@pytest.mark.parametrize("step", ["0.1", '"ideal"'])
def test_quadratic_forms_switch_by_the_state_digital_and_ideal(tmp_path, step):
    text = PLANT.replace("step = 0.1", f"step = {step}") + QUADRATIC
    (tmp_path / "forms.toml").write_text(text)
    problem = load_problem(tmp_path / "forms.toml")
    assert next(iter(problem.laws)) == "state-dependent"
    run = problem.simulate("state-dependent")
    rule = dt.QuadraticRegions([[[1.0, 0.3], [0.3, -1.0]], [[-1.0, 0.0], [0.0, 1.0]]])
    law = dt.StateDependentPredictor(problem.plant, problem.gains, rule)
    other = dt.simulate(
        problem.plant, law, rule, problem.x0, problem.horizon, problem.step, u0=problem.u0
    )
    assert run.signal.switches >= 1
    np.testing.assert_array_equal(run.states, other.states)


def test_polyhedra_may_say_the_same_as_a_half_space(tmp_path):
    text = """\
[signal]
kind = "polyhedra"
regions = [
  { H = [[-1.0, -0.2]], h = [-0.3], mode = 1 },
  { H = [[1.0, 0.2]], h = [0.3], mode = 0 },
]
"""
    one = load(tmp_path, HALF_SPACE).simulate("averaged")
    other = load(tmp_path, text).simulate("averaged")
    np.testing.assert_allclose(other.states, one.states, rtol=0, atol=1e-12)


# -- refused -----------------------------------------------------------------------------------

BAD = [
    ((SEMI_MARKOV.replace("gamma", "gama"), FROM_MODEL),
     r"line 13, \[switching\]: sojourn\[0\]: distribution must be the name .* got 'gama'"),
    ((SEMI_MARKOV.replace("a = 3.0", "shape = 3.0"), FROM_MODEL),
     r"\[switching\]: sojourn\[0\]: gamma takes the parameters a, loc, scale"),
    ((SEMI_MARKOV.replace("0.5]", "-0.5]"), FROM_MODEL), r"\[switching\]: sojourn\[1\]"),
    ((SEMI_MARKOV.replace(", 0.5]", ", 0.5, 0.7]"), FROM_MODEL),
     r"\[switching\]: kind = 'semi-markov' describes 3 modes, the plant has 2"),
    ((SEMI_MARKOV, "transition = [[0.0, 0.9], [1.0, 0.0]]\n", FROM_MODEL),
     r"line 14, \[switching\]: transition\[0\] must be probabilities"),
    ((FROM_MODEL,), r"\[signal\]: kind = \"model\" needs a \[switching\] section"),
    ((CONSTANT, law("expected")), r"\[\[law\]\] 1: kind = 'expected' needs a \[switching\] section"),
    ((CONSTANT, law("optimal")), r"\[\[law\]\] 1: kind = 'optimal' needs a \[switching\] section"),
    ((CONSTANT, law("state-dependent")), r"\[\[law\]\] 1: kind = \"state-dependent\" needs a \[signal\]"),
    ((HALF_SPACE, law("exact")), r"\[\[law\]\] 1: kind = \"exact\" needs a signal that is known"),
    ((HALF_SPACE.replace("[1.0, 0.2]", "[1.0]"),), r"\[signal\]: rule must be one of 2 states"),
    ((QUADRATIC.replace("0.3], [0.3", "0.3], [0.2"),), r"\[signal\]: S\[0\] must be symmetric, got"),
    ((QUADRATIC.replace(", [[-1.0, 0.0], [0.0, 1.0]]", ""),),
     r"\[signal\]: rule must have one form in 2 states for each of the plant's 2 modes, got 1"),
    ((CONSTANT, law("averaged", "dwell_time = 0.0")), r"\[\[law\]\] 1: dwell_time must be positive"),
    ((CONSTANT, law("averaged", "common_gain = true")), r"line 1\d, \[\[law\]\] 1: common_gain = true"),
    (('[switching]\nkind = "fitted"\nlogs = ["none.csv"]\n', FROM_MODEL), r"none\.csv cannot be read"),
]  # fmt: skip


@pytest.mark.parametrize(("parts", "message"), BAD, ids=range(len(BAD)))
def test_a_bad_section_is_refused_by_line_and_key(tmp_path, parts, message):
    with pytest.raises(dt.ProblemFileError, match=message) as caught:
        load(tmp_path, *parts)
    assert "\n" not in str(caught.value)


# -- fit ---------------------------------------------------------------------------------------


@pytest.fixture
def log(tmp_path, monkeypatch):
    """A log of about 200 sojourns in which the modes have names."""
    monkeypatch.chdir(tmp_path)
    model = dt.SemiMarkov([stats.gamma(3.0, scale=0.2), stats.expon(0.2, 0.3)])
    signal = model.sample(110.0, seed=1)
    names = np.array(["throttle", "brake"])[signal.modes]
    rows = [f"{t!r},{name}" for t, name in zip(signal.times.tolist(), names, strict=True)]
    (tmp_path / "log.csv").write_text("\n".join(("time,mode", *rows)) + "\n")
    return tmp_path / "log.csv"


def fit(capsys, *arguments):
    with pytest.raises(SystemExit) as stopped:
        main(["fit", *arguments])
    captured = capsys.readouterr()
    return stopped.value.code, captured.out, captured.err


LABELS = ("--labels.throttle", "0", "--labels.brake", "1")


def test_fit_prints_a_section_that_a_problem_file_takes(tmp_path, capsys, log):
    code, out, err = fit(capsys, "log.csv", *LABELS)
    assert (code, err) == (0, "")
    assert (tmp_path / "fit.png").read_bytes().startswith(b"\x89PNG")
    section = out[out.index("[switching]") : out.index("\nFigure:")]
    pasted = load(tmp_path, section, FROM_MODEL).laws["expected"].model
    text = (
        '[switching]\nkind = "fitted"\nlogs = ["log.csv"]\nlabels = { throttle = 0, brake = 1 }\n'
    )
    fitted = load(tmp_path, text, FROM_MODEL).laws["expected"].model
    np.testing.assert_allclose(pasted.hazard(0.1, 20), fitted.hazard(0.1, 20), rtol=1e-12)
    assert re.search(r"throttle +\d+ ", out)


def test_fit_and_a_problem_file_take_the_unit_of_a_clock(tmp_path, capsys, log):
    rows = [row.split(",") for row in log.read_text().splitlines()[1:]]
    changed = [f"{1_763_800_000_000 + 1000 * float(t)!r},{name}" for t, name in rows]
    (tmp_path / "ms.csv").write_text("\n".join(("time,mode", *changed)) + "\n")
    _, seconds, _ = fit(capsys, "log.csv", *LABELS, "--json")
    code, out, _ = fit(capsys, "ms.csv", *LABELS, "--unit", "ms", "--json")
    means = [[mode["mean"] for mode in json.loads(one)["modes"].values()] for one in (seconds, out)]
    np.testing.assert_allclose(means[1], means[0], rtol=1e-3)
    code, out, _ = fit(capsys, "ms.csv", *LABELS)
    assert (code, "times in ms" in out) == (0, True)
    section = '[signal]\nkind = "log"\nfile = "ms.csv"\nlabels = { throttle = 0, brake = 1 }\nunit = "ms"\n'
    assert load(tmp_path, section).signal.dwell_time < 2.0


def test_fit_with_a_step_prints_the_chain_that_a_problem_file_takes(tmp_path, capsys, log):
    code, section, err = fit(capsys, "log.csv", *LABELS, "--step", "0.1")
    assert (code, err) == (0, "")
    pasted = load(tmp_path, section, FROM_MODEL).laws["expected"].model
    signal = dt.SwitchingSignal.from_csv(log, labels={"throttle": 0, "brake": 1})
    assert np.array_equal(pasted.P, dt.MarkovChain.fit(signal, 0.1).P)
    _, out, _ = fit(capsys, "log.csv", *LABELS, "--step", "0.1", "--json")
    found = json.loads(out)
    assert found.items() >= {"P": pasted.P.tolist(), "step": 0.1, "written": []}.items()
    assert found["off_grid"] == found["switches"] == signal.times.size - 1


def test_fit_as_json_names_families_and_goodness(capsys, log):
    code, out, err = fit(capsys, "log.csv", *LABELS, "--family", "gamma", "--json")
    assert (code, err) == (0, "")
    record = json.loads(out)
    assert set(record["modes"]) == {"throttle", "brake"}
    assert record["modes"]["throttle"]["family"] == "gamma"
    assert record["modes"]["throttle"]["p_value"] > 0.05
    assert record["transition"] == [[0.0, 1.0], [1.0, 0.0]]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "logs must be given"),
        (("none.csv",), "none.csv cannot be read"),
        (("log.csv",), "mode must be an integer counted from 0, got 'brake'"),
        (("log.csv", *LABELS, "--family", "gama"), "family"),
        (("log.csv", *LABELS, "--family", "gamma", "--step", "0.1"), "step fits a chain"),
        (("short.csv",), "5"),
    ],
)
def test_fit_refuses_in_one_line(tmp_path, capsys, log, arguments, message):
    (tmp_path / "short.csv").write_text("time,mode\n0,0\n1,1\n2,0\n3,0\n")
    code, out, err = fit(capsys, *arguments)
    assert (code, out) == (2, "")
    assert message in err.partition("error: ")[2]
    assert err.count("\n") == 1
