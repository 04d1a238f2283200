"""The whole evaluation of a motion experiment: numbers for the report's tables, arrays for its figures."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Float64, Int64
from torch import Tensor

from addressed_dynamics.base.errors import EvaluationError
from addressed_dynamics.base.processes import worker_processes
from addressed_dynamics.episodes.layout import JOINTS, OUTPUT
from addressed_dynamics.episodes.motion import Motion
from addressed_dynamics.evaluation.common.specialisation import specialisation
from addressed_dynamics.evaluation.motion.candidates import BASELINE_LABELS, ENSEMBLE, MotionCandidate
from addressed_dynamics.evaluation.motion.closed_loop.commands import Script, validation_scripts
from addressed_dynamics.evaluation.motion.closed_loop.judging import courses, judge
from addressed_dynamics.evaluation.motion.closed_loop.measures import MotionReference, data_reference
from addressed_dynamics.evaluation.motion.closed_loop.run import Trace, closed_loop, start_pose
from addressed_dynamics.evaluation.motion.closed_loop.score import closed_loop_score
from addressed_dynamics.evaluation.motion.one_step import CHUNK_ROWS, block_deviation, one_step_errors
from addressed_dynamics.evaluation.motion.phase_use import phase_use
from addressed_dynamics.simulators.motion import MotionModel
from addressed_dynamics.simulators.motion_controller import Pose
from addressed_dynamics.simulators.motion_ground import current_gait
from addressed_dynamics.simulators.motion_predictor import MotionPredictor

SHOWN_JOINTS = ("Hips", "Head")
"""Joints whose predicted path is shown: those of the paper's Fig. 7."""
SHOWN_STEPS = 1000
"""Frames of that figure, if the held-out clips have as many."""


@dataclass(frozen=True)
class MotionData:
    """The frames of an experiment, by what they are for."""

    train: Motion
    validation: Motion
    held_out: Mapping[str, Motion]
    """Frames that no model was trained on, by the name of their split: `test` (whole clips), `cycles`, `rows`."""


@dataclass(frozen=True)
class ClosedLoopPlan:
    """What closed loops are asked to do."""

    validation_seed: int
    """Seed of the scripts by which seed and mode are chosen."""
    validation_scripts: int
    validation_seconds: float
    test: Script
    """The script on which everything is judged."""

    @property
    def for_choosing(self) -> tuple[Script, ...]:
        """The scripts by which seed and mode are chosen."""
        return validation_scripts(self.validation_seed, self.validation_scripts, self.validation_seconds)


def evaluate_motion(
    candidates: Sequence[MotionCandidate], data: MotionData, plan: ClosedLoopPlan, *, cores: int
) -> tuple[dict[str, Any], dict[str, Trace]]:
    """Measure all candidates one step ahead and in the closed loop.

    The ensemble that is delivered, and its mode, have the highest score on the validation scripts; the test script and
    the held-out frames have no part in that.

    Args:
        candidates: what is measured.
        data: the frames.
        plan: what the closed loops are asked to do.
        cores: the most closed loops to run at once, each in a process.

    Returns:
        `candidates` by name, `delivered` (seed and mode) and `reference`, JSON-compatible; and the traces under the
        test script.

    Raises:
        EvaluationError: a split is empty, or a prediction one step ahead is not finite; in the closed loop that ends
            the run. Trainings stop by themselves where they diverge, so such a model is damaged.
    """
    reference = data_reference(data.train)
    deviation = block_deviation(data.train.y)
    start = start_pose(data.train)
    to_choose_from = [each for each in candidates if each.seed is not None]
    traces, chosen_by = _loops([(candidates, [plan.test]), (to_choose_from, plan.for_choosing)], start, cores)
    results = {}
    for each in candidates:
        results[each.name] = {
            "group": each.group,
            "seed": each.seed,
            "label": each.label,
            "parameters": each.parameters,
            "multiply_adds": each.multiply_adds,
            "one_step": _one_step(each, data.held_out, deviation),
            "closed_loop": _judged(traces[each.name], chosen_by.get(each.name), reference),
        }
    seed, mode = best_model(results)
    delivered = {"seed": seed, "mode": mode}
    report = {"candidates": results, "delivered": delivered, "reference": asdict(reference)}
    return report, traces


