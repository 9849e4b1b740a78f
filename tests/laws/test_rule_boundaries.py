"""Round-off at a boundary is no chattering: a state slides on it, rests on it, passes a corner."""

import numpy as np
import pytest

import deadtime as dt
import plants
from deadtime.laws import StateDependentPredictor
from deadtime.switching import HalfSpace, Polyhedra
from shares import mostly_long
from swinging import idle, run


def nodes(seed, alike):
    """Two stable modes that share the eigenvector v of their slowest motion; v, and v's normal."""
    rng = np.random.default_rng(seed)
    V = rng.normal(size=(2, 2))
    fast = rng.uniform(2.0, 5.0, size=2)
    A = [V @ np.diag([-0.5, -fast[0 if alike else i]]) @ np.linalg.inv(V) for i in range(2)]
    v = V[:, 0]
    return dt.SwitchedSystem(A, [[[0.0], [1.0]]] * 2, 0.25), V, np.array([-v[1], v[0]])


@pytest.mark.parametrize(
    "alike", mostly_long([True, False], False), ids=["one mode twice", "two modes"]
)
@pytest.mark.parametrize(
    ("as_function", "plants_tried"), mostly_long([(True, 3), (True, 10), (False, 30)], (True, 3))
)
def test_a_plant_that_moves_along_a_boundary_does_not_chatter(alike, as_function, plants_tried):
    for seed in range(plants_tried):
        plant, V, normal = nodes(seed, alike)
        rule = (lambda x, n=normal: int(n @ x >= 0.0)) if as_function else HalfSpace(normal)
        for x0 in (V[:, 0], V[:, 0] + 0.3 * V[:, 1]):
            one = run(idle(plant), rule, plant, x0, 30.0, None)
            assert (one.message, one.end) == ("", 30.0), seed
            assert one.signal.switches <= 1
            # Along the boundary the modes agree.
            late = np.linalg.norm(one.states[:, 250:], axis=0)
            plants.close(late, np.exp(-0.5 * one.time[250:]) * np.linalg.norm(V[:, 0]), 1e-9)


@pytest.mark.parametrize("seeds", mostly_long([range(2), range(2, 8)], range(2)))
def test_a_law_predicts_along_a_boundary(seeds):
    for seed in seeds:
        plant, V, normal = nodes(seed, True)
        gains = dt.place(plant, [-1.5, -2.0])
        free = run(dt.MeanPredictor(plant, gains[0], gains), dt.SwitchingSignal.constant(0), plant,
                   V[:, 0], 20.0, None)  # fmt: skip
        for rule in (HalfSpace(normal), lambda x, n=normal: int(n @ x >= 0.0)):
            law = StateDependentPredictor(plant, gains, rule)
            one = run(law, rule, plant, V[:, 0], 20.0, None)
            assert one.message == ""
            plants.close(one.states, free.states, 1e-10)


@pytest.mark.long
def test_a_plant_that_comes_to_rest_on_an_offset_boundary_does_not_slide():
    """Nodes, affine by a third state that is 1; far from rest they may truly slide."""
    rng = np.random.default_rng(3)
    rested = 0
    for _ in range(40):
        normal, rest = rng.normal(size=(2, 2))
        A = np.zeros((2, 3, 3))
        for i in range(2):
            V = rng.normal(size=(2, 2))
            A[i, :2, :2] = V @ np.diag(-rng.uniform(0.5, 3.0, size=2)) @ np.linalg.inv(V)
            A[i, :2, 2] = -A[i, :2, :2] @ rest
        plant = dt.SwitchedSystem(A, np.zeros((2, 3, 1)), 0.25)
        law = dt.DelayedStateFeedback(plant, np.zeros((2, 1, 3)), allow_unstable=True)
        rule = HalfSpace([*normal, 0.0], float(normal @ rest))
        one = run(law, rule, plant, [*(rest + rng.normal(size=2)), 1.0], 120.0, None, 0.2)
        away = one.states[:2, -1] - rest
        if one.message:
            # Both fields do point at the boundary, far beyond round-off.
            begin = one.record.slides.slides(0.2, 120.0)[0].begin
            away = one.record.states_at(np.array([begin]))[0, :2] - rest
            slopes = normal @ (A[:, :2, :2] @ away).T
            assert np.linalg.norm(away) > 1e-7
            assert slopes[0] > 1e-7
            assert slopes[1] < -1e-7
        else:
            rested += 1
            assert np.linalg.norm(away) < 1e-9
        assert one.signal.switches < 10
    assert rested > 25


CORNERS = {
    "quadrants": [np.diag(s) for s in ([-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0])],
    "junction": [np.array([[1.0, 0.0]]), np.diag([-1.0, -1.0]), np.diag([-1.0, 1.0])],
}


@pytest.mark.parametrize(
    ("corner", "count"),
    mostly_long([("quadrants", 30), *((name, 100) for name in CORNERS)], ("quadrants", 30)),
)
def test_a_plant_that_passes_through_a_corner_goes_on_in_the_region_beyond(corner, count):
    rng = np.random.default_rng(5)
    for _ in range(count):
        angle, at, v = rng.uniform(0.0, 6.28), 10.0 * rng.normal(size=2), rng.normal(size=2)
        R = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        rows = [np.column_stack((H @ R.T, np.zeros(len(H)))) for H in CORNERS[corner]]
        rule = Polyhedra([(H, H[:, :2] @ at) for H in rows])
        A = np.zeros((len(rows), 3, 3))
        A[:, :2, 2] = v * (1.0 + 0.1 * np.arange(len(rows))[:, None])
        plant = dt.SwitchedSystem(A, np.zeros((len(rows), 3, 1)), 0.25)
        law = dt.DelayedStateFeedback(plant, np.zeros((len(rows), 1, 3)), allow_unstable=True)
        x0 = [*(at - v * rng.uniform(0.2, 0.9)), 1.0]
        one = run(law, rule, plant, x0, 2.0, None)
        assert one.message == ""
        assert one.signal.modes[-1] == rule([*(at + 0.3 * v), 1.0])
