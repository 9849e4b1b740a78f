"""Settings, signals and laws of `batch.py`, and the operations that a scenario-step asks for."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import expon

import deadtime as dt
from deadtime.plant import SampledPlant
from deadtime.scenarios.batch_loop import Loop
from deadtime.scenarios.engine import window_form
from deadtime.switching import SignalBatch

PAPER, X0 = dt.problems.paper(), (-1.0, 1.0)
MODEL = dt.SemiMarkov(expon(loc=0.2, scale=0.2))
LAWS: Mapping[str, dt.Law] = {
    "averaged": PAPER.laws["averaged"],
    "mean": PAPER.laws["mean"],
    "expected, Markov": dt.ExpectedPredictor(
        PAPER.plant, PAPER.gains, dt.Markov([[0.0, 2.5], [2.5, 0.0]])
    ),
    "averaged, dwell-aware": dt.AveragedPredictor(PAPER.plant, PAPER.gains, dwell_time=0.2),
    "expected, semi-Markov": dt.ExpectedPredictor(PAPER.plant, PAPER.gains, MODEL),
    "oracle": dt.ExactPredictor(PAPER.plant, PAPER.gains),
}


class Setting(NamedTuple):
    """N, periods and the seconds of one."""

    taps: int
    periods: int

    @property
    def step(self) -> float:
        return PAPER.plant.delay / self.taps

    @property
    def horizon(self) -> float:
        return self.periods * self.step


USUAL, LONG, LONGEST = Setting(100, 1000), Setting(1000, 4000), Setting(10_000, 40_000)


@lru_cache(maxsize=1)
def on_grid(setting: Setting, scenarios: int) -> SignalBatch:
    """Signals whose sojourns are 20 periods and more, 40 on average."""
    rng, periods = np.random.default_rng(7), setting.periods
    most = periods // 20 + 2
    starts = np.zeros((scenarios, most + 1))
    np.rint(20.0 + rng.exponential(20.0, (scenarios, most)), out=starts[:, 1:])
    np.cumsum(starts, axis=1, out=starts)
    kept = starts < periods
    modes = (rng.integers(0, 2, (scenarios, 1)) + np.arange(most + 1)) % 2
    first = np.concatenate(([0], np.cumsum(kept.sum(axis=1))))
    ends, ages = np.full(scenarios, np.inf), np.zeros(scenarios)
    return SignalBatch(first, starts[kept] * setting.step, modes[kept], ends, ages)


def modes_of(batch: SignalBatch, setting: Setting) -> np.ndarray:
    """The mode per period, (scenario, period) int8, as peers read it."""
    change = np.zeros((len(batch), setting.periods), np.int8)
    row = np.repeat(np.arange(len(batch)), np.diff(batch.first))
    change[row, np.rint(batch.times / setting.step).astype(int)] = 1
    change[:, 0] = batch.modes[batch.first[:-1]]
    return np.bitwise_xor.accumulate(change, axis=1)


def run(law: dt.Law, model: Any, setting: Setting, scenarios: int = 0, **more: Any) -> Any:
    """`monte_carlo` of one law; a model draws the signals."""
    size, law_of = max(1, scenarios), {"law": law}
    horizon, step = setting.horizon, setting.step
    return dt.monte_carlo(PAPER.plant, law_of, model, X0, horizon, step, size, **more)


def require_accuracy(law: dt.Law, batch: SignalBatch, setting: Setting, **more: Any) -> None:
    """Every figure of some scenarios is that of `simulate` to 1e-9."""
    few = batch.slice(0, 11 if setting == USUAL else 2)
    data = run(law, few, setting, **more).sel(law="law")
    for i in (0, len(few) - 1):
        one = dt.simulate(PAPER.plant, law, few[i], X0, setting.horizon, setting.step)
        for name, value in one.metrics().items():
            np.testing.assert_allclose(data[name].values[i], value, rtol=1e-9, err_msg=name)


def fmas_of(law: dt.Law, setting: Setting) -> float:
    """Fused multiply-adds of a scenario-step; see the module."""
    loop = Loop(SampledPlant(PAPER.plant, setting.step), np.array(X0), 1.0)
    n, wide = loop.plant.states, loop.acting.wide
    feedback = law.digital(setting.step, dt.SwitchingSignal.constant(0), 1)
    rows, taps, m, _ = feedback.input_gain.shape
    metrics = n + 1 + m + 1 + 2
    plant = n * wide + wide * (wide + 1) // 2 + wide
    if law.needs_preview:
        return metrics + plant + 2 * n * n + m * (n + m) + n * wide + 2 * (n**3 + n * n)
    form = window_form(feedback)
    if form is None:
        return metrics + plant + m * (taps * m + n)
    q, block = form.enter.shape[0], form.transition.shape[1]
    return metrics + plant + rows * m * (n + m + q) + q * (m + block) + q * m * (1 + rows)
