"""The same loop in seconds, milliseconds and hours: the same verdicts, and rates in proportion."""

import json

import numpy as np
import pytest

import deadtime as dt
import plants
from deadtime.spectrum import least_growth
from shares import mostly_long

UNITS = [1e3, 1.0 / 3600.0, 2.0**-40]  # milliseconds, hours, and far more: of a second


def in_unit(plant, unit):
    """The plant whose time is counted in other units, so many of which are a second."""
    return dt.SwitchedSystem(plant.A / unit, plant.B / unit, plant.delays * unit)


def turning(rate):
    """Two modes that grow at a rate whatever the input, which hardly acts."""
    A = np.array([[[rate, 1.0], [-1.0, rate]], [[-0.5, 0.2], [-0.2, -0.5]]])
    return dt.SwitchedSystem(A, np.full((2, 2, 1), 1e-3), 0.3)


def idle(plant):
    gains = np.zeros((plant.modes, plant.inputs, plant.states))
    return dt.DelayedStateFeedback(plant, gains, allow_unstable=True)


def averaged(plant, unit=1.0):
    return dt.AveragedPredictor(plant, dt.place(plant, np.array([-1.0, -2.0]) / unit))


@pytest.mark.parametrize("unit", UNITS)
def test_the_least_growth_and_rates_go_with_the_unit_of_time(unit):
    plant = dt.problems.paper().plant.apart(0.5)
    scaled = in_unit(plant, unit)
    assert least_growth(scaled) == pytest.approx(least_growth(plant) / unit, rel=1e-12)
    for mode in (0, 1):
        for step in (0.05, None):
            known = dt.growth_rate(plant, averaged(plant), mode, step)
            found = dt.growth_rate(scaled, averaged(scaled, unit), mode, step and step * unit)
            assert found * unit == pytest.approx(known, rel=1e-6)
        low, high = dt.growth_bounds(scaled, averaged(scaled, unit), mode, 0.05 * unit)
        assert 0.0 <= (high - low) * unit <= 1e-10


RATES = [(0.0, None), (2e-8, None), (-2e-8, None), (1e-5, False), (-1e-2, True)]  # 1/s, of |x|
VERDICTS = [(*rate, unit) for rate in RATES for unit in (1.0, *UNITS)]


@pytest.mark.parametrize(
    ("rate", "stable", "unit"),
    mostly_long(VERDICTS, *((*rate, 2.0**-40) for rate in RATES), (*RATES[1], 1e3)),
)
def test_a_mode_gets_the_same_verdict_whatever_the_unit_of_time(rate, stable, unit):
    plant = in_unit(turning(rate), unit)
    certificate = dt.certify(plant, idle(plant), 4.0 * unit, 0.1 * unit)
    assert certificate.stable is stable, certificate.message
    assert dt.falsify(plant, idle(plant), 4.0 * unit, 0.1 * unit).grows is (stable is False)
    if stable is None:
        assert "neither grows nor decays" in certificate.message
        if rate > 0.0:
            margin = dt.delay_margin(plant, idle(plant), 0.1 * unit)
            assert margin.message.endswith("neither grows nor decays")


@pytest.mark.parametrize("unit", UNITS)
def test_certificates_are_proved_in_any_unit_of_time(unit, tmp_path):
    plant = dt.problems.paper().plant.apart(0.3)
    known = dt.certify(plant, averaged(plant), 0.3, 0.1)
    scaled = in_unit(plant, unit)
    found = dt.certify(scaled, averaged(scaled, unit), 0.3 * unit, 0.1 * unit)
    assert found.proven
    assert found.decay_rate * unit == pytest.approx(known.decay_rate, rel=1e-6)
    path = found.save(tmp_path / "certificate.json")
    assert dt.verify(path, scaled, averaged(scaled, unit), step=0.1 * unit).proven
    assert json.loads(path.read_text(encoding="utf-8"))["law"]["step"] == 0.1 * unit


@pytest.mark.parametrize("unit", UNITS)
def test_margins_are_the_same_in_any_unit_of_time(unit):
    plant = plants.scalar(1.0, delay=0.2)
    law = dt.SingleModePredictor(plant, dt.place(plant, [-1.0]), 0)
    scaled = in_unit(plant, unit)
    its = dt.SingleModePredictor(scaled, dt.place(scaled, [-1.0 / unit]), 0)
    gain, delay = dt.gain_margin(plant, law, 0.05), dt.delay_margin(plant, law, 0.05)
    for found, known in (
        (dt.gain_margin(scaled, its, 0.05 * unit), (gain.lower, gain.upper)),
        (dt.gain_margin(in_unit(plant.like(plant.A, 9.0 * plant.B), unit), its, 0.05 * unit), None),
    ):
        ends = (found.lower, found.upper) if known else np.multiply(found.stabilising, 9.0)
        assert ends == pytest.approx(known or (gain.lower, gain.upper), rel=1e-8)
    other = dt.delay_margin(scaled, its, 0.05 * unit)
    assert other.upper / unit == pytest.approx(delay.upper, rel=1e-8)
