"""`deadtime app` as a process of its own, and what tests read of its page."""

import re
import signal
import subprocess
import sys
import time
from pathlib import Path

COMMAND = [str(Path(sys.executable).with_name("deadtime")), "app", "--no-browser"]
SHOTS = Path(__file__).parents[1] / "screenshots"
SIZES = {
    "laptop": {"viewport": {"width": 1366, "height": 900}},
    "phone": {
        "viewport": {"width": 390, "height": 844},
        "is_mobile": True,
        "has_touch": True,
        "user_agent": "Mozilla/5.0 (Linux; Android 15) Mobile Chrome",
    },
}


class Explorer:
    """A running explorer."""

    def __init__(self, *arguments, folder=None):
        self.process = subprocess.Popen(
            [*COMMAND, *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            cwd=folder,
        )
        self.said = []
        for line in self.process.stdout:
            self.said.append(line)
            if "Ctrl-C" in line:
                break
        found = re.search(r"http://\S+", "".join(self.said))
        assert found, self.process.stderr.read()
        self.url = found[0]

    def stop(self):
        self.process.send_signal(signal.SIGINT)
        _, errors = self.process.communicate(timeout=30)
        return errors


def open_page(page, url):
    page.goto(url)
    page.locator("tr[data-law]").first.wait_for(timeout=60_000)
    page.wait_for_function("() => Bokeh.documents.length && Bokeh.documents[0].is_idle")
    page.wait_for_timeout(500)


def cost(page, law):
    return float(page.locator(f"tr[data-law='{law}']").get_attribute("data-cost"))


def until(done, seconds=20.0):
    end = time.monotonic() + seconds
    while not (found := done()):
        assert time.monotonic() < end, "nothing happened"
        time.sleep(0.002)
    return found


def message(page):
    return page.get_by_role("alert").inner_text()


def choose(page, label, option):
    """An option of a field."""
    page.get_by_role("combobox", name=label, exact=True).click()
    page.get_by_role("menuitem", name=option, exact=True).click()
