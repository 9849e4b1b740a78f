"""Links that work on a code host work here: pages that are files outside docs/."""

from __future__ import annotations

import re

PAGES = {
    "benchmarks/README.md": "/benchmarks.md",
    "CHANGELOG.md": "/changelog.md",
    "CONTRIBUTING.md": "/contributing.md",
}
# Scripts have pages of their own, made by sphinx-gallery.
SCRIPTS = {
    "examples/gallery/": "/gallery/",
    "examples/howto/": "/howto/scripts/",
    "examples/walkthroughs/": "/walkthroughs/",
}
UP = re.compile(r"\]\((?:\.\./)+([A-Za-z][^)#]*\.(?:md|py))")


def on_site(outside: str) -> str | None:
    """The page that a file outside docs/ has on the site, if it has one."""
    for folder, pages in SCRIPTS.items():
        if outside.startswith(folder):
            return pages + outside.removeprefix(folder).replace(".py", ".rst")
    return PAGES.get(outside)


def to_pages(app, docname: str, source: list[str]) -> None:
    source[0] = UP.sub(lambda m: f"]({on_site(m[1]) or m[0][2:]}", source[0])


def setup(app) -> dict[str, bool]:
    app.connect("source-read", to_pages)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
