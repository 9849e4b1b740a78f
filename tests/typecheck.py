"""The run-time type checker of the test suite: beartype, where an int is a float, and shapes.

jaxtyping's own decorator checks parameters twice, and binds them by name at every call for its
messages, which takes most of the time of many tests. Of a function that a test calls again and
again, or that is made anew within another, the first ones of the test are checked: all of them
would take half of the time of a long search.
"""

import dataclasses
import functools
import inspect
import re
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from types import CodeType
from typing import Any, ClassVar, get_type_hints

from beartype import BeartypeConf, beartype
from jaxtyping import jaxtyped

FACE = Path(__file__).parents[1] / "src" / "deadtime" / "__init__.pyi"
checked = beartype(conf=BeartypeConf(is_pep484_tower=True, violation_type=TypeError))
PUBLIC = set(re.findall(r" as (\w+)", FACE.read_text(encoding="utf-8")))
CONTEXT = jaxtyped("context")  # one of sizes, for the time of a call
MOST = 10  # calls of a function within a test that are checked, and functions made of one code


class _Running:
    """Which test runs, by its number, and how many functions of each code it has made."""

    test = 0
    made: ClassVar[Counter[CodeType]] = Counter()


def begin_test() -> None:
    """From now on another test runs."""
    _Running.test += 1
    _Running.made.clear()


def within_shapes(*, typechecker: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """What jaxtyping's import hook decorates with: sizes agree within a call of a function."""

    def decorate(made: Any) -> Any:
        if inspect.isclass(made):
            if dataclasses.is_dataclass(made):
                made.__init__ = decorate(made.__init__)
            return made
        _Running.made[made.__code__] += 1
        if _Running.made[made.__code__] > MOST:
            return made
        written, made.__annotations__ = made.__annotations__, _known_types(made)
        function = typechecker(made)
        made.__annotations__ = written
        test, left = _Running.test, MOST

        @functools.wraps(made)
        def call(*args: Any, **kwargs: Any) -> Any:
            __tracebackhide__ = True
            nonlocal test, left
            if test != _Running.test:
                test, left = _Running.test, MOST
            if not left:
                return made(*args, **kwargs)
            left -= 1
            with CONTEXT:
                return function(*args, **kwargs)

        return call

    return decorate


def _known_types(function: Any) -> dict[str, Any]:
    """The annotations but those of types that are imported for annotations alone.

    Of a public function, and of one that checks, only shapes: it refuses other types itself, in
    words that tests read.
    """
    known, own = {}, function.__qualname__
    checks = own in PUBLIC or own.startswith(("check_", "require_"))
    for name, written in function.__annotations__.items():
        if checks and "[np.ndarray" not in str(written):
            continue
        one = type("one", (), {"__annotations__": {name: written}})
        try:
            known |= get_type_hints(one, function.__globals__, include_extras=True)
        except Exception:  # as jaxtyping does: NameError, and what a shape written wrongly raises
            known[name] = Any
    return known
