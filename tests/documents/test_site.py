"""The documentation: built strictly, from what the code says, and with nothing that is fetched from elsewhere."""

import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import pytest
from stage_dependencies import ROOT
from typer.main import get_command

import addressed_dynamics
from addressed_dynamics.cli.main import app
from publishing import reference

LOADED = {"script": "src", "link": "href", "img": "src", "iframe": "src", "source": "src", "video": "src"}
"""Attributes that name what a browser fetches with a page."""


class Fetched(HTMLParser):
    """Collects what a page fetches."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found += [value for name, value in attrs if LOADED.get(tag) == name and value]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    target = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(target)]
    done = subprocess.run(command, cwd=ROOT, env=dict(os.environ), capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return target


@pytest.mark.slow
def test_the_site_is_built_strictly_and_fetches_nothing_from_elsewhere(site: Path) -> None:
    pages = sorted(site.rglob("*.html"))
    assert len(pages) > 30
    for page in pages:
        parser = Fetched()
        parser.feed(page.read_text(encoding="utf-8"))
        assert parser.found
        assert [each for each in parser.found if re.match(r"(https?:)?//", each)] == [], page
    for sheet in site.rglob("*.css"):
        assert not re.search(r"url\(['\"]?(https?:)?//|@import", sheet.read_text(encoding="utf-8")), sheet


@pytest.mark.slow
def test_the_site_has_every_name_of_the_front_door_and_every_page(site: Path) -> None:
    api = (site / "reference" / "api.html").read_text(encoding="utf-8")
    for name in addressed_dynamics.__all__:
        assert re.search(rf'<h2 id="addressed_dynamics\.{name}"', api), name
    documents = {path.relative_to(ROOT / "docs").with_suffix(".html") for path in (ROOT / "docs").rglob("*.md")}
    assert [path for path in sorted(documents) if not (site / path).is_file()] == []
    assert (site / "examples" / "planning.html").is_file()
    assert not (site / "figures").exists()


def test_the_reference_of_the_command_line_has_every_command_and_every_option() -> None:
    text = reference.cli_page()
    group = get_command(app)
    for name, command in group.commands.items():
        section = text.partition(f"\n## {name}\n")[2].partition("\n## ")[0]
        assert section, name
        assert [each.opts[0] for each in command.params if each.opts[0] not in section and each.opts[0][0] == "-"] == []
    assert "&lt;name&gt;.recovered.mcap" in text


def test_the_reference_of_the_params_has_both_kinds_with_their_meanings() -> None:
    text = reference.params_page(ROOT / "params.yaml")
    transitions, motion = (text.partition(f"All defaults: {kind}")[2] for kind in ("transitions", "motion"))
    assert "# One ensemble is trained from each seed" in transitions
    assert "members: 4" in motion.partition("## An example")[0]
    assert "behaviour:" in text.partition("## An example: mountaincar")[2]
