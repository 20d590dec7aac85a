"""Sphinx configuration. Needs no network: there is no intersphinx."""

from __future__ import annotations

from vppres import __version__

project = "vppres"
author = "vppres contributors"
copyright = "2026, vppres contributors"
release = __version__

extensions = [
    "myst_parser",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.mathjax",
    "sphinx-mathjax-offline",  # the formulae need no network either
]
templates_path = ["_templates"]
exclude_patterns = ["_build"]
if tags.has("pages"):  # type: ignore[name-defined]  # noqa: F821
    # `make pages` leaves out the reference of all modules, which takes most of the time.
    exclude_patterns.append("api.*")
    suppress_warnings = ["toc.excluded"]

html_theme = "furo"
html_title = f"vppres {release}"

myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3

# Types stand in the docstrings; in signatures they would be links to libraries that are not here.
autodoc_typehints = "none"
autodoc_member_order = "bysource"
autosummary_generate = True
numpydoc_show_class_members = False
# A docstring that names a parameter which does not exist is an error.
numpydoc_validation_checks = {"PR02"}
