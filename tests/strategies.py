"""What hypothesis draws."""

import numpy as np
from hypothesis import strategies as st

import deadtime as dt


@st.composite
def signals(draw):
    gaps = draw(st.lists(st.floats(1e-3, 1e3), max_size=8))
    times = np.concatenate(([0.0], np.cumsum(gaps)))
    modes = draw(st.lists(st.integers(0, 3), min_size=times.size, max_size=times.size))
    end = draw(st.sampled_from([np.inf, times[-1] + 0.1, times[-1] + 1 / 3]))
    return dt.SwitchingSignal(times, modes, end)
