"""The documentation site: it builds without a warning, links lead somewhere, it reads offline.

To build it is long: at every change the pages' links between each other, their code and what it
prints are tested (`test_documents.py`, `test_docs_pages.py`). The gallery's scripts are not run
here: tests of their own run them, and `make docs` does.
"""

import re
import subprocess
import sys
from pathlib import Path

import pytest

import deadtime as dt
import site_pages

pytest.importorskip("sphinx_gallery", reason="the extra docs is not installed")

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
GENERATED = {"_build", "gallery", "scripts", "__pycache__"}
LINK = re.compile(r'<a class="reference internal" href="([^"]*)"')


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The site as built, strictly, from a copy of what it is made of."""
    place = tmp_path_factory.mktemp("site")
    for name in ("docs", "examples", "benchmarks", "studies", "tests", "src", "verifier"):
        (place / name).symlink_to(ROOT / name)
    # The gallery is written beside the pages: they are copied.
    (place / "docs").unlink()
    for path in DOCS.rglob("*"):
        parts = path.relative_to(DOCS).parts
        if path.is_file() and not GENERATED & set(parts):
            copy = place / "docs" / Path(*parts)
            copy.parent.mkdir(parents=True, exist_ok=True)
            copy.write_bytes(path.read_bytes())
    for name in ("CHANGELOG.md", "CONTRIBUTING.md"):
        (place / name).write_bytes((ROOT / name).read_bytes())
    out = place / "html"
    # In a process of its own: there no import hook checks shapes.
    options = ["-n", "-W", "--keep-going", "-q", "-b", "html", "-D", "plot_gallery=0"]
    command = [sys.executable, "-m", "sphinx", *options, "docs", str(out)]
    built = subprocess.run(command, cwd=place, capture_output=True, text=True)
    assert (built.returncode, built.stderr) == (0, ""), built.stderr[-4000:]
    return out


@pytest.mark.long
def test_every_page_of_the_docs_is_on_the_site(site):
    pages = {p.relative_to(DOCS).with_suffix(".html") for p in DOCS.rglob("*.md")}
    pages = {p for p in pages if not GENERATED & set(p.parts)}
    pages |= {Path("gallery", p.stem + ".html") for p in (ROOT / "examples/gallery").glob("*.py")}
    assert {p for p in pages if not (site / p).exists()} == set()


@pytest.mark.long
def test_every_internal_link_and_anchor_leads_somewhere(site):
    assert site_pages.broken(site) == []


@pytest.mark.long
def test_pages_load_nothing_from_elsewhere(site):
    assert site_pages.fetched(site) == []


def test_a_broken_link_and_a_foreign_script_are_found(tmp_path):
    (tmp_path / "a.html").write_text(
        '<p id="x"><a href="b.html#no">b</a><a href="c.html">c</a><a href="#x">x</a>'
        '<script src="https://example.org/x.js"></script>'
    )
    (tmp_path / "b.html").write_text('<p id="yes">')
    assert site_pages.broken(tmp_path) == ["a.html: b.html#no (no such anchor)", "a.html: c.html"]
    assert site_pages.fetched(tmp_path) == ["a.html: https://example.org/x.js"]


@pytest.mark.long
def test_no_formula_is_taken_for_emphasis(site):
    for path in site_pages.pages(site):
        text = path.read_text(encoding="utf-8")
        found = re.findall(r"<em>([^<]*[{}^∫∏²≤][^<]*)</em>", text)
        assert found == [], path.name


def entries(site):
    """Where the entry of each documented name is, by the anchors of the API pages."""
    return {
        anchor: path
        for path in sorted((site / "api").glob("*.html"))
        for anchor in site_pages.page(path).anchors
        if anchor.startswith("deadtime.") or anchor.startswith("module-deadtime.")
    }


@pytest.mark.long
def test_every_public_name_has_an_entry(site):
    found = entries(site)
    missing = [
        name
        for name in dt.__all__
        if f"deadtime.{name}" not in found and f"module-deadtime.{name}" not in found
    ]
    assert missing == []


@pytest.mark.long
def test_every_name_of_the_table_of_stable_names_links_to_its_entry(site):
    text = (site / "api.html").read_text(encoding="utf-8")
    rows = re.findall(r"<tr class=\"row-\w+\"><td>(.*?)</td>", text, re.S)
    assert len(rows) > 50
    for row in rows:
        codes = len(re.findall(r'<code class="[^"]*literal', row))
        assert codes == len(LINK.findall(row)) > 0, row


@pytest.mark.long
def test_every_name_of_the_outer_rooms_links_to_its_entry(site):
    text = (site / "api.html").read_text(encoding="utf-8")
    codes = r'(<a [^>]*>)?<code class="[^"]*literal[^"]*"><span class="pre">(deadtime\.[\w.]+)<'
    names = {name: link for link, name in re.findall(codes, text)}
    assert len(names) > 20
    assert {name for name, link in names.items() if not link} == set()


def equations(site):
    """(anchors, links to entries) of each row of the table of equations."""
    text = (site / "theory" / "equations.html").read_text(encoding="utf-8")
    rows = re.findall(r"<tr class=\"row-\w+\"><td>(.*?)</tr>", text, re.S)
    return [(re.findall(r'id="([\w-]+)"', row), LINK.findall(row)) for row in rows]


def entry_text(text, name):
    """What an API page says of a name itself, up to the next entry."""
    start = text.index(f'id="{name}"')
    # Names that share a description stand one below the other before it.
    said = start if name.startswith("module-") else text.index("<dd>", start)
    following = re.search(r'id="(?:module-)?deadtime\.', text[said + 10 :])
    return text[start : said + 10 + following.start()] if following else text[start:]


@pytest.mark.long
def test_every_equation_links_to_a_function_and_back(site):
    rows = equations(site)
    assert len(rows) >= 25
    for anchors, links in rows:
        assert anchors, links
        assert links, anchors
        for link in links:
            target, _, name = link.partition("#")
            text = (site / "theory" / target).resolve().read_text(encoding="utf-8")
            for anchor in anchors:
                assert f"equations.html#{anchor}" in entry_text(text, name), (name, anchor)


@pytest.mark.long
def test_numbers_in_docstrings_of_the_public_names_link_to_their_equations(site):
    text = (site / "api" / "laws.html").read_text(encoding="utf-8")
    for anchor in ("equation-2", "equation-3", "equation-79", "equation-80", "lemma-2-3"):
        assert f'href="../theory/equations.html#{anchor}"' in text


def test_committed_figures_are_small():
    pictures = [p for p in DOCS.rglob("*.png") if not GENERATED & set(p.parts)]
    assert len(pictures) > 10
    assert {p.name for p in pictures if p.stat().st_size > 200_000} == set()
