"""The documentation site: it builds without a warning, links lead somewhere, it reads offline.

To build it is long: at every change the pages' links between each other, their code and what it
prints are tested (`test_documents.py`, `test_docs_pages.py`). The gallery's scripts are not run
here: tests of their own run them, and `make docs` does.
"""

import importlib
import inspect
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

import deadtime as dt
import site_pages

pytest.importorskip("sphinx_gallery", reason="the extra docs is not installed")

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
sys.path.append(str(DOCS / "extensions"))

import docutils.core  # noqa: E402
import openings  # noqa: E402
import tables  # noqa: E402
from docutils import nodes  # noqa: E402

GENERATED = {"_build", "walkthroughs", "gallery", "names", "scripts", "__pycache__"}
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
    for folder in ("walkthroughs", "gallery"):
        pages |= {Path(folder, p.stem + ".html") for p in (ROOT / "examples" / folder).glob("*.py")}
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
        for path in sorted((site / "api").rglob("*.html"))
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
    numbered = {
        "AveragedPredictor": ("equation-2", "equation-3"),
        "SingleModePredictor": ("equation-79",),
        "MeanPredictor": ("equation-80",),
        "ExactPredictor": ("lemma-2-3",),
    }
    for name, anchors in numbered.items():
        text = (site / "api" / "names" / f"deadtime.{name}.html").read_text(encoding="utf-8")
        for anchor in anchors:
            assert f'href="../../theory/equations.html#{anchor}"' in text


@pytest.mark.long
def test_every_class_and_function_has_a_page_of_its_own_that_links_to_its_source(site):
    for name, _ in public_functions():
        text = (site / "api" / "names" / f"{name}.html").read_text(encoding="utf-8")
        start = text.index(f'id="{name}"')
        signature = text[start : text.index("</dt>", start)]
        assert "viewcode-link" in signature, name
        assert "&lt;" not in signature, name


def public_functions():
    """Full name and object of every class and function that the API pages list."""
    listed = r"^   ([a-z_]+\.)*\w+$"
    for page in sorted((DOCS / "api").glob("*.md")):
        for found in re.finditer(listed, page.read_text(encoding="utf-8"), re.MULTILINE):
            room, _, name = f"deadtime.{found[0].strip()}".rpartition(".")
            yield f"{room}.{name}", getattr(importlib.import_module(room), name)


def test_defaults_in_signatures_are_short_and_have_no_addresses():
    checked = 0
    for name, of in public_functions():
        members = vars(of).values() if isinstance(of, type) else ()
        methods = [each for each in members if inspect.isfunction(each) and each.__doc__]
        shown = [each for each in methods if not each.__name__.startswith("_")]
        # Results are made by functions: the site does not show how they are constructed.
        shown += [of] * ("Parameters\n" in (of.__doc__ or ""))
        for each in shown:
            for one in inspect.signature(each).parameters.values():
                checked += 1
                default = "" if one.default is one.empty else repr(one.default)
                assert len(default) <= 80, (name, each, default)
                assert "<" not in default, (name, each, default)
    assert checked > 700


def table_of(columns, words):
    """The doctree of a page with a table of three rows, `words` in each cell."""
    cell = " ".join(["word"] * words)
    rule = "  ".join(["=" * max(10, len(cell))] * columns)
    row = "  ".join([cell.ljust(max(10, len(cell)))] * columns)
    heads = "  ".join(f"head{i}".ljust(max(10, len(cell))) for i in range(columns))
    return docutils.core.publish_doctree("\n".join([rule, heads, rule, *[row] * 3, rule]))


@pytest.mark.parametrize(
    ("columns", "words", "stacked"), [(5, 6, True), (3, 9, True), (2, 40, False), (8, 1, False)]
)
def test_tables_of_prose_carry_their_headings_and_tables_of_numbers_do_not(columns, words, stacked):
    page = table_of(columns, words)
    tables.stack(None, page)
    headings = [node for node in page.findall(nodes.paragraph) if node["classes"]]
    assert ["stacked" in each["classes"] for each in page.findall(nodes.table)] == [stacked]
    assert [node.astext() for node in headings] == [
        f"head{i}" for _ in range(3) for i in range(1, columns) if stacked
    ]


@pytest.mark.parametrize(("section", "pictures"), [(0, 1), (1, 1), (2, 2)])
def test_a_gallery_page_shows_a_picture_of_its_first_section_once(section, pictures):
    parts = ["Page\n====\n\nwords\n", "One\n---\n\nwords\n", "Two\n---\n\nwords\n"]
    parts[section] += "\n.. image:: a.png\n"
    options = {"doctitle_xform": False, "initial_header_level": 1}
    page = docutils.core.publish_doctree("\n".join(parts), settings_overrides=options)
    app = SimpleNamespace(env=SimpleNamespace(docname="gallery/plot_1_a"))
    openings.open_with_picture(app, page)
    found = list(page.findall(nodes.image))
    assert len(found) == pictures
    first = next(iter(page.findall(nodes.section)))
    assert isinstance(first[1], nodes.image)


def test_committed_figures_are_small():
    pictures = [p for p in DOCS.rglob("*.png") if not GENERATED & set(p.parts)]
    assert len(pictures) > 10
    assert {p.name for p in pictures if p.stat().st_size > 200_000} == set()
