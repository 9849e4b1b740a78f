"""Design for margin says how fast its loop is, and takes a least decay rate."""

import dataclasses
import json

import pytest

import deadtime as dt
import plants
from deadtime.cli.application import main
from deadtime.synthesis.design_result import Floors
from deadtime.synthesis.design_search import DesignSearch
from deadtime.synthesis.gain_families import Poles

# Stable without an input: the cheapest loop with the widest margin hardly moves.
PLANT = dt.SwitchedSystem([[[-0.06]]], [[[1.0]]], 1.0)
GAINS = dt.place(PLANT, [-1.0])


def designed(**options):
    return dt.design(PLANT, delay_margin=0.2, step=0.1, gains=GAINS, budget=60, **options)


def slowest(found):
    return -dt.growth_rate(PLANT, found.law, 0, found.step)


def test_the_sentence_states_the_decay_rate_beside_the_cost():
    found = designed()
    assert found.cost < found.plain.cost
    assert found.decay_rate == pytest.approx(slowest(found), rel=1e-9)
    assert found.plain.decay_rate == pytest.approx(1.0, rel=0.1)
    assert (
        f"In its slowest constant mode it decays at {found.decay_rate:.3g} /s, the plain design at "
        f"{found.plain.decay_rate:.3g} /s."
    ) in found.message


@pytest.mark.parametrize("floor", [0.3, 0.6])
def test_a_least_decay_rate_is_kept(floor):
    free, found = designed(), designed(decay_rate=floor)
    assert found.reached
    assert slowest(found) >= floor
    assert found.margin.relative >= 0.2
    assert found.cost >= free.cost * (1.0 - 1e-9)
    assert f"({floor:.3g} /s asked)" in found.message


def test_a_decay_that_nothing_tried_has_is_not_reached():
    found = designed(decay_rate=500.0)
    assert not found.reached
    assert found.message.startswith("Not reached")
    assert "(500 /s asked)" in found.message


@pytest.mark.parametrize("rate", [-0.1, float("nan")])
def test_a_decay_rate_that_makes_no_sense_is_refused(rate):
    with pytest.raises(dt.ArgumentError, match="decay_rate must be"):
        designed(decay_rate=rate)


def test_the_command_takes_the_floor(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    arguments = ["--delay-margin", "0.05", "--decay-rate", "1.2", "--mode", "0", "--budget", "40"]
    with pytest.raises(SystemExit) as stopped:
        main(["design", "follower", "--step", "0.05", *arguments, "--json"])
    record = json.loads(capsys.readouterr().out)
    assert stopped.value.code == (0 if record["reached"] else 1)
    assert record["reached"] == (record["decay_rate"] >= 1.2)
    assert "(1.2 /s asked)" in record["message"]


def test_without_a_floor_an_estimate_that_hardly_grows_costs_nothing():
    plant = plants.scalar([0.5], delay=0.2)

    def law(plant, K):
        return dt.SingleModePredictor(plant, K, 0)

    search = DesignSearch(plant, law, 20, Floors(0.1))
    [start, *_] = Poles(plant, False).starts(dt.place(plant, [-1.0]))
    tried = search.evaluate(Poles(plant, False), 0.1, start)
    barely = dataclasses.replace(tried, growth=1e-12)
    assert search.cheapest()(barely) == search.cheapest()(tried)
