"""What the params file says of an experiment with a thermostat."""

from typing import Literal

from pydantic import Field

from addressed_dynamics.base.params.sections import Section, Share
from addressed_dynamics.base.params.training import AddressingParams, BaselinesParams, EnsembleParams, RecipeChanges


class ConvertParams(Section):
    """From a text file to tables."""

    test_share: Share


class FeatureParams(Section):
    """What a network is given."""

    scale: float


class EvaluationParams(Section):
    """What is measured."""

    worst: bool


class ThermostatParams(Section):
    """All sections."""

    title: str
    paper: None = None
    recipe: Literal["default", "paper"] = "default"
    paper_recipe: RecipeChanges = Field(default_factory=RecipeChanges)
    convert: ConvertParams
    features: FeatureParams
    ensemble: EnsembleParams
    addressing: AddressingParams
    baselines: BaselinesParams
    evaluation: EvaluationParams
    policy: None = None


FORM = ThermostatParams
