"""One number for the closed loop, by which recipes are chosen on validation scripts."""

from collections.abc import Sequence

from addressed_dynamics.evaluation.motion.closed_loop.judging import KindJudgement, RunJudgement

FROZEN, LIVELY = 5.0, 30.0
"""Limb speeds, in cm/s, at which a character that should move gets nothing and everything: recorded ones walk with 26
and more, and a pose that slides along shows 0 to 4."""
CALM, FRANTIC = 150.0, 300.0
"""The same from above: running limbs stay below the one, and a model that shakes exceeds it."""
STANDING_SPEED = 50.0
"""Speed in cm/s at which a character that should stand gets nothing."""
FACING_LIMIT = 90.0
"""Angle in degrees from the command at which it gets nothing."""
DRIFT_LIMIT = 0.25
"""Drift of bone lengths at which it gets nothing."""


def closed_loop_score(judgements: Sequence[RunJudgement]) -> float:
    """Return how well runs did, from 0 to 1; higher is better.

    Each kind of command counts by its settled frames; those after a run's death count as 0. In the others, a
    character that should move gets `liveliness x mean(following, facing, grip, shape)`, and one that should stand
    `mean(following, grip, shape)`:

    - liveliness: 0 for frozen limbs, 1 for limbs of ordinary speed, 0 again if they shake;
    - following: 1 - |velocity - command| / |command|, at least 0; standing still is worth 0 when told to move;
    - facing: 1 at the commanded heading, 0 at 90 degrees and beyond;
    - grip: 1 - speed of the slowest heel or toe / commanded speed, at least 0: a sliding pose gets 0. It asks no
      contacts of the model, which could deny them;
    - shape: 1 at the recorded bone lengths, 0 at a drift of a quarter; times the share of frames in which the hips
      are at a plausible height.

    Nobody gets everything, for turns are followed late: the released network gets 0.87 on the test script, and its
    mean pose 0.15 if it slides along as commanded.
    """
    total = worth = 0.0
    for judgement in judgements:
        for kind in judgement.kinds:
            if kind.kind in {"all", "moving"}:
                continue
            total += kind.frames + kind.lost
            worth += kind.frames * (_standing(kind) if kind.kind == "stand" else _moving(kind))
    return worth / total if total else 0.0


def _moving(kind: KindJudgement) -> float:
    asked, limbs = kind.commanded_speed or 0.0, kind.limb_speed or 0.0
    if not kind.frames or not asked:
        return 0.0
    following = _falling((kind.velocity_error or 0.0) / asked, 0.0, 1.0)
    facing = _falling(kind.facing_error or 0.0, 0.0, FACING_LIMIT)
    grip = _falling((kind.slowest_foot_speed or 0.0) / asked, 0.0, 1.0)
    liveliness = (1.0 - _falling(limbs, FROZEN, LIVELY)) * _falling(limbs, CALM, FRANTIC)
    return liveliness * (following + facing + grip + _shape(kind)) / 4.0


def _standing(kind: KindJudgement) -> float:
    following = _falling(kind.velocity_error or 0.0, 0.0, STANDING_SPEED)
    grip = _falling(kind.slowest_foot_speed or 0.0, 0.0, STANDING_SPEED)
    return (following + grip + _shape(kind)) / 3.0


def _shape(kind: KindJudgement) -> float:
    return _falling(kind.bone_drift or 0.0, 0.0, DRIFT_LIMIT) * (kind.plausible_height_share or 0.0)


def _falling(value: float, best: float, worst: float) -> float:
    """Return 1 up to `best`, 0 from `worst` on, and a straight line between."""
    return min(1.0, max(0.0, (worst - value) / (worst - best)))
