"""The verdict says what was measured, and no more, on plants far from the paper's."""

import dataclasses

import numpy as np
import pytest

import deadtime as dt
from deadtime.imperfections import Disturbance, Dropout
from deadtime.problems.comparison import compare
from deadtime.reports.report import steps_of, write_report
from deadtime.reports.verdict import DECAY, headings_of, table, verdict

PAPER = dt.problems.paper()


class Swaying(Disturbance):
    """A small force of a user's own, as a sine of time: no noise."""

    def draws(self, sizes, lengths, steps, rng):
        force = 1e-3 * np.sin(0.1 * np.arange(steps))
        return force[:, None, None] * np.ones((1, len(lengths), 1))

    def spread(self, sizes, pieces):
        return np.full((sizes.states, 1), sum(tau for _, tau in pieces))


def sentences(**changes):
    return verdict(compare(dataclasses.replace(PAPER, **changes)))


def test_paper_verdict_has_five_sentences_in_order():
    first, second, third, fourth, fifth = sentences()
    assert first.startswith("The averaged law works on a signal with 41 switches in 15 s")
    assert second == (
        "Yet the same loop is unstable if it stops switching: held in mode 0 it grows at "
        "+0.128 /s, held in mode 1 at +0.282 /s."
    )
    assert third.startswith("Ignoring the delay fails")
    assert fourth.startswith("Predicting as if the plant stayed in one mode costs")
    assert fifth.startswith("Compared with an oracle that knows the future")


def test_laws_that_hear_nothing_cost_the_same():
    *_, last = sentences(imperfections=(Dropout(1.0),))
    assert last.endswith("the mean law 1.00 times: on this signal they cost the same.")
    *_, last = sentences(x0=np.zeros(2))
    assert last.endswith("the mean law 1.00 times: on this signal they cost the same.")


def test_growth_without_switching_does_not_depend_on_a_short_horizon():
    """Shorter than the delay: that leads, and a loop that fails is unstable "too"."""
    late = dt.SwitchingSignal([0.0, 0.4], [0, 1])
    slip, headline, still, *_ = sentences(horizon=0.3, signal=late)
    assert slip.startswith("The delay, 1 s, is not shorter than the horizon, 0.3 s")
    assert headline.startswith("The averaged law fails in 0.3 s without a switch")
    assert still.startswith("The same loop is unstable without switching, too: held in mode 0 it ")
    assert still.split(": ")[1] == sentences()[1].split(": ")[1]


def test_renamed_laws_keep_their_sentences():
    names = {name: f"law {i}" for i, name in enumerate(PAPER.laws)}
    laws = {names[name]: law for name, law in PAPER.laws.items()}
    renamed = sentences(laws=laws)
    assert len(renamed) == 5
    assert "the law “law 3”" in renamed[4]


def test_a_loop_that_starts_at_rest_gets_a_verdict():
    problem = {"x0": np.zeros(2), "u0": 1.0}
    assert "a peak of" in sentences(**problem)[0] or "has not settled" in sentences(**problem)[0]
    at_rest = sentences(x0=np.zeros(2))
    assert len(at_rest) == 5
    assert not any("nan" in sentence for sentence in at_rest)


def test_a_single_mode_is_not_said_to_switch():
    plant = dt.SwitchedSystem([[[0.5]]], [[[1.0]]], delay=0.4)
    gains = dt.place(plant, [-1.0])
    laws = dt.problems.comparison_laws(plant, gains, None)
    problem = dataclasses.replace(
        PAPER, plant=plant, gains=gains, laws=laws, signal=dt.SwitchingSignal.constant(0),
        x0=np.ones(1), states=(), modes=(), published=(),
    )  # fmt: skip
    said = verdict(compare(problem))
    assert "without a switch" in said[0]
    assert not any("stops switching" in sentence for sentence in said)


@pytest.mark.parametrize(
    ("second", "said"),
    [
        (-2.0, "held in mode 0 and in mode 1 it neither grows nor decays."),
        (0.5, "unstable without switching, too: held in mode 1 it grows at +0.500 /s (in the other "
         "modes it does not grow)."),
    ],
)  # fmt: skip
def test_a_loop_that_neither_grows_nor_decays_is_said_to_do_neither(second, said):
    """x[0] is the integral of x[1], and no input depends on it."""
    A = [[[0.0, 1.0], [0.0, -1.0]], [[0.0, 1.0], [0.0, second]]]
    plant = dt.SwitchedSystem(A, [[[0.0], [1.0]]] * 2, delay=0.3)
    law = dt.DelayedStateFeedback(plant, np.zeros((2, 1, 2)), allow_unstable=True)
    mostly_second = dt.SwitchingSignal([0.0, 0.3, 0.6], [1, 0, 1])
    loop = {"plant": plant, "laws": {"none": law}, "signal": mostly_second, "model": None}
    text = " ".join(sentences(**loop, step=0.1, horizon=5.0))
    assert said in text
    assert "in the long run" not in text
    assert "at +0 /s" not in text
    assert "e-" not in text
    for margin in (dt.delay_margin(plant, law, 0.1), dt.gain_margin(plant, law, 0.1)):
        assert ("the loop neither grows nor decays" in margin.message) == (second < 0.0)


