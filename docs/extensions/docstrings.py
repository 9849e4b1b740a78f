"""The docstrings of this project as reStructuredText: sections, formulas, code, equation numbers.

They are written to be read in a terminal: one backtick around code, indented formulas, |x| for a
norm. Formulas become literal blocks, everything else is escaped, so that nothing in them is taken
for markup. Attributes of a class become entries of their own, to be linked to.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

import equations

import deadtime

RULE = re.compile(r"^-{3,}$")
CODE = re.compile(r"``[^`]+``|`[^`]+`")
EMPHASIS = re.compile(r"(?<!\w)\\\*(\w[\w ]*)\\\*(?!\w)")  # once escaped
BESIDE = re.compile(r"[\w*]")  # characters that may not touch the marks of inline code
LISTED = ("Parameters", "Returns", "Raises", "Yields")
PUBLIC = re.compile(rf"\b({'|'.join(name for name in deadtime.__all__ if name[0].isupper())})\b")


def sections(lines: list[str]) -> Iterator[tuple[str, list[str]]]:
    """The text before the first heading, under "", then each section under its heading."""
    heading, body = "", []
    rest = iter(range(len(lines)))
    for i in rest:
        if i + 1 < len(lines) and lines[i] and RULE.match(lines[i + 1]):
            yield heading, body
            heading, body = lines[i], []
            next(rest)
        else:
            body.append(lines[i])
    yield heading, body


def inline(text: str, cites: bool = True) -> str:
    """A piece of prose, escaped, its code marked as code."""
    parts, end = [], 0
    for found in CODE.finditer(text):
        parts.append(_escaped(text[end : found.start()], cites))
        before = text[found.start() - 1] if found.start() else " "
        after = text[found.end()] if found.end() < len(text) else " "
        code = found.group().strip("`")
        parts.append("\\ " * bool(BESIDE.match(before)) + f"``{code}``")
        parts.append("\\ " * bool(BESIDE.match(after)))
        end = found.end()
    return "".join(parts) + _escaped(text[end:], cites)


def _escaped(text: str, cites: bool) -> str:
    text = re.sub(r"([\\*|_])", r"\\\1", text)
    text = EMPHASIS.sub(r"*\1*", text)
    return equations.cited(text) if cites else text


def blocks(lines: list[str]) -> Iterator[list[str]]:
    """Paragraphs; indented ones that follow each other are one."""
    block: list[str] = []
    for line in [*lines, ""]:
        if line.strip():
            block.append(line)
        elif block:
            yield block
            block = []


def prose(lines: list[str]) -> list[str]:
    """Paragraphs, lists, formulas and examples."""
    out: list[str] = []
    for block in blocks(lines):
        first = block[0]
        if first.startswith(">>>"):
            out += [*block, ""]
        elif first.startswith(" "):
            out += ["::", "", *(f"    {line}" for line in block), ""]
        else:
            # A code span may run over the end of a line: a paragraph is escaped as a whole.
            out += [*inline("\n".join(block)).split("\n"), ""]
    return out


def entries(lines: list[str]) -> Iterator[tuple[str, list[str]]]:
    """The head of each entry of a list of parameters, and what is said of it."""
    head, body = None, []
    for line in lines:
        if line and not line.startswith(" "):
            if head is not None:
                yield head, body
            head, body = line, []
        else:
            body.append(line[4:])
    if head is not None:
        yield head, body


def indented(lines: list[str], by: int = 4) -> list[str]:
    return [" " * by + line if line else "" for line in lines]


def kind(text: str) -> str:
    """A type in words, the names of public classes as code."""
    return inline(PUBLIC.sub(r"`\1`", text.replace("`", "")), cites=False)


def listed(heading: str, lines: list[str]) -> list[str]:
    """Parameters, results or exceptions as a field."""
    out = [f":{heading}:"]
    for head, body in entries(lines):
        name, colon, of = head.partition(" : ")
        if colon:
            term = f"**{_escaped(name, False)}** : {kind(of)}"
        else:
            term = kind(head) if heading != "Parameters" else f"**{_escaped(head, False)}**"
        said = prose(body) or ["\\ "]
        out += [*indented([term]), *indented(said, 8)]
    return [*out, ""]


def attributes(owner: object, full: str, lines: list[str]) -> list[str]:
    """Attributes as entries that can be linked to."""
    out: list[str] = []
    for head, body in entries(lines):
        names, _, of = head.partition(" : ")
        each = [name.strip() for name in names.split(",")]
        if not all(name.isidentifier() for name in each):
            out += [f"**{_escaped(names, False)}** : {kind(of)}", *indented(prose(body))]
            continue
        # A property with a text of its own has an entry of its own.
        double = any(isinstance(getattr(owner, name, None), property) for name in each)
        out += [f".. py:attribute:: {each[0]}", *(f"                   {n}" for n in each[1:])]
        out += ["   :no-index:"] if double else ["   :no-index-entry:"]
        said = prose(body)
        numbers = [link for name in each for link in equations.links_of(f"{full}.{name}")]
        if of:
            out += ["", *indented([kind(of) if "``" in kind(of) else f"*{kind(of)}*"], 3)]
        out += [""]
        out += indented(said, 3)
        out += indented([f"{_heading(numbers)} {', '.join(numbers)}", ""], 3) if numbers else []
    return [*out, ""]


def _heading(numbers: list[str]) -> str:
    return ":Equation:" if len(numbers) == 1 else ":Equations:"


def convert(what: str, name: str, owner: object, lines: list[str]) -> list[str]:
    """A whole docstring."""
    fields, examples, own = [], [], []
    out: list[str] = []
    for heading, body in sections(lines):
        if heading == "":
            out += prose(body)
        elif heading in LISTED:
            fields += listed(heading, body)
        elif heading == "Attributes" and what in ("class", "exception"):
            own += attributes(owner, name, body)
        elif heading == "Attributes":
            fields += listed(heading, body)
        elif heading == "Examples":
            examples += [".. rubric:: Example", "", *prose(body)]
        else:
            fields += [f":{heading}:", *indented(prose(body)), ""]
    cited = "\n".join(fields)
    numbers = [link for link in equations.links_of(name) if link.split("<")[1] not in cited]
    if numbers:
        fields += [f"{_heading(numbers)} {', '.join(numbers)}", ""]
    return [*out, "", *fields, *examples, *own]


def process(app, what, name, obj, options, lines) -> None:
    lines[:] = convert(what, name, obj, list(lines))


def signature(app, what, name, obj, options, signature, result):
    """Results are made by functions: how they are constructed is nobody's business."""
    if what == "class" and "Parameters\n" not in (obj.__doc__ or ""):
        return "", None
    return signature, result


def setup(app) -> dict[str, bool]:
    app.connect("autodoc-process-docstring", process)
    app.connect("autodoc-process-signature", signature)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
