"""Sphinx settings; build with ``python -m sphinx -W --keep-going docs docs/_build``."""

import os
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "_extensions"))
sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))

import nbclient.client
from traitlets import Bool

from fuzzyarm import __version__

# Tutorials call the command `fuzzyarm` of the interpreter that builds the pages.
os.environ["TTY_COMPATIBLE"] = "0"  # plain tables, as in a pipe
os.environ["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"

project, author, copyright = "FuzzyArm", "the FuzzyArm authors", "the FuzzyArm authors"
release = version = __version__
extensions = [
    "myst_nb",
    "sphinx_copybutton",
    "sphinx_design",
    "api_pages",
    "equations",
    "results_tables",
    "search_words",
]
exclude_patterns = ["_build", "_extensions"]
nitpicky = True
smartquotes = False  # two dashes begin an option

myst_enable_extensions = ["amsmath", "colon_fence", "deflist", "dollarmath", "fieldlist", "attrs_inline"]
myst_heading_anchors = 3
math_numfig = False

nb_execution_mode = "cache"
nb_execution_raise_on_error = True
nb_execution_timeout = 300
nb_execution_in_temp = True
nb_execution_show_tb = True
nb_merge_streams = True


class _Client(nbclient.client.NotebookClient):
    """Joins the pieces of 100 letters of a shell cell's output; myst-nb would put each on its own line."""

    coalesce_streams = Bool(True)


nbclient.client.NotebookClient = _Client

html_theme = "furo"
html_title = "FuzzyArm"
html_static_path = ["_static"]
html_css_files = ["page.css"]
html_js_files = ["access.js"]
html_copy_source = False
html_show_sphinx = False
html_math_renderer = "svg"
copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True
