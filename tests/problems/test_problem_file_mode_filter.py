"""The [mode_filter] of a problem file makes laws on a belief, and what it refuses."""

import numpy as np
import pytest

import deadtime as dt
from deadtime.app.documents import open_named
from deadtime.app.first_view import laws_on_offer
from deadtime.problems import load_problem
from deadtime.simulation.run_figure import plot_run

PLANT = """\
[plant]
delay = 0.3
A = [[[0.5, 1.0], [0.0, -0.2]], [[0.8, 1.4], [0.3, -0.3]]]
B = [[[0.0], [1.0]], [[0.0], [1.3]]]
[gains]
poles = [-1.0, -2.0]
[signal]
kind = "constant"
mode = 1
"""
RUN = "[run]\nx0 = [1.0, 0.0]\nhorizon = 2.0\nstep = 0.1\n"
MARKOV = '[switching]\nkind = "markov"\nrates = [[0.0, 0.5], [0.7, 0.0]]\n'
AGED = '[switching]\nkind = "semi-markov"\nsojourn = { distribution = "expon", loc = 0.3 }\n'
FILTER = "[mode_filter]\n"
BELIEF = '[[law]]\nkind = "belief"\n'
OBSERVER = '[observer]\nkind = "luenberger"\nC = [[1.0, 0.0]]\npoles = [-3.0, -4.0]\n'


def write(tmp_path, *parts):
    path = tmp_path / "mine.toml"
    path.write_text("".join((PLANT, *parts)), encoding="utf-8")
    return path


def test_a_law_on_a_belief_is_what_python_makes_of_the_same(tmp_path):
    options = "disturbance = [0.01, 0.02]\nnoise = 0.005\nforgetting = 1e-4\ninitial = [0.9, 0.1]\n"
    own = 'switches = "samples"\n'
    problem = load_problem(write(tmp_path, MARKOV, FILTER, options, own, BELIEF, RUN))
    plant, model = problem.plant, dt.Markov([[0.0, 0.5], [0.7, 0.0]])
    filt = dt.ModeFilter(
        plant, model, 0.1, disturbance=[0.01, 0.02], noise=0.005, forgetting=1e-4,
        initial=[0.9, 0.1], switches="samples",
    )  # fmt: skip
    law = dt.BeliefPredictor(dt.ExpectedPredictor(plant, problem.gains, model), filt)
    run, same = problem.simulate("belief"), problem.run(law)
    assert list(problem.laws) == ["belief"]
    assert run.belief is not None
    assert same.belief is not None
    assert np.array_equal(run.belief, same.belief)
    assert np.array_equal(run.states, same.states)


KALMAN = """\
[observer]
kind = "kalman"
C = [[1.0, 0.0]]
process = [[0.02, 0.0], [0.0, 0.03]]
measurement = [[0.0004]]
estimate = [1.0, 0.2]
"""
OPTIONS = {"covariance": [0.1, 0.2], "estimate": [1.0, 0.2]}


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("observer", "own", "options"),
    [
        (KALMAN, "", {"disturbance": [0.02, 0.03], "noise": 0.02}),
        (KALMAN, "noise = [0.1]\ndisturbance = 0.5\n", {"disturbance": 0.5, "noise": 0.1}),
        (OBSERVER + "estimate = [1.0, 0.2]\n", 'gains = "observer"\n', {}),
    ],
)
def test_beside_an_observer_the_law_is_on_its_outputs(tmp_path, observer, own, options):
    first = "covariance = [0.1, 0.2]\n"
    told = '[[law]]\nkind = "expected"\n'
    problem = load_problem(write(tmp_path, MARKOV, FILTER, first, own, observer, BELIEF, told, RUN))
    plant, model = problem.plant, dt.Markov([[0.0, 0.5], [0.7, 0.0]])
    C = [[1.0, 0.0]]
    if "observer" in own:
        C = dt.luenberger(plant, C, [-3.0, -4.0], 0.1)
    filt = dt.OutputModeFilter(plant, model, 0.1, C, **OPTIONS, **options)
    law = dt.BeliefPredictor(dt.ExpectedPredictor(plant, problem.gains, model), filt)
    assert list(problem.laws) == ["belief", "expected"]
    run, same = problem.simulate("belief"), problem.run(law)
    assert run.measured.shape == (1, run.time.size)
    assert np.array_equal(run.belief, same.belief)
    assert np.array_equal(run.estimates, same.estimates)
    laws, _ = laws_on_offer(open_named(str(tmp_path / "mine.toml")))
    assert "belief" in laws


def test_without_laws_it_runs_beside_the_others_and_of_other_laws_by_name(tmp_path):
    usual = load_problem(write(tmp_path, MARKOV, RUN)).laws
    with_filter = load_problem(write(tmp_path, MARKOV, FILTER, RUN)).laws
    assert set(with_filter) - set(usual) == {"belief"}
    of = load_problem(write(tmp_path, AGED, FILTER, BELIEF, 'of = "optimal"\n', RUN)).laws
    assert list(of) == ["optimal by belief"]


