"""How Sphinx makes the site of these pages: `make docs`."""

project = "yamsim"
author = "the yamsim authors"
extensions = ["myst_parser"]
# Headings down to this level can be linked to, as on GitHub.
myst_heading_anchors = 4
html_theme = "furo"
html_title = "yamsim"
html_show_sphinx = False
exclude_patterns = ["_build"]
