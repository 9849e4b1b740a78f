"""The explorer: a page on which a person moves a problem and watches the laws.

`documents` reads, changes and writes problem files; `laws`, `settings` and `drawing` say what a
person has chosen; `outcome` runs it. None of these knows of a browser. `page`, with `controls`
and `figures`, shows it, `server` serves it, and `workers` does in other processes what takes
longer than a moment.
"""
