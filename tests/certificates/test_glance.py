"""A rough solution says that there is one, and no more: certificates are those of whole ones."""

from concurrent.futures import ThreadPoolExecutor
from functools import cache

import numpy as np
import pytest

import deadtime as dt
from deadtime.certificates.dwell.evidence_search import EvidenceSearch, Freedom

FOLLOWER = dt.problems.follower()
DWELL, STEP = 1.0, 0.05


def aside(work, *given):
    """In a thread of its own, as the command line does it: where a solver can be watched."""
    with ThreadPoolExecutor(1) as thread:
        return thread.submit(work, *given).result()


def certify(law):
    return dt.certify(FOLLOWER.plant, FOLLOWER.laws[law], DWELL, STEP, search_signals=False)


@cache
def certificate(law):
    return aside(certify, law)


def searched(law="averaged"):
    return EvidenceSearch(certificate(law).evidence.setting, Freedom(0))


def assert_same(ours, theirs):
    for name in ("P", "Pi", "S"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name))


@pytest.mark.few(1)
@pytest.mark.parametrize("law", ["averaged", "brake only"])
def test_certificates_are_those_of_whole_solutions(law):
    whole = certify(law)
    assert certificate(law).decay_rate == whole.decay_rate
    assert_same(certificate(law).evidence, whole.evidence)


def test_a_rough_solution_is_made_whole_before_it_is_proved():
    search = searched()
    rough, whole = aside(search.glance, 1.0), search.propose(1.0)
    assert rough.solution.rough
    assert not whole.solution.rough
    assert 0.0 < rough.margin < whole.margin  # it stopped on its way
    proved, outcome = search.prove(rough)
    assert outcome.proven
    assert_same(proved, search.prove(whole)[0])


def test_where_there_is_nothing_a_glance_finds_nothing():
    rate = 3.0 * certificate("averaged").decay_rate
    assert aside(searched().glance, np.exp(-rate * STEP)) is None


def test_in_the_main_thread_solvers_are_not_watched():
    assert (
        not searched().glance(1.0).solution.rough
    )  # what it asks on its way would swallow a Ctrl-C
