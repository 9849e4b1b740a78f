"""Imperfections in sentences are words, not the code that makes them."""

from dataclasses import replace

import numpy as np
import pytest

import deadtime as dt
from deadtime.imperfections import LateSamples, Noise, StepDisturbance, WhiteDisturbance


@pytest.mark.parametrize(
    ("imperfection", "words"),
    [
        (Noise([0.1, 0.2]), "noise (std [0.1, 0.2])"),
        (Noise(np.array([0.1, 0.2])), "noise (std [0.1, 0.2])"),
        (LateSamples(2), "late samples (periods 2, probability 1.0)"),
        (
            WhiteDisturbance(0.1 * np.eye(2)),
            "white disturbance (intensity [[0.1, 0. ], [0. , 0.1]])",
        ),
        (StepDisturbance([[0.0, 0.0], [0.3, 0.0]]), "offset [0.3, 0] in mode 1"),
    ],
)
def test_imperfections_are_named_in_words(imperfection, words):
    problem = replace(dt.problems.paper(), imperfections=(imperfection,))
    assert problem.imperfections_in_words == [words]
