"""The report's section on certificates, on answers that are made up."""

from dataclasses import replace
from importlib import import_module
from types import SimpleNamespace

import numpy as np
import pytest

import deadtime as dt
from deadtime.problems import Problem
from deadtime.problems.comparison import compare
from deadtime.problems.switching_assumptions import dwell_time_of
from deadtime.reports.certificate_tables import Judged, certificate_rows, delay_sentence
from deadtime.reports.report import certificates_section, steps_of_section

LIMIT = 0.64


def distance_of(plant):
    """α of the paper's plant."""
    return (plant.A[1, 0, 0] - 2.0) / 0.3


@pytest.fixture
def made_up(monkeypatch):
    """Every law is stable for modes closer than the limit; else mode 1 for ever grows."""

    def worst(plant, law, grows):
        def simulate(cycles):
            signal = dt.SwitchingSignal.constant(1)
            return dt.simulate(plant, law, signal, [-1.0, 1.0], 5.0)

        return SimpleNamespace(
            growth_rate=0.28 if grows else -0.4,
            proven=grows,
            grows=grows,
            modes=(1,),
            sojourns=(np.inf,),
            length=1.0,
            step=0.01,
            signal=dt.SwitchingSignal.constant(1),
            message="worst.",
            simulate=simulate,
        )

    def falsify(plant, law, dwell_time, step, mode_lag=0, **others):
        return worst(plant, law, distance_of(plant) > LIMIT)

    def certify(plant, law, dwell_time, step, decay_rate=None, delays=None, mode_lag=0, **others):
        if isinstance(law, dt.ExactPredictor):
            return SimpleNamespace(
                stable=None, decay_rate=None, proven=False, message="Foresees.", statement=(),
                witness=None,
            )  # fmt: skip
        grows = distance_of(plant) > LIMIT
        return SimpleNamespace(
            stable=not grows,
            decay_rate=None if grows else 0.3,
            proven=not grows,
            message="Not stable: mode 1 for ever." if grows else "Stable.",
            statement=() if grows else ("For every signal.",),
            witness=worst(plant, law, True) if grows else None,
        )

    def constant_delay_margin(plant, law, step):
        if isinstance(law, dt.ExactPredictor):
            raise dt.ArgumentError("the oracle has no constant table.")
        return SimpleNamespace(lower=None, upper=None, differ=False, message="none, mode 1 grows")

    def growth_rate(plant, law, mode, step):
        return 0.28 if distance_of(plant) > LIMIT else -0.4

    for module, function in (
        ("margins.stability", growth_rate),
        ("certificates.certify", certify),
        ("certificates", certify),
        ("certificates.worst_case", falsify),
        ("certificates", falsify),
        ("margins.delay", constant_delay_margin),
    ):
        monkeypatch.setattr(import_module(f"deadtime.{module}"), function.__name__, function)


def closer(alpha):
    """The paper's problem, its modes moved."""
    problem = dt.problems.paper()
    plant = problem.plant.apart(alpha)
    gains = dt.place(plant, [-1.0, -2.0])
    laws = {"averaged": dt.AveragedPredictor(plant, gains)}
    return Problem(
        "closer", "", "", plant, gains, laws, problem.signal, problem.x0, horizon=3.0
    )  # fmt: skip


def test_laws_that_are_refuted_get_a_figure_of_their_witness(made_up):
    problem, said = dt.problems.paper(), []
    section = SimpleNamespace(**certificates_section(compare(problem), said.append))
    assert len(said) == steps_of_section(problem)
    assert section.about == (
        "Every signal that stays in each mode for at least 0.2 s (the problem's dwell time), "
        "switches at any time; sampling period 0.01 s."
    )
    names = [name for name, _, _ in section.figures]
    assert names == [
        "witness-averaged",
        "witness-mode-0-only",
        "witness-mode-1-only",
        "witness-mean",
    ]
    assert section.rows[0] == ("averaged", "no", "–", "witness", "−0.280", "none")
    assert ("oracle", "no answer", "–", "–", "–", "–") in section.rows
    assert section.sentences[0] == "averaged: Not stable: mode 1 for ever."
    assert section.statement == ()


def test_a_proof_is_stated_and_needs_no_figure_of_a_witness(made_up):
    section = SimpleNamespace(**certificates_section(compare(closer(0.5))))
    assert section.figures == []
    assert section.rows == [("averaged", "yes", "0.3", "yes", "+0.400", "none")]
    assert section.statement == ("For every signal.",)
    assert section.statement_of in {row[0] for row in section.rows if row[3] == "yes"}


def test_an_ideal_problem_is_asked_about_a_sampled_loop(made_up):
    problem = replace(closer(0.5), step=None)
    section = SimpleNamespace(**certificates_section(compare(problem)))
    assert "sampling period 0.01 s" in section.about
    assert section.rows[0][1] == "yes"


def test_modes_that_are_the_same_have_no_figure_of_distances(made_up):
    problem, said = closer(0.0), []
    section = SimpleNamespace(**certificates_section(compare(problem), said.append))
    assert len(said) == steps_of_section(problem)
    assert section.figures == []


def test_the_delay_margin_of_the_first_law_is_put_in_a_sentence(made_up):
    problem = dt.problems.paper()
    assert delay_sentence(problem) == ["Under the law “averaged” none, mode 1 grows."]
    oracle = Problem(
        "oracle", "", "", problem.plant, problem.gains, {"oracle": problem.laws["oracle"]},
        problem.signal, problem.x0, 3.0,
    )  # fmt: skip
    assert delay_sentence(oracle) == []


def test_certificates_are_asked_about_whole_periods():
    problem = closer(0.5)
    assert dwell_time_of(problem, dt.SwitchingSignal.constant(0)).value == 3.0
    for sojourn, dwell in ((0.07, 0.07), (0.0794, 0.07), (0.004, 0.004)):
        signal = dt.SwitchingSignal([0.0, sojourn], [0, 1], end=2.0 * sojourn)
        assert dwell_time_of(problem, signal).value == dwell


@pytest.mark.parametrize(
    ("rate", "text"), [(2.03518, "2.03"), (0.29996, "0.299"), (0.3, "0.3"), (0.0, "> 0")]
)
def test_a_proved_decay_rate_is_rounded_towards_zero(rate, text):
    proved = dt.Certificate(True, "", rate, proven=True)
    assert certificate_rows([Judged("law", proved, None, None)])[0][2] == text
