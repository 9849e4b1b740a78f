"""Numbers that floats do not hold, and products that overflow: refused by name, at once."""

import re
from fractions import Fraction

import numpy as np
import pytest

import deadtime as dt
from deadtime.base.checks import as_floats, brief, count, index, number, real_array
from deadtime.numerics.covariance import noise_covariance
from deadtime.numerics.exponential import discretise, gramian
from deadtime.spectrum import characteristic_roots

PAPER = dt.problems.paper()
PLANT, GAINS = PAPER.plant, PAPER.gains
LAW, SIGNAL = PAPER.laws["averaged"], dt.SwitchingSignal.constant(0)
HUGE = [1e308, 1e300, 1e160]
BEYOND = np.longdouble("1e4000")
WIDE = pytest.mark.skipif(not np.isfinite(BEYOND), reason="longdouble is double on this platform")
HALF = dt.HalfSpace([1.0, 0.0], 0.0)


@pytest.mark.parametrize("size", [np.inf, np.nan, 1e308, 1e200])
@pytest.mark.parametrize("tau", [1e308, 1e200, 1.0])
def test_an_exponential_of_any_size_comes_to_an_end_and_what_it_does_not_know_is_not_finite(
    size, tau
):
    A, B = np.array([[size, size], [0.0, size]]), np.ones((2, 1))
    for array in (A, B):
        array.flags.writeable = False
    for result in (*discretise(A, B, tau), gramian(A, B, tau, np.eye(len(A)))):
        assert not np.isfinite(result).all()
    assert not np.isfinite(noise_covariance(A, np.eye(2), tau)).all()


def test_a_stable_exponential_over_1e300_seconds_is_its_limit():
    A, B = np.array([[-1.0]]), np.array([[2.0]])
    for array in (A, B):
        array.flags.writeable = False
    Phi, Gamma = discretise(A, B, 1e300)
    assert Phi[0, 0] == 0.0
    assert Gamma[0, 0] == pytest.approx(2.0, rel=1e-12)


TIMES = {
    "simulate": lambda h: dt.simulate(PLANT, LAW, SIGNAL, [-1, 1], h, step=h),
    "simulate, its horizon far shorter": lambda h: dt.simulate(
        PLANT, LAW, SIGNAL, [-1, 1], 1.0, step=h
    ),
    "monte_carlo": lambda h: dt.monte_carlo(PLANT, [LAW], [SIGNAL], [-1, 1], h, step=h),
    "under a rule": lambda h: dt.simulate(PLANT, LAW, HALF, [-1, 1], h, step=h),
    "lqr": lambda h: dt.lqr(PLANT, np.eye(2), [[1.0]], step=h),
    "place": lambda h: dt.place(PLANT, [-1, -2], step=h),
    "kalman": lambda h: dt.kalman(PLANT, [[1.0, 0.0]], np.eye(2), [[1.0]], step=h),
    "luenberger": lambda h: dt.luenberger(PLANT, [[1.0, 0.0]], [-3, -4], step=h),
    "digital": lambda h: LAW.digital(h),
    "growth_rate": lambda h: dt.growth_rate(PLANT, LAW, 0, step=h),
    "gain_margin": lambda h: dt.gain_margin(PLANT, LAW, step=h),
    "Controller": lambda h: dt.Controller(LAW, h),
}


@pytest.mark.parametrize("step", HUGE)
@pytest.mark.parametrize("function", TIMES)
def test_a_step_over_which_the_plant_overflows_is_refused_by_name(function, step):
    with pytest.raises(dt.ArgumentError, match="step") as refusal:
        TIMES[function](step)
    assert f"{step:g} s" in str(refusal.value)


