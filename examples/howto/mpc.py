"""
MPC on the predicted state
==========================

The paper's plant is unstable, its input is one second late and limited. What is sent now meets the
state at t + D, so a model predictive controller is started from there: ``Controller.prediction``
hands over that state, and the optimiser never hears of the delay. The problem is compiled once; a
period changes its parameter alone.

    python mpc.py --seeds 1000

Under a limit an unstable plant can be brought to rest from near it only. From a start at the edge
of that the plain law, cut off, loses the plant more often than an MPC that spares the input.
"""

import argparse
import time

import cvxpy as cp
import matplotlib.pyplot as plt
import numpy as np

import deadtime as dt

STEP, HORIZON, AHEAD = 0.1, 8.0, 15  # s, s, periods of the optimiser
WEIGHT, X0 = 0.1, (-0.85, 1.0)  # of x² beside u²; where the plant starts
LIMIT, MOST = 5.5, 5.0  # of |u|; of |x1| and |x2|

problem = dt.problems.paper()
plant = problem.plant
model = dt.Markov([[0.0, 20.0], [20.0, 0.0]])  # 0.05 s in a mode, on average
plain = dt.ExpectedPredictor(plant, problem.gains, model)

# %%
# The problem: of the mean plant, from the predicted state on, under the limits of the input; those
# of the states are soft, for a limit that a switch has broken must not leave the actuator without
# an answer.


def compiled():
    """The parameters of the problem, its inputs, and the problem itself.

    States are written in x̂ and the inputs, x = X x̂ + Y u: the inputs are all there is to find.
    """
    from scipy.linalg import expm, solve_discrete_are

    A, B = plant.mean().A[0], plant.mean().B[0]
    whole = expm(STEP * np.block([[A, B], [np.zeros((1, 3))]]))
    Phi, Gamma = whole[:2, :2], whole[:2, 2:]
    Q, R = WEIGHT * np.eye(2), np.eye(1)
    end = np.linalg.cholesky(solve_discrete_are(Phi, Gamma, Q, R)).T
    power = [np.linalg.matrix_power(Phi, k) for k in range(AHEAD + 1)]
    X = np.stack(power[1:])
    Y = np.zeros((AHEAD, 2, AHEAD))
    for k in range(AHEAD):
        for j in range(k + 1):
            Y[k, :, j] = (power[k - j] @ Gamma)[:, 0]
    root = np.array([WEIGHT**0.5 * np.eye(2)] * (AHEAD - 1) + [end])
    x0, u, over = cp.Parameter(2), cp.Variable(AHEAD), cp.Variable(AHEAD)
    weighed = (root @ X).reshape(-1, 2) @ x0 + (root @ Y).reshape(-1, AHEAD) @ u
    cost = cp.sum_squares(weighed) + cp.sum_squares(u) + 100.0 * cp.sum(over)
    rules = [cp.abs(u) <= LIMIT, over >= 0.0]
    rules += [cp.abs(X[:, i] @ x0 + Y[:, i] @ u) <= 0.9 * MOST + over for i in range(2)]
    return x0, u, cp.Problem(cp.Minimize(cost), rules)


class PredictiveControl(dt.Law):
    """MPC of what a law predicts; `spent` are the seconds of every period."""

    def __init__(self):
        vars(self).update(plant=plant, gains=None, outputs=None, spent=[], problem=compiled())

    @property
    def label(self):
        return "MPC on the prediction"

    def digital(self, step, signal=None, steps=None):
        raise dt.ArgumentError("an MPC is no table.")

    def ideal(self, signal, horizon):
        raise dt.ArgumentError("step must be given: an MPC runs at samples.")

    def online(self, step, signal=None, steps=None):
        controller, (x0, u, qp) = dt.Controller(plain, step), self.problem

        def control(x, past, mode, age):
            begun = time.process_time()
            controller.update(x, mode, applied=past[-1])
            x0.value = controller.prediction.states[0]
            qp.solve(solver=cp.CLARABEL)
            answered = qp.status in (cp.OPTIMAL, cp.OPTIMAL_INACCURATE)
            found = np.clip(u.value[:1], -LIMIT, LIMIT) if answered else past[-1]
            self.spent.append(time.process_time() - begun)
            return found

        return control


# %%
# A run under each, along the same signal. The plain law asks for more than there is, and what is
# cut off is missing a second later.


def run(law, seed, limited=False):
    """A run along a signal that is drawn."""
    from deadtime.imperfections import Saturation

    signal = model.sample(HORIZON, seed=seed)
    cut = [Saturation(-LIMIT, LIMIT)] if limited else []
    return dt.simulate(plant, law, signal, X0, HORIZON, step=STEP, imperfections=cut)


def verdict(result):
    """Whether a run ends near rest, and whether its states stayed within their limits."""
    rest = not result.diverged and np.abs(result.states[:, -20:]).max() < 0.5
    return rest, not result.diverged and np.abs(result.states).max() <= MOST


def figure(runs):
    """States and input of both runs."""
    whole, axes = plt.subplots(3, 1, sharex=True, figsize=(7, 6), layout="constrained")
    names = ("x₁", "x₂", "input")
    for (label, result), style in zip(runs.items(), ("-", "--"), strict=True):
        for axis, values in zip(axes, (*result.states, result.inputs[0]), strict=True):
            axis.plot(result.time, values, style, label=label)
    for axis, name, most in zip(axes, names, (MOST, MOST, LIMIT), strict=True):
        axis.axhline(most, color="0.6", linewidth=0.8)
        axis.axhline(-most, color="0.6", linewidth=0.8)
        axis.set(ylabel=name, ylim=(-1.6 * most, 1.6 * most))
    axes[0].legend(loc="upper right")
    axes[-1].set_xlabel("time, s")
    whole.savefig("mpc.png")


def main(seeds):
    control, found = PredictiveControl(), {"plain, saturated": [], "MPC": []}
    for seed in range(seeds):
        found["plain, saturated"].append(verdict(run(plain, seed, limited=True)))
        found["MPC"].append(verdict(run(control, seed)))
    for name, verdicts in found.items():
        rest, within = np.sum(verdicts, axis=0)
        print(f"{name}: at rest in {rest} of {seeds} runs, states within limits in {within}")
    spent = 1e3 * np.array(control.spent)
    slow = np.quantile(spent, 0.99)
    print(f"time per period of the MPC: {np.median(spent):.2f} ms, 99 % below {slow:.2f} ms")
    figure({"plain law, saturated": run(plain, 0, limited=True), "MPC": run(control, 0)})


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, default=2)
    main(parser.parse_known_args()[0].seeds)
