"""What a loop stands: margins and simulated tolerances, in the API, pictures and commands."""

import json
import math

import numpy as np
import pytest

import deadtime as dt
import plants
from deadtime.cli.application import main
from deadtime.imperfections import Dropout, LateSamples, ModeDelay, Noise, Saturation
from deadtime.reports.robustness import plot_robustness

NEAR = plants.generic().apart(0.1)
MODEL = dt.SwitchedSystem(NEAR.A + np.eye(3), NEAR.B, NEAR.delay)
PLANT = dt.SwitchedSystem(1.01 * MODEL.A, 0.98 * MODEL.B, 0.251)
SIGNAL = plants.off_grid()
X0, STEP, HORIZON = np.array([1.0, -1.0, 0.5]), 0.05, 5.0


def assess(law="expected", **options):
    options = {"scenarios": 4, **options}
    made = plants.LAWS[law](MODEL)
    return dt.robustness(PLANT, made, SIGNAL, X0, HORIZON, STEP, **options)


def lost(law, imperfections, seed=0):
    run = dt.simulate(
        PLANT, plants.LAWS[law](MODEL), SIGNAL, X0, HORIZON, STEP,
        imperfections=imperfections, seed=seed,
    )  # fmt: skip
    return run.diverged or np.linalg.norm(run.states[:, -1]) > np.linalg.norm(X0)


@pytest.fixture(scope="module")
def result():
    return assess()


def test_the_margins_are_those_of_the_margin_functions(result):
    law = plants.LAWS["expected"](MODEL)
    assert result.delay.upper == dt.delay_margin(PLANT, law, STEP).upper
    assert result.gain.upper == dt.gain_margin(PLANT, law, STEP).upper
    assert result.sentences[0].startswith("The loop stays stable in every constant mode while the")


def test_late_samples_are_tolerated_up_to_the_period_that_loses_the_loop(result):
    late = result.late
    assert late.failed == late.tolerated + 1.0
    assert not lost("expected", [LateSamples(int(late.tolerated))])
    assert lost("expected", [LateSamples(int(late.failed))])
    assert f"up to {late.tolerated:g} periods" in result.sentences[3]


def test_lost_samples_and_late_modes_are_tried_as_simulate_has_them(result):
    for value, some in zip(result.drops.values, result.drops.lost, strict=True):
        more = [Dropout(value)] if value else []
        assert [lost("expected", more, seed) for seed in range(4)] == some.tolist()
    assert (np.diff(result.drops.values) > 0.0).all()
    assert result.lag is not None
    last = int(result.lag.values[-1])
    assert bool(result.lag.lost[-1, 0]) == lost("expected", [ModeDelay(last)])


@pytest.mark.long
def test_the_price_of_noise_is_quadratic_and_doubles_where_it_says():
    result = assess("averaged", scenarios=20)
    noise = result.noise
    cost = [
        dt.simulate(
            PLANT, plants.LAWS["averaged"](MODEL), SIGNAL, X0, HORIZON, STEP,
            imperfections=[Noise(noise.doubling)], seed=seed,
        ).metrics()["cost"]
        for seed in range(1000, 1040)
    ]  # fmt: skip
    error = np.std(cost) / math.sqrt(len(cost))
    assert abs(np.mean(cost) - 2.0 * noise.base) <= 4.0 * error + 0.05 * noise.base
    # Four times the noise adds sixteen times as much.
    added = noise.cost.mean(axis=1) - noise.base
    assert added[4] / added[3] == pytest.approx(4.0, rel=0.25)


def test_a_law_that_does_not_read_the_mode_is_said_not_to():
    result = assess("averaged")
    assert result.lag is None
    assert (
        result.sentences[-2]
        == "Mode detection delay has no effect: the law does not read the mode."
    )


def test_a_law_on_a_belief_is_told_no_mode_that_could_be_late():
    plant, model = plants.scalar([0.5, 0.9]), dt.Markov([[0.0, 1.0], [1.0, 0.0]])
    law = dt.ExpectedPredictor(plant, dt.place(plant, [-1.0]), model)
    signal = dt.SwitchingSignal.periodic([0.7, 0.9], [0, 1], 4.0)
    filt = dt.ModeFilter(plant, model, 0.1, disturbance=1e-4)
    args = signal, [1.0], 3.0, 0.1
    told, believed = (
        dt.robustness(plant, one, *args, scenarios=2)
        for one in (law, dt.BeliefPredictor(law, filt))
    )
    assert told.lag is not None
    assert believed.lag is None
    assert (
        "Mode detection delay has no effect: the law does not read the mode." in believed.sentences
    )


