"""Sphinx's settings: Markdown pages in, pages that fetch nothing out."""

from __future__ import annotations

from cdobs_cli import __version__

project = "cdobs"
author = "the authors of cdobs"
release = version = __version__
extensions = ["myst_nb"]  # Markdown, and the notebook as it was run
nb_execution_mode = "off"
# Links to headings of other pages are checked as well.
myst_heading_anchors = 4
nitpicky = True
html_theme = "furo"
html_title = f"cdobs {__version__}"
html_copy_source = False
html_show_sphinx = False
pygments_dark_style = "monokai"
