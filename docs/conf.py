"""How the documentation is built: ``make docs``.

Pages are Markdown that reads as well on a code host. What only a built page can have is added here:
the tree of pages from the lists of links in ``index.md``, links from names of functions to the
reference, and the reference of the command.
"""

from __future__ import annotations

import html
import pkgutil
import re
import sys
from pathlib import Path

from pygments.lexers.special import TextLexer

import ekfslam

ROOT = Path(__file__).parents[1]

project = "ekfslam"
author = copyright = "The ekfslam developers"
version = release = ekfslam.__version__

# The source is the repository, so that README, pages and notebooks may link to each other.
root_doc = "docs/index"
include_patterns = [
    "*.md",
    "docs/*.md",
    "docs/reference/*.md",
    "notebooks/*.ipynb",
    "examples/*/README.md",
]
exclude_patterns = ["docs/_build", ".*", "**/.*", "results", "tests", "ekfslam", "baselines"]

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.autosummary"]
nitpicky = True
default_role = "py:obj"
# Names of attributes are looked up among all classes: where several have one, any is no link.
suppress_warnings = ["ref.python"]

myst_heading_anchors = 3
myst_links_external_new_tab = False
nb_execution_mode = "off"  # outputs are kept in the notebooks

autodoc_default_options = {"members": True, "member-order": "bysource"}
autodoc_typehints = "none"  # types stand in the docstrings, with shapes and units
autosummary_generate = False
napoleon_google_docstring = False
napoleon_use_param = False
napoleon_use_rtype = False
napoleon_use_ivar = True

html_theme = "furo"
html_title = f"ekfslam {version}"
html_show_sourcelink = False
html_static_path = ["style"]
html_css_files = ["tables.css"]
highlight_language = "none"  # a block without a language is what a command prints


# What looks like a name of Python and is none: groups of entry points.
GROUPS = {"ekfslam.estimators", "ekfslam.oracles"}


def link_names(text: str) -> str:
    """``module:name`` and names with dots in backticks become links to the reference."""

    def link(match):
        name = ".".join(filter(None, match.groups()))
        return match[0] if name in GROUPS else f"{{py:obj}}`{name}`"

    return re.sub(r"(?<![`}])`((?:ekfslam|baselines)(?:\.\w+)+)(?::([\w.]+))?`(?!`)", link, text)


def drop_folders(text: str, docname: str) -> str:
    """Links to folders, which a built page does not have, become words."""

    def word(match):
        where = (ROOT / docname).parent / match[2]
        return match[1] if where.is_dir() else match[0]

    return re.sub(r"\[([^]\n]*)\]\(([^)#:\s]+)\)", word, text)


def grow_tree(text: str) -> str:
    """Each section of the index whose items are links is a branch of the tree of pages."""
    for title, body in re.findall(r"^## (.*)\n((?:(?!## ).*\n)*)", text, flags=re.MULTILINE):
        if links := re.findall(r"^- \[(.*?)\]\((.*?)\.\w+\)", body, flags=re.MULTILINE):
            listed = "\n".join(f"{name} <{page}>" for name, page in links)
            text += f"\n```{{toctree}}\n:hidden:\n:caption: {title}\n\n{listed}\n```\n"
    return text


def describe_commands() -> str:
    """The commands with their options, as Markdown."""
    import typer
    from typer.cli import get_docs_for_click
    from typer.core import MARKUP_MODE_KEY

    from ekfslam.cli import app

    command = typer.main.get_command(app)
    markup = {MARKUP_MODE_KEY: "rich"}  # that of the texts: else its tags are shown
    context = command.make_context("ekfslam", [], resilient_parsing=True, obj=markup)
    text = get_docs_for_click(obj=command, ctx=context, name="ekfslam", indent=1)
    text = re.sub(r'<span style="color[^>]*>(.*?)</span>', r"# \1", text)
    text = re.sub(r'<span style="font-weight[^>]*>(.*?)</span>', r"**\1**", text)
    options = re.compile(r"(?<=[ (])(--[a-z-]+)(?=[ .,;)])")
    prose = re.compile(r"^[*A-Z].*", re.MULTILINE)  # in which options would lose a dash
    text = prose.sub(lambda line: options.sub(r"`\1`", line[0]), text)
    examples = re.compile(r"(?:^  \S.*\n+)+", re.MULTILINE)
    return examples.sub(lambda lines: _fenced(lines[0]), text)


