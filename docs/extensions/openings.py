"""Pages of the gallery open with their picture: the first one that their script draws."""

from __future__ import annotations

from docutils import nodes

PAGES = "gallery/plot_"


def open_with_picture(app, doctree: nodes.document) -> None:
    """The first picture right below the title: from the first part or section of the page it moves
    there; of a later one, whose text speaks of it, it is a copy."""
    if not app.env.docname.startswith(PAGES):
        return
    pictures = [
        node
        for node in doctree.findall(nodes.Element)
        if isinstance(node, nodes.image) or type(node).__name__ == "imgsgnode"
    ]
    titles = list(doctree.findall(nodes.title))
    if pictures and titles:
        picture, page = pictures[0], titles[0].parent
        opening = picture.deepcopy()
        sections = [node for node in page.children if isinstance(node, nodes.section)]
        if picture.parent in (page, *sections[:1]):
            picture.parent.remove(picture)
        page.insert(page.index(titles[0]) + 1, opening)


def setup(app) -> dict[str, bool]:
    app.connect("doctree-read", open_with_picture)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
