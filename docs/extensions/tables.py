"""Tables of prose on a telephone: a row is a block, each cell under the heading of its column.

Tables of numbers are compared across rows: they stay tables, and scroll.
"""

from __future__ import annotations

from docutils import nodes

COLUMNS, LETTERS = 3, 100  # at least so many, and in a row on average more than so many


def stack(app, doctree: nodes.document) -> None:
    """Mark tables of prose, and write the headings into their cells, which wide screens hide."""
    for table in doctree.findall(nodes.table):
        heads, bodies = (list(table.findall(kind)) for kind in (nodes.thead, nodes.tbody))
        if not heads or not bodies:
            continue
        headings = [entry.astext() for entry in heads[0].findall(nodes.entry)]
        rows = [list(row.findall(nodes.entry)) for row in bodies[0].findall(nodes.row)]
        letters = sum(len(entry.astext()) for row in rows for entry in row)
        if len(headings) < COLUMNS or letters <= LETTERS * len(rows):
            continue
        table["classes"].append("stacked")
        for row in rows:
            for heading, entry in list(zip(headings, row, strict=True))[1:]:
                entry.insert(0, nodes.paragraph("", heading, classes=["column-heading"]))


def setup(app) -> dict[str, bool]:
    app.connect("doctree-read", stack)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
