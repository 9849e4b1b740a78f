"""Two writers of one folder: the files that are left are all of one of them."""

import os
import threading
from pathlib import Path

import pytest

from deadtime.base.files import Staging

NAMES = ("a.txt", "b.txt", "c.txt")


@pytest.mark.skipif(os.name != "posix", reason="only there a writer can wait for another one")
@pytest.mark.parametrize("stopped", NAMES)
def test_two_writers_of_one_folder_do_not_mix_their_files(stopped, tmp_path, monkeypatch):
    target, moved = tmp_path / "out", threading.Event()
    target.mkdir()
    second = threading.Thread(target=lambda: moved.wait(10.0) and write("second"))

    def write(text):
        with Staging() as staging:
            place = staging.folder(target)
            for name in NAMES:
                (place / name).write_text(text, encoding="utf-8")

    whole = Path.replace

    def replace(place, to):
        if threading.current_thread() is not second and Path(to).name == stopped:
            moved.set()
            second.join(0.3)  # until it is through, or as long as it has to wait
        return whole(place, to)

    monkeypatch.setattr(Path, "replace", replace)
    second.start()
    write("first")
    second.join()
    assert {(target / name).read_text(encoding="utf-8") for name in NAMES} == {"second"}
    assert sorted(one.name for one in target.iterdir()) == sorted(NAMES)
