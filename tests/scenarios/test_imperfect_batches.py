"""Imperfect sensors and actuators in the batch engine: against single runs, and a plain loop."""

import numpy as np
import pytest

import deadtime as dt
import plants
from batches import require_single_runs
from deadtime.imperfections import (
    Dropout,
    Jitter,
    LateSamples,
    MeasurementDelay,
    ModeDelay,
    Noise,
    RateLimit,
    Saturation,
    StepDisturbance,
    TimingImperfection,
    WhiteDisturbance,
    WrongMode,
)
from deadtime.loop.received_samples import fill_rows, rows_of_run
from deadtime.plant import SampledPlant
from deadtime.scenarios import draw_signals
from deadtime.scenarios.batch_loop import Loop
from deadtime.scenarios.batch_run import _block
from deadtime.scenarios.received_lanes import BlockMeasurements
from shares import mostly_long


class Early(TimingImperfection):
    """Every other sample is taken early, some by more than a period."""

    waits = False

    def __init__(self, most):
        vars(self)["most"] = most

    def lags(self, sizes, samples, rng):
        return self.most * rng.random(samples) * (np.arange(samples) % 2)


H, HORIZON, COUNT, SEED = 0.1, 6.03, 11, 5
TRUTH, BELIEVED = plants.generic(0.234), plants.generic(0.3, seed=5)
X0 = [0.3, -0.6, 0.9]
MODEL = dt.Markov(2.0 * (1.0 - np.eye(3)))
KINDS = "averaged", "expected", "averaged, dwell-aware", "exact"
LAWS = {name: plants.LAWS[name](BELIEVED) for name in KINDS}
CASES = {
    "noise": [Noise([0.02, 0.01, 0.03])],
    "lost": [Dropout(0.2)],
    "late": [LateSamples(3, 0.4)],
    "late modes": [ModeDelay(4)],
    "wrong modes": [WrongMode(0.1)],
    "late, then noise": [LateSamples(2, 0.3), Noise(0.02)],
    "measured late": [MeasurementDelay(0.237)],
    "measured whole periods late": [MeasurementDelay(0.2)],
    "jitter": [Jitter(0.08)],
    "measured late, with jitter, lost": [Jitter(0.1), MeasurementDelay(0.133), Dropout(0.2)],
    "timing of one's own": [Early(0.13), LateSamples(2, 0.3), Noise(0.02)],
    "all": [
        Jitter(0.05),
        Noise(0.02),
        Saturation([-2.0, -1.0], 1.5),
        LateSamples(2, 0.2),
        WrongMode(0.05),
        Dropout(0.1),
        RateLimit([9.0, 12.0]),
        WhiteDisturbance([0.05, 0.1, 0.0]),
        StepDisturbance([0.1, -0.2, 0.1], 0.55, 4.0),
    ],
}


# By the rows of a table, and by a model. Rows of an age are tried at every change with what laws
# remember, samples that come late where no instant moves with laws on a belief.
FEW = "averaged", "exact"
# Of the others each has two kinds in turn, late modes those that look at ages: each is a kernel.
IN_TURN = {case: (2 * KINDS)[(i + 3) % 4 :][:2] for i, case in enumerate(CASES)}


@pytest.mark.parametrize(
    ("case", "kinds"),
    mostly_long([*(IN_TURN | {"all": KINDS}).items(), ("all", FEW)], ("all", FEW)),
)
def test_imperfect_scenarios_are_those_of_single_runs(case, kinds):
    require_single_runs(TRUTH, {name: LAWS[name] for name in kinds}, CASES[case])


def test_imperfect_scenarios_do_not_depend_on_their_company():
    laws = {name: LAWS[name] for name in FEW}
    whole = dt.monte_carlo(
        TRUTH, laws, MODEL, X0, 3.0, H, 21, SEED, imperfections=CASES["all"], threads=2
    )
    fewer = dt.monte_carlo(
        TRUTH, {"exact": LAWS["exact"]}, MODEL, X0, 3.0, H, 9, SEED, imperfections=CASES["all"]
    )
    mine, theirs = fewer.cost.sel(law="exact").values, whole.cost.sel(law="exact").values[:9]
    np.testing.assert_array_equal(mine, theirs)


