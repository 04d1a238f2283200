"""What all sections of a params file are made of."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

Share = Annotated[float, Field(ge=0.0, le=1.0)]
Positive = Annotated[float, Field(gt=0.0)]
Count = Annotated[int, Field(ge=1)]
Dropout = Annotated[float, Field(ge=0.0, lt=1.0)]
Seed = Annotated[int, Field(ge=0, lt=2**31)]


class Section(BaseModel):
    """Base of all sections: frozen, strictly typed, no keys but the declared ones."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


class OptimiserParams(Section):
    """Adam and its schedule."""

    learning_rate: Positive
    """Peak learning rate."""
    betas: tuple[Share, Share]
    """Decay rates of Adam's moment estimates."""
    final_share: Share
    """The learning rate falls to this share of its peak (half a cosine); 1 keeps it constant, as in the paper."""
