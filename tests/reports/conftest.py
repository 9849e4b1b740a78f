"""A small study that several files look into."""

import pytest

from deadtime.reports.study import run_study
from small_study import load


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """A small study, and its data."""
    folder = tmp_path_factory.mktemp("study")
    study = load(folder)
    return study, run_study(study, folder / "small.zarr", workers=1)
