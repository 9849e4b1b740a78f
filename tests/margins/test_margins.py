"""The search for margins, on answers that are made up: the logic without the certificates."""

import re
from dataclasses import dataclass
from importlib import import_module
from types import SimpleNamespace

import numpy as np
import pytest

import deadtime as dt
from deadtime.margins import stability_chart, stability_margin
from deadtime.margins.stability import Questions, bracket

TRUTH = 0.6391  # the made-up loops are stable below


@dataclass
class Made:
    """A certificate or a worst case that is made up."""

    value: float
    stable: bool | None = None
    growth_rate: float | None = None
    proven: bool = True
    message: str = "made up."
    witness: object = None

    @property
    def grows(self):
        return self.proven and self.growth_rate > 0.0


def always(value):
    return True


def never(value):
    return False


def questions(stable, provable=always, findable=always, constant=always):
    """Answers for a loop that is stable where `stable` says so.

    A proof succeeds where the loop is stable and `provable`, a witness is found where it is not
    stable and `findable`, and it is a constant mode that grows where `constant`.
    """
    asked = SimpleNamespace(proofs=[], searches=[], glances=[])

    def grows(value):
        asked.glances.append(value)
        return not stable(value) and constant(value)

    def certify(value):
        asked.proofs.append(value)
        if not stable(value) and findable(value):
            return Made(value, stable=False, witness=Made(value, growth_rate=0.1))
        good = stable(value) and provable(value)
        return Made(value, stable=True if good else None, message=f"no answer at {value:.4g}.")

    def falsify(value):
        asked.searches.append(value)
        grows = not stable(value) and findable(value)
        return Made(value, stable=False, growth_rate=0.1 if grows else -0.1)

    return Questions(grows, certify, falsify), asked


@pytest.mark.parametrize("interval", [(0.0, 1.0), (0.1, 0.7), (0.6, 0.65), (0.0, 100.0)])
@pytest.mark.parametrize("ratio", [1.001, 1.01, 1.1])
@pytest.mark.parametrize("constant", [always, never, lambda value: value > 0.645])
def test_tight_answers_give_a_tight_bracket_around_the_truth(interval, ratio, constant):
    ask, asked = questions(lambda value: value < TRUTH, constant=constant)
    found = bracket(ask, *interval, ratio)
    assert found.certified < TRUTH <= found.refuted
    assert found.refuted / found.certified <= ratio
    assert found.certificate.value == found.certified
    assert found.witness.value == found.refuted
    assert found.open is None
    assert len(asked.proofs) <= 3  # proofs are dear
    if constant is always:
        assert asked.searches == [found.refuted]  # and searches are


@pytest.mark.parametrize("slack", [0.999, 0.98, 0.9, 0.5])
def test_certificates_with_slack_are_found_as_far_up_as_they_go(slack):
    ask, asked = questions(lambda v: v < TRUTH, provable=lambda v: v < slack * TRUTH)
    found = bracket(ask, 0.0, 1.0, 1.01)
    assert slack * TRUTH / 1.01 <= found.certified <= slack * TRUTH
    assert TRUTH <= found.refuted <= 1.01 * TRUTH
    value, reason = found.open
    assert found.certified < value <= 1.01 * found.certified
    assert reason == f"no answer at {value:.4g}."
    assert len(asked.proofs) <= 16


def test_a_witness_from_the_certificate_itself_moves_the_refuted_end():
    ask, _ = questions(lambda value: value < TRUTH, findable=lambda value: value > 0.8)
    blind = ask.certify

    def certify(value):
        if value < TRUTH:
            return blind(value)
        return Made(value, stable=False, witness=Made(value, growth_rate=0.2))

    found = bracket(Questions(never, certify, ask.falsify), 0.0, 1.0, 1.01)
    assert found.certified < TRUTH <= found.refuted <= 1.01 * found.certified
    assert found.witness.value == found.refuted


