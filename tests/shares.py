"""Which cases of one claim are tried at every change, and which in `make long` alone."""

from collections.abc import Collection, Iterable
from typing import Any

import pytest


def mostly_long(cases: Iterable[Any], *always: Any) -> list[Any]:
    """The cases of a `parametrize`, all but `always` marked as long.

    For claims whose cases differ in what they run through, not in what could break: each costs
    seconds, of compiling or of solving, and a few of them show most faults at once.
    """
    cases = list(cases)
    unknown = [case for case in always if case not in cases]
    assert not unknown, f"always must be among the cases, and these are not: {unknown}"
    return [case if _within(case, always) else _later(case) for case in cases]


def _within(case: Any, always: Collection[Any]) -> bool:
    return any(case == one for one in always)


def _later(case: Any) -> Any:
    values = case if isinstance(case, tuple) else (case,)
    return pytest.param(*values, marks=pytest.mark.long)
