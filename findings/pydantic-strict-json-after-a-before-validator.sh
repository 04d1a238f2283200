#!/usr/bin/env bash
# pydantic 2.14.3: with a 'before' validator, a strict model no longer takes in JSON what it took without one.
#
# A strict model with a tuple and a Decimal reads both from JSON, where they can only stand as a list and as a text: strict
# mode knows that JSON has no such types, and 'model_validate_json' says so to it. A validator 'mode="before"' that returns
# its input as it got it changes that: what it returns counts as Python from there on, and strict Python takes neither a list
# for a tuple nor a text for a Decimal. Only the fields below the validator are concerned: a nested model without one, in
# the same document, is read as before only if no model above it has one either. 'ValidationInfo.mode' goes on to say 'json'.
#
# Seen (pydantic 2.14.3, Python 3.11): the plain model reads the document; the one with the validator raises two errors,
# tuple_type and is_instance_of; so does a plain model inside of one with the validator; info.mode is 'json' all the while.
# This script exits with 0 as long as that is so, and with 1 when it changes.
set -euo pipefail

folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check 'pydantic==2.14.3'

"$folder/venv/bin/python" - <<'PYTHON'
from decimal import Decimal

from pydantic import BaseModel, ConfigDict, ValidationError, ValidationInfo, model_validator

modes = []


class Plain(BaseModel):
    model_config = ConfigDict(strict=True)
    widths: tuple[int, ...]
    price: Decimal


class Checked(Plain):
    @model_validator(mode="before")
    @classmethod
    def look(cls, data: object, info: ValidationInfo) -> object:
        modes.append(info.mode)
        return data


class Around(BaseModel):
    model_config = ConfigDict(strict=True)
    inner: Plain

    @model_validator(mode="before")
    @classmethod
    def look(cls, data: object, info: ValidationInfo) -> object:
        modes.append(info.mode)
        return data


def errors(model: type[BaseModel], text: str) -> list[str]:
    try:
        model.model_validate_json(text)
    except ValidationError as error:
        return sorted(each["type"] for each in error.errors())
    return []


DOCUMENT = '{"widths": [8, 4], "price": "1.50"}'
found = {
    "plain": errors(Plain, DOCUMENT),
    "with a validator": errors(Checked, DOCUMENT),
    "inside of one with a validator": errors(Around, '{"inner": ' + DOCUMENT + "}"),
    "info.mode": modes,
}
for name, value in found.items():
    print(f"{name}: {value}")
assert found["plain"] == []
assert found["with a validator"] == ["is_instance_of", "tuple_type"]
assert found["inside of one with a validator"] == ["is_instance_of", "tuple_type"]
assert set(modes) == {"json"}
PYTHON
