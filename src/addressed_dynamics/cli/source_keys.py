"""A reference of all keys of the section `source`, made from the classes that check it."""

from __future__ import annotations

import io
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from pydantic import TypeAdapter
from ruamel.yaml import YAML

from addressed_dynamics.base.params import source
from addressed_dynamics.base.params.sections import CHOOSERS

COMMAND = "addressed-dynamics source-keys"
"""What writes the reference."""
Schema = Mapping[str, Any]


def source_keys() -> str:
    """Return the reference, a Markdown document."""
    return "\n".join(_lines(TypeAdapter(source.SourceParams).json_schema())) + "\n"


def _lines(schema: Schema) -> Iterator[str]:
    definitions: Mapping[str, Schema] = schema["$defs"]
    kinds = _kinds(schema)
    yield "# All keys of `source`"
    yield ""
    yield f"Made from the classes that check a params file, by `{COMMAND}`; a test holds it against them."
    yield ""
    yield _first_sentence(source.__doc__ or "")
    yield "What `kind` says chooses its other keys; each has an example."
    for name in dict.fromkeys(kinds.values()):
        own = [kind for kind, other in kinds.items() if other == name]
        yield from ("", f"## {_listed([f'`kind: {kind}`' for kind in own])}", "")
        yield from (_meaning(definitions[name]), "", "```yaml", *_example(own[0]), "```", "")
        yield from _table(definitions[name], definitions)
    yield from ("", "## Sections inside")
    for name in _inside(definitions, list(dict.fromkeys(kinds.values()))):
        yield from ("", f"### {_title(name)}", "", _meaning(definitions[name]), "")
        yield from _table(definitions[name], definitions)


def _kinds(schema: Schema) -> dict[str, str]:
    """Return the name of the class of each kind, in the order of the classes."""
    kinds = {kind: _name(reference) for kind, reference in schema["discriminator"]["mapping"].items()}
    order = [_name(each["$ref"]) for each in schema["oneOf"]]
    return dict(sorted(kinds.items(), key=lambda item: order.index(item[1])))


def _inside(definitions: Mapping[str, Schema], outer: Sequence[str]) -> list[str]:
    """Return the names of the classes that those of `outer` are made of, each after the first that needs it."""
    found = list(outer)
    for name in found:
        references = re.findall(r'"\$ref": "#/\$defs/(\w+)"', json.dumps(definitions[name]["properties"]))
        found += [each for each in dict.fromkeys(references) if each not in found]
    return found[len(outer) :]


def _table(section: Schema, definitions: Mapping[str, Schema]) -> Iterator[str]:
    properties: Mapping[str, Schema] = section["properties"]
    required = section.get("required", ())
    yield "| Key | Value | Default | Meaning |"
    yield "| --- | --- | --- | --- |"
    for key in sorted(properties, key=lambda key: (key not in CHOOSERS, key not in required)):
        own = properties[key]
        default = "required" if key in required else f"`{_default(own)}`"
        meaning = "Chooses this form." if key in CHOOSERS else _meaning(own) or _meaning_of_parts(own, definitions)
        yield f"| `{key}` | {_cell(_value(own))} | {_cell(default)} | {_cell(meaning)} |"


def _meaning_of_parts(key: Schema, definitions: Mapping[str, Schema]) -> str:
    """Return what a key means that has no text of its own: what the only section means that it may be."""
    references = [each["$ref"] for each in key.get("anyOf", key.get("oneOf", [key])) if "$ref" in each]
    if len(references) > 1:
        return "One of these."
    return " ".join(_meaning(definitions[_name(reference)]) for reference in references)


def _default(key: Schema) -> str:
    empty = {"object": "{}", "array": "[]"}
    if "default" not in key:
        return empty.get(key.get("type", ""), "null")
    return json.dumps(key["default"], ensure_ascii=False)


def _value(key: Schema) -> str:
    """Say in words what a key may be."""
    for choice in ("anyOf", "oneOf"):
        if choice in key:
            return _listed([_value(each) for each in key[choice]])
    match key:
        case {"$ref": reference}:
            return f"[{_title(_name(reference))}](#{_title(_name(reference)).replace(' ', '-')})"
        case {"const": value}:
            return f"`{value}`"
        case {"enum": values}:
            return _listed([f"`{value}`" for value in values])
        case {"type": "array"}:
            return f"list of {_value(key.get('items', {}))}"
        case {"type": "object"}:
            inner = (
                [key["additionalProperties"]] if key.get("additionalProperties") else key["patternProperties"].values()
            )
            return f"names with {_listed([_value(each) for each in inner])} each"
    words = {"string": "text", "number": "number", "integer": "whole number", "boolean": "true or false"}
    return " ".join([words.get(key.get("type", ""), "`null`"), *_bounds(key)])


def _bounds(key: Schema) -> Iterator[str]:
    words = {
        "exclusiveMinimum": "above {:g}",
        "minimum": "of at least {:g}",
        "exclusiveMaximum": "below {:g}",
        "maximum": "of at most {:g}",
    }
    if "pattern" in key:
        yield f"that matches `{json.dumps(key['pattern'])[1:-1]}`"
    yield from (text.format(key[name]) for name, text in words.items() if name in key)


def _example(kind: str) -> list[str]:
    """Return the example of a kind as lines of a params file."""
    yaml, stream = YAML(), io.StringIO()
    yaml.default_flow_style = False
    section = yaml.load(f"{{kind: {kind}, {source.EXAMPLES[kind]}}}")
    section.fa.set_block_style()
    yaml.dump({"source": section}, stream)
    return stream.getvalue().splitlines()


def _meaning(described: Schema) -> str:
    return " ".join(described.get("description", "").split())


def _first_sentence(text: str) -> str:
    return f"{text.split('.', maxsplit=1)[0]}."


def _name(reference: str) -> str:
    return reference.rpartition("/")[2]


def _title(name: str) -> str:
    """Return the name of a class in words: `EpisodeByGap` is `episode by gap`."""
    return " ".join(re.findall(r"[A-Z][a-z0-9]*", name.removesuffix("Params"))).lower()


def _listed(words: Sequence[str]) -> str:
    return " or ".join([", ".join(words[:-1]), words[-1]]) if len(words) > 1 else words[0]


def _cell(text: str) -> str:
    return text.replace("|", "\\|")
