"""The site: ``make docs``. Pages are the Markdown files of this folder; ``measured.md`` is drawn from
the data of ``results`` each time, and belongs to the site alone, as the copies of `OUTER` do."""

import re
import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))

from hpac_gym import __version__  # noqa: E402
from tools.result_tables import measured_page  # noqa: E402

project = "hpac_gym"
author = "The hpac_gym maintainers"
copyright = "2026, the hpac_gym maintainers"
release = __version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.autosummary", "sphinx.ext.napoleon"]
exclude_patterns = ["_build"]
html_theme = "furo"
html_title = f"hpac_gym {release}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
myst_heading_anchors = 4
autodoc_member_order = "bysource"
autodoc_default_options = {"members": True, "show-inheritance": True}
autodoc_mock_imports = ["stable_baselines3"]
autodoc_typehints = "description"
napoleon_use_ivar = True
suppress_warnings = [
    "myst.header",  # a heading that skips a level
    "ref.python",  # a name that a package repeats from its module
]

OUTER = {
    "firmware/README.md": "boards",
    "firmware/board/esp32/README.md": "esp32",
    "CONTRIBUTING.md": "contributing",
    "CHANGELOG.md": "changelog",
}
"""Pages of other folders that the site has too, and their names there."""

(HERE / "measured.md").write_text(measured_page(), encoding="utf-8")
(HERE / "_reference").mkdir(exist_ok=True)
for path, name in OUTER.items():
    text = (HERE.parent / path).read_text(encoding="utf-8").replace("](docs/", "](/")
    (HERE / "_reference" / f"{name}.md").write_text(text, encoding="utf-8")


def with_outer_links(app, docname, source):
    """Lead links that leave this folder to the site's copy; of others, tell the path."""
    page = HERE / f"{docname}.md"

    def kept(match):
        text, target, anchor = match.groups("")
        where = (page.parent / target).resolve()
        if where.is_relative_to(HERE):
            return match[0]
        path = where.relative_to(HERE.parent).as_posix()
        if path in OUTER:
            return f"[{text}](/_reference/{OUTER[path]}.md{anchor})"
        return text if path in text else f"{text} (`{path}`)"

    source[0] = re.sub(r"\[([^\]]*)\]\((\.\.?/[^)#\s]+)(#[\w-]+)?\)", kept, source[0])


def without_fences(app, what, name, thing, options, lines):
    """Turn the fenced code of a docstring into a literal block."""
    inside = False
    for number, line in enumerate(lines):
        if line.strip().startswith("```"):
            inside = not inside
            lines[number] = "::\n" if inside else ""
        elif inside:
            lines[number] = f"    {line}"
    lines[:] = "\n".join(lines).split("\n")


def setup(app):
    """Called by Sphinx."""
    app.connect("source-read", with_outer_links)
    app.connect("autodoc-process-docstring", without_fences)
