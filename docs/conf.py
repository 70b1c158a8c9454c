"""The site: Sphinx with numpydoc, MyST-NB and the PyData theme.   make docs

Two kinds of page are written anew at every build: the API, one page per room, from the docstrings; and the
tutorials, with their figures where ``make notebooks`` has run them, and without outputs otherwise.
"""

import importlib.util
import re
import shutil
import sys
import types
from pathlib import Path

DOCS = Path(__file__).parent
ROOT = DOCS.parent
PACKAGE = ROOT / "agility_ref"
sys.path.insert(0, str(ROOT))

import agility_ref  # noqa: E402

project = "agility_ref"
author = "the agility_ref authors"
version = release = agility_ref.__version__
extensions = ["myst_nb", "numpydoc", "sphinx.ext.autodoc", "sphinx.ext.viewcode"]
exclude_patterns = ["_build", "jupyter_execute"]
html_theme = "pydata_sphinx_theme"
html_title = "agility_ref"
html_static_path: list[str] = []
html_theme_options = {"navigation_with_keys": False, "show_toc_level": 2, "secondary_sidebar_items": ["page-toc"]}
html_show_sourcelink = False

myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3  # as GitHub makes them, so that links to a heading work in both places
nb_execution_mode = "off"
suppress_warnings = ["myst.header"]  # a tutorial's cells may begin below the first level

autodoc_member_order = "bysource"
autodoc_typehints = "none"
autodoc_default_options = {"members": True}
autodoc_mock_imports = [
    name
    for name in ("gymnasium", "viser", "imageio_ffmpeg", "onnx", "onnxruntime")
    if not importlib.util.find_spec(name)
]
numpydoc_show_class_members = False

ROOMS = {
    "core": "The core: the paper",
    "training": "Training: policies as data, runs in folders",
    "pictures": "Pictures: recordings, curves, maps, films",
    "results": "Results: Table 1 and the findings",
    "cli": "The command line",
}


def modules_of(room: str) -> list[str]:
    """Return the modules of a room by their whole names, those of the core in their reading order."""
    folder = PACKAGE if room == "core" else PACKAGE / room
    names = sorted(path.stem for path in folder.glob("*.py") if not path.stem.startswith("__"))
    if room != "core":
        return [f"agility_ref.{room}.{name}" for name in names]
    order = re.findall(r"^\| `(\w+)\.py` \|", (ROOT / "README.md").read_text(encoding="utf-8"), re.M)
    return [f"agility_ref.{name}" for name in (*order, *(name for name in names if name not in order))]


def write_api() -> None:
    """Write docs/api/<room>.md: every module of the room with its public functions and classes."""
    folder = DOCS / "api"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    for room, title in ROOMS.items():
        parts = [f"# {title}\n"]
        for name in modules_of(room):
            parts.append(f"## `{name}`\n\n```{{eval-rst}}\n.. automodule:: {name}\n```\n")
        (folder / f"{room}.md").write_text("\n".join(parts), encoding="utf-8")


def write_tutorials() -> None:
    """Write docs/tutorials/<name>.ipynb from tutorials/<name>.py, or copy what ``make notebooks`` has run."""
    import jupytext

    folder = DOCS / "tutorials"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    for script in sorted((ROOT / "tutorials").glob("[0-9]*.py")):
        executed = ROOT / "notebooks" / f"{script.stem}.ipynb"
        if executed.exists() and executed.stat().st_mtime >= script.stat().st_mtime:
            shutil.copyfile(executed, folder / executed.name)
        else:
            notebook = jupytext.read(script)
            notebook.metadata["language_info"] = {"name": "python", "pygments_lexer": "ipython3"}
            jupytext.write(notebook, folder / executed.name)


def plain_to_rst(app, what, name, obj, options, lines) -> None:
    """Turn what our docstrings write plainly into reST: "In:" and "Out:" into a list, |x| into a bar, x and a bar."""
    rst, item = [], False
    for line in lines:
        start = re.match(r"(In|Out): +(.*)", line) if what == "module" else None
        if start:
            rst += [] if item else [""]
            rst.append(f"* **{start[1]}:** {start[2]}")
        elif item and line.strip():
            rst.append(f"  {line.strip()}")
        else:
            rst.append(line if line.startswith(" ") else re.sub(r"(?<!`)\|([^|`]+)\|", r"\\|\1\\|", line))
        item = bool(start) or (item and bool(line.strip()))
    lines[:] = rst


def skip_alias(app, what, name, obj, skip, options) -> bool | None:
    """Leave aliases of types out, such as ``Cells``: their signature is that of dict."""
    return True if isinstance(obj, types.GenericAlias) else None


def link_names(app, docname, source) -> None:
    """Link names such as `agility_ref.ppo.gae` to their place in the API, and pages outside docs/ as files."""
    if not docname.startswith(("api/", "tutorials/")):
        source[0] = re.sub(r"\[([^\]]+)\]\((\.\./[^)#]+\.md)(#[^)]*)?\)", r"{download}`\1 <\2>`", source[0])
        source[0] = re.sub(r"`agility_ref\.([\w.]+)`", r"{py:obj}`\1 <agility_ref.\1>`", source[0])


def setup(app) -> None:
    """Hook them in; numpydoc comes after."""
    app.connect("autodoc-process-docstring", plain_to_rst, priority=400)
    app.connect("autodoc-skip-member", skip_alias)
    app.connect("source-read", link_names)


write_api()
write_tutorials()
