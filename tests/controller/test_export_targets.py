"""Targets of exports: each is an option of the command line, and all are filled from one record."""

from inspect import cleandoc

import numpy as np
import pytest

import deadtime as dt
import plants
from deadtime.cli.application import main
from deadtime.controller.export.forms import dense
from deadtime.controller.export.law_record import LawRecord
from deadtime.controller.targets import TARGETS

GAINS = plants.gains(plants.paper())
LAWS = {
    "one row": lambda plant: dt.AveragedPredictor(plant, GAINS),
    "by mode": lambda plant: dt.ExpectedPredictor(plant, GAINS, dt.Markov([[0, 1], [2, 0]])),
    "by mode and age": lambda plant: dt.AveragedPredictor(plant, GAINS, dwell_time=0.3),
}


def test_every_target_is_an_option_of_the_command_line_with_its_help(capsys):
    with pytest.raises(SystemExit):
        main(["export", "--help"])
    shown = " ".join(capsys.readouterr().out.replace("│", " ").split())
    for key, target in TARGETS.items():
        assert f"--{key.replace('_', '-')} PATH {cleandoc(target.help)}" in shown


@pytest.mark.parametrize("name", LAWS)
def test_the_record_that_templates_are_filled_from_answers_as_the_controller(name):
    controller = dt.Controller(LAWS[name](plants.paper()), 0.1, limits=(-20.0, 20.0))
    arrays, sizes, *_ = LawRecord.of(controller, dense(controller.table), "double")
    F, G, low, high = (arrays[key][0] for key in ("F", "G", "LOW", "HIGH"))
    past, rng, mode, age = np.zeros(sizes["taps"] * sizes["m"]), np.random.default_rng(1), 0, 0
    for k in range(40):
        now, x = (k // 7) % sizes["modes"], rng.normal(size=sizes["n"])
        age = age + 1 if k and now == mode else 0
        mode = now
        row = mode * sizes["ages"] + min(age, sizes["ages"] - 1) if sizes["by_mode"] else 0
        u = np.clip(F[row] @ x + G[row] @ past, low, high)
        np.testing.assert_allclose(controller.update(x, mode), u, rtol=1e-12, atol=1e-12)
        past = np.concatenate((past[sizes["m"] :], u))
