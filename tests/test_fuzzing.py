"""A short run of `make fuzz`; and that the runner sees what it is there to see."""

import time

import numpy as np
import pytest

from fuzzing import targets
from fuzzing.runner import fuzz

# The runner forks, which processes that hold the threads of other tests must not.
pytestmark = pytest.mark.long

COUNTS = {"problem": 150, "study": 150, "log": 400, "certificate": 100, "store": 100}


@pytest.mark.parametrize(("kind", "count"), COUNTS.items())
def test_mutants_are_read_or_refused_with_an_error_of_the_package(kind, count):
    found = fuzz(kind, count)
    assert found.faults == {}
    assert found.count == count
    assert min(found.read, found.refused) >= 1


class Broken(targets.Log):
    """A reader with a fault of every kind."""

    def read_seeds(self):
        pass

    def write(self, rng):
        self.number = rng.randrange(4)

    def read(self):
        if self.number == 0:
            raise KeyError("x")
        if self.number == 1:
            np.float64(1e308) * 10.0
        if self.number == 2:
            np.ones(2**45)
        while self.number == 3:
            time.process_time()


def test_a_bug_a_warning_a_lack_of_memory_and_a_loop_without_end_are_faults(monkeypatch):
    monkeypatch.setitem(targets.TARGETS, "broken", Broken)
    monkeypatch.setattr("fuzzing.runner.SECONDS", 1)
    found = fuzz("broken", 5, seed=10)
    assert found.count == found.faults.total() == 5
    told = " ".join(found.faults)
    for word in ("KeyError", "RuntimeWarning", "MemoryError", "more than 1 s"):
        assert word in told
