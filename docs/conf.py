"""Settings of the documentation site; `make docs` builds it into build/site."""

from __future__ import annotations

import json
import os
import shutil
import sys
from functools import partialmethod
from importlib.metadata import version as version_of
from pathlib import Path
from typing import Any

from nbclient import NotebookClient

import hallsym
from hallsym.cli import records

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
math_number_all = False

# -- tutorials: each page is a notebook, which runs in the build and can be downloaded with its outputs ----

nb_execution_mode = "off"  # of all other pages the tests run every example
nb_execution_in_temp = True
nb_execution_raise_on_error = True
nb_execution_timeout = 120
nb_output_stderr = "remove"  # progress, on a slow machine; a command that fails ends the build
# a command's text comes in pieces of 100 bytes
NotebookClient.__init__ = partialmethod(NotebookClient.__init__, coalesce_streams=True)
# the `hallsym` of this Python
os.environ["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
_ipython = Path(__file__).parents[1] / "build" / "ipython"  # not the user's own settings and history
(_ipython / "profile_default").mkdir(parents=True, exist_ok=True)
(_ipython / "profile_default" / "ipython_kernel_config.json").write_text(
    json.dumps({"IPKernelApp": {"log_level": 40}})
)
os.environ["IPYTHONDIR"] = str(_ipython)


# -- file formats: the schemas that validate what is read ---------------------------------------------------

_schemas = Path(__file__).parent / "reference" / "generated" / "schemas"
_schemas.mkdir(parents=True, exist_ok=True)
for _name, _schema in (
    ("calibration", hallsym.calibration_schema()),
    ("diagnosis", hallsym.diagnosis_schema()),
    ("meta", hallsym.meta_schema()),
    *((command, records.schema(command)) for command in records.COMMANDS),
):
    (_schemas / f"{_name}.schema.json").write_text(json.dumps(_schema, indent=1) + "\n", encoding="utf-8")


def _offer_notebooks(app: Any, failed: Exception | None) -> None:
    """Put the notebooks that have run beside their pages."""
    for notebook in Path(app.outdir).parent.glob("jupyter_execute/tutorials/*.ipynb"):
        shutil.copy(notebook, Path(app.outdir) / "tutorials")


def setup(app: Any) -> None:
    """Register what is done after a build."""
    app.connect("build-finished", _offer_notebooks)


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
    "reset_modules": ("scrape.style",),
    "within_subsection_order": "FileNameSortKey",
}

# -- look --------------------------------------------------------------------------------------------------

html_theme = "pydata_sphinx_theme"
html_title = "hallsym"
html_context = {"default_mode": "auto"}
html_static_path = ["site"]
html_css_files = ["site.css"]
html_show_sourcelink = False
html_sidebars = {"tutorials/*": [], "formats": []}  # what a command prints is wide
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
