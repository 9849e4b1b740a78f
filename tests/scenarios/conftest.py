"""A finished sweep that several files look into."""

import pytest

from own_sweep import filled, load


@pytest.fixture(scope="module")
def own(tmp_path_factory):
    folder = tmp_path_factory.mktemp("own")
    study = load(folder)
    return study, filled(study, folder / "own.zarr").load()
