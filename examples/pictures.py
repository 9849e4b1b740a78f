"""For sphinx-gallery: the pictures of a page are the PNG files that its script writes.

In a `sphinx_gallery_conf`: ``"image_scrapers": ("pictures.written",)``, this folder on the path.
The scripts draw with matplotlib's `Figure`, which pyplot, and so the default, does not know of.
"""

import shutil
from pathlib import Path
from typing import Any


def written(block: Any, variables: dict[str, Any], configuration: dict[str, Any]) -> str:
    """Move what the block wrote, oldest first, to the gallery's pictures; return their reST."""
    from sphinx_gallery.scrapers import figure_rst

    folder = Path(variables["src_file"]).parent
    found = sorted(folder.glob("*.png"), key=lambda path: path.stat().st_mtime_ns)
    targets = [variables["image_path_iterator"].next() for _ in found]
    for picture, target in zip(found, targets, strict=True):
        shutil.move(picture, target)
    return figure_rst(targets, configuration["src_dir"])
