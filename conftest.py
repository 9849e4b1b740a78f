"""Check shapes at run time: modules that state them run under jaxtyping and beartype.

Compiled ones cannot; in modules without shapes the checks would only bind arguments at every call.
"""

import gc
from importlib import import_module
from pathlib import Path

import jaxtyping
import pytest

SOURCE = Path(__file__).parent / "src"
ROOMS = sorted(SOURCE.glob("deadtime/*/__init__.pyi"))


def _checked_modules() -> list[str]:
    texts = {path: path.read_text(encoding="utf-8") for path in (SOURCE / "deadtime").rglob("*.py")}
    return [
        ".".join(path.relative_to(SOURCE).with_suffix("").parts)
        for path, text in sorted(texts.items())
        if "from jaxtyping" in text and "from numba" not in text and "@kernel" not in text
    ]


collect_ignore = ["tests/typecheck.py"]  # what is checked with is not to be imported anew

typecheck = import_module("typecheck")
jaxtyping.jaxtyped = typecheck.within_shapes
jaxtyping.install_import_hook(_checked_modules(), "typecheck.checked")


@pytest.fixture(scope="session", autouse=True)
def _filled_faces() -> None:
    """Faces load their names on first use: not while a test has replaced one of them."""
    for face in ("deadtime", *(f"deadtime.{path.parent.name}" for path in ROOMS)):
        for name in import_module(face).__all__:
            getattr(import_module(face), name)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup() -> None:
    """Of every function the first calls within each test are checked."""
    typecheck.begin_test()


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Of a test marked few(n) n of its cases, spread over them, run always; the others are long."""
    cases: dict[str, list[pytest.Item]] = {}
    for item in items:
        if item.get_closest_marker("few") and not item.get_closest_marker("long"):
            cases.setdefault(item.nodeid.partition("[")[0], []).append(item)
    for each in cases.values():
        (number,) = each[0].get_closest_marker("few").args
        always = {round(k * (len(each) - 1) / max(number - 1, 1)) for k in range(number)}
        for place, item in enumerate(each):
            if place not in always:
                item.add_marker("long")


def pytest_collection_finish() -> None:
    """What was imported and collected stays: the garbage collector need not visit it again."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(20_000)  # of small objects that tests make, most go by themselves
