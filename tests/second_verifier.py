"""The second verifier as a module, for what is asked of it within a process."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

VERIFY = Path(__file__).parents[1] / "verifier/verify.py"


def second_verifier() -> Any:
    """A new module of it; its arithmetic takes `BITS` bits, which its caller sets."""
    spec = importlib.util.spec_from_file_location("verify", VERIFY)
    assert spec is not None
    assert spec.loader is not None
    found = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(found)
    return found
