"""Settings of the documentation site (`make docs`): pages of docs/ and the reference."""

from concord import __version__

project = "concord"
copyright = "the concord developers"
version = release = __version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.viewcode"]
default_role = "code"
smartquotes = False
add_module_names = False
html_theme = "furo"
html_title = f"concord {version}"
myst_heading_anchors = 3
# README and ARCHITECTURE stand above docs/, where the site has no page; diagrams stay text.
suppress_warnings = [
    "myst.xref_missing",
    "myst.header",
    "toc.not_included",
    "misc.highlighting_failure",
]
autodoc_typehints = "description"
autodoc_member_order = "bysource"
