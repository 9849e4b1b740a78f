"""From a hidden plant to its C: what the verdict passes is stable. The benchmark has a hundred."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from c_code import needs_compiler

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "log_to_law.py"


@needs_compiler
@pytest.mark.long
def test_loops_of_hidden_plants_that_the_verdict_passes_are_stable():
    command = [sys.executable, SCRIPT, "--draws", "4", "--first", "60"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    passed, stable = re.search(
        r"the verdict passes (\d+) of 4, of which (\d+) are stable", done.stdout
    ).groups()
    assert passed == stable
    assert int(passed) >= 3
