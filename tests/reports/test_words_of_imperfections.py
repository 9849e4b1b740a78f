"""Imperfections in sentences are words, not the code that makes them."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

import deadtime as dt
from deadtime.imperfections import (
    ColouredDisturbance,
    LateSamples,
    MeasurementDelay,
    Noise,
    Saturation,
    StepDisturbance,
    WhiteDisturbance,
)
from deadtime.imperfections.base import Imperfection


@pytest.mark.parametrize(
    ("imperfection", "words"),
    [
        (Noise([0.1, 0.2]), "noise (std [0.1, 0.2])"),
        (Noise(np.array([0.1, 0.2])), "noise (std [0.1, 0.2])"),
        (LateSamples(2), "late samples (periods 2, probability 1)"),
        (WhiteDisturbance(0.1 * np.eye(2)), "white disturbance (intensity [[0.1, 0], [0, 0.1]])"),
        (MeasurementDelay(0.25), "measurement delay (0.25 s)"),
        (Saturation(-1.0, 12_000.0), "saturation (-1 to 12000)"),
        (
            ColouredDisturbance(0.1, 2.0, [1.0, 0.0]),
            "coloured disturbance (std 0.1, time constant 2 s, force [1, 0])",
        ),
        (
            StepDisturbance([[0.0, 0.0], [1 / 3, 0.0]], 1.0, 2.5),
            "step disturbance (force [[0, 0], [0.333333, 0]], from 1 s to 2.5 s)",
        ),
        (StepDisturbance([[0.0, 0.0], [0.3, 0.0]]), "offset [0.3, 0] in mode 1"),
    ],
)
def test_imperfections_are_named_in_words(imperfection, words):
    problem = replace(dt.problems.paper(), imperfections=(imperfection,))
    assert problem.imperfections_in_words == [words]


def test_an_imperfection_without_words_is_its_repr():
    @dataclass(frozen=True)
    class Unplugged(Imperfection):
        wire: str | None

    assert Unplugged("red").in_words == repr(Unplugged("red"))
    assert Unplugged(None).in_words == repr(Unplugged(None))
