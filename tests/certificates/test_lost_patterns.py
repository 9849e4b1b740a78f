"""Every pattern of switches and losses of tiny loops: what acts in any of them is in the graph.

Switches lie on a grid of a sixth of the period and the law is followed sample by sample, so that
runs of any length are walks through finitely many states, all of which are visited.
"""

import math

import pytest

import deadtime as dt
from deadtime.certificates.proof.transitions import SwitchGraph

PARTS = 6  # of a period
OLD = 40  # samples: no table of these tells ages apart from here on
RING, FREE = ((1,), (2,), (0,)), ((1, 2), (0, 2), (0, 1))

# (dwell times, longest sojourns in parts, which mode may follow, context, ages, losses in a row)
CASES = [
    ((9, 7, 11), (None, 14, None), FREE, "mode_age", 3, 2),
    ((7, 8, 7), (13, None, 8), RING, "mode_age", 2, 4),
    ((13, 20, 9), (None,) * 3, ((1,), (0, 2), (1,)), "mode", 1, 5),
    ((7, 19), (9, 29), ((1,), (0,)), "mode_age", 4, 1),
    ((8, 8, 8), (None,) * 3, FREE, "none", 1, 3),
    ((12,), (None,), ((),), "mode_age", 3, 2),
]


def told_next(law, mode, age, lost):
    """What the law goes by at a sample: the mode that it was told last, and the age it counts."""
    told, counted = law
    if told is None:  # its first mode is as old as it is
        return (None if lost else mode), age
    return (told, min(counted + 1, OLD)) if lost or told == mode else (mode, 0)


def moves(node, dwell, longest, following):
    """(the part of the period at which it switches, next node) of a node (mode, age, parts)."""
    mode, age, parts = node
    most = longest[mode]
    if most is None or parts + PARTS < most:
        limit = max(dwell[mode], most or 0) + PARTS
        yield None, (mode, min(age + 1, OLD), min(parts + PARTS, limit))
    for at in range(1, PARTS + 1):
        if dwell[mode] <= parts + at <= (most or parts + at):
            yield from ((at, (after, 0, PARTS - at)) for after in following[mode])


def steps_of_all_runs(dwell, longest, following, context, ages, most):
    """{(mode, age, row, lost, lost next, mode after, age after): instants of the switch}."""
    todo = [((mode, 0, 0), 0, (None, 0)) for mode in range(len(dwell))]
    visited, found = set(todo), {}
    measured = 1 if context == "none" else ages * len(dwell)
    while todo:
        node, before, law = todo.pop()
        for lost in (False, True)[: 1 + (before < most)]:
            told = told_next(law, *node[:2], lost)
            then = before + 1 if lost else 0
            for at, after in moves(node, dwell, longest, following):
                if told[0] is not None:
                    row = 0 if context == "none" else told[0] * ages + min(told[1], ages - 1)
                    step = (*node[:2], row + lost * measured, before, then, *after[:2])
                    found.setdefault(step, set()).add(at)
                if (after, then, told) not in visited:
                    visited.add((after, then, told))
                    todo.append((after, then, told))
    return found


@pytest.mark.parametrize("case", CASES)
def test_each_step_that_any_signal_and_any_losses_bring_about_is_in_the_graph(case):
    dwell, longest, following, context, ages, most = case
    times = tuple(x * 0.1 / PARTS for x in dwell)
    ends = tuple(math.inf if x is None else x * 0.1 / PARTS for x in longest)
    modes = len(dwell)
    ways = None if following is None else [[j in row for j in range(modes)] for row in following]
    signals = dt.SignalClass(times, ends, ways, lost_samples=most)
    graph = SwitchGraph.of(modes, signals, 0.1, context, ages)
    known, last = {}, [clock.last for clock in graph.clocks]
    for one in graph.all(tuple(range(graph.last + 1))):
        key = one.mode, one.age, one.row, one.lost, one.next_lost, one.after, one.next_age
        known[key] = one.instants
    found = steps_of_all_runs(*case)
    assert len(found) > 50
    for (mode, age, row, lost, then, after, next_age), instants in found.items():
        places = mode, min(age, last[mode]), row, lost, then, after, min(next_age, last[after])
        low, high = known[places]
        assert all(low <= at / PARTS <= high + 1e-12 for at in instants if at)
