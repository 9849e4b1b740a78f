"""Under test, sizes of one name agree among the arguments and the result of a call."""

from dataclasses import dataclass

import numpy as np
import pytest
from jaxtyping import Float

from deadtime.gains.pole_placement import reachable
from typecheck import MOST, begin_test, checked, within_shapes

shaped = within_shapes(typechecker=checked)


@shaped
def product(A: Float[np.ndarray, "n m"], x: Float[np.ndarray, "m"]) -> Float[np.ndarray, "n"]:
    return A @ x if A.any() else np.zeros(1)


@shaped
@dataclass
class Pair:
    A: Float[np.ndarray, "n n"]
    x: Float[np.ndarray, "n"]

    @shaped
    def applied(self, y: Float[np.ndarray, "m"]) -> Float[np.ndarray, "n"]:
        return product(np.ones((3, y.size)), y)  # whose sizes are its own


def test_sizes_that_disagree_are_refused_and_calls_within_have_sizes_of_their_own():
    assert product(np.ones((3, 2)), np.ones(2)).shape == (3,)
    with pytest.raises(TypeError, match="parameter x="):
        product(np.ones((3, 2)), np.ones(3))
    with pytest.raises(TypeError, match="return"):
        product(np.zeros((3, 2)), np.ones(2))
    pair = Pair(np.ones((2, 2)), np.ones(2))
    assert pair.applied(np.ones(5)).shape == (3,)
    with pytest.raises(TypeError, match="parameter x="):
        Pair(np.ones((2, 2)), np.ones(3))
    with pytest.raises(TypeError, match="parameter y="):
        pair.applied([1.0])


def test_the_package_is_checked():
    with pytest.raises(TypeError, match="parameter B="):
        reachable(np.eye(2), np.ones((3, 1)))


def test_first_calls_of_a_test_are_checked_and_so_are_those_of_the_next():
    for _ in range(2):
        begin_test()
        with pytest.raises(TypeError, match="parameter x="):
            product(np.ones((3, 2)), np.ones(3))
        for _ in range(MOST):
            product(np.ones((3, 2)), np.ones(2))
        with pytest.raises(ValueError, match="mismatch"):  # NumPy's own
            product(np.ones((3, 2)), np.ones(3))


def test_a_function_within_another_is_checked_where_it_is_first_made():
    def made():
        @shaped
        def inner(x: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
            return x

        return inner

    begin_test()
    every = [made() for _ in range(MOST + 1)]
    for inner in every[:-1]:
        with pytest.raises(TypeError, match="parameter x="):
            inner(np.eye(2))
    assert every[-1](np.eye(2)).shape == (2, 2)
