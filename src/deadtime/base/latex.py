"""Text and tables for LaTeX: plain text escaped, its mathematical characters as commands."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Sequence

_TEXT = {
    "\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
    "–": "--", "—": "---", "…": r"\ldots{}", "“": "``", "”": "''", "’": "'", "‘": "`",
    "\u200b": "", "\u00a0": "~", "\u202f": r"\,",
    **{letter: f"\\{letter}" for letter in "&%$#_{}"},
}  # fmt: skip
_MATHS = {
    "−": "-", "×": r"\times", "·": r"\cdot", "±": r"\pm", "≤": r"\le", "≥": r"\ge", "≈": r"\approx",
    "≠": r"\ne", "∞": r"\infty", "∫": r"\int", "√": r"\surd", "→": r"\to", "ℓ": r"\ell",
    "°": r"^\circ", "‖": r"\|", "∂": r"\partial", "∈": r"\in", "′": "'",
    **{letter: letter for letter in "<>|"},
}  # fmt: skip
_SCRIPTS = {"<super>": "^", "<sub>": "_"}


def latex(text: str) -> str:
    r"""A text escaped for LaTeX, which prints it unchanged; other non-ASCII letters are kept.

    Examples
    --------
    >>> print(latex("∫|x₁|² at 95 % of σ"))
    \ensuremath{\int}\ensuremath{|}x\ensuremath{_{1}}\ensuremath{|}\ensuremath{^{2}} at 95 \% of \ensuremath{\sigma}
    """  # noqa: E501
    return "".join(map(_character, text))


def _character(one: str) -> str:
    if one in _TEXT:
        return _TEXT[one]
    if one in _MATHS:
        return rf"\ensuremath{{{_MATHS[one]}}}"
    if one.isascii():
        return one
    script, _, code = unicodedata.decomposition(one).partition(" ")
    if script in _SCRIPTS and " " not in code:
        below = chr(int(code, 16))
        return rf"\ensuremath{{{_SCRIPTS[script]}{{{_MATHS.get(below, below)}}}}}"
    name = unicodedata.name(one, "").split()
    if name[:1] == ["GREEK"] and name[2:3] == ["LETTER"] and len(name) == 4:
        command = name[3].replace("LAMDA", "LAMBDA").lower()
        return rf"\ensuremath{{\{command if name[1] == 'SMALL' else command.capitalize()}}}"
    return one


_POWER = re.compile(r"(?<![\w.])(\d\.\d)e(-?\d+)(?!\w)")


def booktabs(headings: Sequence[str], rows: Sequence[Sequence[str]], notes: Sequence[str]) -> str:
    """A `tabular` of the package booktabs, its first column left, the others right.

    `notes` become comments above it, which say where the numbers come from.

    Examples
    --------
    >>> print(booktabs(["law", "95 %"], [["mean", "1.2e13"]], ["Costs"]), end="")
    % Costs
    % needs: \\usepackage{booktabs}
    \\begin{tabular}{lr}
    \\toprule
    law & 95 \\% \\\\
    \\midrule
    mean & \\ensuremath{1.2\\cdot10^{13}} \\\\
    \\bottomrule
    \\end{tabular}
    """
    comments = [*(" ".join(one.split()) for one in notes), r"needs: \usepackage{booktabs}"]
    power = r"\\ensuremath{\1\\cdot10^{\2}}"
    cells = [[_POWER.sub(power, latex(cell)) for cell in row] for row in (headings, *rows)]
    lines = [" & ".join(row) + r" \\" for row in cells]
    begin = rf"\begin{{tabular}}{{l{'r' * (len(headings) - 1)}}}"
    whole = [begin, r"\toprule", lines[0], r"\midrule", *lines[1:], r"\bottomrule"]
    return "\n".join([*(f"% {one}" for one in comments), *whole, r"\end{tabular}", ""])
