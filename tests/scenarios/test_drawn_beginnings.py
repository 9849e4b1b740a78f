"""Runs draw first estimates and references: by seed alone, the same in batches and single runs."""

import numpy as np
import pytest
from scipy import stats

import deadtime as dt
from deadtime.app.script import script_of
from deadtime.estimation.servo import Reference
from deadtime.problems.file import load_problem
from deadtime.scenarios import scenario_seed

PLANT = dt.SwitchedSystem(
    [[[0.0, 1.0], [0.0, -0.5]], [[0.0, 1.1], [0.0, 0.3]]], [[[0.0], [1.0]], [[0.0], [0.8]]], 0.25
)
SERVO = dt.Servo(PLANT, [[1.0, 0.0]])
LAW = dt.AveragedPredictor(
    SERVO.plant, SERVO.place([-0.7, -1.0, -1.5], step=0.1), allow_unstable=True
)
OBSERVER = dt.luenberger(SERVO.model, SERVO.C, [-3.0, -4.0], 0.1)
MEAN, COVARIANCE = np.array([0.3, -0.2]), np.array([[0.5, 0.3], [0.3, 0.4]])
HEIGHT = stats.norm(loc=2.0, scale=0.5)
LOOP = dt.OutputFeedback(
    LAW, OBSERVER, servo=SERVO, reference=HEIGHT, estimate=MEAN, covariance=COVARIANCE
)
SIGNALS = [dt.SwitchingSignal.random(2, 5.0, dwell_time=0.7, seed=i) for i in range(5)]
RUN = {"x0": [0.1, 0.0], "horizon": 4.0, "step": 0.1}


def reference_of(law: object) -> Reference:
    assert isinstance(law, dt.OutputFeedback)
    assert law.reference is not None
    return law.reference


@pytest.mark.long
def test_draws_have_the_mean_and_covariance_that_were_asked_for():
    laws = [LOOP.drawn(scenario_seed(3, i)) for i in range(4000)]
    first = np.array([law.estimate for law in laws])
    height = np.array([reference_of(law)(1.0)[0] for law in laws])
    assert not laws[0].draws
    assert np.abs(first.mean(axis=0) - MEAN).max() < 5.0 * np.sqrt(0.5 / 4000)
    # A sample covariance of normal numbers has the variance (σ_ij² + σ_ii σ_jj)/N.
    assert np.abs(np.cov(first.T) - COVARIANCE).max() < 5.0 * np.sqrt(2.0 * 0.5**2 / 4000)
    assert stats.kstest(height, HEIGHT.cdf).pvalue > 1e-3
    assert abs(np.corrcoef(first[:, 0], height)[0, 1]) < 5.0 / np.sqrt(4000)


def test_a_covariance_without_full_rank_moves_only_what_is_uncertain():
    loop = dt.OutputFeedback(
        LAW, OBSERVER, servo=SERVO, estimate=MEAN, covariance=[[0.0, 0.0], [0.0, 1.0]]
    )
    drawn = [loop.drawn(seed) for seed in range(3)]
    assert [law.estimate[0] for law in drawn] == [0.3] * 3
    assert len({law.estimate[1] for law in drawn}) == 3
    assert reference_of(drawn[0])(0.0) == reference_of(loop)(0.0) == [0.0]


def test_a_run_is_that_of_the_law_that_its_seed_draws():
    run = dt.simulate(PLANT, LOOP, SIGNALS[0], seed=5, **RUN)
    given = LOOP.drawn(5)
    height = float(reference_of(given)(0.0)[0])
    assert run.reference is not None
    assert (run.reference == height).all()
    fixed = dt.OutputFeedback(LAW, OBSERVER, servo=SERVO, reference=height, estimate=given.estimate)
    assert np.array_equal(dt.simulate(PLANT, fixed, SIGNALS[0], **RUN).states, run.states)
    other = dt.OutputFeedback(LAW, OBSERVER, servo=SERVO, reference=HEIGHT).drawn(5)
    assert reference_of(other)(0.0) == [height]  # for every law alike


