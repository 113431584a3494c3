"""Settings of the documentation site; `make docs` builds it into build/site."""

from __future__ import annotations

import sys
from importlib.metadata import version as version_of
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

project = "hallsym"
author = "hallsym contributors"
copyright = author
version = release = version_of("hallsym")

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx_copybutton",
    "sphinx_design",
    "sphinx_gallery.gen_gallery",
    "sphinx-mathjax-offline",
]
default_role = "code"
exclude_patterns = [
    "gallery",
    *(f"examples/**/*.{kind}" for kind in ("ipynb", "json", "md5", "zip")),
    "**sg_execution_times.rst",
]
suppress_warnings = ["config.cache"]

# -- pages -------------------------------------------------------------------------------------------------

myst_enable_extensions = ["amsmath", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 4
nb_execution_mode = "off"  # the tests run every example
math_number_all = False

# -- reference ---------------------------------------------------------------------------------------------

autosummary_generate = True
autosummary_ignore_module_all = False
autodoc_typehints = "none"
autodoc_member_order = "bysource"
autodoc_default_options = {"members": True}

# -- gallery -----------------------------------------------------------------------------------------------

sphinx_gallery_conf = {
    "examples_dirs": "gallery",
    "gallery_dirs": "examples",
    "subsection_order": ["gallery/stage", "gallery/encoder", "gallery/halbach", "gallery/curves"],
    "filename_pattern": "/plot_",
    "download_all_examples": False,
    "remove_config_comments": True,
    "plot_gallery": True,
    "abort_on_example_error": True,
    "min_reported_time": 1e9,
    "image_scrapers": ("scrape.figures",),
    "within_subsection_order": "FileNameSortKey",
}

# -- look --------------------------------------------------------------------------------------------------

html_theme = "pydata_sphinx_theme"
html_title = "hallsym"
html_static_path = ["site"]
html_css_files = ["site.css"]
html_show_sourcelink = False
html_theme_options = {
    "show_toc_level": 2,
    "navigation_with_keys": True,
    "navbar_align": "left",
    "footer_start": ["copyright"],
    "footer_end": [],
    "secondary_sidebar_items": ["page-toc"],
    "pygments_light_style": "friendly",
    "pygments_dark_style": "monokai",
}
