"""A report on disk: its folder, figures, metrics, and the page that shows them."""

from __future__ import annotations

import base64
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from matplotlib.figure import Figure

from deadtime.base.errors import DeadtimeError
from deadtime.base.files import Staging, unwritable
from deadtime.base.json_records import json_text
from deadtime.base.version import __version__

if TYPE_CHECKING:
    from jinja2 import Environment

PAGE = "index.html"


@contextmanager
def writing(folder: Path) -> Iterator[Path]:
    """A folder for the files of a report, which appear in `folder` when all of them are made.

    Raises
    ------
    ArgumentError
        If the folder cannot be written, now or while the context lasts.
    """
    with Staging() as staging:
        place = staging.folder(folder)
        try:
            for part in ("figures", "data"):
                (place / part).mkdir()
            yield place
        except DeadtimeError:
            raise
        except OSError as error:
            raise unwritable("folder", folder, error) from None


def save_figure(figure: Figure, folder: Path, name: str, caption: str) -> dict[str, str]:
    """Save as SVG and PNG; return the PNG inlined for the page."""
    figure.savefig(folder / "figures" / f"{name}.svg", metadata={"Date": None})
    png, image = inlined(figure)
    (folder / "figures" / f"{name}.png").write_bytes(png)
    inches = f"{figure.get_figwidth():.2f}"
    return {"name": name, "caption": caption, "image": image, "inches": inches}


def inlined(figure: Figure) -> tuple[bytes, str]:
    """A figure as PNG, and the data address of that image."""
    buffer = BytesIO()
    figure.savefig(buffer, format="png")
    png = buffer.getvalue()
    return png, f"data:image/png;base64,{base64.b64encode(png).decode('ascii')}"


def write_metrics(record: Mapping[str, Any], folder: Path, indent: int = 2) -> None:
    """Write metrics.json."""
    (folder / "metrics.json").write_text(json_text(record, indent) + "\n", encoding="utf-8")


def write_page(folder: Path, template: str, **parts: Any) -> None:
    """Write the page, by a template of `templates/`."""
    (folder / PAGE).write_text(render(template, **parts), encoding="utf-8")


def render(template: str, **parts: Any) -> str:
    """A page, or a part of one, by a template of `templates/`."""
    return _environment().get_template(template).render(version=__version__, **parts)


@cache
def _environment() -> Environment:
    from jinja2 import Environment, PackageLoader

    loader = PackageLoader("deadtime.reports")
    return Environment(loader=loader, autoescape=True, trim_blocks=True, lstrip_blocks=True)
