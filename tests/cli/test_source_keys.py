"""docs/source-keys.md: every key of the section `source`, as the classes have it."""

import json
import re

from pydantic import TypeAdapter
from ruamel.yaml import YAML
from stage_dependencies import ROOT
from typer.testing import CliRunner

from addressed_dynamics.base.params.source import FieldParams, McapSource, SourceParams
from addressed_dynamics.cli.main import app
from addressed_dynamics.cli.source_keys import COMMAND, source_keys

REFERENCE = ROOT / "docs" / "source-keys.md"
KINDS = TypeAdapter(SourceParams).json_schema()["discriminator"]["mapping"]


def test_the_reference_in_the_repository_is_what_the_classes_make() -> None:
    assert REFERENCE.read_text(encoding="utf-8") == source_keys(), (
        f"source.py has changed; run: {COMMAND} > {REFERENCE}"
    )


def test_the_command_prints_the_reference() -> None:
    done = CliRunner().invoke(app, ["source-keys"])
    assert done.exit_code == 0
    assert done.stdout == source_keys()


def test_the_example_of_each_kind_is_a_source() -> None:
    printed = re.findall(r"```yaml\n(.*?)```", source_keys(), flags=re.DOTALL)
    sections = [YAML(typ="safe").load(text)["source"] for text in printed]
    checked = [TypeAdapter(SourceParams).validate_json(json.dumps(section)) for section in sections]
    assert {each.kind for each in checked} == set(KINDS)
    assert len(checked) == len(KINDS)


def test_every_key_of_every_class_has_a_row_with_its_meaning() -> None:
    schema = TypeAdapter(SourceParams).json_schema()["$defs"]
    rows = re.findall(r"^\| `(\w+)` \| (.+) \| (.+) \| (.*) \|$", source_keys(), flags=re.MULTILINE)
    assert sorted(key for key, *_ in rows) == sorted(key for each in schema.values() for key in each["properties"])
    assert [key for key, _, _, meaning in rows if not meaning] == []


def section(title: str) -> dict[str, tuple[str, str, str]]:
    """Return value, default and meaning of the keys below a heading."""
    text = source_keys().partition(f"# {title}\n")[2].partition("\n#")[0]
    rows = re.findall(r"^\| `(\w+)` \| (.+) \| (.+) \| (.*) \|$", text, flags=re.MULTILINE)
    return {key: (value, default, meaning) for key, value, default, meaning in rows}


def test_a_row_says_what_a_key_may_be_its_default_and_what_its_docstring_says() -> None:
    mcap, field = section("`kind: mcap`"), section("field")
    assert set(mcap) == set(McapSource.model_fields)
    assert set(field) == set(FieldParams.model_fields)
    assert next(iter(mcap)) == "kind"
    assert mcap["rate_hz"] == ("number above 0", "required", "Steps in a second.")
    assert mcap["min_length"][0] == "whole number of at least 2"
    assert mcap["observation"][0] == "names with [field](#field) each"
    assert mcap["time"][:2] == ("`log`, `publish` or `header`", '`"log"`')
    assert mcap["topics"][1] == "`{}`"
    assert "[episode by gap](#episode-by-gap)" in mcap["episode"][0]
    assert field["low"] == ("number or `null`", "`null`", "Lowest possible value; null if unbounded.")


def test_links_lead_to_headings_of_the_reference() -> None:
    text = source_keys()
    headings = {title.replace(" ", "-") for title in re.findall(r"^### (.+)$", text, flags=re.MULTILINE)}
    assert set(re.findall(r"\(#([\w-]+)\)", text)) == headings