@pytest.mark.long  # "all" has lost samples and limits, against single runs
def test_lost_samples_hold_the_command_and_not_the_limited_input():
    # u = −x of an integrator, limited to 0.5: what is asked for again is −x of the last sample
    # that came, so a wider limit of the next actuator is met at once.
    plant = plants.scalar([0.1], delay=0.1)
    law = dt.DelayedStateFeedback(plant, [[[-1.0]]])
    given = [Dropout(0.5), Saturation(-0.5, 0.5)]
    data = dt.monte_carlo(
        plant, {"law": law}, dt.Markov([[0.0]]), [1.0], 4.0, H, 8, imperfections=given,
        trajectories=True,
    )  # fmt: skip
    assert data.attrs["one_by_one"] == []
    x, u = data.x.values[0, :, 0], data.u.values[0, :, 0]
    asked = np.clip(-x, -0.5, 0.5)
    held = np.abs(u - asked) > 1e-15
    assert 0.3 < held.mean() < 0.6
    k = np.arange(1, x.shape[1])
    repeated = np.isclose(u[:, k], u[:, k - 1], atol=0.0)
    assert (repeated | ~held[:, k]).all()


def heard_block(kinds):
    loop = Loop(SampledPlant(TRUTH, H), np.array(X0), HORIZON)
    signals = draw_signals(MODEL, HORIZON + 1.0, SEED, count=COUNT)
    return BlockMeasurements(loop, kinds, signals, loop.sample_signals(signals), SEED, 0, True, 3)


def test_what_is_heard_is_stacked_once_and_in_32_bits():
    block, tables = heard_block(CASES["all"]), [LAWS[name].digital(H) for name in KINDS[:3]]
    for begin in (0, 8):
        told = [block.measurements(table, begin, 3).relayed for table in tables]
        assert all(np.shares_memory(each.lag, told[0].lag) for each in told)
        assert all(np.shares_memory(each.noise, told[0].noise) for each in told)
        assert told[0].lag.dtype == told[-1].row.dtype == np.int32
    noisy = heard_block(CASES["noise"]).measurements(tables[-1], 0, 3).relayed
    assert noisy.lag.size == noisy.row.size == noisy.reach == 0
    assert noisy.noise.size == 16 * 61 * 3  # two groups of eight


def test_blocks_in_which_all_that_is_heard_is_kept_are_smaller():
    loop = Loop(SampledPlant(TRUTH, H), np.array(X0), 4e3)
    limits = [Saturation(-1.0, 1.0)]
    assert _block(loop, limits) == _block(loop, []) == 96
    assert _block(loop, [*limits, Noise(0.1)]) == 24


def plain_rows(told, sampled, age, apart, ages):
    """The rows of one run by a loop over the samples."""
    mode, rows, last, before = -1, [], None, None
    for now, true in zip(told, sampled, strict=True):
        if mode < 0:
            age = age if last is None else age + 1 if true == before else 0
            mode = now
        else:
            age = 0 if now not in (-1, mode) else age + 1
            mode = mode if now < 0 else now
        last, before = mode, true
        rows.append(max(mode, 0) * apart + min(age, ages - 1))
    return rows


@pytest.mark.parametrize(("apart", "ages"), [(30, 30), (9, 9), (1, 1), (0, 1)])
def test_a_law_follows_the_modes_that_it_is_told_in_many_runs_as_in_one(apart, ages):
    rng = np.random.default_rng(0)
    sampled = np.repeat(rng.integers(0, 3, (40, 12)), 4, axis=1)
    told = np.where(rng.random(sampled.shape) < 0.5, -1, sampled)
    told[0], told[1, :20] = -1, -1
    age = rng.integers(0, 7, 40)
    row = np.empty(sampled.size, np.int32)
    fill_rows(row, told, sampled, age, apart, ages, (0.0,) * 8)
    together = row.reshape(5, -1, 8).swapaxes(1, 2).reshape(40, -1)
    for i in range(40):
        wanted = plain_rows(told[i], sampled[i], int(age[i]), apart, ages)
        np.testing.assert_array_equal(together[i], wanted)
        alone = rows_of_run(told[i], sampled[i], int(age[i]), apart, ages)
        np.testing.assert_array_equal(alone, wanted)
