"""Laws under a Markov chain at samples, on a target: told the mode, and on a belief."""

import numpy as np
import pytest

import deadtime as dt
import plants
from c_code import Library, needs_compiler

pytestmark = needs_compiler
STEP = 0.05


def law_of(on_belief):
    plant = plants.paper()
    model = dt.MarkovChain([[0.95, 0.05], [0.1, 0.9]], STEP)
    law = dt.ExpectedPredictor(plant, plants.gains(plant), model)
    if not on_belief:
        return law
    return dt.BeliefPredictor(law, dt.ModeFilter(plant, model, STEP, disturbance=1e-4, noise=1e-3))


@pytest.mark.parametrize("on_belief", [False, True], ids=["told the mode", "on a belief"])
def test_the_exported_c_answers_as_the_controller_does_along_a_run(tmp_path, on_belief):
    law = law_of(on_belief)
    kinds = [dt.imperfections.WhiteDisturbance(1e-4), dt.imperfections.Noise(1e-3)]
    model = law.law.model if on_belief else law.model
    signal = model.sample(12.0, seed=3)
    run = dt.simulate(
        law.plant, law, signal, [-1.0, 1.0], 10.0, STEP, imperfections=kinds, seed=2
    )  # fmt: skip
    assert signal.switches > 5
    controller = dt.Controller(law, STEP)
    exported = controller.export_c(tmp_path)
    assert exported.check.passed, exported.check
    library = Library(tmp_path, law.plant)
    library.reset()
    x = run.states.T
    count = len(x) - 1
    modes = [int(mode) for mode in signal(np.arange(count) * STEP + 1e-9)]
    found, status = library.run(x[:count], modes, [None] * count, [None] * count)
    expected = [controller.update(x[k], modes[k]) for k in range(count)]
    assert not np.any(status)
    np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-11)
