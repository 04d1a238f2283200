"""Hooks of MkDocs: pages that are made when the site is, and links that lead out of `docs`."""

from __future__ import annotations

import json
import posixpath
import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

from addressed_dynamics.cli.source_keys import source_keys
from publishing import ROOT, reference

DECISIONS = "Decisions"
"""Title in the navigation below which every decision stands."""
EXAMPLES = "Examples"
_CODE = re.compile(r"`[^`\n]+`")
_LINK = re.compile(r"(!?)\[([^\]]*)\]\(([^)#\s]+)(#[^)\s]*)?\)")


def on_config(config: Any) -> Any:
    """Name every decision, every example and every other page in the navigation."""
    found = {
        DECISIONS: [{_title(path): f"decisions/{path.name}"} for path in _decisions()],
        EXAMPLES: [{_title(path): _page(path)} for path in _examples()],
    }
    named = [{title: found.get(title, inside)} for each in config.nav for title, inside in each.items()]
    # A page that nobody has named yet is found all the same.
    text = json.dumps(named)
    others = [path for path in sorted((ROOT / "docs").glob("*.md")) if f'"{path.name}"' not in text]
    config.nav = [*named, *({_title(path): path.name} for path in others)]
    return config


def on_files(files: Files, config: Any) -> Files:
    """Add the pages of the reference and the READMEs of the examples."""
    made = {
        "reference/cli.md": reference.cli_page(),
        "reference/params.md": reference.params_page(ROOT / "params.yaml"),
        "reference/api.md": reference.api_page(),
        "source-keys.md": source_keys(),
        **{_page(path): path.read_text(encoding="utf-8") for path in _examples()},
    }
    for uri, text in made.items():
        if (old := files.get_file_from_path(uri)) is not None:
            files.remove(old)
        files.append(File.generated(config, uri, content=text))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Files) -> str:  # noqa: ARG001 - MkDocs passes it
    """Let links lead to the pages of the site, and take those away that lead to a file which is none."""
    uri: str = page.file.src_uri
    # GitHub wants a bar in a cell's code escaped, Python-Markdown shows the backslash.
    bars = _CODE.sub(lambda code: code.group().replace("\\|", "|"), markdown)
    return _LINK.sub(lambda link: _link(link, uri, files), bars)


def _link(link: re.Match[str], uri: str, files: Files) -> str:
    image, text, target, place = link.groups()
    if "://" in target or image:
        return link.group()
    own = _source(uri)
    wanted = posixpath.normpath(posixpath.join(posixpath.dirname(own), target))
    there = wanted.removeprefix("docs/") if wanted.startswith("docs/") else _page(Path(wanted))
    if files.get_file_from_path(there) is None:
        return text
    return f"[{text}]({posixpath.relpath(there, posixpath.dirname(uri) or '.')}{place or ''})"


def _source(uri: str) -> str:
    """Return where a page is in the repository."""
    found = [path for path in _examples() if _page(path) == uri]
    return found[0].relative_to(ROOT).as_posix() if found else f"docs/{uri}"


def _decisions() -> list[Path]:
    return sorted((ROOT / "docs" / "decisions").glob("*.md"))


def _examples() -> list[Path]:
    return sorted((ROOT / "examples").glob("*/README.md"))


def _page(readme: Path) -> str:
    """Return the page of an example's README."""
    return f"examples/{readme.parent.name}.md"


def _title(path: Path) -> str:
    return path.read_text(encoding="utf-8").partition("\n")[0].removeprefix("# ")
