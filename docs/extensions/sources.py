"""Links between entries and their source that Sphinx's viewcode does not find by itself."""

from __future__ import annotations

import re

import deadtime

# A name in a listing, and the link back to its entry, on the page ROOM.NAME of api/names.
BACK = re.compile(
    r'id="([\w.]+)">\n<a class="viewcode-back" href="([^"]*/names/([\w.]+)\.\w+\.html)#[^"]*"'
)


def module_of(app, module: str, name: str) -> str | None:
    """The module whose text defines a name; errors say that they are of the package itself."""
    own = module == "deadtime" and getattr(getattr(deadtime, name, None), "__module__", "")
    return "deadtime.base.errors" if own == "deadtime" else None


def mend_links(app, pagename: str, templatename, context: dict, doctree) -> None:
    """Links from a listing back to entries: viewcode takes all of a file to be of one room."""
    if pagename.startswith("_modules/deadtime"):
        link = r'id="\1">\n<a class="viewcode-back" href="\2#\3.\1"'
        context["body"] = BACK.sub(link, context["body"])


def setup(app) -> dict[str, bool]:
    app.connect("viewcode-follow-imported", module_of)
    app.connect("html-page-context", mend_links)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
