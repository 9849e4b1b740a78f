"""Docstrings after napoleon: attributes that can be linked to, and links to equations."""

from __future__ import annotations

import inspect
import re

import equations
from sphinx.ext.napoleon import NumpyDocstring

import deadtime

ATTRIBUTE = re.compile(r"^\.\. attribute:: (.+)\n((?:\n|   .*\n)*)", re.M)
TYPE = re.compile(r"\(\*([^*\n]+)\*\)")  # of a parameter
PUBLIC = re.compile(rf"\b({'|'.join(name for name in deadtime.__all__ if name[0].isupper())})\b")
KIND = re.compile(r"^   :type: (.*(?:\n {6,}.*)*)\n", re.M)


def attribute(owner: object, full: str, found: re.Match[str]) -> str:
    """The entry of attributes that are described together."""
    names, text = found[1].split(", "), found[2]
    # A property with a docstring has an entry of its own.
    own = any(isinstance(getattr(owner, one, None), property) for one in names)
    kind = KIND.search(text)
    # Types are prose, with shapes: as cross-references they would lead astray.
    parts = [f"\n   *{re.sub(r'`|  +', '', kind[1])}*\n"] if kind else []
    parts.append("\n" + KIND.sub("", text).strip("\n") + "\n")
    numbers = [link for one in names for link in equations.links_of(f"{full}.{one}")]
    parts += [f"\n   Equations: {', '.join(numbers)}\n"] if numbers else []
    heads = f"\n{'':15}".join(names)
    option = ":no-index:" if own else ":no-index-entry:"
    return f".. attribute:: {heads}\n   {option}\n{''.join(parts)}\n"


def process(app, what, name, owner, options, lines) -> None:
    """Mend what napoleon has made of a docstring."""
    if what in ("property", "attribute"):  # "X: …" of their first line is no type
        given = inspect.getdoc(owner) or ""
        text = str(NumpyDocstring(given, app.config, app, "method", name, owner))
    else:
        text = "\n".join(lines) + "\n"
    text = equations.cited(text)
    text = ATTRIBUTE.sub(lambda found: attribute(owner, name, found), text)
    text = TYPE.sub(lambda found: "(" + PUBLIC.sub(r"``\1``", found[1]) + ")", text)
    at = text.find(".. attribute::") % (len(text) + 1)  # entries of their own
    numbers = [link for link in equations.links_of(name) if link.split("<")[1] not in text[:at]]
    if numbers:
        text = f"{text[:at]}\nEquations: {', '.join(numbers)}\n\n{text[at:]}"
    lines[:] = text.split("\n")


def signature(app, what, name, owner, options, signature, result):
    """Results are made by functions: their constructors are not part of the interface."""
    if what == "class" and "Parameters\n" not in (owner.__doc__ or ""):
        return "", None
    return signature, result


def setup(app) -> dict[str, bool]:
    app.connect("autodoc-process-docstring", process, priority=600)  # napoleon has 500
    app.connect("autodoc-process-signature", signature)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
