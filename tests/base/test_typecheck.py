"""Under test, sizes of one name agree among the arguments and the result of a call."""

from dataclasses import dataclass

import numpy as np
import pytest
from jaxtyping import Float

from deadtime.gains.pole_placement import reachable
from typecheck import checked, within_shapes

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
