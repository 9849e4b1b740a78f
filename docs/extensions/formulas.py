"""Displayed formulas become MathML when the pages are built: no script, no font, no network.

In pages and docstrings a formula is Unicode text in an indented block, readable wherever the source
is. On the site the block is MathML, a row for each line and a column for each gap of three spaces:

    x_{k+1} = Φ x_k + Σ_j Γ_j u_{k−j},    e^{A(t−s)},    √(rᵀ X r)

Letters are variables, known words are upright, `_` and `^` and the raised and lowered characters
are scripts, `√(…)` is a root. Nothing is left out or reordered, so the text of the MathML is that
of the source without its marks.
"""

from __future__ import annotations

import re
from html import escape

from docutils import nodes

RAISED = dict(zip("⁰¹²³⁴⁵⁶⁷⁸⁹⁺⁻⁽⁾ᵀᴴᵏⁿᵐⁱᵇᵈˢᵖ", "0123456789+−()THknmibdsp", strict=True))
LOWERED = dict(zip("₀₁₂₃₄₅₆₇₈₉₊₋₍₎ᵢⱼₖₙₘₗₓₜₚₐₑ", "0123456789+−()ijknmlxtpae", strict=True))
RELATION = re.compile(r"[=≤≥≠≺≻⪯⪰∈≈→]|∫|Σ| < | > ")
# What is no formula: commands, code, drawings.
OTHER = re.compile(
    r"[\"`$#│├└─]|>>>|^deadtime |^import |https?:|--|\.py\b|==|\w\(\)|/\*|;$", re.MULTILINE
)
TOKEN = re.compile(
    rf"""(?P<space>\s+)
    | (?P<number>\d+(?:[.,]\d+)*)
    | (?P<raised>[{"".join(RAISED)}′″]+)
    | (?P<lowered>[{"".join(LOWERED)}]+)
    | (?P<word>[A-Za-z]{{2,}})
    | (?P<letter>[^\W\d_][\u0300-\u036f]*)
    | (?P<other>.[\u0300-\u036f]*)""",
    re.VERBOSE,
)
UPRIGHT = {
    "arg", "as", "at", "cos", "cot", "det", "diag", "exp", "if", "is", "in", "Im", "inf", "lim",
    "ln", "log", "max", "min", "mod", "of", "on", "or", "Re", "sat", "sign", "sin", "sup", "tan",
    "to", "tr", "and", "for", "all", "one", "per", "the", "not", "row", "has", "may", "no", "by",
    "it", "be",
}  # fmt: skip
BIG = "∫∑∏ΣΠ"
WIDE = 4  # letters: a word and no product
INDICES = re.compile(r"(?:,\w)+\b")
PAIRS = {"(": ")", "{": "}", "[": "]"}
OUTPUT = "sphx-glr-script-out"  # the class of what an example has printed


def mathml(text: str) -> str:
    """A block of formulas as MathML; its lines as rows."""
    rows = []
    for line in filter(str.strip, text.split("\n")):
        cells = re.split(r" {3,}", line.strip())
        indent = "<mspace width='2em'/>" if line.startswith(" ") else ""
        body = "".join(f"<mtd><mrow>{_row(cell)}</mrow></mtd>" for cell in cells)
        rows.append(f"<mtr>{body.replace('<mrow>', f'<mrow>{indent}', 1)}</mtr>")
    table = f"<mtable>{''.join(rows)}</mtable>"
    return f"<math display='block' alttext='{escape(text, quote=True)}'>{table}</math>"


def is_formula(text: str) -> bool:
    """Whether a block is a formula rather than code or a drawing."""
    return bool(RELATION.search(text)) and not OTHER.search(text)


def _row(text: str) -> str:
    """One formula: atoms in a row, with their scripts."""
    done: list[str] = []
    at = 0
    while at < len(text):
        atom, at = _atom(text, at)
        low, high = "", ""
        while at < len(text):
            kind, script, end = _script(text, at)
            if not kind or (low if kind == "low" else high):
                break
            low, high = (script, high) if kind == "low" else (low, script)
            at = end
        done.append(_with_scripts(atom, low, high))
    return "".join(done)


