"""Modes that change at samples only: by words of modes, by hand, and by steps of the graph."""

import dataclasses
import itertools
import json
import math
from fractions import Fraction

import numpy as np
import pytest

import certificate_corpus as corpus
import certificate_reference as reference
import deadtime as dt
from deadtime.certificates.proof import check
from deadtime.certificates.proof.transitions import SwitchGraph
from deadtime.certificates.worst_case.cycles import Admissible
from deadtime.certificates.worst_case.run_search import _drawn
from deadtime.switching.signal_class import SignalClass

H = 0.1
SAMPLES = {"at": "samples"}


# -- a second method: every ring ------------------------------------------------------------------


def rings(sojourns, dwell, most):
    """The modes in the periods of all cycles of so many sojourns of `dwell` to `most`, in turns."""
    for lengths in itertools.product(range(dwell, most + 1), repeat=sojourns):
        yield tuple(k % 2 for k, length in enumerate(lengths) for _ in range(length))


def growth(loop, word, lag=0):
    """Of a cycle, 1/s: eigenvalues of the product of its periods, each under the row told."""
    count, M = len(word), np.eye(loop.order)
    rounds, age = word * (2 + lag), 0
    ages = []
    for k, mode in enumerate(rounds):
        age = age + 1 if k and rounds[k - 1] == mode else 0
        ages.append(age)
    for k in range(count):
        at = len(rounds) - count + k - lag
        row = loop.row(rounds[at], 10**6 if len(set(word)) == 1 else ages[at])
        (w, u), N, state = loop.outputs(row), loop.plant.count, np.eye(loop.plant.n, loop.order)
        x = loop.plant.rows(word[k]) @ np.concatenate((state, u[N], u[N - 1]))
        M = np.concatenate((x, w, *u[: loop.held])) @ M
    return math.log(np.abs(np.linalg.eigvals(M)).max()) / (count * H)


SWITCHED = np.array([[[0.0, 1.0], [-10.0, -1.0]], [[0.0, 1.0], [-0.1, -0.5]]])


def fed(law, delay=0.23):
    """A pair that grows where it is switched at the wrong moments, its inputs late."""
    plant = dt.SwitchedSystem(SWITCHED, [[[0.3], [0.5]], [[0.0], [1.0]]], delay)
    gains = [[[-0.3, -0.1]], [[-0.2, -0.4]]]
    return plant, law(plant, np.array(gains))


def averaged(plant, gains):
    return dt.AveragedPredictor(plant, gains, allow_unstable=True)


def by_mode(plant, gains):
    return dt.DelayedStateFeedback(plant, gains, allow_unstable=True)


def aged(plant, gains):
    return dt.AveragedPredictor(plant, gains, None, 0.25, allow_unstable=True)


CASES = {  # law, dwell time and longest sojourn in periods, lag, sojourns of a ring
    "one period": (averaged, 1, math.inf, 0, 2),
    "seven periods": (averaged, 7, math.inf, 0, 2),
    "four to five": (averaged, 4, 5, 0, 6),
    "rows by mode": (by_mode, 2, math.inf, 0, 2),
    "rows by mode, told late": (by_mode, 2, math.inf, 3, 2),
    "rows by age": (aged, 2, math.inf, 0, 2),
}


@pytest.mark.parametrize("name", CASES)
def test_the_worst_signal_is_that_of_all_rings_and_no_certificate_decays_faster(name):
    law, dwell, most, lag, sojourns = CASES[name]
    plant, law = fed(law)
    loop = reference.Loop(plant.A, plant.B, plant.delay, law.digital(H))
    turns = [ring for n in range(2, sojourns + 1, 2) for ring in rings(n, dwell, min(most, 20))]
    held = [(0,), (1,)] if math.isinf(most) else []
    worst = max(growth(loop, ring, lag) for ring in (*turns, *held))
    signals = dt.SignalClass(dwell * H, most * H, mode_lag=lag, **SAMPLES)
    found = dt.falsify(plant, law, signals, H, budget=4_000)
    assert found.growth_rate >= worst - 1e-6
    if len(found.cycle.modes) <= sojourns:
        assert found.growth_rate == pytest.approx(worst, abs=1e-6)
    periods = np.array(found.sojourns) / H
    assert found.phase == 0.0
    if not found.cycle.constant:
        assert np.abs(periods - periods.round()).max() < 1e-9
        assert dwell - 1e-9 <= periods.min() <= periods.max() <= most + 1e-9
    certificate = dt.certify(plant, law, signals, H, search_signals=False)
    assert (certificate.stable is True) <= (worst < 0.0)
    if certificate.stable:
        assert certificate.decay_rate <= -worst
    if found.proven:
        assert worst > 0.0