@pytest.mark.parametrize(
    ("horizon", "step"), [(1.0, 1e300), (1.0, 1e10), (1e-300, 0.01), (5e-324, 0.01), (1e-12, 0.01)]
)
def test_a_horizon_of_no_step_at_all_is_refused(horizon, step):
    plant = dt.SwitchedSystem([[[-1.0]]], [[[1.0]]], 1.0)
    law = dt.AveragedPredictor(plant, [[[-1.0]]])
    message = re.escape(f"horizon = {horizon:g} s and step = {step:g} s")
    with pytest.raises(dt.ArgumentError, match=message):
        dt.simulate(plant, law, SIGNAL, [1.0], horizon, step=step)
    with pytest.raises(dt.ArgumentError, match=message):
        dt.monte_carlo(plant, [law], [SIGNAL], [1.0], horizon, step=step)


def test_an_ideal_run_far_shorter_than_the_delay_is_refused():
    with pytest.raises(dt.ArgumentError, match=r"horizon must be at least 1e-09 of the delay"):
        dt.simulate(PLANT, LAW, SIGNAL, [-1, 1], 1e-300, step=None)


@pytest.mark.parametrize("horizon", [1e-6, 1e-3])
def test_a_run_far_shorter_than_a_step_costs_what_its_integral_says(horizon):
    plant = dt.SwitchedSystem([[[-1.0]]], [[[1.0]]], 1.0)
    law = dt.AveragedPredictor(plant, [[[-1.0]]])
    run = dt.simulate(plant, law, SIGNAL, [1.0], horizon, step=100.0)
    figures = run.metrics()
    assert figures["ise"] == pytest.approx(-np.expm1(-2.0 * horizon) / 2.0, rel=1e-9)
    assert figures["energy"] == pytest.approx(horizon * float(run.inputs[0, 0] ** 2), rel=1e-9)
    assert figures["decay_rate"] == pytest.approx(1.0, rel=1e-6)


def plant_of(size, delay=1.0):
    return dt.SwitchedSystem([[[size, size], [0.0, -1.0]]], [[[1.0], [1.0]]], delay)


@pytest.mark.parametrize("size", [1e308, -1e308])
def test_a_delay_over_which_a_norm_overflows_is_refused(size):
    with pytest.raises(dt.ArgumentError, match=r"delay must be short enough .* got 1 s .* 1e\+308"):
        plant_of(size)
    with pytest.raises(dt.ArgumentError, match=r"delay must be short enough .* got 1e\+308 s"):
        plant_of(1e3, 1e308)


ENORMOUS = {
    "simulate": lambda plant, law: dt.simulate(plant, law, SIGNAL, [1.0, 1.0], 1.0),
    "the ideal loop": lambda plant, law: dt.simulate(
        plant, law, SIGNAL, [1.0, 1.0], 1.0, step=None
    ),
    "under a rule": lambda plant, law: dt.simulate(plant, law, HALF, [1.0, 1.0], 1.0),
    "monte_carlo": lambda plant, law: dt.monte_carlo(plant, [law], [SIGNAL], [1.0, 1.0], 1.0),
    "growth_rate": lambda plant, law: dt.growth_rate(plant, law, 0),
    "characteristic_roots": lambda plant, law: characteristic_roots(plant, law, 0),
    "lqr": lambda plant, law: dt.lqr(plant, np.eye(2), [[1.0]]),
    "falsify": lambda plant, law: dt.falsify(plant, law, 1.0),
}


@pytest.mark.parametrize("size", [9e307, 1e200, 1e20])
@pytest.mark.parametrize("function", ENORMOUS)
def test_a_plant_of_enormous_entries_is_refused(function, size):
    plant = dt.SwitchedSystem([[[size, 0.0], [0.0, -1.0]]] * 2, [[[1.0], [1.0]]] * 2, 1.0)
    law = dt.AveragedPredictor(plant, [[[-1.0, -1.0]]] * 2, allow_unstable=True)
    with pytest.raises(dt.ArgumentError):
        ENORMOUS[function](plant, law)


def test_gains_that_overflow_with_the_plant_are_refused_by_name():
    K = np.full((2, 1, 2), 1e308)
    plant = dt.SwitchedSystem(PLANT.A, 10.0 * PLANT.B, 1.0)
    for function in (dt.AveragedPredictor, dt.common_lyapunov, dt.theorem_bound):
        rest = (1.0,) if function is dt.theorem_bound else ()
        with pytest.raises(dt.ArgumentError, match=r"gains\[0\] must keep A \+ B K of mode 0"):
            function(plant, K, *rest)


