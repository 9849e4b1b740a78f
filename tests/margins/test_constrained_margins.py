"""Margins where not every switch and not every sojourn is allowed: by hand, or by runs."""

import math

import numpy as np
import pytest

import deadtime as dt
from deadtime.base.errors import ArgumentError

# Three scalar modes in a ring, without feedback: |x| changes by the factor e^{Σ aᵢ Tᵢ} in a turn,
# which is largest where modes that grow last as long, and those that decay as short, as they may.
RING = [[0, 1, 0], [0, 0, 1], [1, 0, 0]]
RATES, LONGEST, DWELL = (-2.0, 0.4, 1.0), (math.inf, 0.8, 0.3), (0.4, 0.1, 0.1)
LEAST = (0.4 * 0.8 + 1.0 * 0.3) / 2.0  # of mode 0, seconds
RAREST = (2.0 * 0.4 - 0.4 * 0.8) / 0.3  # the growth of mode 2 with which the worst turn is 1
LIMITS = {"maximum_dwell": LONGEST, "transitions": RING}
H = 0.05


def loop(rates=RATES):
    """Two inputs with delays of their own, that do nothing."""
    plant = dt.SwitchedSystem([[[a]] for a in rates], np.ones((3, 1, 2)), [0.03, 0.064])
    return plant, dt.AveragedPredictor(plant, np.zeros((3, 2, 1)), allow_unstable=True)


def turn(rates, sojourns):
    return sum(a * T for a, T in zip(rates, sojourns, strict=True))


@pytest.mark.long
@pytest.mark.parametrize("mode", [None, 0])
def test_the_least_dwell_times_of_a_ring_hold_the_limit_between_them(mode):
    plant, law = loop()
    found = dt.least_dwell_time(plant, law, H, 1.1, dwell_time=DWELL, mode=mode, **LIMITS)
    assert found.proven
    assert found.refuted_each[0] <= LEAST <= found.certified_each[0] <= LEAST + 2.0 * H
    if mode is None:  # all in proportion
        assert np.allclose(np.array(found.certified_each) / found.certified, [4.0, 1.0, 1.0])
        assert found.certified == min(found.certified_each)
    else:
        assert found.certified_each[1:] == found.refuted_each[1:] == DWELL[1:]
        assert found.certified == found.certified_each[0]
        assert "in mode 0 of" in found.message
    worst = dict(zip(found.witness.modes, found.witness.sojourns, strict=True))
    assert turn(RATES, [worst[i] for i in range(3)]) > 0.0
    limits = dt.SignalClass(found.refuted_each, **LIMITS).limits(3)
    found.witness.signal.require_within(limits, 1.1e-5)
    limits = found.certificate.evidence.setting.limits
    assert limits.following == ((1,), (2,), (0,))
    assert limits.dwell_time == pytest.approx(found.certified_each, rel=1e-12)


@pytest.mark.long
def test_where_every_switch_is_allowed_no_dwell_time_is_long_enough():
    plant, law = loop()
    limits = {"dwell_time": DWELL, "mode": 0, "maximum_dwell": (math.inf, 0.8, 0.3)}
    free = dt.least_dwell_time(plant, law, H, 1.05, **limits)
    assert (free.certified, free.refuted) == (None, math.inf)  # 1 and 2 grow in turns for ever
    assert set(free.witness.modes) == {1, 2}
    assert free.message.startswith("No dwell time of mode 0 is long enough: ")


@pytest.mark.long
def test_the_stability_margin_of_a_ring_holds_the_limit_between_its_ends():
    """Held, modes 1 and 2 grow at every value: they may not be held."""
    given = {"dwell_time": DWELL, "step": H, "ratio": 1.05, **LIMITS}
    found = dt.stability_margin(lambda a: loop((-2.0, 0.4, a)), (0.1, 3.0), **given)
    assert found.proven
    assert found.certified <= RAREST <= found.refuted <= 1.05 * RAREST
    assert turn((-2.0, 0.4, found.refuted), found.witness.sojourns) > 0.0


