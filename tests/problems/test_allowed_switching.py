"""Problem files that say which switches and sojourns there are: drawn, and asked about."""

import dataclasses
import itertools
import json
import math
from pathlib import Path

import numpy as np
import pytest

import deadtime as dt
from deadtime.cli.application import main
from deadtime.cli.options import with_step
from deadtime.problems.file import load_problem
from deadtime.problems.file.switching import drawn_as
from deadtime.problems.switching_assumptions import random_model, signals_of
from deadtime.scenarios.source import draw_signals

PLANT = """\
[plant]
delay = 0.2
A = [[[-1.0]], [[-2.0]], [[-3.0]]]
B = [[[1.0]], [[1.0]], [[1.0]]]
[gains]
poles = [-4.0]
[[law]]
kind = "averaged"
[run]
x0 = [1.0]
horizon = 60.0
step = 0.1
"""
LEAST, MOST, WAYS = [0.3, 0.6, 0.4], [0.5, math.inf, 0.9], [[0, 1, 0], [1, 0, 1], [0, 1, 0]]
LIMITED = f"""\
[signal]
kind = "random"
dwell_time = {LEAST}
maximum_dwell = {MOST}
transitions = {WAYS}
"""
MODEL = """\
[switching]
kind = "semi-markov"
sojourn = { distribution = "expon", scale = 0.5 }
transition = [[0, 1, 0], [0.5, 0, 0.5], [0, 1, 0]]
dwell_time = [0.3, 0.6, 0.4]
maximum_dwell = [0.5, inf, 0.9]
[signal]
kind = "model"
"""


@pytest.fixture
def load(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def of(text):
        (tmp_path / "p.toml").write_text(PLANT + text, encoding="utf-8")
        return load_problem(tmp_path / "p.toml")

    return of


def kept(signal):
    """By the definition: every whole sojourn, and every switch."""
    lengths, modes = np.diff(signal.times), signal.modes.tolist()
    assert signal.switches > 20
    assert all(WAYS[i][j] for i, j in itertools.pairwise(modes))
    return all(
        LEAST[i] <= length * (1 + 1e-9) and length <= MOST[i] * (1 + 1e-9)
        for i, length in zip(modes, lengths.tolist(), strict=False)
    )


@pytest.mark.parametrize("text", [LIMITED, MODEL])
def test_signals_of_the_file_are_those_it_allows_and_it_is_asked_about_them(load, text):
    problem = load(text)
    assert kept(problem.signal)
    assert problem.dwell_time == 0.3
    asked = signals_of(problem, problem.signal)
    assert asked.signals == dt.SignalClass(LEAST, MOST, WAYS)
    limits = asked.signals.limits(3)
    problem.signal.require_within(limits)
    assert kept(random_model(limits).sample(60.0, seed=2))
    longer = signals_of(problem, problem.signal, [0.5], [2.0])
    assert longer.signals == dt.SignalClass(0.5, 2.0, WAYS)


def test_what_certificates_take_is_the_signal_s_else_the_model_s(load):
    rates = '[switching]\nkind = "markov"\nrates = [[0, 1.0, 0], [0.5, 0, 0.5], [0, 1.0, 0]]\n'
    drawn = load(rates + '[signal]\nkind = "model"\n')
    assert drawn.dwell_time is None
    assert drawn.limits.transitions.astype(int).tolist() == WAYS
    own = load(rates + '[signal]\nkind = "random"\ndwell_time = 0.3\n')
    assert signals_of(own, own.signal).signals == dt.SignalClass(0.3)


def test_a_class_without_a_dwell_time_is_known_of_a_problem_and_asked_of_nothing(load):
    rates = '[switching]\nkind = "markov"\nrates = [[0, 1.0, 0], [0.5, 0, 0.5], [0, 1.0, 0]]\n'
    problem = load(rates + '[signal]\nkind = "model"\n')
    assert problem.signals == dt.SignalClass(transitions=WAYS)
    law = next(iter(problem.laws.values()))
    for ask in (dt.certify, dt.falsify):
        with pytest.raises(dt.ArgumentError, match=r"dwell_time must be a number .* got none"):
            ask(problem.plant, law, problem.signals, 0.1)


def test_an_average_dwell_time_with_a_chatter_of_one_is_a_dwell_time(load):
    text = '[signal]\nkind = "random"\naverage_dwell_time = 0.3\nchatter = {}\n'
    assert load(text.format(1)).dwell_time == 0.3
    averaged = load(text.format(2))
    assert (averaged.dwell_time, averaged.signals) == (None, dt.SignalClass(0.3, chatter=2))


def test_a_dead_end_draws_no_random_signals(load):
    ends = load(LIMITED.replace("[0, 1, 0]]", "[0, 0, 0]]").replace("0.9]", "inf]"))
    with pytest.raises(dt.ArgumentError, match=r"transitions\[2\] allows no switch"):
        random_model(ends.limits)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "[0, 1, 0]]",
            "[0, 0, 0]]",
            r"line 17, \[signal\]: transitions\[2\] allows no switch, but",
        ),
        ("[0, 1, 0]]", "[0, 0.5, 0]]", r"\[signal\]: transitions\[2, 1\] must be True or False"),
        ("0.4]", "0.4, 0.4]", r"\[signal\]: dwell_time must be .* each of the 3 modes"),
        ("0.9]", "0.1]", r"\[signal\]: maximum_dwell\[2\] must be at least dwell_time\[2\]"),
    ],
)
def test_limits_that_cannot_be_are_refused_by_section(load, old, new, message):
    with pytest.raises(dt.ProblemFileError, match=message):
        load(LIMITED.replace(old, new))