@pytest.mark.long
def test_scenarios_are_the_single_runs_with_their_seeds_however_they_are_laid_out():
    other = dt.OutputFeedback(LAW, OBSERVER, servo=SERVO, reference=HEIGHT)
    laws = {"both": LOOP, "height": other}
    data = dt.monte_carlo(PLANT, laws, SIGNALS, seed=7, trajectories=True, threads=2, **RUN)
    assert data.one_by_one == ["both", "height"]
    for i in (0, 3):
        run = dt.simulate(PLANT, LOOP, SIGNALS[i], seed=scenario_seed(7, i), **RUN)
        assert np.array_equal(data.x.sel(law="both")[i], run.states)
        assert data.IAE.sel(law="both")[i, 0] == run.step_info()["IAE"]
        assert run.reference is not None
        # By hand: the law that was drawn, in a run that draws nothing.
        given = LOOP.drawn(scenario_seed(7, i))
        fixed = dt.OutputFeedback(
            LAW, OBSERVER, servo=SERVO, reference=float(run.reference[0, 0]),
            estimate=given.estimate,
        )  # fmt: skip
        assert np.array_equal(dt.simulate(PLANT, fixed, SIGNALS[i], **RUN).states, run.states)
        same = dt.simulate(PLANT, other, SIGNALS[i], seed=scenario_seed(7, i), **RUN)
        assert same.reference is not None
        assert np.array_equal(same.reference, run.reference)  # for every law alike
    few = dt.monte_carlo(PLANT, {"both": LOOP}, SIGNALS[:2], seed=7, threads=1, **RUN)
    assert np.array_equal(few.ise.values[0], data.ise.sel(law="both").values[:2])
    again = dt.monte_carlo(PLANT, {"both": LOOP}, SIGNALS[:2], seed=8, threads=1, **RUN)
    assert (again.ise != few.ise).all()


def test_where_nothing_runs_the_means_hold():
    assert reference_of(LOOP)(0.0) == [2.0]
    controller = dt.Controller(LOOP, 0.1)
    fixed = dt.OutputFeedback(LAW, OBSERVER, servo=SERVO, reference=2.0, estimate=MEAN)
    assert controller.update([0.1], mode=0) == dt.Controller(fixed, 0.1).update([0.1], mode=0)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"covariance": [[1.0, 2.0], [2.0, 1.0]]}, "covariance must be positive semidefinite"),
        ({"covariance": [[1.0]]}, r"covariance must have shape \(n, n\) = \(2, 2\)"),
        ({"reference": stats.cauchy()}, "reference must have a finite mean"),
    ],
)
def test_what_cannot_be_drawn_is_refused(options, message):
    with pytest.raises(dt.ArgumentError, match=message):
        dt.OutputFeedback(LAW, OBSERVER, servo=SERVO, **options)


FILE = """\
[plant]
delay = 0.25
A = [[[0.0, 1.0], [0.0, -0.5]], [[0.0, 1.1], [0.0, 0.3]]]
B = [[[0.0], [1.0]], [[0.0], [0.8]]]
[gains]
poles = [-0.7, -1.0, -1.5]
[observer]
kind = "luenberger"
C = [[1.0, 0.0]]
poles = [-3.0, -4.0]
estimate = [0.3, -0.2]
covariance = [[0.5, 0.3], [0.3, 0.4]]
[servo]
reference = { distribution = "uniform", loc = 1.0, scale = 0.5 }
[[imperfection]]
kind = "saturation"
low = -8.0
high = 8.0
[[law]]
kind = "averaged"
[signal]
kind = "periodic"
sojourns = [0.85, 1.1]
modes = [0, 1]
[run]
x0 = [0.0, 0.0]
horizon = 4.0
step = 0.1
"""


def test_a_file_says_both(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(FILE, encoding="utf-8")
    law = load_problem(path).laws["averaged"]
    assert isinstance(law, dt.OutputFeedback)
    assert law.covariance is not None
    assert np.array_equal(law.covariance, COVARIANCE)
    assert reference_of(law)(0.0) == [1.25]
    drawn = [reference_of(law.drawn(seed))(0.0)[0] for seed in range(20)]
    assert 1.0 <= min(drawn) < 1.1 < 1.4 < max(drawn) <= 1.5
    path.write_text(FILE.replace('"uniform"', '"even"'), encoding="utf-8")
    with pytest.raises(dt.ArgumentError, match="reference: distribution must be the name of one"):
        load_problem(path)


def test_the_script_of_the_explorer_draws_the_same(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(FILE, encoding="utf-8")
    problem = load_problem(path)
    text = script_of(problem)
    assert f"seed={problem.seed}," in text
    made: dict = {}
    exec(text.split("\nruns = {")[0].replace("from deadtime.reports import plot_laws", ""), made)
    ours, theirs = (laws["averaged"].drawn(4) for laws in (problem.laws, made["laws"]))
    assert isinstance(ours, dt.OutputFeedback)
    assert isinstance(theirs, dt.OutputFeedback)
    assert np.array_equal(ours.estimate, theirs.estimate)
    assert reference_of(ours)(0.0) == reference_of(theirs)(0.0)