def _with_scripts(atom: str, low: str, high: str) -> str:
    if low and high:
        return f"<msubsup>{atom}{low}{high}</msubsup>"
    if low or high:
        tag = "msub" if low else "msup"
        return f"<{tag}>{atom}{low or high}</{tag}>"
    return atom


def _atom(text: str, at: int) -> tuple[str, int]:
    """What stands at a place, and where it ends."""
    if text[at] == "√" and at + 1 < len(text):
        inner, end = _group(text, at + 1)
        return f"<msqrt>{_row(inner)}</msqrt>", end
    found = TOKEN.match(text, at)
    assert found is not None
    token, end = found[0], found.end()
    kind = found.lastgroup
    if kind == "space":
        return "<mspace width='0.28em'/>", end
    if kind == "number":
        return f"<mn>{token}</mn>", end
    if kind == "word":
        if token in UPRIGHT or len(token) >= WIDE:
            return f"<mtext>{token}</mtext>", end
        return f"<mi>{token[0]}</mi>", at + 1
    if kind == "letter" and token not in BIG:
        accented = " class='accented'" if len(token) > 1 else ""
        return f"<mi{accented}>{token}</mi>", end
    if token in BIG:
        return f"<mo largeop='true' movablelimits='false'>{token}</mo>", end
    if kind == "raised":  # nothing stands before it
        return f"<mo>{''.join(RAISED.get(c, c) for c in token)}</mo>", end
    if kind == "lowered":
        return f"<mo>{''.join(LOWERED[c] for c in token)}</mo>", end
    return f"<mo stretchy='false'>{escape(token)}</mo>", end


def _script(text: str, at: int) -> tuple[str, str, int]:
    """A script at a place: "low" or "high", its MathML and its end; "" where there is none."""
    if text[at] in "_^" and at + 1 < len(text) and text[at + 1] not in " _^":
        inner, end = _group(text, at + 1)
        return "low" if text[at] == "_" else "high", f"<mrow>{_row(inner)}</mrow>", end
    if text[at] == "'":
        return "high", "<mi>′</mi>", at + 1
    found = TOKEN.match(text, at)
    if found is None or found.lastgroup not in ("raised", "lowered"):
        return "", "", at
    names = RAISED if found.lastgroup == "raised" else LOWERED
    inner = "".join(names.get(c, c) for c in found[0])
    tag = "mn" if inner.isdigit() else "mi"
    kind = "low" if found.lastgroup == "lowered" else "high"
    return kind, f"<{tag}>{inner}</{tag}>", found.end()


def _group(text: str, at: int) -> tuple[str, int]:
    """What a script or a root holds: within brackets, or one number, word or letter, and more
    indices after commas without a space.

    Braces are marks and fall away; other brackets of a script stay.
    """
    opening = text[at]
    if opening in PAIRS:
        depth = 0
        for end in range(at, len(text)):
            depth += (text[end] == opening) - (text[end] == PAIRS[opening])
            if depth == 0:
                inside = text[at + 1 : end]
                keep = opening != "{" and text[at - 1] != "√"
                return (text[at : end + 1] if keep else inside), end + 1
        return text[at:], len(text)
    sign = 1 if opening in "-−+" and at + 1 < len(text) else 0
    found = TOKEN.match(text, at + sign)
    assert found is not None
    end = found.end()
    tail = TOKEN.match(text, end)
    if tail is not None and tail.lastgroup == "lowered":
        end = tail.end()
    more = INDICES.match(text, end)
    end = more.end() if more else end
    return text[at:end], end


def typeset(app, doctree: nodes.document, docname: str) -> None:
    """Put MathML in the place of blocks that are formulas."""
    if app.builder.format != "html":
        return
    for block in list(doctree.findall(nodes.literal_block)):
        text = block.astext()
        printed = OUTPUT in (*block["classes"], *block.parent.get("classes", ()))
        if printed or block.get("language", "none") not in ("none", "default"):
            continue
        if is_formula(text):
            block.replace_self(
                nodes.raw("", f"<div class='formula'>{mathml(text)}</div>", format="html")
            )


def setup(app) -> dict[str, bool]:
    app.connect("doctree-resolved", typeset)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
