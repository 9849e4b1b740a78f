"""The two stacks of a preview against products of all maps of a window, one after the other."""

import numpy as np
import pytest

from deadtime.loop.preview_steps import (
    PreviewSizes,
    PreviewState,
    answer_ahead,
    enter_piece,
    move_window,
    predict_ahead,
)


@pytest.mark.parametrize(("n", "m", "q"), [(1, 1, 1), (2, 1, 2), (3, 2, 4)])
def test_windows_of_changing_length_are_predicted_as_by_one_map_after_the_other(n, m, q):
    rng = np.random.default_rng(n)
    moves, inputs = rng.normal(size=(60, n, n + q)), rng.normal(size=(60, q))
    tail = rng.normal(size=(m, n + m))
    begin = np.sort(rng.integers(0, 55, 25))
    end = np.maximum.accumulate(np.minimum(begin + rng.integers(1, 9, 25), 60))
    state, answer = PreviewState.of(PreviewSizes.of(n, m, q), int((end - begin).max())), np.empty(m)
    for first, stop in zip(begin, end, strict=True):
        for piece in range(state.bounds[0], stop):
            state.acting[:] = inputs[piece]
            enter_piece(state, moves[piece].ravel())
        x, latest = rng.normal(size=n), rng.normal(size=m)
        state.x[:] = x
        move_window(state, first)
        predict_ahead(state, first)
        answer_ahead(state, tail.ravel(), latest, answer)
        for piece in range(first, stop):
            x = moves[piece] @ np.concatenate((x, inputs[piece]))
        scale = np.prod([np.abs(one).sum() for one in moves[first:stop]])
        np.testing.assert_allclose(state.x, x, rtol=0, atol=1e-14 * scale)
        np.testing.assert_allclose(
            answer, tail @ np.concatenate((x, latest)), rtol=0, atol=1e-13 * scale
        )