def test_a_loop_that_is_lost_as_it_is_says_so():
    plant = plants.scalar([0.5, 0.6])
    law = dt.DelayedStateFeedback(plant, [[[-0.1]], [[-0.1]]], allow_unstable=True)
    signal = dt.SwitchingSignal.periodic([0.3, 0.3], [0, 1], 4.0)
    result = dt.robustness(plant, law, signal, [1.0], 3.0, 0.1, scenarios=2)
    for one in (result.drops, result.late, result.lag):
        assert one.tolerated is None
        assert one.message == "the runs are lost as they are, with nothing added"
    assert result.delay.lower is None
    assert len(result.sentences) == 4
    assert result.sentences[-1].startswith("The cost of noise cannot be computed")
    plot_robustness(result)


def test_what_every_run_has_beside_what_is_tried_is_kept():
    limits = Saturation(-2.0, 2.0)
    result = assess("averaged", imperfections=[limits])
    run = dt.simulate(
        PLANT, plants.LAWS["averaged"](MODEL), SIGNAL, X0, HORIZON, STEP, imperfections=[limits]
    )
    assert (result.drops.cost[0] == run.metrics()["cost"]).all()
    assert result.sentences[0].startswith("Without saturation (-2 to 2): the")
    assert result.late.cost.shape[1] == 4


@pytest.mark.long
def test_a_law_without_a_table_has_tolerances_and_no_margins():
    rule = dt.HalfSpace([1.0, 0.0], 0.0)
    plant = plants.paper(0.3).apart(0.1)
    law = dt.StateDependentPredictor(plant, dt.place(plant, [-1.0, -2.0]), rule)
    result = dt.robustness(plant, law, rule, [-1.0, 0.5], 6.0, 0.1, scenarios=1)
    assert result.delay is result.gain is None
    assert result.late.tolerated is not None
    assert len(result.sentences) == 4
    plot_robustness(result)


def test_the_picture_has_a_panel_for_each(result):
    figure = plot_robustness(result, "a title", ["slow", "fast", "odd"])
    assert [axes.get_title(loc="left") for axes in figure.axes] == [
        "delay error", "gain error", "noise", "lost samples", "late samples",
        "mode detection delay",
    ]  # fmt: skip
    assert [text.get_text() for text in figure.legends[0].get_texts()][:3] == [
        "slow",
        "fast",
        "odd",
    ]


def test_the_command_prints_sentences_and_leaves_a_picture(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    options = ["--scenarios", "2", "--step", "0.05", "--law", "mean"]
    with pytest.raises(SystemExit) as stopped:
        main(["robustness", "follower", *options, "--out", "stands"])
    assert stopped.value.code == 0
    out = capsys.readouterr().out
    assert "law “mean”, sampled every 0.05 s" in " ".join(out.split())
    assert out.count("•") == 5  # beside the first line
    assert (tmp_path / "stands.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(SystemExit):
        main(["robustness", "follower", *options, "--json"])
    record = json.loads(capsys.readouterr().out)
    assert record["law"] == "mean"
    assert record["delay_margin"][1] is None or record["delay_margin"][1] > 0.2
    assert set(record) >= {"gain_margin", "lost_samples", "late_samples", "noise", "sentences"}
    assert (tmp_path / "follower-robustness.png").exists()


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"x0": np.zeros(3)}, "x0 must not be 0, from where nothing moves"),
        ({"horizon": 0.25}, "horizon must be longer than the delay, 0.251 s, got 0.25"),
        ({"imperfections": Noise(0.1)}, "imperfections must be a list"),
    ],
)
def test_what_would_say_nothing_is_refused(changed, message):
    arguments = {"x0": X0, "horizon": HORIZON, "imperfections": (), **changed}
    with pytest.raises((dt.ArgumentError, TypeError), match=message):
        dt.robustness(
            PLANT, plants.LAWS["mean"](MODEL), SIGNAL, step=STEP, scenarios=1, **arguments
        )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--law", "nonsense"], "law must be one of"),
        (["--scenarios", "0"], "scenarios must be an integer of at least 1"),
        (["--step", "0"], "step must be positive"),
        (["--seed", "-1"], "seed must be an integer of at least 0"),
    ],
)
def test_the_command_says_what_is_wrong(arguments, message, capsys):
    with pytest.raises(SystemExit) as stopped:
        main(["robustness", "follower", *arguments])
    assert stopped.value.code == 2
    assert message in capsys.readouterr().err
