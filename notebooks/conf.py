"""The handbook: ``python -m sphinx -W notebooks build/handbook`` makes it.

Notebooks are executed with few rays, some as sketches; ``GONIO_RAYS=1e6`` executes them
in full, which takes an hour. ``GONIO_HANDBOOK=pages`` leaves them unexecuted. With
``GONIO_HANDBOOK_ONLINE=1``, and on Read the Docs, types link to other projects' pages.
"""

import os
import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path += [str(HERE / "_extension"), str(HERE.parent)]
os.environ.setdefault("GONIO_RAYS", "5e4")

project = "gonio-mi"
author = "the gonio-mi maintainers"
extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.intersphinx",
    "sphinx.ext.napoleon",
    "sphinx.ext.mathjax",
    "reference_pages",
]
exclude_patterns = ["_extension", "build", "**.ipynb_checkpoints"]
html_theme = "sphinx_book_theme"
html_title = "gonio-mi"
html_show_sourcelink = False
html_theme_options = {
    "show_toc_level": 2,
    "use_download_button": False,
    "navbar_persistent": [],  # a search box in the sidebar is enough
}
html_static_path = ["_static"]
html_css_files = ["handbook.css"]
suppress_warnings = ["mystnb.unknown_mime_type"]

myst_enable_extensions = ["dollarmath", "colon_fence"]
myst_heading_anchors = 3

nb_execution_mode = "off" if os.environ.get("GONIO_HANDBOOK") == "pages" else "force"
nb_execution_in_temp = True  # what notebooks write is not a part of the project
nb_execution_timeout = -1
nb_execution_raise_on_error = True

autodoc_typehints = "none"
napoleon_use_rtype = False
napoleon_preprocess_types = True
napoleon_type_aliases = {
    "ndarray": ":class:`~numpy.ndarray`",
    "path": ":class:`path <os.PathLike>`",
    "mi.BSDF": ":class:`mi.BSDF <mitsuba.BSDF>`",
    "mi.Scene": ":class:`mi.Scene <mitsuba.Scene>`",
}

LINKED = {
    "python": "https://docs.python.org/3",
    "numpy": "https://numpy.org/doc/stable",
    "xarray": "https://docs.xarray.dev/en/stable",
    "mitsuba": "https://mitsuba.readthedocs.io/en/stable",
}
if {"READTHEDOCS", "GONIO_HANDBOOK_ONLINE"} & os.environ.keys():
    intersphinx_mapping = {name: (url, None) for name, url in LINKED.items()}
linkcheck_anchors_ignore_for_url = ["https://github.com/.*"]  # made by a script
