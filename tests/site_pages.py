"""The built pages of the documentation: their anchors, links and what they load."""

from __future__ import annotations

from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

# Elements that make a browser fetch something, and the attribute that says what.
LOADING = {"script": "src", "img": "src", "link": "href", "iframe": "src", "source": "src"}
LOADED_LINKS = {"stylesheet", "preload", "icon", "modulepreload", "shortcut icon"}


class Page(HTMLParser):
    """What one page defines, points to and loads."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.path = path
        self.anchors: set[str] = set()
        self.links: list[str] = []
        self.loaded: list[str] = []
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {name: value or "" for name, value in attrs}
        self.anchors |= {given[name] for name in ("id", "name") if name in given}
        if tag == "a" and "href" in given:
            self.links.append(given["href"])
        if tag in LOADING and LOADING[tag] in given:
            (self.loaded if _fetched(tag, given) else self.links).append(given[LOADING[tag]])


def _fetched(tag: str, given: dict[str, str]) -> bool:
    return tag != "link" or given.get("rel", "") in LOADED_LINKS


@cache
def page(path: Path) -> Page:
    """A page, parsed once."""
    return Page(path)


def pages(site: Path) -> list[Path]:
    """Every page; what themes keep beside their scripts is none."""
    return [p for p in sorted(site.rglob("*.html")) if "_static" not in p.parts]


def external(link: str) -> bool:
    """Whether a link leaves the site."""
    return bool(urlsplit(link).scheme or urlsplit(link).netloc)


def _has(target: Path, anchor: str) -> bool:
    return target.suffix != ".html" or anchor in page(target).anchors


def broken(site: Path) -> list[str]:
    """Links and loaded files of all pages that lead nowhere on the site."""
    found = []
    for path in pages(site):
        here = page(path)
        for link in [*here.links, *here.loaded]:
            if external(link):
                continue
            parts = urlsplit(link)
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            if not target.is_file():
                found.append(f"{path.relative_to(site)}: {link}")
            elif parts.fragment and not _has(target, unquote(parts.fragment)):
                found.append(f"{path.relative_to(site)}: {link} (no such anchor)")
    return found


def fetched(site: Path) -> list[str]:
    """What pages and style sheets load from elsewhere: scripts, styles, pictures, fonts."""
    found = [
        f"{path.relative_to(site)}: {link}"
        for path in pages(site)
        for link in page(path).loaded
        if external(link) and not link.startswith("data:")
    ]
    for path in sorted(site.rglob("*.css")):
        text = path.read_text(encoding="utf-8", errors="replace")
        found += [
            f"{path.relative_to(site)}: {mark}"
            for mark in ("url(http", "url(//", "@import url(http", 'url("http', "url('http")
            if mark in text
        ]
    return found
