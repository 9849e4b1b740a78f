"""Maps of the best law: when a law is only as good as another."""

import numpy as np
import pytest
import xarray as xr

from deadtime.reports.figures.sweeps import plot_wins


@pytest.mark.parametrize(("share", "tied"), [(1.0001, True), (1.0049, True), (1.0051, False)])
def test_what_reads_as_1_00_is_a_tie_however_sure_it_is(share, tied):
    """The same share on every signal: no interval of the mean holds 1."""
    base = np.geomspace(1.0, 50.0, 30)
    dims, ise = ("delay", "law", "scenario"), np.array([[base, share * base]])
    variables = {"ise": (dims, ise), "diverged": (dims, np.zeros(ise.shape, dtype=bool))}
    data = xr.Dataset(variables, {"delay": [0.5], "law": ["averaged", "mean"]})
    panel = plot_wins(data).axes[0]
    assert panel.texts[0].get_text() == ("1.00" if tied else "1.01")
    assert any(cells.get_hatch() is not None for cells in panel.collections) == tied
