"""What a command writes to a terminal."""

import os
import pty
import subprocess
from typing import Any


def on_a_terminal(command: list[str], pipe_stdout: bool = False, **options: Any):
    """What it wrote there, and what came through the pipe if its output has one."""
    leader, follower = pty.openpty()
    stdout = subprocess.PIPE if pipe_stdout else follower
    with subprocess.Popen(command, stdout=stdout, stderr=follower, **options) as process:
        os.close(follower)
        seen = b""
        try:
            while chunk := os.read(leader, 65536):
                seen += chunk
        except OSError:  # Linux says so when the last writer is gone
            pass
        piped = process.stdout.read() if process.stdout is not None else b""
    os.close(leader)
    assert process.returncode == 0
    return seen, piped
