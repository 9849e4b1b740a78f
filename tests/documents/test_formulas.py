"""Displayed formulas of the pages become MathML that says what the source says."""

import re
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

ROOT = Path(__file__).parents[2]
sys.path.append(str(ROOT / "docs" / "extensions"))

pytest.importorskip("docutils")
import formulas  # noqa: E402

PAGES = sorted((ROOT / "docs" / "theory").glob("*.md"))


def blocks(page):
    """Indented blocks of a page."""
    text = page.read_text(encoding="utf-8")
    found = re.findall(r"(?:^    .*\n(?:\n(?=    ))?)+", text, re.MULTILINE)
    return [re.sub(r"^    ", "", block, flags=re.MULTILINE) for block in found]


def marks_left_out(text):
    """A text without spaces and marks of scripts, all characters at the same height."""
    text = "".join(formulas.RAISED.get(c, formulas.LOWERED.get(c, c)) for c in text)
    return sorted(re.sub(r"[\s_^{}()√]", "", text.replace("'", "′")))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_formula_of_a_theory_page_is_well_formed_and_complete(page):
    for block in filter(formulas.is_formula, blocks(page)):
        tree = ElementTree.fromstring(formulas.mathml(block))
        assert marks_left_out("".join(tree.itertext())) == marks_left_out(block)
        assert str(tree.get("alttext")).split() == block.split()


def parts(text):
    """Tags and texts in order, rows and spaces left out."""
    skipped = {"math", "mtable", "mtr", "mtd", "mrow", "mspace"}
    tree = ElementTree.fromstring(formulas.mathml(text))
    return [(one.tag, one.text or "") for one in tree.iter() if one.tag not in skipped]


def test_scripts_roots_and_words_are_what_they_look_like():
    assert parts("x_{k+1} = e²") == [
        ("msub", ""), ("mi", "x"), ("mi", "k"), ("mo", "+"), ("mn", "1"), ("mo", "="),
        ("msup", ""), ("mi", "e"), ("mn", "2"),
    ]  # fmt: skip
    assert parts("∫₀^∞ u")[:4] == [("msubsup", ""), ("mo", "∫"), ("mn", "0"), ("mo", "∞")]
    assert parts("√(2p)") == [("msqrt", ""), ("mn", "2"), ("mi", "p")]
    assert parts("log det M where") == [
        ("mtext", "log"), ("mtext", "det"), ("mi", "M"), ("mtext", "where")
    ]  # fmt: skip
    assert parts("b_σ,j x'")[:4] == [("msub", ""), ("mi", "b"), ("mi", "σ"), ("mo", ",")]


@pytest.mark.parametrize(
    "text",
    [
        "deadtime completion bash > file",
        "status = controller_update(&c, x, 0);",
        "x = np.array()",
        "a plain sentence",
        'name = "motor"',
    ],
)
def test_code_and_commands_are_no_formulas(text):
    assert not formulas.is_formula(text)
