"""What several files about the explorer open and run."""

import pytest

from deadtime.app.documents import open_named
from deadtime.app.workers import Workers
from mixer import OWN


@pytest.fixture
def own(tmp_path):
    path = tmp_path / "mixer.toml"
    path.write_text(OWN, encoding="utf-8")
    return open_named(str(path))


@pytest.fixture(scope="module")
def workers():
    team = Workers(1)
    yield team
    team.close()
