"""What the evaluation finds of who says reward and end: `reward` in evaluation.json."""

from __future__ import annotations

from pydantic import Field

from addressed_dynamics.evaluation.common.records import Record


class JudgedTask(Record):
    """How well somebody says reward and end of the steps of test episodes."""

    says_ends: bool
    """Whether an episode can end at all."""
    steps: int
    """Steps whose reward was judged."""
    reward_rmse: float | None
    """Root mean square of the errors of the reward, in its unit; None if there are no steps, or nobody says it."""
    reward_largest_error: float | None
    steps_that_go_on: int
    """Steps that do not end their episode, of segments in which some do."""
    false_ends: int
    """How many of them are said to end it."""
    ends: int
    """Steps that do."""
    missed_ends: int
    """How many of them are said to go on."""

    @property
    def false_ends_per_thousand(self) -> float | None:
        """False ends in a thousand steps that go on; None without such steps, or if nothing ever ends."""
        known = self.steps_that_go_on and (self.says_ends or self.ends)
        return 1000 * self.false_ends / self.steps_that_go_on if known else None

    @property
    def missed_ends_per_thousand(self) -> float | None:
        """Misses in a thousand ends; None without ends."""
        return 1000 * self.missed_ends / self.ends if self.ends else None


class TaskRecord(Record):
    """Who says reward and end of a learned environment, and how well."""

    reward_source: str
    """A function as `module:function`, `learned` or `none`."""
    end_source: str
    reward_deviation: float
    """Standard deviation of the rewards in test episodes, in their unit."""
    ends_in_training: int
    """Training episodes that terminated: what an end is learned from."""
    silent_steps: dict[str, int] = Field(default_factory=dict)
    """Training steps by segment that had no part in learning ends, for none of their episodes terminates."""
    judged: dict[str, JudgedTask] = Field(default_factory=dict)
    """By the name of who says them; `learned` among them."""
