"""The site: `make docs` builds it from these pages into build/docs, every warning an error.

Nothing in it leaves the machine of who reads it: Furo brings its own styles and has no fonts, formulas become MathML
when the site is built, and ``extensions/offline.py`` looks at every file for an address that a browser would fetch.
``extensions/anchors.py`` looks for links inside the site that lead nowhere.
"""

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE / "extensions"), str(HERE.parent)]

from services.run.provenance import version as installed_version  # noqa: E402  (from this checkout)

project = "ltv-mpc"
copyright = "the authors of ltv-mpc"
version = release = installed_version()

extensions = [
    *("sphinx.ext.autodoc", "sphinx.ext.viewcode", "myst_parser"),
    *("anchors", "commands", "docstrings", "glossary", "mathml", "offline", "settings"),  # docs/extensions
]
exclude_patterns = ["extensions"]
smartquotes = False  # two dashes are an option
nitpicky = True  # a type in a signature has an entry on the page of Python names
nitpick_ignore_regex = {  # of other projects, or not a name for users
    (
        "py:class",
        r"(collections\.abc|pandas|pathlib|scipy)\..*|ltv_mpc\.(messages\.Message|control\.failed_qp\.NamedQp)",
    )
}

myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 4  # as GitHub makes them, so that the same links work there

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
autodoc_type_aliases = {
    "Array": "Array",
    "Reference": "Reference",
    "Pair": "Pair",
    "Triple": "Triple",
    "Stopwatch": "Stopwatch",
}
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 80
add_module_names = False

html_theme = "furo"
html_title = "ltv-mpc"
html_static_path = ["extensions/static"]
html_css_files = ["site.css"]
html_math_renderer = "mathml"
html_show_sphinx = False
html_copy_source = False
