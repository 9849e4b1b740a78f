"""A law of one's own that answers what no law does is refused by the name of its method."""

import numpy as np
import pytest

import deadtime as dt
import plants
from deadtime.feedback import Feedback
from deadtime.imperfections import Noise

PLANT = plants.paper()
K = plants.gains(PLANT)
SIGNAL, MODEL = dt.SwitchingSignal([0.0, 0.31], [0, 1]), dt.Markov([[0, 2], [2, 0]])
ROW, TAP = np.zeros((1, 1, 2)), np.zeros((1, 4, 1, 1))


def law_with(**body):
    """An averaged law some of whose methods are written anew."""
    return type("Mine", (dt.AveragedPredictor,), body)(PLANT, K)


def answering(value):
    """A method that returns a value whatever it is asked."""
    return lambda self, *args, **options: value


def simulate(law, **options):
    return dt.simulate(PLANT, law, SIGNAL, [1.0, 0.0], 1.0, 0.05, **options)


USES = {
    "simulate": simulate,
    "Controller": lambda law: dt.Controller(law, 0.05),
    "monte_carlo": lambda law: dt.monte_carlo(
        PLANT, [law], MODEL, [1.0, 0.0], 2.0, 0.05, scenarios=2
    ),
    "growth_rate": lambda law: dt.growth_rate(PLANT, law, 0, step=0.05),
}


@pytest.mark.parametrize("use", USES)
@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (None, r"Mine\.digital must return a Feedback, got None, a NoneType\."),
        ("x", r"Mine\.digital must return a Feedback, got 'x', a str\."),
        ((ROW, TAP), r"Mine\.digital must return a Feedback, got .*, a tuple\."),
        (
            Feedback(np.zeros((1, 1, 3)), TAP, "none", 0.05),
            r"Mine\.digital must return gains of shape \(rows, m, n\) = \(rows, 1, 2\), got \(1, 1",
        ),
        (
            Feedback(ROW, TAP, "mode", 0.05),
            r"Mine\.digital must return 2 rows for the context 'mode', ages = 1 and 2 modes, got 1",
        ),
        (
            Feedback(np.zeros((3, 1, 2)), np.zeros((3, 4, 1, 1)), "mode_age", 0.05, ages=2),
            r"Mine\.digital must return 4 rows for the context 'mode_age', ages = 2 and .*, got 3",
        ),
        (
            Feedback(np.zeros((2, 1, 2)), np.zeros((2, 4, 1, 1)), "none", 0.05),
            r"Mine\.digital must return 1 rows for the context 'none', .*, got 2",
        ),
    ],
)
def test_a_table_that_is_none_for_the_plant_is_refused(use, answer, message):
    with pytest.raises(dt.ArgumentError, match=message):
        USES[use](law_with(digital=answering(answer)))


def test_other_methods_are_held_to_what_they_return():
    with pytest.raises(dt.ArgumentError, match=r"Mine\.ideal must return a Functional or Forecast"):
        dt.simulate(PLANT, law_with(ideal=answering(3)), SIGNAL, [1.0, 0.0], 1.0, None)
    with pytest.raises(dt.ArgumentError, match=r"Mine\.preview must return a Preview or None"):
        simulate(law_with(preview=answering(True)))


class Called(dt.StateDependentPredictor):
    """A law that is called once a period, and answers what it is made to."""

    def __init__(self, answer):
        super().__init__(PLANT, K, dt.HalfSpace([1.0, 0.0]))
        vars(self)["answer"] = answer

    def online(self, step, signal=None, steps=None):
        return self.answer


@pytest.mark.parametrize("imperfections", [(), (Noise(0.1),)])
@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (None, r"Called\.online must return a Callable, got None"),
        (lambda *_: None, r"returns u_k of shape \(m,\) = \(1,\), got None"),
        (
            lambda *_: np.zeros(2),
            r"returns u_k of shape \(m,\) = \(1,\), got array\(\[0\., 0\.\]\)",
        ),
    ],
)
def test_a_law_that_is_called_is_held_to_an_input(imperfections, answer, message):
    with pytest.raises(dt.ArgumentError, match=message):
        simulate(Called(answer), imperfections=imperfections)


def test_a_number_is_the_input_of_a_plant_with_one():
    run = simulate(Called(lambda *_: 0.25))
    assert (run.inputs == 0.25).all()


def test_a_label_that_is_a_method_is_refused_where_it_is_to_be_a_name():
    law = law_with(label=answering("x"))
    with pytest.raises(
        dt.ArgumentError, match=r"Mine\.label must be a text, got a method: make it"
    ):
        USES["monte_carlo"](law)
    assert repr(law).startswith("Mine(its label is no text")
    data = dt.monte_carlo(PLANT, {"x": law}, MODEL, [1.0, 0.0], 2.0, 0.05, scenarios=2)
    assert data.law.values.tolist() == ["x"]


@pytest.mark.parametrize("rows", [1, 3])
def test_a_table_without_a_tap_is_refused_and_one_of_zeros_reads_no_input(rows):
    gains = -np.ones((rows, 1, 2))
    with pytest.raises(dt.ArgumentError, match=rf"N ≥ 1\), got shape \({rows}, 0, 1, 1\): a law"):
        Feedback(gains, np.zeros((rows, 0, 1, 1)), "step", 0.05)
    table = Feedback(gains[:1], np.zeros((1, 1, 1, 1)), "none", 0.05)
    run = simulate(law_with(digital=answering(table)))
    np.testing.assert_allclose(run.inputs[0], -run.states.sum(axis=0), rtol=1e-12)


@pytest.mark.parametrize("name", ["observer", "servo", "reference", "filter"])
def test_a_law_may_not_declare_what_laws_on_estimates_have(name):
    with pytest.raises(dt.ArgumentError, match=rf"Mine\.{name} must have another name"):
        law_with(__annotations__={name: float})


def test_a_law_of_ones_own_may_keep_another_and_tables_of_its_own():
    inner = dt.AveragedPredictor(PLANT, K)
    law = law_with(digital=lambda self, *args: self.inner.digital(*args))
    vars(law).update(inner=inner, tables={})
    for use in USES.values():
        use(law)
    assert np.array_equal(simulate(law).states, simulate(inner).states)
