"""What is asked of outputs alone: how many states each has."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from deadtime.base.checks import brief
from deadtime.base.errors import ArgumentError

_MOST = 12  # states in all


def order_of(order: Any, outputs: tuple[str, ...]) -> tuple[int, ...]:
    """How many states each output has; one number is that of every output.

    Examples
    --------
    >>> order_of(2, ("position", "angle")), order_of((2, 1), ("position", "heat"))
    ((2, 2), (2, 1))
    """
    several = isinstance(order, Iterable) and not isinstance(order, str)
    given: list[Any] = list(order) if several else [order] * len(outputs)
    whole = [isinstance(one, int | np.integer) and not isinstance(one, bool) for one in given]
    if not given or not all(whole) or min(given) < 1 or sum(given) > _MOST:
        raise ArgumentError(
            "order must be how many states each output has, such as 2 for a position, or (2, 1), "
            f"at least 1 each and {_MOST} in all, got {brief(order)}."
        )
    if len(given) != len(outputs):
        raise ArgumentError(
            f"order must have a number for each output, {len(outputs)} ({', '.join(outputs)}), "
            f"got {len(given)}: {brief(order)}."
        )
    return tuple(int(one) for one in given)


def is_states(order: Any, outputs: tuple[str, ...]) -> bool:
    """Whether outputs are the states: one of each."""
    return set(order_of(order, outputs)) == {1}


def require_logged(C: Any, noise: bool | None, hidden: bool) -> None:
    """Refuse what outputs alone are not identified with."""
    if C is not None:
        raise ArgumentError(
            "C must be left out beside order: the states are chosen so that outputs are the first "
            "of each chain."
        )
    if noise is False:
        raise ArgumentError(
            "noise must not be False with order: from outputs alone noise of the sensors is always "
            "estimated. Leave it out."
        )
    if hidden:
        raise ArgumentError(
            "modes must be logged where order is given, got a number of hidden ones: they are told "
            "from all states alone. Log the mode, or all states; of one mode say modes=None, "
            "--one-mode."
        )


def state_names(
    outputs: tuple[str, ...], order: tuple[int, ...], numbered: bool
) -> tuple[str, ...]:
    """What states are called: outputs and primes for their derivatives, or numbers.

    Examples
    --------
    >>> state_names(("position", "heat"), (3, 1), False)
    ('position', "position'", "position''", 'heat')
    >>> state_names(("position",), (2,), True)
    ('position', 'position (2)')
    """
    names = []
    for name, count in zip(outputs, order, strict=True):
        more = [
            f"{name} ({k + 1})" if numbered else f"{name}{chr(39) * k}" for k in range(1, count)
        ]
        names += [name, *more]
    return tuple(names)
