"""Sentences on what was found of a model of motion; empty where there is nothing to say."""

from __future__ import annotations

from statistics import median

from addressed_dynamics.evaluation.motion.records import Candidate, MotionEvaluation
from addressed_dynamics.reporting.common.numbers import listed, percent, significant
from addressed_dynamics.reporting.motion.comparison import (
    middle,
    normalised_error,
    ranking,
    raw_error,
    score_of,
    skate_of,
)
from addressed_dynamics.reporting.motion.models import UNTRAINED, model_style
from addressed_dynamics.reporting.motion.paper import PAPER_OWN, PAPER_PFNN
from addressed_dynamics.reporting.motion.targets import expected_limb_speed

TELLING = 0.3
"""Rank correlations nearer to 0 than this say next to nothing."""


def one_step(evaluation: MotionEvaluation) -> str:
    """Say how large the errors on held-out clips are, and whose are the lowest."""
    own = own_group(evaluation)
    raw, normalised = (median(map(of, own)) for of in (raw_error, normalised_error))
    errors = {name: median(map(raw_error, group)) for name, group in evaluation.models.items()}
    best = min(errors, key=lambda name: errors[name])
    text = (
        f"One step ahead, on {own[0].test.rows:,} frames of held-out clips, the mean absolute error (MAE) is "
        f"{significant(raw)} raw, over all 311 outputs whatever their units, and {significant(normalised)} normalised, "
        "in units of each output's deviation"
    )
    if best == evaluation.own_group:
        return f"{text}. No other model has a lower raw error."
    return f"{text}. The lowest raw error is that of {model_style(best)[0]}: {significant(errors[best])}."


def unseen_gaits(evaluation: MotionEvaluation) -> str:
    """Say which gaits are trained on but do not occur in held-out clips."""
    held_out = {use.gait for use in evaluation.addressing.test.gaits}
    missing = [use.gait for use in evaluation.addressing.train.gaits if use.gait not in held_out]
    if not missing:
        return ""
    return f"The held-out clips hold no {listed(missing)}, so errors on them say nothing of that gait."


def trajectory(evaluation: MotionEvaluation, target: str) -> str:
    """Say how much of a lower raw error than that of PFNN lies in the trajectory, which may be another task for both.

    Args:
        evaluation: what was measured.
        target: what our networks are asked for, as `MotionFeatureParams.target`; PFNN predicts the outputs themselves.
    """
    pfnn = evaluation.models.get("phase_functioned", [])
    lead = median(map(raw_error, pfnn)) - median(map(raw_error, own_group(evaluation))) if pfnn else 0.0
    if lead <= 0 or target == "absolute":
        return ""
    sums = [median(map(_of_trajectory, group)) for group in (pfnn, own_group(evaluation))]
    blocks = [block for block in evaluation.own.test.blocks if block.block.startswith("trajectory")]
    share = (sums[0] - sums[1]) / (sum(block.columns for block in evaluation.own.test.blocks) * lead)
    return (
        f"Of its lead over PFNN in raw MAE, {percent(min(share, 1.0), 0)} lies in "
        f"{sum(block.columns for block in blocks)} outputs, the trajectory: our networks predict only what that adds "
        "to the trajectory that they are given, PFNN as it was published all of it. This part says nothing of "
        "addressing."
    )


def closed_loop(evaluation: MotionEvaluation) -> str:
    """Say whether it is alive, and how it follows, moves and stands."""
    own = own_group(evaluation)
    runs = [each.closed_loop.run for each in own]
    alive, seconds = sum(run.alive for run in runs), f"{runs[0].seconds:.0f} s"
    seeds = "" if len(runs) == 1 else f" from {alive} of {len(runs)} seeds"
    whole = f"is{' not' * (len(runs) == 1 and not alive)} alive for the whole {seconds}{seeds}"
    off = middle(own, lambda each: each.closed_loop.run.moving.speed_error)
    asked = middle(own, lambda each: each.closed_loop.run.moving.commanded_speed)
    facing = middle(own, lambda each: each.closed_loop.run.moving.facing_error)
    limbs = middle(own, lambda each: each.closed_loop.run.moving.limb_speed)
    frozen = middle(own, lambda each: each.closed_loop.run.moving.frozen_share)
    if off is None or asked is None or facing is None or limbs is None or frozen is None:
        return f"In the closed loop it {whole}."
    expected = expected_limb_speed(evaluation)
    data = f", where recorded limbs move at {significant(expected)} cm/s in the same gaits" if expected else ""
    still = "are never frozen" if not frozen else f"are frozen in {percent(frozen)} of the frames"
    text = (
        f"In the closed loop it {whole}. While it should move, its speed is off by {significant(off)} cm/s where "
        f"{significant(asked)} are asked for on average, it faces {significant(facing, 2)} degrees off the command, "
        f"and its limbs move at {significant(limbs)} cm/s{data}, and {still}."
    )
    skate, recorded = middle(own, skate_of), evaluation.reference.of("all").skate_speed
    if skate is not None and recorded is not None:
        text += (
            f" Feet that it says touch the ground slide at {significant(skate)} cm/s (foot skate); recorded ones at "
            f"{significant(recorded)} cm/s."
        )
    return text


