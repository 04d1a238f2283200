"""What a learned environment is made of: a model, where it starts, and who says what the model does not."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypedDict

import numpy as np
import torch
from gymnasium.spaces import Box, Discrete
from jaxtyping import Int64

from addressed_dynamics.base.errors import ModelError
from addressed_dynamics.base.torch_runtime import named_device
from addressed_dynamics.episodes.transitions import DiscreteAction
from addressed_dynamics.simulators.addressed import AddressedDynamics
from addressed_dynamics.simulators.modes import Mode
from addressed_dynamics.simulators.on_device import ModelOnDevice
from addressed_dynamics.simulators.rewards import LEARNED, NOBODY, LearnedTask, read_task
from addressed_dynamics.simulators.spaces import checked_hold, observation_box, space_of_actions
from addressed_dynamics.simulators.starts import Starts, read_starts
from addressed_dynamics.simulators.tasks import Told, told
from addressed_dynamics.simulators.trust import Trust

Begin = Literal["beginnings", "anywhere"]
BEGINS: tuple[Begin, ...] = ("beginnings", "anywhere")
OWN_FUNCTIONS = "addressed_dynamics."
"""How functions begin that a folder of models may name."""


class WorldOptions(TypedDict, total=False):
    """What one may say of a learned environment beside its model."""

    candidate: str | None
    """Which of the experiment's models, as in `AddressedDynamics.load`; None for the one that is delivered."""
    mode: Mode | None
    """How it uses its members, as there."""
    starts: Starts | str | Path | None
    """States to start from, or the folder of models that they are kept in; None for those kept with the model."""
    begin: Begin
    """Whether to start where recorded episodes begin (the default), or anywhere in them."""
    reward: Callable[..., Any] | str | None
    """Who says reward and end: a function, or its name as `module:function`, from states (B, d), actions and next
    states of B copies to (rewards (B,), terminated (B,)); `learned`: what was learned from the logs; `none`: nobody, so
    rewards of 0, and no end. None: the function that the experiment names, else what was learned, else nobody."""
    exogenous: Callable[..., Any] | str | None
    """A function from numbers of steps (B,), the first of which is 0, to exogenous inputs (B, d_exo), or its name; None
    to replay those of the recorded episode, with which an episode ends."""
    trust: bool | None
    """Whether to say the trust in every step; None: if it was calibrated."""
    least_trust: float | None
    """Trust below which an episode is truncated; None for no such end."""
    hold: int
    """For how many steps of the model an action is held; so many are one step of the environment."""
    exact: bool
    """Whether the networks compute in double precision, rounded once a step, so that a copy's states do not depend on
    how many others there are. In single precision, the default and twice as fast, they do in the last digit."""
    device: torch.device | str | None
    """Where the networks compute, for instance `cuda`; what they say comes back in every step, so this pays for many
    copies or large networks. None for the CPU."""


@dataclass(frozen=True)
class World:
    """A learned environment without a state."""

    model: AddressedDynamics
    precise: AddressedDynamics | None
    """The model in double precision, if that is what steps."""
    there: ModelOnDevice | None
    """The model on another device, if that is what steps."""
    starts: Starts | None
    no_starts: str
    """Why there are none."""
    candidates: Int64[np.ndarray, " candidate"]
    """Which of the starts are drawn from."""
    task: Told | LearnedTask | None
    """Who says reward and end; None for nobody."""
    exogenous: Told | None
    """Who says the exogenous inputs; None if they are replayed, or if there are none."""
    trust: Trust | None
    least_trust: float | None
    hold: int
    observation_space: Box
    action_space: Box | Discrete

    @staticmethod
    def of(
        model: AddressedDynamics | str | Path,
        *,
        candidate: str | None = None,
        mode: Mode | None = None,
        starts: Starts | str | Path | None = None,
        begin: Begin = "beginnings",
        reward: Callable[..., Any] | str | None = None,
        exogenous: Callable[..., Any] | str | None = None,
        trust: bool | None = None,
        least_trust: float | None = None,
        hold: int = 1,
        exact: bool = False,
        device: torch.device | str | None = None,
    ) -> World:
        """Make one of a model, or of its folder; what the others mean says `WorldOptions`.

        Raises:
            ModelError: there is no such model, function or choice, or the starts are of another model.
            ParamsError: there is no device of this name.
            DeviceError: it is not there.
        """
        home = None
        if isinstance(model, AddressedDynamics):
            used = model
            if (candidate, mode) != (None, None):
                message = (
                    "candidate and mode choose among the models in a folder, but a model was given; leave them out"
                )
                raise ModelError(message)
        else:
            home = Path(model)
            used = AddressedDynamics.load(home, candidate=candidate, mode=mode)
        if begin not in BEGINS:
            message = f"begin should be one of {', '.join(BEGINS)}, but is {begin!r}"
            raise ModelError(message)
        if exogenous is not None and not used.features.spaces.exogenous:
            message = "the model has no exogenous inputs, but a function of them was given; leave exogenous= out"
            raise ModelError(message)
        place = named_device(device) if isinstance(device, str) else device
        elsewhere = place is not None and place.type != "cpu"
        if exact and elsewhere:
            message = f"exact=True computes in double precision, which it does on the CPU, but not on '{device}'"
            raise ModelError(message)
        found, missing = _starts(used, home if starts is None else starts)
        here = None if found is None else found.beginning | (begin == "anywhere")
        return World(
            model=used,
            precise=_precise(used) if exact else None,
            there=ModelOnDevice(used, place) if elsewhere and place is not None else None,
            starts=found,
            no_starts=missing,
            candidates=np.empty(0, np.int64) if here is None else np.flatnonzero(here),
            task=_task(used, home, reward, exact=exact),
            exogenous=None if exogenous is None else told(exogenous, "exogenous"),
            trust=_trust(used, wanted=trust, least=least_trust),
            least_trust=least_trust,
            hold=checked_hold(hold),
            observation_space=observation_box(used.features.spaces),
            action_space=space_of_actions(used.features.spaces, found),
        )

    @property
    def history(self) -> int:
        """Number of frames that the model is given."""
        return self.model.features.history

    def described(self) -> dict[str, Any]:
        """Return metadata of an environment: names, units and the length of a step, as `addressed_dynamics.envs`."""
        spaces = self.model.features.spaces
        action = spaces.action
        return {
            "render_modes": [],
            "render_fps": 1.0 / (spaces.step_seconds * self.hold),
            "addressed_dynamics": {
                "observation": tuple((each.name, each.unit) for each in spaces.observation),
                "action": (
                    action.names
                    if isinstance(action, DiscreteAction)
                    else tuple((each.name, each.unit) for each in action.dimensions)
                ),
                "step_seconds": spaces.step_seconds * self.hold,
            },
        }


