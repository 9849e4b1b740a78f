"""Notices about slow operations: silent, unless an application replaces them."""


def compiling() -> None:
    """Called when compiling has taken a second."""
