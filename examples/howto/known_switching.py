"""
Learn from a log how a plant switches
=====================================

Three unstable modes, one second of delay, and a law that uses what a log of some 200 sojourns
tells. The picture: ``|x|`` under laws that know nothing, the dwell time, and the statistics.
"""

from scipy import stats

import deadtime as dt
from deadtime.reports import plot_norms

problem = dt.problems.three_mode()
plant, gains, mean = problem.plant, problem.gains, problem.laws["mean"]

# The truth, of which only a log of some 200 sojourns is known.
truth = dt.SemiMarkov(stats.gamma(4.0, loc=0.5, scale=0.25), modes=3)
model = dt.SemiMarkov.fit(truth.sample(300.0, seed=1), family="gamma")
for mode, good in enumerate(model.goodness):
    print(f"mode {mode}: {good.complete} sojourns, p = {good.p_value:.2f}")

laws = {
    "averaged": problem.laws["averaged"],
    "mean": mean,
    "mean, dwell-aware": dt.MeanPredictor(plant, mean.gain, gains, 0.5, mean.mean),
    "expected": dt.ExpectedPredictor(plant, gains, model),
    "oracle": problem.laws["oracle"],
}
data = dt.monte_carlo(plant, laws, truth, problem.x0, horizon=15, scenarios=100)
for law in laws:
    print(f"{law}: median ∫|x|² {float(data.ise.sel(law=law).median()):.1f}")

signal = truth.sample(16.0, seed=2)
runs = {name: dt.simulate(plant, law, signal, problem.x0, 15) for name, law in laws.items()}
plot_norms(runs, "Three modes, sojourns learnt from a log").savefig("known_switching.png")
