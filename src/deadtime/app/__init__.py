"""The explorer: a page on which a person moves a problem and watches the laws.

`documents` reads, changes and writes problem files; `settings` says what a person has chosen, and
`page_outcome` runs it. None of these knows of a browser. `page`, with `controls` and `page_panels`,
shows it, `server` serves it, and `workers` does in other processes what takes longer than a
moment.
"""
