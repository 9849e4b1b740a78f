"""The explorer saves problem files as it shows them, and hostile ones change nothing."""

import gc
import re
import time
import tomllib
import weakref
from concurrent.futures import Future

import numpy as np
import pytest

import deadtime as dt
from deadtime.app.documents import MOST_BYTES, open_named, open_upload, to_toml
from deadtime.app.first_view import laws_on_offer
from deadtime.app.page import Page
from deadtime.app.page_outcome import run_draft
from deadtime.app.settings import DrawnSignal, Settings, draft_of
from deadtime.problems.file import load_problem
from mixer import OWN


@pytest.mark.few(1)
@pytest.mark.parametrize("name", list(dt.problems.NAMED))
def test_an_untouched_problem_is_saved_as_it_was_opened(name):
    document = open_named(name)
    offer, _ = laws_on_offer(document)
    assert to_toml(document, draft_of(document, offer, Settings())) == document.text


def test_what_is_saved_is_what_is_shown_and_keeps_comments(own, tmp_path):
    offer, _ = laws_on_offer(own)
    settings = Settings(
        {"delay": 0.4, "noise": 0.01, "dwell_time": 0.3, "run.x0.1": 0.25, "step": 0.04},
        laws=("averaged", "middle", "expected", "oracle"),
        signal=DrawnSignal(5),
    )
    draft = draft_of(own, offer, settings)
    text = to_toml(own, draft)
    assert tomllib.loads(text) == draft
    assert text.startswith("# my plant\n")
    assert "delay = 0.4   # measured" in text
    path = tmp_path / "saved.toml"
    path.write_text(text, encoding="utf-8")
    saved, here = load_problem(path), run_draft(draft, own.source)
    assert list(saved.laws) == list(here.runs)
    for law, run in here.runs.items():
        np.testing.assert_array_equal(saved.simulate(law).states, run.states)


def test_a_parameter_moved_back_leaves_no_trace(own):
    page = Page(own, None)
    slider = page.controls.sliders["delay"]
    slider.value = 0.5
    assert page.outcome.problem.model.delay == 0.5
    slider.value = page.controls.ranges["delay"].value
    assert page.toml() == OWN


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"x" * (MOST_BYTES + 1), "has 1.0 MB, a problem file at most 1 MB"),
        (b"[plant\n", "is not valid TOML"),
        (b"\xff\xfe\x00", "is not UTF-8 text"),
        (b"a = 1\n", "a is not known"),
        (b"x = " + b"[" * 5000, "nested too deeply"),
        (b"a" + b".a" * 50_000 + b" = 1", "nested too deeply"),
        (OWN.replace('kind = "switches"', 'kind = "log"\nfile = "/etc/passwd"\n#').encode(),
         "missing|reads other files|not known|belongs to kind"),
    ],
)  # fmt: skip
def test_hostile_uploads_are_refused_by_name(content, message, tmp_path):
    with pytest.raises(dt.ProblemFileError, match=message):
        open_upload("../../evil.toml", content, tmp_path)
    assert not list(tmp_path.iterdir())


def test_uploads_cannot_read_files_of_this_machine(tmp_path):
    log = (
        OWN.split("[signal]")[0]
        + '[signal]\nkind = "log"\nfile = "/etc/passwd"\n[run]'
        + (OWN.split("[run]")[1])
    )
    with pytest.raises(dt.ProblemFileError, match="reads other files"):
        open_upload("a.toml", log.encode(), tmp_path)
    fitted = OWN + '\n[switching]\nkind = "fitted"\nlogs = ["/etc/passwd"]\n'
    with pytest.raises(dt.ProblemFileError, match="reads other files"):
        open_upload("a.toml", fitted.encode(), tmp_path)


@pytest.mark.few(2)
@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("horizon = 4.0", "horizon = nan", "horizon makes nan periods"),
        ("horizon = 4.0", "horizon = 1e9", "horizon makes 20,000,000,000 periods"),
        ("step = 0.05", "step = 0.0", "step must be positive"),
        ("delay = 0.365", "delay = nan", "delay makes nan periods"),
        ("x0 = [1.0, -0.5]", "x0 = [nan, 0.0]", r"line 19, \[run\]: x0\[0\] must be finite"),
        ("[[0.2, 1.0], [0.0, -0.5]]", "[[nan, 1.0], [0.0, -0.5]]", "A.* must .*finite"),
        ("poles = [-1.0, -1.5]", "poles = [1.0, -1.5]", "mode 0"),
    ],
)
def test_an_upload_that_does_not_hold_together_changes_nothing(own, workers, old, new, message):
    page = Page(own, workers)
    before = page.outcome
    assert old in OWN
    page.upload("bad.toml", OWN.replace(old, new).encode())
    wait(lambda: page.message.severity == "error")
    assert page.outcome is before
    assert page.message.object.endswith("Nothing was changed.")
    assert re.search(message, page.message.object), page.message.object


def wait(done, seconds=60.0):
    end = time.monotonic() + seconds
    while not done():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_what_was_found_for_another_problem_is_dropped(own):
    class Late:
        """Workers that are still busy with something else."""

        def submit(self, limit, job, *given):
            self.future = Future()
            return self.future

        def stop(self, future):
            future.cancel()

    page = Page(own, late := Late())
    page.actions.worst.clicks += 1
    assert page.actions.worst.loading
    first = late.future
    page.open(open_named("paper"))
    shown_now = page.outcome
    assert first.cancelled()
    assert not page.actions.worst.loading
    page.actions.worst.clicks += 1
    running = late.future
    running.set_running_or_notify_cancel()  # too late to cancel
    page.open(own)
    running.set_result({"times": [0.0], "modes": [1], "growth_rate": 0.0, "message": "late"})
    assert page.controls.signal is None
    assert page.actions.state.object == ""
    assert page.outcome is not shown_now


def test_a_closed_session_holds_no_curves(own):
    page = Page(own, None)
    figures = weakref.ref(page.figures)
    page.close()
    gc.collect()
    assert figures() is None


def test_an_upload_is_tried_elsewhere_and_opened(own, workers):
    page = Page(open_named("paper"), workers)
    page.upload("mixer.toml", OWN.encode())
    wait(lambda: "Opened" in page.message.object)
    assert list(page.outcome.runs) == ["averaged", "middle"]
