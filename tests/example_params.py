"""Sections of a params file for tests to change: the tiny ones, with a recording plan of all behaviours."""

from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

OPTIMISER = {"learning_rate": 1e-3, "betas": [0.9, 0.99], "final_share": 0.01}
DQN = {
    "kind": "dqn",
    "frame_skip": 1,
    "reward_scale": 1.0,
    "learning_rate": 2e-3,
    "batch_size": 32,
    "buffer_size": 1_000,
    "learning_starts": 100,
    "discount": 0.99,
    "return_steps": 5,
    "target_update_interval": 100,
    "train_every": 8,
    "gradient_steps": 4,
    "exploration_share": 0.2,
    "exploration_final": 0.05,
    "exploration_hold_steps": 20,
    "hidden": [16],
}
ENVIRONMENT = {"id": "MountainCar-v0", "kwargs": {}}


def segment(name: str, behaviour: dict[str, Any]) -> dict[str, Any]:
    return {
        "name": name,
        "behaviour": behaviour,
        "environment": ENVIRONMENT,
        "environments": 2,
        "transitions": 400,
        "seed": 0,
    }


RECORD = {
    "shard_transitions": 150,
    "segments": [
        segment("learner", DQN),
        segment("random", {"kind": "random", "mean_hold_steps": 5}),
        segment("right", {"kind": "constant", "action": 2}),
        segment("late", {"kind": "greedy", "segment": "learner", "epsilon": 0.1}),
    ],
}
"""A recording plan with every kind of behaviour."""


def _tiny_section(name: str) -> dict[str, Any]:
    text = (Path(__file__).parent / "tiny_params.yaml").read_text()
    section: dict[str, Any] = YAML(typ="safe", pure=True).load(text)[name]
    return section


EXAMPLE: dict[str, Any] = _tiny_section("mountaincar") | {"record": RECORD}
"""A whole section of a params file."""
MOTION: dict[str, Any] = _tiny_section("pfnn")
"""The same for an experiment with motion capture."""


def write_params(path: Path, **experiments: Any) -> Path:
    """Write a params file with these experiments."""
    yaml = YAML(typ="safe", pure=True)
    yaml.sort_base_mapping_type_on_output = False
    with path.open("w") as file:
        yaml.dump(experiments, file)
    return path