def best_model(results: Mapping[str, Mapping[str, Any]]) -> tuple[int, str]:
    """Return the seed and the mode of the ensemble that does best on the validation scripts; of equals the first."""
    own = [each for each in results.values() if each["group"].startswith(f"{ENSEMBLE}/")]
    best = max(own, key=lambda each: float(each["closed_loop"]["validation_score"]))
    return best["seed"], best["group"].removeprefix(f"{ENSEMBLE}/")


def shown_candidates(candidates: Sequence[MotionCandidate], seed: int, mode: str) -> list[MotionCandidate]:
    """Return what figures show: the delivered ensemble, and the first of each other group that learned from frames.

    Args:
        candidates: all there are.
        seed: the one that is delivered.
        mode: likewise.
    """
    others = [each for each in candidates if each.group in {*BASELINE_LABELS, "released"}]
    first = {each.group: each for each in reversed(others)}
    own = [each for each in candidates if each.group == f"{ENSEMBLE}/{mode}" and each.seed == seed]
    return [*own, *(each for each in others if each is first[each.group])]


def evaluate_motion_addressing(model: MotionModel, motion: Motion, loss: str) -> dict[str, Any]:
    """Return how an ensemble divides frames among its members, and whether that follows the phase, which it never sees.

    Returns:
        `specialisation`, as for environments but for losses of normalised targets, and `phase_use`, for all gaits and
        for each.
    """
    x, y = torch.from_numpy(motion.x), torch.from_numpy(motion.y)
    chunks = [slice(first, first + CHUNK_ROWS) for first in range(0, len(motion), CHUNK_ROWS)]
    losses = torch.cat([_member_losses(model, x[rows], y[rows], loss) for rows in chunks], dim=1)
    probabilities = model.probabilities(x)
    use = phase_use(
        probabilities.argmax(dim=1).numpy(),
        motion.phase,
        current_gait(motion.x),
        model.networks.members,
        np.random.default_rng(0),
    )
    return {"specialisation": specialisation(losses, probabilities), "phase_use": [asdict(each) for each in use]}


def motion_arrays(
    shown: Sequence[MotionCandidate], traces: Mapping[str, Trace], data: MotionData
) -> dict[str, np.ndarray]:
    """Return what the figures show of some candidates.

    Arrays: `frames.true` and `frames.NAME` (time, joint, 3): the joints `SHOWN_JOINTS` over the first frames of a
    held-out clip, in cm; `loop.NAME.WHAT`: the closed loop under the test script (`Trace.arrays` of its one run, and
    what was measured of it frame by frame, `Course.arrays`).
    """
    rows = stretch(data.held_out["test"], SHOWN_STEPS)
    motion = data.held_out["test"].select(rows)
    joints = [JOINTS.index(name) for name in SHOWN_JOINTS]

    def positions(y: Float64[np.ndarray, "time 311"]) -> np.ndarray:
        return y[:, OUTPUT.joint_position].reshape(len(y), -1, 3)[:, joints].astype(np.float32)

    arrays = {"frames.true": positions(motion.y.astype(np.float64))}
    x, phase = torch.from_numpy(motion.x), torch.from_numpy(motion.phase) % 1.0
    reference = data_reference(data.train)
    for each in shown:
        with torch.inference_mode():
            arrays[f"frames.{each.name}"] = positions(each.predictor(x, phase).double().numpy())
        arrays |= {f"loop.{each.name}.{key}": value for key, value in _loop_arrays(traces[each.name], reference)}
    return arrays


