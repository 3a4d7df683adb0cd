"""The documentation as a site: ``sh scripts/docs.sh``.

The source folder is that of the whole project, so that links between docs/, robots/ and the files beside them are the
same on a code host and on the site. Nothing is loaded from any other host, neither by the build nor by a browser.
"""

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "docs" / "_ext")]

import calib  # noqa: E402

project = "urdf-calib"
author = "The urdf-calib contributors"
project_copyright = author
version = release = calib.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx_copybutton",
    "mathml",
    "docstrings",
    "commands",
]
root_doc = "docs/index"
include_patterns = [
    "docs/**",
    "robots/*/README.md",
    "scripts/README.md",
    "CHANGELOG.md",
    "CONTRIBUTING.md",
    "SECURITY.md",
]
exclude_patterns = ["docs/_*", ".*", "out", "dist", "build", "tests", "calib"]

myst_enable_extensions = ["dollarmath"]
# What a code host shows as an equation is one here.
myst_fence_as_directive = ["math"]
myst_heading_anchors = 3
myst_links_external_new_tab = False

smartquotes = False

nitpicky = True
# Names of other projects: their inventories would have to be fetched.
nitpick_ignore_regex = [
    ("py:.*", r"(?!calib\b).*"),
    # Types in signatures: they link where they are described, and not all of them need to be.
    ("py:class", r"calib\..*"),
]

autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
autodoc_typehints_format = "short"
python_use_unqualified_type_names = True
maximum_signature_line_length = 100

html_theme = "furo"
html_title = f"urdf-calib {release}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_extra_path = ["_front"]
html_copy_source = False
html_show_sourcelink = False
copybutton_prompt_text = "$ "
copybutton_only_copy_prompt_lines = True
pygments_style = "tango"
