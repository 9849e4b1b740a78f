"""The documentation site: `make docs`.

Formulas are Unicode text, here as in the docstrings, so no page needs a renderer of maths, a font
or a network. Pages read on a file system without either.
"""

import os
import sys
import warnings
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE / "extensions"), str(HERE.parent / "src")]

from deadtime.version import __version__  # noqa: E402

project = "deadtime"
author = "The deadtime developers"
copyright = "The deadtime developers, BSD-3-Clause"
release = version = __version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx_copybutton",
    "sphinx_design",
    "sphinx_gallery.gen_gallery",
    "docstrings",
    "equations",
    "links",
    "names",
]
exclude_patterns = ["_build", "gallery/**/*.ipynb", "gallery/**/*.py", "gallery/**/*.md5"]
highlight_language = "none"
nitpicky = True

myst_enable_extensions = ["attrs_inline", "colon_fence"]
myst_heading_anchors = 3

autodoc_typehints = "none"  # shapes and units are in the docstrings
autodoc_inherit_docstrings = False  # what a law shares with all laws is on the page of `Law`
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
python_maximum_signature_line_length = 88

# The gallery's scripts; a page that says where they are, in a checkout without them.
GALLERY = HERE.parent / "examples" / "gallery"
if not GALLERY.exists():
    extensions.remove("sphinx_gallery.gen_gallery")
    (HERE / "gallery").mkdir(exist_ok=True)
    text = "# Gallery\n\nScripts that draw: the folder `examples` of the repository.\n"
    (HERE / "gallery" / "index.md").write_text(text, encoding="utf-8")
sphinx_gallery_conf = {
    "examples_dirs": os.path.relpath(GALLERY, HERE),
    "gallery_dirs": "gallery",
    "filename_pattern": r"\.py$",
    "ignore_pattern": r"__init__\.py|processor_in_the_loop\.py",
    "download_all_examples": False,
    "show_memory": False,
    "show_signature": False,
    "remove_config_comments": True,
    "min_reported_time": 1e9,
    "abort_on_example_error": True,
}
warnings.filterwarnings("ignore", message=".*non-interactive.*", category=UserWarning)

html_theme = "pydata_sphinx_theme"
html_title = "deadtime"
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
    "article_footer_items": ["prev-next"],
    "footer_start": ["copyright"],
    "footer_end": ["theme-version"],
    "pygments_light_style": "a11y-high-contrast-light",
    "pygments_dark_style": "a11y-high-contrast-dark",
}
html_sidebars = {"index": []}
copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True
copybutton_exclude = ".linenos, .gp, .go"