def _starts(model: AddressedDynamics, place: Starts | str | Path | None) -> tuple[Starts | None, str]:
    """Return the starts, or why there are none."""
    if place is None:
        return None, "nobody says where to start; give starts=, or a state: reset(options={'state': ...})"
    if not isinstance(place, Starts) and (Path(place) / "network").is_dir():
        return None, (
            f"{place}: one saved model, beside which no starts are kept; name the folder of the experiment's models, "
            "for instance starts='data/models/mountaincar', or give a state: reset(options={'state': ...})"
        )
    try:
        found = place if isinstance(place, Starts) else read_starts(Path(place))
    except ModelError as error:
        return None, str(error)
    if found.spaces != model.features.spaces or found.frames < model.features.history:
        theirs, own = (", ".join(each.observation_names) for each in (found.spaces, model.features.spaces))
        message = (
            f"the starts are of another model: of {found.frames} frames with {theirs}, where this one has "
            f"{model.features.history} with {own}"
        )
        raise ModelError(message)
    return found, ""


def _trust(model: AddressedDynamics, *, wanted: bool | None, least: float | None) -> Trust | None:
    if least is not None and not 0.0 <= least <= 1.0:
        message = f"least_trust should lie in 0..1, but is {least:g}"
        raise ModelError(message)
    if least is not None and wanted is False:
        message = "least_trust asks for trust, which trust=False leaves out"
        raise ModelError(message)
    if wanted or least is not None:
        return model.trusted(model.mode)
    return None if wanted is False else model.trusted_if_calibrated()


def _task(
    model: AddressedDynamics, home: Path | None, reward: Callable[..., Any] | str | None, *, exact: bool
) -> Told | LearnedTask | None:
    if reward == NOBODY:
        return None
    if reward is not None and reward != LEARNED:
        return told(reward, "reward")
    kept = None if home is None else read_task(home)
    if reward is None and kept is not None and kept.function is not None:
        # A model may come from anywhere, and reading one runs no code but this package's.
        if not kept.function.startswith(OWN_FUNCTIONS):
            message = (
                f"{home}: the experiment names '{kept.function}' for reward and end, which is no function of this "
                f"package and is not run unasked; give reward='{kept.function}', or reward='{LEARNED}'"
            )
            raise ModelError(message)
        return told(kept.function, "reward")
    learned = None if kept is None else kept.learned
    if learned is None:
        if reward is None:
            return None
        where = "a model without its folder" if home is None else str(home)
        message = (
            f"{where}: no reward was learned that is kept with it; name a folder of an experiment's models, for which "
            "'dvc repro evaluate@NAME' learns one, or give a function"
        )
        raise ModelError(message)
    if learned.spaces != model.features.spaces:
        message = f"{home}: reward and end were learned in other spaces than the model; evaluate the experiment again"
        raise ModelError(message)
    return learned.double() if exact else learned


def _precise(model: AddressedDynamics) -> AddressedDynamics:
    """Return the same model with networks in double precision."""
    addressing = None if model.addressing is None else copy.deepcopy(model.addressing).double()
    return AddressedDynamics(model.features, copy.deepcopy(model.ensemble).double(), addressing, mode=model.mode)