# Under feedback mode 1 grows, if it is held; m = 2 and a delay off the grid.
PLANT = dt.SwitchedSystem(
    [[[-1.0]], [[0.5]], [[-0.3]]], [[[1.0, 0.2]], [[0.3, 0.1]], [[0.8, 0.2]]], 0.12
)
LAW = dt.DelayedStateFeedback(PLANT, [[[-1.5], [-0.3]]] * 3, allow_unstable=True)
SWITCHED = {
    "dwell_time": [0.5, 0.15, 0.3], "maximum_dwell": [1.0, 0.3, 0.6], "transitions": RING
}  # fmt: skip


def drawn(rng, seconds):
    """An admissible signal: sojourns of any length that is allowed, or one of the extremes."""
    times, modes = [0.0], [int(rng.integers(3))]
    while times[-1] < seconds:
        low, high = (SWITCHED[name][modes[-1]] for name in ("dwell_time", "maximum_dwell"))
        times.append(times[-1] + rng.choice([low, high, rng.uniform(low, high)]))
        modes.append((modes[-1] + 1) % 3)
    return dt.SwitchingSignal(times[:-1], modes[:-1], end=times[-1])


@pytest.mark.long
def test_a_delay_margin_goes_beyond_a_mode_that_grows_but_is_never_held():
    held = dt.delay_margin(PLANT, LAW, 0.1)
    assert (held.lower, held.upper_mode) == (None, 1)
    found = dt.delay_margin(PLANT, LAW, 0.1, upto=0.25, **SWITCHED)
    assert found.certified
    assert found.lower < 0.001
    assert found.upper == pytest.approx(0.25)
    assert found.relative == pytest.approx(min(1.0 - found.lower / 0.12, found.upper / 0.12 - 1.0))
    assert "0.15 to 0.3 s in mode 1" in found.message
    assert "but only so: from mode 0 to 1" in found.message
    assert "no mode may be held" in found.message
    rng = np.random.default_rng(1)
    for true in (0.002, 0.12, found.upper):
        plant = dt.SwitchedSystem(PLANT.A, PLANT.B, true)
        for _ in range(3):
            run = dt.simulate(plant, LAW, drawn(rng, 60.0), [1.0], 60.0, 0.1)
            assert np.abs(run.states[0, -100:]).max() < 0.1
    beyond = dt.SwitchedSystem(PLANT.A, PLANT.B, 1.6)
    worst = dt.falsify(beyond, LAW, step=0.1, budget=2_000, **SWITCHED)
    assert worst.proven
    assert worst.growth_rate > 0.0
    worst.signal.require_within(dt.SignalClass(**SWITCHED).limits(3), 1.1e-5)


BAD = {
    "dwell_time must be given with mode": lambda: dt.least_dwell_time(*loop(), H, mode=1),
    "mode must be": lambda: dt.least_dwell_time(*loop(), H, dwell_time=DWELL, mode=3),
    r"maximum_dwell must leave room above a period of 0\.05 s, and dwell times up to 0\.05 s": (
        lambda: dt.least_dwell_time(*loop(), H, maximum_dwell=[1.0, 0.05, 1.0])
    ),
    r"transitions must have shape": lambda: dt.least_dwell_time(*loop(), H, transitions=[[0, 1]]),
    "dwell_time must be given with transitions": lambda: dt.delay_margin(
        *loop(), H, transitions=RING
    ),
    r"maximum_dwell\[0\] must be at least dwell_time\[0\]": lambda: dt.delay_margin(
        *loop(), H, DWELL, maximum_dwell=[0.2, 1.0, 1.0]
    ),
    "transitions allows no switch to mode": lambda: dt.stability_margin(
        lambda a: loop((-2.0, 0.4, a)), (0.1, 1.0), DWELL, H, transitions=np.zeros((3, 3))
    ),
    "transitions must have": lambda: dt.longest_mode_lag(*loop(), DWELL, H, transitions=[[0]]),
}


@pytest.mark.parametrize("message", BAD)
def test_signals_that_cannot_be_are_refused_by_name(message):
    with pytest.raises(ArgumentError, match=message):
        BAD[message]()
