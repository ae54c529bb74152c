"""Settings of the documentation; what is drawn from code and records is written by `pages/`."""

import os
import sys
from functools import partial
from pathlib import Path

import numpydoc.docscrape_sphinx
from docutils import nodes
from docutils.parsers.rst import roles
from jinja2 import FileSystemBytecodeCache

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))
# Tutorials take one core, whatever the machine has.
os.environ.setdefault("OMP_NUM_THREADS", "1")

from pages import write_pages  # noqa: E402
from pages.mathml import add_mathml  # noqa: E402
from pages.signatures import shortened  # noqa: E402
from pages.theory import way_back  # noqa: E402

write_pages(HERE)
# numpydoc compiles its template again for each of thousands of docstrings.
numpydoc.docscrape_sphinx.SandboxedEnvironment = partial(
    numpydoc.docscrape_sphinx.SandboxedEnvironment, bytecode_cache=FileSystemBytecodeCache()
)

project = "identknee"
author = "The identknee developers"
extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "numpydoc",
    "myst_parser",
    "sphinx_gallery.gen_gallery",
]
# Pictures, parts of pages, scripts, and a list of times that would change with every build.
TIMES = "sg_execution_times.rst"
exclude_patterns = ["_build", "_parts", "paper", "tutorials", TIMES, f"**/{TIMES}"]

nitpicky = True
# Other projects' names, which a build without a network cannot look up, and type variables.
NAMES = "Item|Result|Made|Model|Group|Getter|Given|Found|Function"
VARIABLES = rf"identknee\.(mechanics|model|report|runs|verbs)(\.\w+)+\.({NAMES})"
# An object and no function: it has no page.
SERIAL = r"identknee\.runs\.executors\.serial"
nitpick_ignore_regex = [("py:.*", rf"(?!identknee).*|{VARIABLES}|{SERIAL}")]
# Sources at the head of a module are cited by its private functions too, which have no page.
suppress_warnings = ["config.cache", "ref.citation"]

autodoc_member_order = "bysource"
# Its signature cannot be read where a module has imported it.
autodoc_default_options = {"exclude-members": "cKDTree"}
autodoc_typehints_format = "short"
autodoc_use_type_comments = False
autosummary_generate = False
numpydoc_show_class_members = False
numpydoc_attributes_as_param_list = True
python_use_unqualified_type_names = True
maximum_signature_line_length = 100

myst_enable_extensions = ["attrs_inline", "colon_fence", "dollarmath"]
myst_heading_anchors = 3

sphinx_gallery_conf = {
    "examples_dirs": "tutorials",
    "gallery_dirs": "gallery",
    "filename_pattern": "plot_",
    "within_subsection_order": "FileNameSortKey",
    "abort_on_example_error": False,
    "doc_module": (),
    "image_scrapers": "pages.pictures.scraped",
    "capture_repr": (),
    "show_signature": False,
    "show_memory": False,
    "download_all_examples": False,
    "min_reported_time": 1e9,
    "remove_config_comments": True,
}

html_theme = "pydata_sphinx_theme"
html_title = "identknee"
html_math_renderer = "mathml"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_js_files = ["site.js"]
html_show_sourcelink = False
html_copy_source = False
# Only lists of pages have something to show beside them.
html_sidebars = {"*": []} | {f"{x}/**": ["sidebar-nav-bs"] for x in ("api", "gallery", "studies")}
html_context = {"default_mode": "auto"}
html_theme_options = {
    "header_links_before_dropdown": 5,
    "navbar_align": "left",
    "show_prev_next": False,
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": [],
    "pygments_light_style": "a11y-high-contrast-light",
    "pygments_dark_style": "a11y-high-contrast-dark",
}


# A role that matplotlib has in docstrings which a figure of ours inherits.
roles.register_generic_role("mpltype", nodes.literal)


def setup(app):
    """Equations without scripts, and from each function the way back to its equation."""
    add_mathml(app)
    app.connect("autodoc-process-signature", shortened)
    # After numpydoc, which would take the link for a part of the last section.
    app.connect("autodoc-process-docstring", way_back(HERE / "theory.md"), priority=900)