@pytest.mark.parametrize("size", [1e308, 1e9])
def test_a_dwell_time_of_too_many_periods_is_refused_before_anything_is_laid_out(size):
    for ask in (dt.certify, dt.falsify):
        with pytest.raises(dt.ArgumentError, match=r"dwell_time / step = .* periods, at most"):
            ask(PLANT, LAW, size, step=0.1)
    with pytest.raises(dt.ArgumentError, match=r"maximum_dwell / step = .* periods, at most"):
        dt.certify(PLANT, LAW, 0.2, step=0.1, maximum_dwell=size)
    with pytest.raises(dt.ArgumentError, match=r"chatter · dwell_time / step must be at most"):
        dt.certify(PLANT, LAW, 0.2, step=0.1, chatter=int(size))


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (10**400, "x must be below 1.8e308 in size, got 1000"),
        (Fraction(10**400), "x must be below 1.8e308 in size, got Fraction"),
        pytest.param(
            -(10**5000),
            "x must be below 1.8e308 in size, got an integer of thousands of digits.",
            id="5000 digits",
        ),
        pytest.param(BEYOND, "x must be finite, got 1e+4000, which is beyond 1.8e308", marks=WIDE),
        (np.ma.masked, "x must be a number, got a masked one: fill them"),
        (np.ma.array(1.0, mask=True), "x must be a number, got a masked one"),
        (1 + 2j, "x must be a real number, got (1+2j). Pass its .real"),
        (np.array([1.0]), "x must be one number, got an array of shape (1,)."),
        ([1.0], "x must be a number, got [1.0], a list."),
        ("1e3", "x must be a number, got '1e3', a str: pass it without quotes"),
        (np.nan, "x must be finite, got nan."),
    ],
)
def test_what_is_no_number_of_floats_is_refused_and_said_on_one_short_line(value, message):
    with pytest.raises(dt.ArgumentError, match=re.escape(message)) as refusal:
        number("x", value)
    assert len(str(refusal.value)) < 400
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ([10**400, 1.0], "x must hold real numbers, got an entry of 1.8e308 or more"),
        ([10**5000], "x must hold real numbers, got an entry of 1.8e308 or more"),
        (np.ma.array([1.0, 2.0], mask=[0, 1]), "x must be whole, got masked entries: fill them"),
        ([np.ma.array([1.0], mask=[1]), [2.0]], "x must be whole, got masked entries"),
        ([1.0, np.ma.masked], "x must be whole, got masked entries"),
        ([1.0, 2j], "x must hold real numbers, got an array of complex128. Pass its .real"),
        (["1"], "x must hold real numbers, got an array of <U1. Convert text with float."),
        ([None], "x must hold real numbers, got an array of object."),
    ],
)
@pytest.mark.parametrize(
    "check", [lambda v: real_array("x", v, "(n,)", 1), lambda v: as_floats("x", v, "(n,)")]
)
def test_what_is_no_array_of_floats_is_refused(check, value, message):
    pattern = re.escape(message).replace("numbers,", r"numbers,( \(n,\),)?")
    with pytest.raises(dt.ArgumentError, match=pattern):
        check(value)


@WIDE
def test_a_longdouble_beyond_doubles_is_named_with_its_place():
    with pytest.raises(dt.ArgumentError, match=r"x\[1\] must be finite, got 1e\+4000, which is"):
        real_array("x", np.array([1.0, BEYOND]), "(n,)", 1)
    assert real_array("x", np.array([1.0, np.longdouble(0.1)]), "(n,)", 1)[1] == 0.1


def test_whole_masked_arrays_and_integers_beyond_64_bits_are_numbers():
    assert real_array("x", np.ma.array([1.0, 2.0]), "(n,)", 1).tolist() == [1.0, 2.0]
    assert real_array("x", [10**30, 1], "(n,)", 1).tolist() == [1e30, 1.0]
    assert number("x", 10**30) == 1e30
    assert number("x", np.array(2.5)) == 2.5


