"""A log that is dropped on the explorer's page, in Chromium."""

import re
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

import deadtime as dt
from deadtime.problems import load_problem
from dropping import drop, drop_sized
from explorer import SHOTS, SIZES, choose, cost, message, open_page, until

LOG = Path(__file__).parents[2] / "examples" / "logs" / "motor.csv"
BROKEN = "t,x1,u1\n0,1,1\n0.1,2,0\n0.1,3,1\n0.2,1,0\n"


def say_what_columns_are(page):
    """Of the motor's log, whose columns have names of their own."""
    page.get_by_role("button", name="Identify").wait_for()
    for column, role in (("speed", "state"), ("current", "state"), ("voltage", "input")):
        choose(page, column, role)


def found(page):
    return page.locator(".found").first.inner_text().replace("\xa0", " ")


@pytest.fixture(scope="module")
def fit():
    names = {"states": ["speed", "current"], "inputs": ["voltage"]}
    return dt.identify(LOG, "arm", (0.0, 0.6), **names)


def test_a_log_that_is_dropped_becomes_a_plant_with_its_delay_and_figures(page, fit, tmp_path):
    drop(page, "motor.csv", LOG.read_text())
    say_what_columns_are(page)
    assert page.get_by_role("combobox", name="arm").inner_text() == "mode"
    page.get_by_role("button", name="Identify").click()
    until(lambda: page.locator(".found figure").count() >= 4, 120.0)
    low, high = fit.interval("delay")
    D = fit.delays[0, 0]
    assert f"Delay {D:.4g} s" in found(page)
    assert f"{low:.5g} … {high:.5g} s at 95 %" in found(page)
    for sentence in fit.sentences[1:]:  # the first is the heading
        assert sentence in found(page)
    assert re.search("Law “averaged”, each mode held: Delay 0.026.*tolerates", found(page))
    names = page.locator(".found figure img").evaluate_all(
        "all => all.filter((one) => one.naturalWidth > 200).map((one) => one.alt)"
    )
    assert sorted(names) == ["inputs", "likelihood", "predictions", "whiteness"]
    assert page.get_by_text("Signal: ").count()
    assert cost(page, "averaged") > 0.0
    with page.expect_download() as download:
        page.get_by_role("button", name="Download problem file").click()
    path = tmp_path / download.value.suggested_filename
    download.value.save_as(path)
    assert path.name == "motor.toml"
    np.testing.assert_array_equal(load_problem(path).plant.A, fit.plant.A)
    with page.expect_download() as download:
        page.get_by_role("button", name="Download report").click()
    assert download.value.suggested_filename == "motor-report.html"


def test_a_malformed_log_is_refused_by_its_line_and_the_old_problem_stays(page):
    before = cost(page, "averaged")
    drop(page, "broken.csv", BROKEN)
    until(lambda: page.get_by_role("alert").count() and "line 4" in message(page), 120.0)
    assert re.search("broken.csv, line 4: t must be later.*Nothing was changed", message(page))
    assert cost(page, "averaged") == before
    assert page.get_by_text("The paper's example").count()


def test_a_problem_file_that_is_dropped_is_opened(page):
    drop(page, "mine.toml", files("deadtime.problems").joinpath("files", "paper.toml").read_text())
    until(lambda: page.get_by_role("alert").count() and "Opened mine.toml" in message(page), 60.0)


@pytest.mark.parametrize(
    ("name", "size", "said"),
    [
        ("long.csv", 46_000_000, "46.0 MB, a page takes logs of at most 16 MB and 200,000 rows"),
        ("long.toml", 2_000_000, "2.0 MB, a problem file at most 1 MB"),
        ("photo.jpg", 1000, "neither a problem (.toml) nor a log (.csv)"),
    ],
)
def test_what_a_page_does_not_take_is_refused_before_it_is_sent(page, name, size, said):
    page.evaluate(
        """() => { const send = WebSocket.prototype.send; window.most = 0;
        WebSocket.prototype.send = function (data) {
          window.most = Math.max(window.most, data.length || data.byteLength || 0);
          return send.call(this, data); } }"""
    )
    drop_sized(page, name, size)
    until(lambda: page.get_by_role("alert").count() and said in message(page))
    assert "Nothing was changed." in message(page)
    assert 0 < page.evaluate("() => window.most") < 5_000


def test_a_drag_over_the_page_says_what_may_be_dropped(page):
    veil = page.locator(".drop-here")
    assert not veil.is_visible()
    drop(page, "log.csv", "", kinds=("dragenter", "dragover"))
    assert veil.is_visible()
    drop(page, "log.csv", "", kinds=("dragleave",))
    assert not veil.is_visible()


def test_a_search_is_cancelled_and_asked_again(page):
    rows = np.random.default_rng(0).standard_normal((4000, 7))
    text = "\n".join(",".join(f"{v:.6f}" for v in (0.01 * i, *row)) for i, row in enumerate(rows))
    drop(page, "noise.csv", "t,x1,x2,x3,x4,x5,x6,u1\n" + text)
    cancel = page.get_by_role("button", name="Cancel")
    cancel.wait_for(timeout=60_000)
    until(lambda: "s of at most 120 s" in page.locator(".progress").inner_text())
    cancel.click()
    until(lambda: "Cancelled. Nothing was changed." in message(page))
    assert not cancel.is_visible()
    assert page.get_by_role("button", name="Identify").is_enabled()
    assert page.get_by_text("The paper's example").count()


@pytest.mark.parametrize("theme", ["light", "dark"])
@pytest.mark.parametrize("size", list(SIZES))
def test_what_was_found_fits_the_screen(browser, explorer, size, theme):
    context = browser.new_context(**SIZES[size], device_scale_factor=1)
    page = context.new_page()
    open_page(page, explorer.url)
    if theme == "dark":
        page.get_by_label("Toggle theme").first.click()
    if size == "phone":  # nothing is dropped there, and the drawer must give way to the card
        page.locator("[aria-label='Open drawer']").tap()
        page.locator("input[type=file]").first.set_input_files(LOG)
        page.locator(".sidebar").wait_for(state="hidden")
    else:
        drop(page, "motor.csv", LOG.read_text())
    say_what_columns_are(page)
    SHOTS.mkdir(exist_ok=True)
    page.screenshot(path=SHOTS / f"explorer-log-{size}-{theme}-columns.png")
    page.get_by_role("button", name="Identify").click()
    until(lambda: page.locator(".found figure").count() >= 4, 120.0)
    page.wait_for_timeout(1500)
    page.screenshot(path=SHOTS / f"explorer-log-{size}-{theme}.png")
    for number in range(2):
        page.locator(".found summary").nth(number).click()
    page.locator(".found img[alt='predictions']").scroll_into_view_if_needed()
    page.wait_for_timeout(500)
    page.screenshot(path=SHOTS / f"explorer-log-{size}-{theme}-figures.png")
    page.locator(".found table").scroll_into_view_if_needed()
    page.wait_for_timeout(500)
    page.screenshot(path=SHOTS / f"explorer-log-{size}-{theme}-table.png")
    wide = page.evaluate("() => document.documentElement.scrollWidth - window.innerWidth")
    assert wide <= 0
    context.close()