def test_between_proofs_and_witnesses_that_miss_the_truth_the_bracket_stays_wide():
    ask, _ = questions(
        lambda value: value < TRUTH,
        provable=lambda value: value < 0.5,
        findable=lambda value: value > 0.8,
        constant=never,
    )
    found = bracket(ask, 0.0, 1.0, 1.01)
    assert 0.495 < found.certified < 0.5
    assert 0.8 < found.refuted < 0.81
    assert 0.5 <= found.open[0] < 0.505


def test_nothing_refuted_leaves_the_upper_end_open():
    ask, _ = questions(lambda value: True)
    found = bracket(ask, 0.1, 1.0, 1.01)
    assert (found.certified, found.refuted, found.witness, found.open) == (1.0, None, None, None)
    ask, _ = questions(lambda value: True, provable=lambda value: value < 0.5)
    found = bracket(ask, 0.1, 1.0, 1.01)
    assert 0.495 < found.certified < 0.5 <= found.open[0] < 0.505
    assert found.refuted is None


def test_low_without_a_certificate_is_refused_with_its_reason():
    ask, _ = questions(lambda value: value < TRUTH, findable=never)
    with pytest.raises(
        dt.ArgumentError, match=r"low = 0\.7 must be certified .* no answer at 0\.7\."
    ):
        bracket(ask, 0.7, 1.0, 1.01)


def test_an_unstable_island_below_the_proved_end_moves_the_bracket_below_it():
    def stable(value):
        return value < 0.3 or 0.4 < value < 0.7

    ask, _ = questions(stable)
    found = bracket(ask, 0.0, 1.0, 1.01)
    assert found.certified < 0.3 <= found.refuted <= 1.01 * found.certified
    assert all(0.4 < value < 0.7 for value in found.again)
    assert found.again


@pytest.mark.parametrize(("low", "close"), [(0.0, 2e-6), (-1.0, 0.01)])
def test_a_margin_of_nothing_ends_the_search(low, close):
    ask, asked = questions(lambda value: value <= low)
    found = bracket(ask, low, 1.0, 1.01)
    assert found.certified == low
    assert low < found.refuted <= low + close
    assert len(asked.proofs) == 1
    assert len(asked.searches) == 1


# -- the public function -------------------------------------------------------------------------


@pytest.fixture
def made_up(monkeypatch):
    """The three questions, answered from the one entry of the plant's matrix."""

    def install(stable, **how):
        ask, asked = questions(stable, **how)

        def of(function):
            def called(plant, law, *given, **options):
                assert given in ((dt.SignalClass(0.2), 0.01), (0, 0.01))
                return function(plant.A[0, 0, 0])

            return called

        def replaced(module, name, function):
            monkeypatch.setattr(import_module(f"deadtime.{module}"), name, function)

        replaced("certificates", "certify", of(ask.certify))
        replaced("certificates", "falsify", of(ask.falsify))
        replaced("margins.stability", "growth_rate", of(lambda v: 1.0 if ask.grows(v) else -1.0))
        replaced("margins.stability", "growth_bounds", of(lambda v: (1.0, 1.0)))
        return asked

    return install


def loop(value):
    plant = dt.SwitchedSystem([[[value]]], [[[1.0]]], delay=1.0)
    return plant, dt.DelayedStateFeedback(plant, [[[-5.0]]])


def test_a_margin_says_what_was_found_and_everything_that_was_asked(made_up):
    asked = made_up(lambda value: value < TRUTH)
    margin = stability_margin(loop, (0.0, 1.0), 0.2)
    assert margin.certified < TRUTH <= margin.refuted
    assert margin.ratio == margin.refuted / margin.certified <= 1.01
    assert margin.proven
    words = (
        r"At (\S+) proved stable for every admissible switching signal, at (\S+) not: a growing "
        r"signal is known\."
    )
    proved, refuted = map(float, re.findall(words, margin.message)[0])
    # Rounded away from what is open: no more is said than was proved.
    assert 0.0 <= margin.certified - proved < 1e-5
    assert 0.0 <= refuted - margin.refuted < 1e-5
    values = [value for value, _ in margin.evaluations]
    assert values == sorted({*asked.proofs, *asked.searches, *asked.glances})
    answers = dict(margin.evaluations)
    assert answers[margin.certified] is True
    assert answers[margin.refuted] is False


