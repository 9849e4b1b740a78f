"""A short run of `make fuzz`; and that the runner sees what it is there to see."""

import multiprocessing
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor

import pytest

from fuzzing import broken, runner

COUNTS = {"problem": 75, "study": 75, "log": 200, "certificate": 50, "store": 50}


@pytest.fixture(scope="module")
def apart() -> Iterator[Callable[..., runner.Found]]:
    """Calls in a new process: the runner forks, which one with other tests' threads must not."""
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        yield lambda *call: pool.submit(*call).result()


@pytest.mark.few(2)
@pytest.mark.parametrize(("kind", "count"), COUNTS.items())
def test_mutants_are_read_or_refused_with_an_error_of_the_package(apart, kind, count):
    found = apart(runner.fuzz, kind, count)
    assert found.faults == {}
    assert found.count == count
    assert min(found.read, found.refused) >= 1


def test_a_bug_a_warning_a_lack_of_memory_and_a_loop_without_end_are_faults(apart):
    found = apart(broken.fuzz_broken, 5, 10)
    assert found.count == found.faults.total() == 5
    told = " ".join(found.faults)
    for word in ("KeyError", "RuntimeWarning", "MemoryError", "more than 1 s"):
        assert word in told
