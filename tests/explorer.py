"""`deadtime app` as a process of its own, and what tests read of its page."""

import re
import signal
import subprocess
import sys
from pathlib import Path

COMMAND = [str(Path(sys.executable).with_name("deadtime")), "app", "--no-browser"]


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
