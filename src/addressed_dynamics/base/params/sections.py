"""What all sections of a params file are made of."""

import re
from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    ValidationInfo,
    model_validator,
)

Share = Annotated[float, Field(ge=0.0, le=1.0)]
Positive = Annotated[float, Field(gt=0.0)]
Count = Annotated[int, Field(ge=1)]
CountOrAuto = Annotated[
    Annotated[Count, Tag("int")] | Annotated[Literal["auto"], Tag("auto")],
    Discriminator(lambda value: "auto" if value == "auto" else "int"),
]
"""A count, or that validation is to choose it. What is neither is a count that is wrong."""
Dropout = Annotated[float, Field(ge=0.0, lt=1.0)]
Seed = Annotated[int, Field(ge=0, lt=2**31)]


def _all_different(seeds: tuple[int, ...]) -> tuple[int, ...]:
    if len(set(seeds)) < len(seeds):
        message = "should be different: the same seed trains the same network again"
        raise ValueError(message)
    return seeds


Seeds = Annotated[tuple[Seed, ...], Field(min_length=1), AfterValidator(_all_different)]


class Section(BaseModel):
    """Base of all sections: frozen, strictly typed, no keys but the declared ones."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", strict=True, allow_inf_nan=False, use_attribute_docstrings=True
    )

    @model_validator(mode="before")
    @classmethod
    def _keeps_the_defaults_of_its_place(cls, section: Any, info: ValidationInfo) -> Any:
        """A section that is given in part has the other keys of its default there, which may not be its class's."""
        if not isinstance(section, dict):
            return section
        # Pydantic takes a list for a tuple in JSON alone, and no longer knows here that it was JSON.
        section = {name: tuple(value) if isinstance(value, list) else value for name, value in section.items()}
        mode: Any = info.mode
        defaults = {
            name: field.default.model_dump(mode=mode)
            for name, field in cls.model_fields.items()
            if isinstance(field.default, Section) and isinstance(section.get(name), dict)
        }
        return merged(defaults, section)


CHOOSERS = ("kind", "by")
"""Keys whose value chooses one of several forms of their section."""


def merged(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """Return `below` with what `above` says otherwise, section by section; one of another form is not mixed in."""
    result = dict(below)
    for key, value in above.items():
        old = below.get(key)
        if isinstance(old, Mapping) and isinstance(value, Mapping) and same_form(old, value):
            result[key] = merged(old, value)
        else:
            result[key] = value
    return result


def same_form(below: Mapping[str, Any], above: Mapping[str, Any]) -> bool:
    """Whether neither of two sections says that it is of another form than the other."""
    return all(below.get(key) == above[key] for key in CHOOSERS if key in above)


def by_name(sections: Any) -> Any:
    """Return sections that stand under their names as a list in which each has its `name`; a list as it is."""
    if not isinstance(sections, Mapping):
        return sections
    return tuple({"name": name, **each} if isinstance(each, Mapping) else each for name, each in sections.items())


def _widths(value: Any) -> Any:
    """Return the widths in `512-256`, or in a single number; a list as it is."""
    if isinstance(value, str) and re.fullmatch(r"[0-9]+(-[0-9]+)*", value):
        return tuple(int(width) for width in value.split("-"))
    return (value,) if isinstance(value, int) else value


Widths = Annotated[tuple[Count, ...], BeforeValidator(_widths)]
"""Widths of layers: `512-256`, a list, or a number alone."""


class OptimiserParams(Section):
    """Adam and its schedule."""

    learning_rate: Positive = 1e-3
    """Peak learning rate."""
    betas: tuple[Share, Share] = (0.9, 0.99)
    """Decay rates of Adam's moment estimates."""
    final_share: Share = 0.0
    """The learning rate falls to this share of its peak (half a cosine); 1 keeps it constant, as in the paper."""
