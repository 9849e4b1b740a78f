"""Links that work on a code host work here: pages that are files outside docs/."""

from __future__ import annotations

import re

PAGES = {
    "benchmarks/README.md": "/benchmarks.md",
    "CHANGELOG.md": "/changelog.md",
    "CONTRIBUTING.md": "/contributing.md",
}
UP = re.compile(r"\]\((?:\.\./)+([A-Za-z][^)#]*\.md)")


def to_pages(app, docname: str, source: list[str]) -> None:
    source[0] = UP.sub(lambda m: f"]({PAGES.get(m[1], m[0][2:])}", source[0])


def setup(app) -> dict[str, bool]:
    app.connect("source-read", to_pages)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