def test_huge_integers_are_refused_where_indices_and_counts_are_asked_for():
    with pytest.raises(
        dt.ArgumentError, match=r"mode must be in 0..1, got an integer of thousands"
    ):
        index("mode", 10**5000, 2)
    with pytest.raises(dt.ArgumentError, match="seed must be an integer of at least 0"):
        count("seed", -(10**5000), 0)
    assert len(brief("x" * 1000)) < 250


MASKED = np.ma.array([[1.0, 2.0]], mask=[[0, 1]])
ARGUMENTS = {
    "A": lambda: dt.SwitchedSystem(np.ma.array(PLANT.A, mask=PLANT.A > 2.2), PLANT.B, 1.0),
    "x0": lambda: dt.simulate(PLANT, LAW, SIGNAL, MASKED[0], 1.0),
    "u0": lambda: dt.simulate(PLANT, LAW, SIGNAL, [1, 1], 1.0, u0=MASKED[0, 1:]),
    "times": lambda: dt.simulate(PLANT, LAW, SIGNAL, [1, 1], 1.0, times=MASKED[0]),
    "modes": lambda: dt.SwitchingSignal([0.0, 1.0], MASKED[0]),
    "t": lambda: SIGNAL(MASKED),
    "poles": lambda: dt.place(PLANT, -MASKED[0]),
    "weights": lambda: dt.AveragedPredictor(PLANT, GAINS, weights=MASKED[0]),
    "gains": lambda: dt.AveragedPredictor(PLANT, np.ma.array(GAINS, mask=GAINS < -12.5)),
    "time_constant": lambda: dt.LowPassPredictor(LAW, MASKED[:, 1:]),
    "first": lambda: dt.SignalBatch(
        np.ma.array([0, 1], mask=[0, 1]), np.zeros(1), np.zeros(1, int), np.ones(1), np.zeros(1)
    ),
}


@pytest.mark.parametrize("name", ARGUMENTS)
def test_masked_entries_are_refused_wherever_arrays_are_taken(name):
    with pytest.raises(dt.ArgumentError, match=rf"^{name}.* masked"):
        ARGUMENTS[name]()


@pytest.mark.parametrize(
    ("ask", "message"),
    [
        (lambda: dt.SwitchedSystem(PLANT.A, [[[0, 1]], [[0, 1.02]]], 1.0), "pass the transpose"),
        (lambda: dt.SwitchedSystem(PLANT.A, [[0, 1], [0, 1.02]], 1.0), "[[[0], [1]], …] for col"),
        (lambda: dt.SwitchedSystem(PLANT.A[:1], [0, 1], 1.0), "[[[0], [1]], …] for columns"),
        (lambda: dt.AveragedPredictor(PLANT, GAINS.swapaxes(1, 2)), "pass the transpose"),
        (lambda: dt.AveragedPredictor(PLANT, GAINS[:, 0]), "[[[1, 2]], …] for rows"),
        (
            lambda: dt.place(PLANT, [1, 2]),
            "poles of mode 0 must have negative real parts, got 2: a loop with this pole does not "
            "decay; write -2",
        ),
        (lambda: dt.place(PLANT, [-1.0, 0.0]), "poles of mode 0 must have negative real parts"),
        (lambda: dt.place(PLANT, [1 + 2j, 1 - 2j]), "negative real parts, got 1+2j"),
        (lambda: dt.place(PLANT, ["-4+2i", "-4-2i"]), "Write a complex pole as -4+2j"),
        (lambda: dt.place(PLANT, "-4+2i"), "without quotes"),
        (
            lambda: dt.simulate(PLANT, LAW, [0, 1], [1, 1], 1.0),
            "signal must be a SwitchingSignal or a rule, got a list: modes need the times",
        ),
    ],
)
def test_unit_checks_of_shape_and_sign_are_told_what_to_write_instead(ask, message):
    with pytest.raises(dt.ArgumentError, match=re.escape(message)):
        ask()