def test_certify_asks_about_what_the_file_and_the_options_say(load, capsys, monkeypatch):
    load(LIMITED)
    asked = []

    def certify(plant, law, signals, step, **options):
        asked.append(signals)
        return dt.Certificate(None, "made up")

    monkeypatch.setattr("deadtime.certificates.certify", certify)
    for options in ((), ("--dwell-time", "0.4,0.6,0.5", "--maximum-dwell", "2"), ("--json",)):
        with pytest.raises(SystemExit):
            main(["certify", "p.toml", *options])
        out = capsys.readouterr().out
        if options == ():
            text = " ".join(out.split())
            assert "from mode 1 to mode 0 or mode 2, from mode 2 to mode 1;" in text
            assert "0.3 to 0.5 s in mode 0, at least 0.6 s in mode 1, 0.4 to 0.9 s" in text
    assert json.loads(out)["transitions"] == WAYS
    assert json.loads(out)["maximum_dwell"] == [0.5, None, 0.9]
    given = dt.SignalClass(LEAST, MOST, WAYS), dt.SignalClass([0.4, 0.6, 0.5], 2.0, WAYS)
    assert asked[:2] == list(given)


def test_a_problem_without_limits_is_asked_about_as_before():
    paper = dataclasses.replace(dt.problems.paper(), signals=dt.SignalClass())
    assert signals_of(paper, paper.signal).signals == dt.SignalClass(0.2)


# -- modes that change at samples only -------------------------------------------------------------


SAMPLED = LIMITED.replace("[signal]", '[signal]\nat = "samples"')


def test_signals_of_a_file_at_samples_last_whole_periods_and_it_is_asked_about_such(load):
    problem = load(SAMPLED)
    step, signal = problem.step, problem.signal
    periods = signal.times / step
    assert np.abs(periods - periods.round()).max() < 1e-9
    assert kept(signal)
    asked = signals_of(problem, signal).signals
    assert asked == dt.SignalClass(LEAST, MOST, WAYS, "samples")
    assert signals_of(problem, signal, at="anywhere").signals.at == "anywhere"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            'at = "samples"',
            'at = "now"',
            "line 14: signal.at: input should be 'anywhere' or 'samples'",
        ),
        (
            "[0.3, 0.6, 0.4]\nmaximum_dwell = [0.5,",
            "[0.31, 0.6, 0.4]\nmaximum_dwell = [0.39,",
            r"\[signal\]: maximum_dwell must leave a sojourn of whole periods of 0.1 s",
        ),
    ],
)
def test_files_at_samples_that_cannot_be_are_refused(load, old, new, message):
    with pytest.raises(dt.ProblemFileError, match=message):
        load(SAMPLED.replace(old, new))


