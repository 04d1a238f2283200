"""Kinds of data: what a kind supplies to each layer is the module `kind` of its sub-package there."""

from importlib import import_module
from importlib.util import find_spec
from typing import Any, Literal

from addressed_dynamics.base.errors import ParamsError

Layer = Literal["sources", "features", "evaluation", "reporting"]
"""The layers in which kinds differ; everything between is written once."""


def supplied(layer: Layer, kind: str, module: Literal["kind", "params"] = "kind") -> Any:
    """Return what `kind` supplies to `layer`: the module `addressed_dynamics.<layer>.<kind>.kind`.

    Beside it `sources` has a module `params` with the `FORM` of an experiment's section, which stages need that read no
    data.

    Raises:
        ParamsError: there is no such kind.
    """
    package = f"addressed_dynamics.{layer}.{kind}"
    if not kind.isidentifier() or kind == "common" or find_spec(package) is None:
        message = (
            f"there is no kind of data '{kind}': a kind is a package {package} with a module 'kind'; "
            "'transitions' and 'motion' come with this version"
        )
        raise ParamsError(message)
    return import_module(f"{package}.{module}")
