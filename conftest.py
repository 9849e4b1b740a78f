"""Check shapes at run time: all modules but the compiled ones run under jaxtyping and beartype."""

from pathlib import Path

from jaxtyping import install_import_hook

SOURCE = Path(__file__).parent / "src"


def _checked_modules() -> list[str]:
    paths = sorted((SOURCE / "deadtime").rglob("*.py"))
    return [
        ".".join(path.relative_to(SOURCE).with_suffix("").parts)
        for path in paths
        if path.name != "__init__.py" and "from numba" not in path.read_text(encoding="utf-8")
    ]


install_import_hook(_checked_modules(), "typecheck.checked")
