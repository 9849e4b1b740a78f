"""A finished sweep that several files look into."""

import pytest

import deadtime as dt
from own_sweep import filled, load


@pytest.fixture(scope="session")
def own_store(tmp_path_factory):
    """The study, and the folder of its store; both are only read."""
    folder = tmp_path_factory.mktemp("own")
    study = load(folder)
    filled(study, folder / "own.zarr")
    return study, folder / "own.zarr"


@pytest.fixture(scope="session")
def own(own_store):
    study, store = own_store
    return study, dt.open_sweep(store).load()
