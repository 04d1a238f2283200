"""What `from addressed_dynamics import …` offers, and what it costs."""

import os
import subprocess
import sys
from pathlib import Path

import gymnasium
import numpy as np
import pytest
import torch
from builders import car_transitions, write_log
from motion_examples import make_clip, save_database

import addressed_dynamics
from addressed_dynamics import AddressedDynamics, TransitionRecorder, assign_to_bins, read_transitions


def run_python(program: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run a program in a fresh interpreter, from nowhere near the sources."""
    command = [sys.executable, "-W", "error", "-c", program, *arguments]
    return subprocess.run(command, cwd="/", env=dict(os.environ), capture_output=True, text=True, check=False)


def test_what_it_offers_is_what_its_modules_define() -> None:
    from addressed_dynamics.simulators import addressed
    from addressed_dynamics.training import clustering

    assert AddressedDynamics is addressed.AddressedDynamics
    assert assign_to_bins is clustering.assign_to_bins
    assert set(addressed_dynamics.__all__) == {
        "AddressedDynamics", "CEM", "MPPI", "Motion", "MotionModel", "Policy", "StepModule", "TransitionRecorder",
        "Transitions", "assign_to_bins", "export_model", "load_policy", "read_motion", "read_transitions", "write_log",
    }  # fmt: skip


def test_a_name_that_it_does_not_have_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'Simulator'"):
        addressed_dynamics.Simulator  # noqa: B018 - the access is the test
    with pytest.raises(ImportError):
        from addressed_dynamics import Simulator  # noqa: F401 - as above


def test_losses_become_equal_bins() -> None:
    assert assign_to_bins(torch.tensor([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]])).tolist() == [1, 0, 0]


def test_an_environment_is_recorded_and_read_back(tmp_path: Path) -> None:
    env = TransitionRecorder(gymnasium.make("MountainCar-v0", max_episode_steps=7), tmp_path / "run.mcap")
    observations = [env.reset(seed=0)[0]]
    observations += [env.step(step % 3)[0] for step in range(7)]
    env.close()
    found = read_transitions(tmp_path / "run.mcap")
    np.testing.assert_array_equal(found.observation, observations[:-1])
    np.testing.assert_array_equal(found.next_observation, observations[1:])
    assert found.action.tolist() == [0, 1, 2, 0, 1, 2, 0]


def test_reading_motion_imports_neither_torch_nor_mlflow(tmp_path: Path) -> None:
    source = save_database(tmp_path / "database.npz", make_clip("walk", (6, 5)))
    program = (
        "import sys; from addressed_dynamics import Motion, read_motion; motion = read_motion(sys.argv[1]);"
        "print(isinstance(motion, Motion), len(motion), 'torch' in sys.modules, 'mlflow' in sys.modules)"
    )
    done = run_python(program, str(source))
    assert (done.stdout.split(), done.stderr) == (["True", "11", "False", "False"], "")


@pytest.mark.slow
def test_reading_a_log_imports_neither_torch_nor_mlflow_nor_a_learner(tmp_path: Path) -> None:
    log = write_log(tmp_path / "some.mcap", car_transitions([3, 2]))
    program = (
        "import sys\n"
        "import addressed_dynamics\n"
        "from addressed_dynamics import read_transitions\n"
        "assert len(read_transitions(sys.argv[1])) == 5\n"
        "print(*sorted({'torch', 'mlflow', 'stable_baselines3', 'gymnasium', 'dvc'} & set(sys.modules)))\n"
    )
    done = run_python(program, str(log))
    assert (done.returncode, done.stdout.strip(), done.stderr) == (0, "", "")


def test_the_public_names_are_shown() -> None:
    assert set(addressed_dynamics.__all__) <= set(dir(addressed_dynamics))