def test_given_signals_at_samples_are_checked(load):
    text = (
        '[signal]\nkind = "switches"\nat = "samples"\ntimes = [0.0, 0.7, 1.25]\nmodes = [0, 1, 0]'
    )
    with pytest.raises(dt.ProblemFileError, match=r"got one at 1\.25 s with a period of 0\.1 s"):
        load(text)
    assert load(text.replace("1.25", "1.3")).signals.at == "samples"


def test_a_log_at_samples_is_checked_and_asked_about_such(load, tmp_path):
    text = '[signal]\nkind = "log"\nfile = "log.csv"\nat = "samples"'
    log = tmp_path / "log.csv"
    log.write_text("t,mode\n0,0\n0.7,1\n1.25,0\n", encoding="utf-8")
    with pytest.raises(dt.ProblemFileError, match=r"got one at 1\.25 s with a period of 0\.1 s"):
        load(text)
    log.write_text("t,mode\n0,0\n0.7,1\n1.3,0\n", encoding="utf-8")
    problem = load(text)
    assert problem.given_signal.times.tolist() == [0.0, 0.7, 1.3]
    assert signals_of(problem, problem.signal).signals.at == "samples"


def _whole(signals, step):
    for signal in signals:
        periods = signal.times / step
        assert np.abs(periods - periods.round()).max() < 1e-9
        yield signal


def test_monte_carlo_and_studies_draw_signals_at_samples_within_the_limits(load, capsys):
    problem = load(SAMPLED)
    with pytest.raises(SystemExit) as end:
        main(["monte-carlo", "p.toml", "--scenarios", "2", "--law", "averaged"])
    assert end.value.code == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "switches at samples only, but only so" in out
    assert "sojourns are rounded up to whole periods" in out
    model = random_model(problem.limits, problem.mean_sojourn)
    drawn = drawn_as(model, problem.signals, problem.step)
    tight = dt.SignalClass(0.23, maximum_dwell=0.34, at="samples")
    with pytest.raises(dt.ArgumentError, match="maximum_dwell must leave a sojourn of whole per"):
        drawn_as(model, tight, 0.2)
    assert all(map(kept, _whole(draw_signals(drawn, 60.0, seed=2, count=20), problem.step)))
    Path("study.toml").write_text(
        'problem = "p.toml"\nlaws = ["averaged"]\n[grid]\ndwell_time = [0.15, 0.25]\n',
        encoding="utf-8",
    )
    study = dt.load_study("study.toml")
    for cell in study.cells():
        signals = draw_signals(study.loop(cell).model, 9.0, count=5)
        least = cell.values["dwell_time"]
        assert all(one.dwell_time > least - 1e-9 for one in _whole(signals, problem.step))


CHAIN = """\
[switching]
kind = "markov-chain"
P = [[0.8, 0.2, 0.0], [0.1, 0.8, 0.1], [0.0, 0.5, 0.5]]
step = 0.2
[signal]
kind = "model"
"""


def test_signals_drawn_from_a_chain_change_at_samples_where_its_step_is_whole_periods(load):
    for step, at in ((0.1, "samples"), (0.4, "samples"), (0.05, "anywhere"), (0.15, "anywhere")):
        problem = load(CHAIN.replace("step = 0.2", f"step = {step}"))
        asked = signals_of(problem, problem.signal).signals
        assert asked == dt.SignalClass(step, transitions=WAYS, at=at)


def test_another_period_keeps_at_samples_only_where_it_is_a_part_of_the_file_s(load):
    for text in (SAMPLED, CHAIN):
        problem = load(text)
        for step, kept_at in ((None, True), (0.05, True), (0.2, False), (0.07, False)):
            assert (with_step(problem, step).signals.at == "samples") is kept_at


def test_monte_carlo_draws_from_a_chain_at_samples(load, capsys):
    load(CHAIN)
    with pytest.raises(SystemExit) as end:
        main(["monte-carlo", "p.toml", "--scenarios", "2", "--out", "p.png"])
    assert end.value.code == 0
    assert "drawn from [switching]: mean sojourns 1" in capsys.readouterr().out