# -- by hand ----------------------------------------------------------------------------------


def test_modes_that_turn_by_half_in_a_period_only_shrink_at_samples():
    plant, law = corpus.half_turns()  # e^{A_i h} = −e^{−h/2} I in both
    for dwell in (H, 0.3 * H, 2 * H):
        found = dt.certify(plant, law, dwell, H, decay_rate=0.4999, **SAMPLES)
        assert found.stable, found.message
        worst = dt.falsify(plant, law, dwell, H, budget=2_000, **SAMPLES)
        assert worst.growth_rate == pytest.approx(-0.5, abs=1e-9)
    elsewhere = dt.falsify(plant, law, 1.2 * H, H, budget=8_000)
    assert elsewhere.proven


def test_delays_that_rise_by_a_period_at_most_and_fall_by_any_are_certified_close_to_the_limit():
    plant, law = corpus.delays_in_turn()
    step, slowest = 0.05, -max(dt.growth_rate(plant, law, i, 0.05) for i in range(4))
    anywhere = dt.certify(plant, law, 1.01 * step, step, **corpus.RISING)
    at_samples = dt.certify(plant, law, step, step, **corpus.RISING, **SAMPLES)
    assert at_samples.decay_rate >= anywhere.decay_rate > 1.13
    close = dt.certify(
        plant, law, step, step, decay_rate=0.99 * slowest, **corpus.RISING, **SAMPLES
    )
    assert 0.99 * slowest <= close.decay_rate <= slowest


# -- the graph --------------------------------------------------------------------------------


@pytest.mark.parametrize("tolerance", [1e-8, 1e-5, 0.1])
@pytest.mark.parametrize(
    ("dwell", "longest"),
    [(0.1, None), (0.05, None), (0.3, None), (0.25, 0.5), (0.3, 0.3), (1.2, 1.45), (0.7, 0.7)],
)
def test_sojourns_in_the_graph_are_the_admissible_whole_numbers_of_periods(
    dwell, longest, tolerance
):
    signals = dt.SignalClass(dwell, longest, clock_tolerance=tolerance, **SAMPLES)
    graph = SwitchGraph.of(2, signals, H, "mode_age", 3)
    part, h = Fraction(repr(tolerance)), Fraction(1, 10)
    least, most = ((1 - part) * Fraction(repr(dwell)), longest and Fraction(repr(longest)))
    leaves = {step.age: step for step in graph.all(tuple(range(graph.last + 1))) if step.switches}
    stays = {step.age for step in graph.all(tuple(range(graph.last + 1))) if not step.switches}
    for count in range(1, 21):  # periods
        allowed = count * h >= least and (not most or count * h <= (1 + part) * most)
        age = count - 1 if most else min(count - 1, graph.last)
        walks = all(a in stays or (not most and graph.last in stays) for a in range(count - 1))
        if most or count - 1 <= graph.last:
            assert allowed == (walks and age in leaves), count
    assert {(step.instants, step.within - step.mode) for step in leaves.values()} == {((1, 1), 0)}


def test_nearest_cycles_are_whole_and_of_the_length_asked_for():
    signals = Admissible.of(SignalClass(0.25, [0.6, 0.9], **SAMPLES), 2, H)
    rng, word = np.random.default_rng(1), (0, 1, 0, 1)
    low, high = signals.totals(word)
    assert (low, high) == (12, 30)
    for total in range(low, high + 1):
        gaps = signals.near(rng.uniform(0.0, 12.0, 4), total, word)
        assert gaps.sum() == total
        assert (gaps == gaps.round()).all()
        assert (gaps >= 3).all()
        assert (gaps <= [6, 9, 6, 9]).all()


# -- what is proved ------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["samples", "samples-turning", "samples-aged"])
def test_the_function_falls_at_every_step_by_definition(name):
    (plant, law), dwell, step, options = corpus.CASES[name][0](), *corpus.CASES[name][1:]
    found = dt.certify(plant, law, dwell, step, **options)
    loop = reference.Loop(plant.A, plant.B, plant.delay, law.digital(step))
    least = round(dwell / step) - 1
    slack = 1e-9 if name == "samples-turning" else 0.0
    for i, age in itertools.product(range(plant.modes), range(6)):
        M, V = loop.step(i, age), found.lyapunov(i, age)
        V = V + slack * np.linalg.norm(V) * np.eye(len(V))
        assert reference.decreases(V, found.lyapunov(i, age + 1), M, found.evidence.rho)
        for j in range(plant.modes) if age >= least else ():
            if j != i:
                assert reference.decreases(V, found.lyapunov(j, 0), M, found.evidence.rho)