def test_the_message_tells_why_a_bracket_is_wide_or_open(made_up):
    made_up(lambda value: value < TRUTH, provable=lambda value: value < 0.5)
    margin = stability_margin(loop, (0.0, 1.0), 0.2)
    assert margin.ratio > 1.25
    assert " No answer at 0.50" in margin.message
    assert "no answer at 0.50" in margin.message
    made_up(lambda value: True)
    margin = stability_margin(loop, (0.0, 1.0), 0.2)
    assert (margin.certified, margin.refuted, margin.ratio) == (1.0, None, None)
    assert margin.message.endswith("; nothing higher was refuted. Look higher.")
    made_up(lambda value: value < 0.3 or 0.4 < value < 0.7)
    margin = stability_margin(loop, (0.0, 1.0), 0.2)
    assert "Not monotone: certified above that again, at 0.69" in margin.message
    made_up(lambda value: value <= 0.0)
    assert stability_margin(loop, (0.0, 1.0), 0.2).ratio == np.inf


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (((1.0, 0.5), 0.2), r"low < high, got \(1, 0\.5\): to search downwards"),
        (((0.0, 1.0, 2.0), 0.2), r"bounds must be two values \(low, high\), got 3"),
        (((0.0, np.inf), 0.2), r"bounds\[1\] must be finite"),
        (((0.0, 1.0), 0.0), "dwell_time must be positive"),
        (((0.0, 1.0), 0.2, -1.0), "step must be positive"),
        (((0.0, 1.0), 0.2, 0.01, 1.0), "ratio must be above 1, got 1"),
    ],
)
def test_bad_requests_for_a_margin_are_refused_by_name(arguments, message):
    with pytest.raises(dt.ArgumentError, match=message):
        stability_margin(loop, *arguments)


def test_a_chart_holds_a_margin_per_law_and_dwell_time_or_the_reason(made_up):
    made_up(lambda value: value < TRUTH)
    seen = []
    laws = {
        "as is": lambda value, time: loop(value),
        "worse": lambda value, time: loop(value + 1.0),
    }
    chart = stability_chart(laws, (0.0, 1.0), [0.2], progress=seen.append)
    assert seen == ["as is, dwell time 0.2 s", "worse, dwell time 0.2 s"]
    assert chart.certified("as is") < TRUTH <= chart.refuted("as is") <= 1.02 * TRUTH
    assert np.isnan(chart.certified("worse"))
    assert np.isnan(chart.refuted("worse"))
    assert "low = 0 must be certified stable" in chart.reasons["worse", 0.2]
    with pytest.raises(dt.ArgumentError, match="at least one entry"):
        stability_chart({}, (0.0, 1.0), [0.2])


# -- the real answers ----------------------------------------------------------------------------


def apart(alpha):
    plant = dt.problems.paper().plant.apart(alpha)
    return plant, dt.AveragedPredictor(plant, dt.place(plant, [-1.0, -2.0]))


@pytest.mark.long
def test_the_paper_s_modes_may_be_between_0_65_and_0_66_as_far_apart_at_a_step_of_0_1():
    margin = dt.stability_margin(apart, (0.1, 1.0), dwell_time=0.2, step=0.1)
    assert 0.65 <= margin.certified < margin.refuted <= 0.66
    assert margin.ratio <= 1.01
    assert margin.proven
    assert margin.certificate.stable
    assert margin.witness.growth_rate > 0.0
    assert dt.growth_rate(*apart(margin.refuted), margin.witness.modes[0], 0.1) > 0.0


def test_a_law_with_a_margin_of_its_own_is_refused_where_it_is_unstable():
    with pytest.raises(dt.ArgumentError, match="must be certified stable, and is not: Not stable"):
        dt.stability_margin(apart, (0.7, 1.0), dwell_time=0.2, step=0.1)
    oracle = dt.problems.paper().laws["oracle"]
    with pytest.raises(dt.ArgumentError, match="The oracle knows the future switching"):
        dt.stability_margin(lambda a: (oracle.plant, oracle), (0.1, 1.0), 0.2, step=0.1)
