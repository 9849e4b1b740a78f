"""Check shapes at run time: modules that state them run under jaxtyping and beartype.

Compiled ones cannot; in modules without shapes the checks would only bind arguments at every call.
"""

from pathlib import Path

from jaxtyping import install_import_hook

SOURCE = Path(__file__).parent / "src"


def _checked_modules() -> list[str]:
    texts = {path: path.read_text(encoding="utf-8") for path in (SOURCE / "deadtime").rglob("*.py")}
    return [
        ".".join(path.relative_to(SOURCE).with_suffix("").parts)
        for path, text in sorted(texts.items())
        if "from jaxtyping" in text and "from numba" not in text
    ]


install_import_hook(_checked_modules(), "typecheck.checked")
