"""A sweep that several files look into."""

import pytest

from own_sweep import STUDY, filled, load


@pytest.fixture(scope="module")
def own(tmp_path_factory):
    folder = tmp_path_factory.mktemp("own")
    study = load(folder)
    return study, filled(study, folder / "own.zarr").load()


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A folder with the study, where commands run."""
    monkeypatch.chdir(tmp_path)
    load(tmp_path, STUDY.replace("12", "3"))
