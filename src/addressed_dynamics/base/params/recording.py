"""The sections of a params file that say what to record."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from addressed_dynamics.base.params.sections import Count, Positive, Section, Seed, Share, Widths, by_name

Action = int | tuple[float, ...]


class EnvironmentParams(Section):
    """Which environment to make, and how."""

    id: str
    """Gymnasium identifier, for instance `MountainCar-v0`."""
    kwargs: dict[str, Any] = Field(default_factory=dict)
    """Keyword arguments for `gymnasium.make`."""


class DqnBehaviour(Section):
    """A DQN (stable-baselines3) that learns while it is recorded."""

    kind: Literal["dqn"]
    frame_skip: Count = 1
    """Simulated steps in a decision, for which its action is held; each of them is recorded. The intervals below
    count decisions."""
    reward_scale: Positive = 1.0
    """What the rewards, summed over a decision, are multiplied by for the learner alone. It learns fast if returns are
    some tens at most: the value network starts at zero, and beyond an error of 1 its loss pulls no harder."""
    learning_rate: Positive = 4e-3
    batch_size: Count = 128
    """Decisions per gradient step."""
    buffer_size: Count = 50_000
    """Decisions kept for replay."""
    learning_starts: Annotated[int, Field(ge=0)] = 1000
    """Decisions, over all copies, before the first gradient step."""
    discount: Share = 0.98
    """Of the return that follows a decision."""
    return_steps: Count = 5
    """Decisions whose rewards a target sums before it asks the value network for the rest (n-step returns)."""
    target_update_interval: Count = 600
    """Decisions, over all copies, between two copies of the value network to the target network."""
    train_every: Count = 8
    """Decisions of each environment between two rounds of training."""
    gradient_steps: Count = 8
    """Gradient steps in a round of training."""
    exploration_share: Share = 0.2
    """Share of the segment over which epsilon falls from 1 to its final value."""
    exploration_final: Share = 0.07
    """Final epsilon."""
    exploration_hold_steps: Annotated[float, Field(ge=1.0)] = 10.0
    """Mean number of decisions for which a random action is held (geometric)."""
    hidden: Widths = (64, 64)
    """Widths of the value network's hidden layers."""


class RandomBehaviour(Section):
    """Actions drawn uniformly, each held for a random number of steps."""

    kind: Literal["random"]
    mean_hold_steps: Annotated[float, Field(ge=1.0)]
    """Mean number of steps for which an action is held (geometric); 1 draws a new one every step."""


class ConstantBehaviour(Section):
    """The same action at every step."""

    kind: Literal["constant"]
    action: Action
    """The action: its number if discrete, else its components in the environment's units."""


class JointParams(Section):
    """A joint that a gait moves, and how."""

    name: str
    angle: str
    """Name of the dimension of the state with its angle."""
    velocity: str
    """Name of the dimension with its velocity."""
    centre: float = 0.0
    """Angle that it swings about, in the unit of the angle."""
    swing: Annotated[float, Field(ge=0.0)] = 0.0
    """How far it swings to either side."""
    phase: float = 0.0
    """Where in its sine it is when a gait begins, in rad."""


class GaitBehaviour(Section):
    """A gait that nobody has learned: a spring and a damper draw every joint after a sine.

    Every episode begins with a gait of its own and after a while has another, so that no two are alike. An action of
    more than the environment allows is cut to its bounds.
    """

    kind: Literal["gait"]
    joints: Annotated[tuple[JointParams, ...], BeforeValidator(by_name), Field(min_length=1)]
    """Each under its name, in the order of the action's components."""
    period_steps: Positive
    """Steps in a period of the sines."""
    stiffness: Positive
    """Action for each unit by which an angle is off."""
    damping: Annotated[float, Field(ge=0.0)] = 0.0
    """Action against each unit of a joint's velocity."""
    variation: Annotated[float, Field(ge=0.0)] = 0.0
    """Standard deviation among gaits: of the logarithm of period, stiffness and swings; of centres and phases in their
    units."""
    mean_gait_steps: Annotated[float, Field(ge=1.0)] = 200.0
    """Mean number of steps for which a gait lasts (geometric)."""
    noise: Annotated[float, Field(ge=0.0)] = 0.0
    """Standard deviation of what is added to every action, as a share of half of its range."""


class GreedyBehaviour(Section):
    """The policy that an earlier `dqn` segment ended with, with its frame skip and a share of random actions."""

    kind: Literal["greedy"]
    segment: str
    """Name of the earlier segment."""
    epsilon: Share
    """Share of decisions drawn uniformly."""


class SignBehaviour(Section):
    """One action while a dimension of the observation is negative, another while it is not.

    With a velocity it pushes in the direction of motion, or against it.
    """

    kind: Literal["sign"]
    dimension: str
    """Name of the dimension, for instance `velocity`."""
    negative: Action
    """The action while it is below 0."""
    positive: Action
    """The action while it is not."""


Unlearned = Annotated[RandomBehaviour | ConstantBehaviour | SignBehaviour, Field(discriminator="kind")]
"""Behaviours that need nobody who has learned."""
Behaviour = Annotated[
    DqnBehaviour | RandomBehaviour | ConstantBehaviour | GaitBehaviour | GreedyBehaviour | SignBehaviour,
    Field(discriminator="kind"),
]


class SegmentParams(Section):
    """One part of a recording plan: who acts, where, for how long."""

    name: Annotated[str, Field(pattern=r"^[a-z0-9_]+$")]
    behaviour: Behaviour
    environment: EnvironmentParams
    environments: Count = 4
    """Copies of the environment that run side by side."""
    transitions: Count
    """Transitions to record, over all copies; a multiple of their number."""
    seed: Seed = 0
    """Copy i is first reset with this seed plus i."""

    @model_validator(mode="after")
    def _copies_share_equally(self) -> SegmentParams:
        if self.transitions % self.environments:
            message = f"{self.transitions} transitions cannot be shared equally by {self.environments} environments"
            raise ValueError(message)
        return self


class RecordParams(Section):
    """The recording plan."""

    shard_transitions: Count = 50_000
    """A log file is closed at the end of the episode in which it reaches this many transitions."""
    segments: Annotated[tuple[SegmentParams, ...], BeforeValidator(by_name), Field(min_length=1)]
    """In their order, each under its name."""

    @model_validator(mode="after")
    def _segments_fit(self) -> RecordParams:
        learners: set[str] = set()
        names: set[str] = set()
        for segment in self.segments:
            if segment.name in names:
                message = f"two segments are called '{segment.name}'"
                raise ValueError(message)
            behaviour = segment.behaviour
            if isinstance(behaviour, GreedyBehaviour) and behaviour.segment not in learners:
                message = f"segment '{segment.name}' follows '{behaviour.segment}', which is no earlier dqn segment"
                raise ValueError(message)
            names.add(segment.name)
            if isinstance(behaviour, DqnBehaviour):
                learners.add(segment.name)
        return self


class WalkerParams(Section):
    """Clips that are made up, so that the experiment runs on a machine without motion capture."""

    minutes: Positive = 3.0
    """Length of all clips together, mirrors included."""
    seed: Seed = 0