def test_the_filter_believes_in_the_laws_own_model(tmp_path):
    own = "model = { delay = 0.2 }\n"
    (law,) = load_problem(write(tmp_path, MARKOV, FILTER, BELIEF, own, RUN)).laws.values()
    assert isinstance(law, dt.BeliefPredictor)
    assert law.filter.plant.delay == law.plant.delay == 0.2


def test_the_figure_of_a_run_has_a_strip_with_the_belief(tmp_path):
    problem = load_problem(write(tmp_path, MARKOV, FILTER, RUN))
    with_belief = plot_run(problem.simulate("belief")).axes
    assert [axes.get_title(loc="left") for axes in with_belief] == ["x₁", "x₂", "u", "", ""]
    assert [axes.get_ylabel() for axes in with_belief[3:]] == ["belief", ""]
    assert len(plot_run(problem.simulate("expected")).axes) == 4
    (strip,) = with_belief[3].collections
    shown = strip.get_array()
    assert shown is not None
    assert shown.shape == (2, 20)
    assert np.allclose(shown.sum(axis=0), 1.0)


@pytest.mark.parametrize("parts", [(MARKOV, FILTER), (MARKOV,)])
def test_the_explorer_offers_it_where_there_is_a_filter(tmp_path, parts):
    laws, _ = laws_on_offer(open_named(str(write(tmp_path, *parts, RUN))))
    assert ("belief" in laws) == (FILTER in parts)


def test_it_has_no_certificate_and_is_told_what_could_be_proved(tmp_path):
    problem = load_problem(write(tmp_path, MARKOV, FILTER, RUN))
    found = dt.certify(problem.plant, problem.laws["belief"], 0.3, step=0.1)
    assert found.stable is None
    assert "no table to certify. Certify its .law instead" in found.message


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ((MARKOV, BELIEF, RUN), r"\[\[law\]\] 1: kind = .belief. needs a \[mode_filter\] section"),
        ((FILTER, RUN), r"\[mode_filter\]: a mode filter needs a \[switching\] section"),
        ((MARKOV, FILTER, OBSERVER, RUN), r"\[mode_filter\]: covariance must be given beside an"),
        (
            (MARKOV, FILTER, "covariance = 1.0\n", RUN),
            r"\[mode_filter\]: covariance is for outputs: give an \[observer\]",
        ),
        (
            (MARKOV, FILTER, 'gains = "observer"\n', RUN),
            r"\[mode_filter\]: gains is for outputs: give an \[observer\]",
        ),
        (
            (
                *(MARKOV, FILTER, "covariance = 1.0\n", RUN),
                KALMAN.replace("[[1.0, 0.0]]", "[[1.0, 0.0], [0.0, 1.0]]").replace(
                    "[[0.0004]]", "[[0.1, 0.02], [0.02, 0.1]]"
                ),
            ),
            r"\[mode_filter\]: noise must be given: the measurement of \[observer\] is not",
        ),
        (
            (MARKOV, FILTER, RUN.replace("0.1", '"ideal"')),
            r"\[mode_filter\]: a mode filter runs at samples: give \[run\] a step",
        ),
        ((MARKOV, FILTER, "disturbance = -1.0\n", RUN), r"\[mode_filter\]: disturbance must be"),
        ((MARKOV, FILTER, "disturbance = [1.0]\n", RUN), r"\[mode_filter\]: disturbance must "),
        ((MARKOV, FILTER, "noise = -0.1\n", RUN), r"\[mode_filter\]: noise must be"),
        ((MARKOV, FILTER, "noise = [0.1]\n", RUN), r"\[mode_filter\]: noise must have"),
        ((MARKOV, FILTER, "forgetting = 1.0\n", RUN), r"\[mode_filter\]: forgetting must be above"),
        ((MARKOV, FILTER, "initial = [1.0]\n", RUN), r"initial must have 2 entries, one for each"),
        ((MARKOV, FILTER, "initial = [0.7, 0.7]\n", RUN), r"\[mode_filter\]: initial must be"),
        ((MARKOV, FILTER, "ages = 3\n", RUN), r"\[mode_filter\]: ages must be left out"),
        ((AGED, FILTER, "ages = 0\n", RUN), r"\[mode_filter\]: ages must be"),
        (
            (MARKOV, FILTER, 'switches = "never"\n', RUN),
            r"mode_filter.switches: input should be 'anywhere' or 'samples'",
        ),
        (
            (MARKOV, FILTER, "allow_alike = 3\n", RUN),
            r"mode_filter.allow_alike: input should be a valid boolean",
        ),
        (
            (MARKOV, FILTER, "noises = 0.1\n", RUN),
            r"mode_filter.noises is not known",
        ),
        (
            (MARKOV, FILTER, BELIEF, 'of = "mean"\n', RUN),
            r"\[\[law\]\] 1, of: input should be 'expected' or 'optimal'",
        ),
    ],
)
def test_what_a_file_says_wrong_is_named(tmp_path, parts, message):
    with pytest.raises(dt.DeadtimeError, match=message):
        load_problem(write(tmp_path, *parts))