def stretch(motion: Motion, steps: int) -> Int64[np.ndarray, " row"]:
    """Return the longest run of consecutive frames of one clip, at most `steps` of it, as rows of `motion`.

    The frame that two cycles share occurs once.
    """
    # A boundary repeats the frame of the row before; everything else that is not the next frame begins a new run.
    _, clip = np.unique(motion.clip, return_inverse=True)
    same_clip = np.diff(clip) == 0
    moved = np.diff(motion.frame)
    kept = np.flatnonzero(np.append(True, ~(same_clip & (moved == 0))))
    follows = (np.diff(clip[kept]) == 0) & (np.diff(motion.frame[kept]) == 1)
    begins = np.flatnonzero(np.append(True, ~follows))
    lengths = np.diff(np.append(begins, len(kept)))
    longest = int(lengths.argmax())
    rows: Int64[np.ndarray, " row"] = kept[begins[longest] : begins[longest] + min(int(lengths[longest]), steps)]
    return rows


def _loops(
    jobs: Sequence[tuple[Sequence[MotionCandidate], Sequence[Script]]], start: Pose, cores: int
) -> list[dict[str, Trace]]:
    """Run the closed loops of each job, candidates under scripts, by the candidates' names; at most `cores` at once."""
    parts = [
        (index, together, scripts)
        for index, (candidates, scripts) in enumerate(jobs)
        for together in _by_network(candidates)
    ]
    # Copies, as another process gets them: members that are drawn are the same for any number of cores.
    works = [({each.name: deepcopy(each.predictor) for each in part}, scripts, start) for _, part, scripts in parts]
    found: list[dict[str, Trace]] = [{} for _ in jobs]
    with worker_processes(min(cores, len(works))) as ordered_map:
        for (index, _, _), part_traces in zip(parts, ordered_map(_run, works), strict=True):
            found[index] |= part_traces
    return [
        {each.name: traces[each.name] for each in candidates}
        for (candidates, _), traces in zip(jobs, found, strict=True)
    ]


def _by_network(candidates: Sequence[MotionCandidate]) -> list[list[MotionCandidate]]:
    """Return the candidates in groups that use the same networks, and those that have next to none as one group.

    A frame of a closed loop reads all weights once, so its time is that of memory; the weights of one network stay in
    the processor's cache from frame to frame, those of all candidates do not.
    """
    groups = dict[tuple[str, int] | None, list[MotionCandidate]]()
    for each in candidates:
        key = None if each.seed is None else (each.group.partition("/")[0], each.seed)
        groups.setdefault(key, []).append(each)
    return list(groups.values())


def _run(work: tuple[dict[str, MotionPredictor], Sequence[Script], Pose]) -> dict[str, Trace]:
    predictors, scripts, start = work
    return closed_loop(predictors, scripts, start)


def _one_step(
    candidate: MotionCandidate, held_out: Mapping[str, Motion], deviation: Float64[np.ndarray, " 311"]
) -> dict[str, Any]:
    errors = {}
    for split, motion in held_out.items():
        try:
            errors[split] = asdict(one_step_errors(candidate.predictor, motion, deviation))
        except EvaluationError as error:
            message = f"'{candidate.name}' on the frames of '{split}': {error}"
            raise EvaluationError(message) from error
    return errors


def _member_losses(
    model: MotionModel, x: Float[Tensor, "row 342"], y: Float[Tensor, "row 311"], loss: str
) -> Float[Tensor, "member row"]:
    target = model.features.encode_target(x, y)
    outputs = torch.stack([model.features.encode_target(x, each) for each in model.member_predictions(x)])
    error = (outputs - target).double()
    losses: Tensor = (error.abs() if loss == "mae" else error.square()).mean(dim=-1)
    return losses


def _judged(test: Trace, validation: Trace | None, reference: MotionReference) -> dict[str, Any]:
    judged = judge(test, reference)
    return {
        "score": closed_loop_score(judged),
        "validation_score": None if validation is None else closed_loop_score(judge(validation, reference)),
        "run": asdict(judged[0]),
    }


def _loop_arrays(trace: Trace, reference: MotionReference) -> Iterator[tuple[str, np.ndarray]]:
    yield from ((name, array[0]) for name, array in trace.arrays().items() if name != "lived")
    yield from courses(trace, reference)[0].arrays().items()
