"""The documentation site: `make docs`.

Formulas are LaTeX, rendered by the MathJax that is shipped with the site.
"""

import os
import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE / "extensions"), str(HERE.parent / "src")]

from deadtime.base.version import __version__  # noqa: E402

project = "deadtime"
author = "The deadtime developers"
copyright = "The deadtime developers, BSD-3-Clause"
release = version = __version__
repository = os.environ.get("REPOSITORY", "")  # make docs REPOSITORY=https://…

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "sphinx-mathjax-offline",  # with sphinx.ext.mathjax
    "sphinx_copybutton",
    "sphinx_design",
    "sphinx_gallery.gen_gallery",
    "docstrings",
    "equations",
    "links",
    "names",
    "openings",
    "sources",
    "tables",
]
templates_path = ["templates"]
exclude_patterns = ["_build"]
highlight_language = "none"
nitpicky = True
default_role = "literal"  # `names` makes links of it, here and in pages
napoleon_google_docstring = False
napoleon_use_param = False
napoleon_use_rtype = False

myst_enable_extensions = ["amsmath", "attrs_inline", "colon_fence", "dollarmath"]
myst_heading_anchors = 3

autodoc_typehints = "none"  # shapes and units are in the docstrings
autodoc_inherit_docstrings = False  # what a law shares with all laws is on the page of `Law`
autodoc_member_order = "bysource"
# Their bases have no page of their own: what they inherit is on theirs.
autosummary_context = {
    "whole": [
        f"deadtime.{n}"
        for n in ("Controller", "Identification", "Markov", "MarkovChain", "SemiMarkov")
    ]
}
python_maximum_signature_line_length = 88

EXAMPLES = HERE.parent / "examples"
sys.path.append(str(EXAMPLES))  # for the scraper
sphinx_gallery_conf = {
    "examples_dirs": [
        os.path.relpath(EXAMPLES / name, HERE) for name in ("walkthroughs", "gallery", "howto")
    ],
    "gallery_dirs": ["walkthroughs", "gallery", "howto/scripts"],
    "filename_pattern": r"/(walkthroughs|gallery)/",  # the others take too long, or need a compiler
    "within_subsection_order": "FileNameSortKey",
    "image_scrapers": ("pictures.written",),
    "download_all_examples": False,
    "show_memory": False,
    "write_computation_times": False,
    "show_signature": False,
    "remove_config_comments": True,
    "min_reported_time": 1e9,
    "abort_on_example_error": True,
}

html_theme = "pydata_sphinx_theme"
html_title = f"deadtime {release}"
html_context = {"repository": repository}
html_static_path = ["static"]
html_css_files = ["deadtime.css"]
html_copy_source = False
html_show_sourcelink = False
html_theme_options = {
    "navbar_align": "left",
    "header_links_before_dropdown": 7,
    "navigation_depth": 2,
    "show_toc_level": 2,
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["clone", "copyright"],
    "footer_end": ["theme-version"],
    "pygments_light_style": "a11y-high-contrast-light",
    "pygments_dark_style": "a11y-high-contrast-dark",
}
html_sidebars = {"index": [], "tutorial": []}
copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True
copybutton_exclude = ".linenos, .gp, .go"
