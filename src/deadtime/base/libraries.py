"""Libraries that only some functions need: extras, which may not be installed."""

from __future__ import annotations

from typing import Any

from deadtime.base.errors import ArgumentError


def python_control(what: str) -> Any:
    """python-control; `what` needs it, in the plural."""
    try:
        import control
    except ModuleNotFoundError:
        raise ArgumentError(
            f"{what} need python-control, and it is not installed: "
            'pip install ".[control]" in a clone of deadtime.'
        ) from None
    return control
