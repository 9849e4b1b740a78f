"""The second verifier as a module, for what is asked of it within a process."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import deadtime as dt
from deadtime.base.errors import CertificateFileError
from deadtime.numerics.precision import precision

Answer = tuple[bool, str]  # whether a file is proved, and what is said of it

VERIFY = Path(__file__).parents[1] / "verifier/verify.py"


def second_verifier() -> Any:
    """A new module of it; its arithmetic takes `BITS` bits, which its caller sets."""
    spec = importlib.util.spec_from_file_location("verify", VERIFY)
    assert spec is not None
    assert spec.loader is not None
    found = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(found)
    return found


def both(verifier: Any, path: Path, limit: float = 1.0) -> tuple[Answer, Answer]:
    """What the package's verifier answers, and what the second one does."""
    try:
        found = dt.verify(path, limit=limit)
        first = found.proven, found.message
    except CertificateFileError as error:
        first = False, str(error)
    with precision(verifier.BITS):
        code, verdict, _ = verifier.judged(path, limit)
    return first, (code == 0, verdict)