def _fenced(lines: str) -> str:
    dense = "".join(f"{html.unescape(line.strip())}\n" for line in lines.splitlines() if line)
    return f"```{'sh' if dense.startswith('ekfslam') else 'text'}\n{dense}```\n\n"


def head_modules(text: str) -> str:
    """Every module of the reference has a heading."""
    return re.sub(
        r"^\.\. automodule:: (\S+)$",
        r".. rubric:: \1\n   :heading-level: 2\n\n\g<0>",
        text,
        flags=re.MULTILINE,
    )


def list_others(match: re.Match[str]) -> str:
    """The modules of a package that its page does not list."""
    package, text = match[1], match.string
    folder = ROOT / package.replace(".", "/")
    files = folder.glob("*.py") if package == "ekfslam" else folder.rglob("*.py")
    names = [".".join(file.relative_to(ROOT).with_suffix("").parts) for file in sorted(files)]
    names = [name for name in names if "__" not in name and f"automodule:: {name}\n" not in text]
    listed = "\n".join(f".. automodule:: {name}" for name in names)
    return f"## Inside\n\n```{{eval-rst}}\n{listed}\n```\n"


def read_source(app, docname, source):
    """Add to a page what it has only when it is built."""
    text = source[0]
    if docname == root_doc:
        text = grow_tree(text)
    elif docname == "docs/reference/commands":
        text += describe_commands()
    text = re.sub(r"<!-- all other modules of ([\w.]+) -->\n", list_others, text)
    text = head_modules(text)
    if not docname.startswith("notebooks"):
        text = link_names(drop_folders(text, docname))
    source[0] = text


def skip_aliases(app, what, name, obj, skip, options):
    """Fields of a named tuple that its docstring does not describe are left out."""
    return True if (getattr(obj, "__doc__", "") or "").startswith("Alias for field") else None


def join_colons(app, what, name, obj, options, lines):
    """A colon in the line of a property is one; napoleon takes what stands before it for a type."""
    for i, line in enumerate(lines):
        if what in ("attribute", "data", "property") and line.startswith(":type: "):
            lines[0] = f"{line.removeprefix(':type: ')}: {lines[0]}"
            del lines[i]
            break


def resolve_reference(app, env, node, contnode):
    """Links names to where they are defined, as ``ekfslam.Estimate`` is in ``ekfslam.estimates``.

    What is no object of Python, and what has no docstring, stays a word without a link; a name with
    dots that does not exist is a warning.
    """
    if node.get("refdomain") != "py":
        return None
    name = node["reftarget"]
    for whole in (name, f"{node.get('py:module')}.{name}", f"ekfslam.{name}"):
        if "." not in whole or whole.partition(".")[0] not in sys.modules:
            continue
        try:
            found = pkgutil.resolve_name(whole)
        except (ImportError, AttributeError, ValueError):
            continue
        home = f"{getattr(found, '__module__', '')}.{getattr(found, '__qualname__', '')}"
        link = env.domains["py"].resolve_xref(
            env, node["refdoc"], app.builder, "obj", home, node, contnode
        )
        return link or contnode
    return None if "." in name else contnode


def lead_from_root(app, error):
    """The folder of a site opens at its first page."""
    page = f'<!doctype html><meta http-equiv="refresh" content="0; url={root_doc}.html">\n'
    (Path(app.outdir) / "index.html").write_text(page, encoding="utf-8")


def setup(app):
    """Connect the hooks."""
    app.add_lexer("csv", TextLexer)
    app.connect("source-read", read_source)
    app.connect("autodoc-skip-member", skip_aliases)
    app.connect("autodoc-process-docstring", join_colons, priority=600)  # after napoleon
    app.connect("missing-reference", resolve_reference)
    app.connect("build-finished", lead_from_root)