def test_a_proof_at_samples_is_none_for_signals_that_switch_anywhere(tmp_path):
    plant, law = corpus.half_turns()
    found = dt.certify(plant, law, 0.2, H, **SAMPLES)
    signals = dataclasses.replace(found.evidence.setting.signals, at="anywhere")
    setting = dataclasses.replace(found.evidence.setting, signals=signals)
    assert not check(dataclasses.replace(found.evidence, setting=setting)).proven
    path = found.save(tmp_path / "cert.json")
    assert json.loads(path.read_text())["signals"]["at"] == "samples"
    assert dt.verify(path, plant, law).proven
    assert dt.verify(path, plant, law, dwell_time=0.3, at="samples").proven
    assert dt.verify(path, dwell_time=dt.SignalClass(0.3, 0.5, **SAMPLES)).proven
    for asked in ({"dwell_time": 0.3}, {"at": "anywhere"}, {"maximum_dwell": 0.5}):
        verdict = dt.verify(path, **asked)
        assert not verdict.proven
        assert "at samples only, not at any instant (at=, --at)" in verdict.message
    assert "switches at samples only, and for every initial state" in found.statement[0]


def test_a_proof_for_any_instant_is_one_at_samples(tmp_path):
    plant, law = corpus.designed(corpus.PAIR)
    path = dt.certify(plant, law, 0.2, H).save(tmp_path / "cert.json")
    assert dt.verify(path, plant, law, dwell_time=0.2, at="samples").proven


# -- other functions ---------------------------------------------------------------------------


def test_margins_take_the_class():
    plant, law = corpus.half_turns()
    signals = dt.SignalClass(H, **SAMPLES)
    least = dt.least_dwell_time(plant, law, H, 1.5, dwell_time=signals)
    assert least.certified == pytest.approx(H)
    assert least.refuted is None
    assert "0.1 s or more, of modes that change at samples only" in least.message
    delays = dt.delay_margin(plant, law, H, signals)
    assert "for at least 0.1 s, and switches at samples only: stable" in delays.message
    margin = dt.stability_margin(lambda _: (plant, law), (0.0, 1.0), signals, H)
    assert margin.certified == 1.0
    late = dt.longest_mode_lag(*fed(by_mode), dt.SignalClass(3.0, **SAMPLES), H, upto=1)
    assert late.certified == 1


def test_cycles_drawn_for_runs_are_whole():
    signals = Admissible.of(SignalClass(0.25, [0.6, 0.9], **SAMPLES), 2, H)
    drawn = list(_drawn(signals, 10.0, 40))
    assert len(drawn) == 40
    for cycle in drawn:
        assert cycle.offset == 0.0
        assert all(gap == round(gap) for gap in cycle.gaps)


WRONG = {
    'at must be "anywhere" or "samples", got \'sometimes\'': lambda: dt.SignalClass(
        0.2, at="sometimes"
    ),
    r"at must be \"anywhere\" or \"samples\", got array": lambda: dt.SignalClass(
        0.2, at=np.array(["samples", "samples"])
    ),
    r"transitions must have shape \(modes, modes\), got rows of": lambda: dt.SignalClass(
        0.2, transitions=[[0, 1], [1]]
    ),
    "maximum_dwell must not be given beside a SignalClass": lambda: dt.certify(
        *corpus.half_turns(), dt.SignalClass(0.2), H, maximum_dwell=1.0
    ),
    r"maximum_dwell must leave a sojourn of whole periods of 0\.1 s": lambda: dt.falsify(
        *corpus.half_turns(), 0.12, H, maximum_dwell=0.18, **SAMPLES
    ),
    r"mode_lag is what is sought": lambda: dt.longest_mode_lag(*fed(by_mode), 0.5, H, mode_lag=1),
}


def test_counts_of_numpy_are_counts():
    given = {name: np.int64(1) for name in ("mode_lag", "chatter")}
    assert all(type(getattr(dt.SignalClass(0.2, **given), name)) is int for name in given)
    assert type(dt.SignalClass(0.2, lost_samples=np.int64(1)).lost_samples) is int
    found = dt.certify(*fed(by_mode), dt.SignalClass(3.0, mode_lag=np.int64(1), **SAMPLES), H)
    assert "the mode is reported 1 period late" in " ".join(found.statement)


@pytest.mark.parametrize("message", WRONG)
def test_what_makes_no_sense_is_refused_by_name(message):
    with pytest.raises(dt.ArgumentError, match=message):
        WRONG[message]()