def ranks(evaluation: MotionEvaluation) -> str:
    """Say whether errors one step ahead rank the models as the closed loop does."""
    models = evaluation.models
    trained = [name for name in models if name not in UNTRAINED]
    of_all, of_trained = ranking(evaluation, list(models)), ranking(evaluation, trained)
    if of_all is None:
        return ""
    # Low errors should go with high scores, so a correlation of -1 is what one hopes for.
    says = (
        "ranks models almost backwards"
        if of_all > TELLING
        else "says next to nothing of the closed loop"
        if of_all > -TELLING
        else "says something of the closed loop"
    )
    text = (
        f"The error one step ahead {says}: over all {len(models)} models the rank correlation of raw MAE and score is "
        f"{_signed(of_all)}, where −1 would be perfect"
    )
    if of_trained is not None and len(trained) < len(models):
        text += f"; among the {len(trained)} networks alone it is {_signed(of_trained)}"
    own = median(map(raw_error, models[evaluation.own_group]))
    dead = [
        f"{model_style(name)[0]} (MAE {significant(error)}, score {median(map(score_of, group)):.2f})"
        for name, group in models.items()
        if (error := median(map(raw_error, group))) < own and not any(each.closed_loop.run.alive for each in group)
    ]
    return f"{text}. Lower errors than ours, but no life in the closed loop: {listed(dead)}." if dead else f"{text}."


def addressing(evaluation: MotionEvaluation) -> list[str]:
    """Say how well a network is chosen, and whether the choice follows the phase."""
    found = evaluation.addressing
    if found.members < 2:
        return []
    train, test = found.train.specialisation, found.test.specialisation
    unused = [str(index + 1) for index, number in enumerate(test.addressed) if not number]
    which = f"network {unused[0]} is" if len(unused) == 1 else f"networks {listed(unused or [''])} are"
    use, seen = found.test.all, found.train.all
    told = (
        "follows the phase"
        if use.information_share > use.chance_share_p95
        else "tells no more than chance of the phase"
    )
    return [
        f"The addressing network selects the network with the lowest loss for {percent(train.agreement)} of the "
        f"training frames and {percent(test.agreement)} of the held-out "
        f"ones{f'; {which} never selected there' * bool(unused)}.",
        f"Without a phase label, the choice of a network {told} of the gait cycle on held-out clips: the phase "
        f"explains {percent(use.information_share)} of it (by chance {percent(use.chance_share)}); on the training "
        f"frames {percent(seen.information_share)} (by chance {percent(seen.chance_share)}).",
    ]


def near_copies(evaluation: MotionEvaluation) -> str:
    """Say what the errors are on frames such as the paper's, beside those that it states."""
    own, pfnn = own_group(evaluation), evaluation.models.get("phase_functioned", [])
    if not pfnn or not all("rows" in each.one_step for each in (*own, *pfnn)):
        return ""
    ours, theirs = (median(each.one_step["rows"].raw for each in group) for group in (own, pfnn))
    order = "the same order" if ours < theirs else "the opposite order"
    return (
        f"The paper states an MAE of {PAPER_OWN:g} against {PAPER_PFNN:g} of PFNN, on frames drawn from cycles that "
        f"were trained on. On such near copies the raw MAE here is {significant(ours)} against {significant(theirs)}: "
        f"{order}."
    )


def own_group(evaluation: MotionEvaluation) -> list[Candidate]:
    """Return the delivered kind of model from all its seeds."""
    return evaluation.models[evaluation.own_group]


def _of_trajectory(candidate: Candidate) -> float:
    blocks = [block for block in candidate.test.blocks if block.block.startswith("trajectory")]
    return sum(block.raw * block.columns for block in blocks)


def _signed(value: float) -> str:
    return f"{value:+.2f}".replace("-", "−")