def test_decay_rate_of_a_growing_loop_is_negative_however_few_its_samples():
    law = PAPER.laws["delay ignored"]
    run = dt.simulate(PAPER.plant, law, PAPER.signal, [-1, 1], horizon=10.0, step=6.0)
    assert run.time.size == 3
    assert run.metrics()["decay_rate"] < 0.0


@pytest.mark.long
def test_laws_whose_names_differ_in_punctuation_keep_their_own_data(tmp_path):
    laws = {"a b": PAPER.laws["averaged"], "a-b": PAPER.laws["mean"], "_c $": PAPER.laws["oracle"]}
    problem = dataclasses.replace(
        PAPER,
        constants={},
        laws=laws,
        horizon=3.0,
        states=("$x", "_y"),
        modes=("$\\foo$", "b"),
        u0=0.5,
    )
    said = []
    report = write_report(problem, tmp_path, said.append, certificates=False)
    assert len(said) == steps_of(problem, certificates=False)
    assert len(list((tmp_path / "data").iterdir())) == 3
    page = report.path.read_text(encoding="utf-8")
    assert "u = [0.5] before time 0" in page


@pytest.mark.parametrize(
    ("law", "message"),
    [
        (lambda plant: dt.AveragedPredictor(plant, [[[-900.0]]]).digital(0.01), "overflow"),
        (lambda plant: dt.simulate(plant, dt.AveragedPredictor(plant, [[[-900.0]]]),
                                   dt.SwitchingSignal.constant(0), [1.0], 1.0, step=None), "overflow"),
    ],
)  # fmt: skip
def test_a_law_whose_gains_overflow_is_refused_by_name(law, message):
    plant = dt.SwitchedSystem([[[800.0]]], [[[1.0]]], delay=1.0)
    with pytest.raises(dt.ArgumentError, match=f"gains over its delay {message}"):
        law(plant)


@pytest.mark.parametrize("cheap", ["a", "delay ignored", "only 1"])
def test_the_cheapest_law_is_that_of_the_table(cheap):
    """Whichever law it is, and whatever others the sentence names."""
    result = compare(PAPER)
    laws = {f"law {name}": law for name, law in result.problem.laws.items()}
    others = [name for name in laws if not isinstance(laws[name], dt.ExactPredictor)]
    least = others[["a", "delay ignored", "only 1"].index(cheap)]
    metrics = {
        f"law {name}": {**row, "cost": 1.0 if f"law {name}" == least else 2.0}
        for name, row in result.metrics.items()
    }
    runs = {f"law {name}": result.runs["oracle"] for name in result.runs}
    outcomes = {f"law {name}": result.outcomes["oracle"] for name in result.runs}
    problem = dataclasses.replace(result.problem, laws=laws)
    made = dataclasses.replace(result, problem=problem, runs=runs)
    vars(made).update(metrics=metrics, outcomes=outcomes)
    (told,) = (text for text in verdict(made) if text.startswith("Compared with an oracle"))
    assert f"the law “{least}” is the cheapest of those that do not know the future." in told


@pytest.mark.parametrize(("poles", "slow"), [((-0.1, -0.2), True), ((-4.0, -5.0), False)])
def test_an_observer_that_is_slower_than_its_loop_is_said_to_be(poles, slow):
    plant = PAPER.plant.like(PAPER.plant.A[:1], PAPER.plant.B[:1], PAPER.plant.delays[:1])
    law = dt.AveragedPredictor(plant, dt.place(plant, [-1.0, -1.5]))
    observer = dt.luenberger(plant, [[1.0, 0.0]], poles, 0.05)
    fed = dt.OutputFeedback(law, observer)
    still = {"signal": dt.SwitchingSignal.constant(0), "modes": ("only",), "model": None}
    text = " ".join(sentences(plant=plant, gains=law.gains, laws={"fed": fed}, step=0.05, **still))
    assert ("The observer is slower than the loop that it serves: held in only its error decays at "
            "0.100 /s, the loop on the true state at 0.842 /s" in text) == slow  # fmt: skip
    assert ("observer is slower" in text) == slow


@pytest.mark.parametrize(
    ("imperfection", "in_noise"),
    [
        (dt.imperfections.Noise(1e-2), True),
        (dt.imperfections.Noise(1e-12), False),
        (dt.imperfections.WhiteDisturbance(1e-4), True),
        (dt.imperfections.ColouredDisturbance([1e-2], [0.1], [[0.0], [1.0]]), True),
        (dt.imperfections.StepDisturbance([0.0, 1e-3], 0.0, 1.0), False),
        (Swaying(), False),
    ],
)
def test_only_a_run_that_noise_keeps_from_falling_is_in_noise(imperfection, in_noise):
    A = [[[0.0, 1.0], [-1.0, -1.0]]]
    plant = dt.SwitchedSystem(A, [[[0.0], [1.0]]], 0.1)
    law = dt.SingleModePredictor(plant, dt.place(plant, [-2.0, -2.5]), 0)
    signal = dt.SwitchingSignal.constant(0)
    problem = dataclasses.replace(
        PAPER, plant=plant, gains=law.gains, laws={"exact": law}, signal=signal, x0=np.ones(2),
        horizon=20.0, step=0.05, imperfections=(imperfection,), modes=("one",), constants={},
        published=(),
    )  # fmt: skip
    result = compare(problem)
    assert np.isfinite(result.outcomes["exact"].settling)
    row = dict(zip(headings_of(result), table(result)[0], strict=True))
    assert (row[DECAY] == "in noise") == in_noise
