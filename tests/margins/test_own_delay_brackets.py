"""Between proof and refutation is little on plants with two different delays."""

import importlib.util
import sys
from pathlib import Path

import pytest

PATH = Path(__file__).parents[2] / "benchmarks" / "own_delays.py"
spec = importlib.util.spec_from_file_location("own_delays", PATH)
assert spec is not None
assert spec.loader is not None
sys.path.append(str(PATH.parent))  # for what scripts share
own_delays = importlib.util.module_from_spec(spec)
spec.loader.exec_module(own_delays)


@pytest.mark.long
@pytest.mark.parametrize("number", own_delays.NUMBERS[::4])
def test_between_certified_and_refuted_is_little_and_neither_end_is_trivial(number):
    margin = own_delays.bracket(number)
    low, high = own_delays.RANGE
    assert margin.proven
    assert margin.refuted is not None
    assert low < margin.certified < margin.refuted < high
    assert margin.refuted <= 1.03 * margin.certified
    assert margin.witness.growth_rate > 0.0
