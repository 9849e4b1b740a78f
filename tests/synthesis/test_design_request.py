"""What a design for margin makes of a request of two floors: a delay margin and a decay rate."""

import math
from dataclasses import replace

import numpy as np
import pytest

import deadtime as dt
from deadtime.reports.design import HEADINGS, design_record, design_rows, plot_designs
from deadtime.synthesis.design_result import Floors

# A quadrotor's roll axis with and without payload: poles that turn, in two modes under one law.
PLANT = dt.SwitchedSystem(
    [[[0.0, 1.0, 0.0], [0.0, 0.0, J], [0.0, 0.0, -20.0]] for J in (50.0, 28.6)],
    [[[0.0], [0.0], [20.0]]] * 2,
    0.06,
)
GAINS = dt.place(PLANT, [-5.0 + 3.0j, -5.0 - 3.0j, -20.0])


def designed(margin, decay, budget, **options):
    return dt.design(
        PLANT,
        delay_margin=margin,
        decay_rate=decay,
        step=0.005,
        gains=GAINS,
        budget=budget,
        **options,
    )


@pytest.fixture(scope="module")
def short():
    """More decay than was found, with the margin."""
    return designed(0.9, 6.0, 60)


@pytest.mark.few(2)
@pytest.mark.parametrize("floors", [(0.9, 3.0), (0.9, 2.9), (0.5, 3.0), (0.5, 2.9)])
@pytest.mark.parametrize("filtered", [None, False])
def test_the_plain_design_counts_and_is_the_dearest_answer_where_it_meets_the_request(
    floors, filtered
):
    found = designed(*floors, 20, filtered=filtered)
    assert not found.missed(found.plain)
    assert found.reached
    assert found.cost <= found.plain.cost
    rates = [dt.growth_rate(PLANT, found.law, mode, 0.005) for mode in range(2)]
    assert -max(rates) >= floors[1]


def test_a_plain_design_that_is_chosen_is_one_row_and_one_ringed_mark():
    found = designed(0.9, 3.0, 20, filtered=False)
    assert found.law is found.plain.law
    assert "It is the plain design" in found.message
    assert [row[0] for row in design_rows(found)].count("plain, chosen") == 1
    assert ringed(found) == pytest.approx([100.0 * found.margin.relative])


def ringed(found):
    """The margins that the chart rings, percent."""
    panel = plot_designs({"": found}).axes[0]
    rings = [line for line in panel.lines if line.get_markersize() == 10.0]
    return np.concatenate([line.get_xdata() for line in rings])


def test_turning_poles_are_sped_up_and_cost_less_than_the_plain_design():
    slow_poles = dt.place(PLANT, [-4.0 + 3.0j, -4.0 - 3.0j, -20.0])
    options = {"step": 0.005, "gains": slow_poles, "budget": 150}
    found = dt.design(PLANT, delay_margin=0.9, decay_rate=3.0, **options)
    assert found.plain.decay_rate < 3.0
    assert found.reached
    assert found.cost < 0.75


@pytest.mark.long
def test_a_larger_budget_never_costs_more_and_a_decay_of_two_is_cheap():
    costs = [designed(0.9, 2.0, budget).cost for budget in (20, 75, 150)]
    assert costs[0] >= costs[1] >= costs[2]
    assert costs[2] < 0.622


def test_what_is_missed_is_the_decay_rate_and_the_offer_keeps_the_margin(short):
    assert not short.reached
    assert short.margin.relative >= 0.9 * (1.0 - 0.02)
    assert short.decay_rate >= short.plain.decay_rate
    missing = 6.0 - short.decay_rate
    assert f"It misses the decay rate asked for by {missing:.3g} /s, not the margin." in (
        short.message
    )


def test_what_is_missed_is_the_margin():
    plant = dt.SwitchedSystem([[[1.0]]], [[[1.0]]], 1.0)
    found = dt.design(plant, delay_margin=0.6, step=0.1, budget=40)
    assert found.missed(replace(found.plain, margin=0.7)) == ()
    assert "It misses the margin asked for by" in found.message
    assert "decay rate" not in found.message


def test_the_chosen_design_is_a_row_and_a_mark_and_rows_say_what_they_miss(short):
    rows = [dict(zip(HEADINGS, row, strict=True)) for row in design_rows(short)]
    (chosen,) = [row for row in rows if "chosen" in row["design"]]
    assert chosen["unmet"] == "decay rate"
    assert rows[0]["unmet"] == "decay rate"
    (point,) = [point for point in design_record(short)["points"] if point["chosen"]]
    assert point["missed"] == ["decay rate"]
    assert ringed(short) == pytest.approx([100.0 * short.margin.relative])


def test_points_decay_as_fast_as_asked_where_some_do():
    found = designed(0.5, 2.0, 100)
    assert found.reached
    assert all(point.decay_rate >= 2.0 for point in found.points)
    assert "chosen" in [row[0] for row in design_rows(found)]


def test_the_legend_says_what_every_mark_is_and_nothing_else(short):
    def legend(design):
        return {text.get_text() for text in plot_designs({"": design}).legends[0].get_texts()}

    labels = legend(short)
    assert {"chosen", "plain design", "hollow: slower than asked", "margin asked for"} <= labels
    assert "beyond reach in some mode" not in labels
    calm = dt.SwitchedSystem([[[-1.0]]], [[[1.0]]], 1.0)
    found = dt.design(calm, delay_margin=0.2, step=0.1, gains=[[[-0.3]]], budget=20)
    assert math.isinf(found.margin.relative)
    labels = legend(found)
    assert {"chosen", "stable whatever the delay"} <= labels
    assert "hollow: slower than asked" not in labels
    both = {"short": short, "calm": found}
    for figure in (plot_designs(both), plot_designs(both, columns=1)):
        figure.draw_without_rendering()
        width, legend = figure.bbox.width, figure.legends[0].get_window_extent()
        assert 0.0 <= legend.x0 < legend.x1 <= width


def test_every_design_that_is_tried_is_told():
    told = []
    plant = dt.SwitchedSystem([[[1.0]]], [[[1.0]]], 1.0)
    found = dt.design(plant, delay_margin=0.2, step=0.1, budget=25, progress=told.append)
    assert told == ["trying designs"] * found.evaluated
    assert 0 < found.evaluated <= 25


def test_the_axis_of_margins_names_the_delay_that_they_are_shares_of():
    asked = {"delay_margin": 0.2, "step": 0.1, "gains": [[[-0.3], [0.0]]], "budget": 20}
    for delay, label in ((1.0, "D"), ([1.0, 0.5], "the shortest delay")):
        plant = dt.SwitchedSystem([[[-1.0]]], [[[1.0, 0.5]]], delay)
        _, panel = plot_designs({"": dt.design(plant, **asked)}).axes
        assert panel.get_xlabel() == f"delay margin (% of {label})"


def test_a_shortfall_counts_only_what_is_asked_for():
    assert Floors(0.1).shortfall(math.inf, -1.0) == 0.0
    assert Floors(0.1, 1.0).shortfall(0.05, 0.5) == pytest.approx(2.0 * math.log(2.0))
    assert Floors(0.1, 1.0).shortfalls(0.05, 0.5) == ("margin", "decay rate")
