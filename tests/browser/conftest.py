"""The explorer served for real, and a browser to drive it with: `make browser`."""

import shutil
from pathlib import Path

import pytest

from explorer import Explorer, open_page

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
FLAGS = ["--no-sandbox", "--disable-gpu", "--disable-quic", "--disable-background-networking"]


def pytest_collection_modifyitems(items):
    for item in items:
        if Path(item.fspath).parent == Path(__file__).parent:
            item.add_marker(pytest.mark.browser)


@pytest.fixture(scope="session")
def explorer():
    one = Explorer()
    yield one
    assert one.stop() == "", "the server complained"


@pytest.fixture(scope="session")
def browser():
    if CHROMIUM is None:
        pytest.skip("no Chromium: install your system's (Debian: chromium)")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        one = driver.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield one
        one.close()


@pytest.fixture
def page(browser, explorer):
    """A fresh session at laptop size, whose browser must find nothing wrong."""
    context = browser.new_context(viewport={"width": 1366, "height": 768}, accept_downloads=True)
    one = context.new_page()
    faults, foreign = [], []
    one.on("pageerror", lambda e: faults.append(str(e)))
    one.on("console", lambda m: faults.append(m.text) if m.type == "error" else None)
    one.on("request", lambda r: None if explorer.url in r.url or r.url[:5] in ("data:", "blob:")
           else foreign.append(r.url))  # fmt: skip
    open_page(one, explorer.url)
    yield one
    context.close()
    assert not faults
    assert not foreign, "the page asked other machines"
