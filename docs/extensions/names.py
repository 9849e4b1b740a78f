"""Names in code become links to their entries, in pages and docstrings alike.

Pages are written to be read on a code host, too, where `certify` in backticks is just that. Here it
is a link wherever there is an entry. In the tables of api.md and theory/equations.md every name
must have one.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

from docutils import nodes
from sphinx import addnodes
from sphinx.util import logging
from sphinx.util.nodes import make_refnode

logger = logging.getLogger(__name__)
# Page: the column of its tables in which every name must have an entry.
STRICT = {"api": 0, "theory/equations": -1}
NAME = re.compile(r"^\.?[A-Za-z_][\w.]*")
CALL = re.compile(r"^(\.?[A-Za-z_][\w.]*)(\(.*\))?$", re.S)
PLAIN = (nodes.title, nodes.reference, addnodes.desc_signature, addnodes.toctree, nodes.raw)


def entry(objects: dict, name: str) -> str | None:
    """The full name of the entry meant by a name, if there is just one."""
    name = re.sub(r"^dt\.", "deadtime.", name)
    for full in (name, f"deadtime.{name}"):
        if full in objects:
            return full
    if "." in name.strip(".") or name[:1].isupper():
        ends = [full for full in objects if full.endswith(f".{name}")]
        if len(ends) == 1:
            return ends[0]
    return None


def candidates(text: str, last: str) -> Iterator[str]:
    """What a name may stand for: `.draw` belongs to the class named before it, or beside it."""
    if not text.startswith("."):
        yield text
        return
    while last:
        yield last + text
        last = last.rpartition(".")[0]


def column(node: nodes.Node) -> int | None:
    """In which column of a table a node is."""
    while node is not None and not isinstance(node, nodes.entry):
        node = node.parent
    return None if node is None else node.parent.index(node)


def _strict(docname: str, node: nodes.Node) -> bool:
    where = column(node)
    if docname not in STRICT or where is None:
        return False
    wanted = STRICT[docname]
    while not isinstance(node, nodes.row):
        node = node.parent
    return where == wanted % len(node) and not isinstance(node.parent, nodes.thead)


def link(app, doctree: nodes.document, docname: str) -> None:
    """Put links around the names on a page that have entries."""
    domain = app.env.domains.python_domain
    objects, last = domain.objects, ""
    for node in list(doctree.findall(nodes.literal)):
        text = node.astext()
        found = CALL.match(text)
        parent = node.parent
        while parent is not None and not isinstance(parent, PLAIN):
            parent = parent.parent
        strict = _strict(docname, node)
        if parent is not None or not (found or strict):
            continue
        name = (found or NAME.match(text))[1 if found else 0].strip("*")
        full = next((f for c in candidates(name, last) if (f := entry(objects, c))), None)
        if full is None:
            if strict:
                logger.warning("%s has no entry on an API page", text, location=node)
            continue
        # `.draw` after `deadtime.Markov` is deadtime.Markov.draw, and `.rates` after it a sibling.
        last = full
        item = objects[full]
        made = make_refnode(app.builder, docname, item.docname, item.node_id, node.deepcopy(), full)
        node.replace_self(made)


def setup(app) -> dict[str, bool]:
    app.connect("doctree-resolved", link)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
