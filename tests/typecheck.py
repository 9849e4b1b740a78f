"""The run-time type checker of the test suite: beartype, where an int is a float, and shapes.

jaxtyping's own decorator checks parameters twice, and binds them by name at every call for its
messages, which takes most of the time of many tests.
"""

import dataclasses
import functools
import inspect
from collections.abc import Callable
from typing import Any, get_type_hints

from beartype import BeartypeConf, beartype
from jaxtyping import jaxtyped

checked = beartype(conf=BeartypeConf(is_pep484_tower=True, violation_type=TypeError))
CONTEXT = jaxtyped("context")  # one of sizes, for the time of a call


def within_shapes(*, typechecker: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """What jaxtyping's import hook decorates with: sizes agree within a call of a function."""

    def decorate(made: Any) -> Any:
        if inspect.isclass(made):
            if dataclasses.is_dataclass(made):
                made.__init__ = decorate(made.__init__)
            return made
        written, made.__annotations__ = made.__annotations__, _known_types(made)
        function = typechecker(made)
        made.__annotations__ = written

        @functools.wraps(made)
        def call(*args: Any, **kwargs: Any) -> Any:
            __tracebackhide__ = True
            with CONTEXT:
                return function(*args, **kwargs)

        return call

    return decorate


def _known_types(function: Any) -> dict[str, Any]:
    """The annotations but those of types that are imported for annotations alone."""
    known = {}
    for name, written in function.__annotations__.items():
        one = type("one", (), {"__annotations__": {name: written}})
        try:
            known |= get_type_hints(one, function.__globals__, include_extras=True)
        except Exception:  # as jaxtyping does: NameError, and what a shape written wrongly raises
            known[name] = Any
    return known
