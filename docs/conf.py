"""Sphinx's configuration: ``./dev docs`` builds the site into build/docs and runs the examples on the way."""

import os
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent), str(HERE / "_make")]

from architecture import draw_architecture  # noqa: E402 - found on the path set above
from commands import write_commands  # noqa: E402 - found on the path set above
from concepts import draw_concepts  # noqa: E402
from gallery import collect  # noqa: E402
from result_files import write_result_files  # noqa: E402
from validation_page import write_validation  # noqa: E402

from bcid import __version__  # noqa: E402

project, author, version = "bcid", "bcid developers", __version__
extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.mathjax",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "sphinx_gallery.gen_gallery",
]
exclude_patterns = ["_make", "_made/examples"]
myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3

html_theme, html_title = "furo", "bcid"
html_theme_options = {"source_repository": ""}
html_show_sourcelink = False

autodoc_typehints, autodoc_typehints_format = "signature", "short"
python_use_unqualified_type_names = True
autodoc_member_order = "bysource"
# Shown as they are written; most of them come from packages whose documentation is elsewhere.
nitpicky = False

# 07 and 08 read published measurements, which are not part of the project.
_RUN = os.environ.get("BCID_DOCS_EXAMPLES", r"/0[1-6]_")
sphinx_gallery_conf = {
    "examples_dirs": ["_made/examples"],
    "gallery_dirs": ["_examples"],
    "filename_pattern": _RUN,
    "abort_on_example_error": True,
    "download_all_examples": False,
    "remove_config_comments": True,
    "show_memory": False,
    "min_reported_time": 0,
    "plot_gallery": "True",
    "reset_modules": ("matplotlib", "gallery.name_the_file"),
}

made = HERE / "_made"
made.mkdir(exist_ok=True)
write_commands(made / "commands.md")
write_result_files(HERE / "_make/files_head.md", made / "files.md")
draw_concepts(made)
draw_architecture(made)
write_validation(made)
collect(made / "examples")
