"""Install a wheel in an empty environment and use it there, as its README says: `make test-wheel`.

It is no test of the suite, for an environment takes a minute: python tests/installing.py dist/*.whl
"""

import os
import re
import signal
import subprocess
import sys
import tempfile
import urllib.request
import venv
from pathlib import Path

from driven import write_drift

from addressed_dynamics.simulators.delivery import Delivered, write_delivered

ROOT = Path(__file__).parents[1]
USE = """
import gymnasium, numpy as np
import addressed_dynamics, addressed_dynamics.envs
from addressed_dynamics import CEM, AddressedDynamics

assert "site-packages" in addressed_dynamics.__file__, addressed_dynamics.__file__
model = AddressedDynamics.load("data/models/drift")
state, thrust = np.zeros((3, 2), dtype=np.float32), np.full((3, 50, 1), 0.5, dtype=np.float32)
assert np.abs(model.predict(state, thrust[:, 0])).max() < 1.0
assert model.rollout(state, thrust).shape == (3, 50, 2)
env = gymnasium.make("addressed_dynamics/Learned-v0", model="data/models/drift")
env.reset(seed=0)
assert np.isfinite(env.step(env.action_space.sample())[0]).all()
CEM(model, lambda states, actions: states[..., 0] ** 2, horizon=3, samples=8, bounds=(-1.0, 1.0)).command(state[0])
print("loads, predicts, rolls out, plans, and stands in for an environment")
"""


def main(wheel: Path) -> None:
    """Go through what there is without extras."""
    with tempfile.TemporaryDirectory(prefix="wheel-") as name:
        folder = Path(name)
        # Nothing but what is installed there, and no bytecode that takes a minute to write for two minutes of use.
        environment = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
        venv.create(folder / "venv", with_pip=True)
        bin_folder = folder / "venv" / "bin"
        constraint = ["--constraint", ROOT / "requirements.lock"]
        run(environment, folder, bin_folder / "pip", "install", "--quiet", "--no-compile", *constraint, wheel.resolve())
        print(run(environment, folder, bin_folder / "pip", "list", "--format=freeze").count("=="), "packages")
        models = write_drift(folder / "data" / "models" / "drift")
        write_delivered(models, Delivered(0, None, None, candidate="total_parameters"))
        print(run(environment, folder, bin_folder / "python", "-W", "error", "-c", USE), end="")
        command = bin_folder / "addressed-dynamics"
        print(run(environment, folder, command, "--version"), end="")
        print(run(environment, folder, command, "export", "drift", "-o", "drift.pt2"), end="")
        print(run(environment, folder, command, "init", "project"), end="")
        print(driven(environment, folder, command))


def run(environment: dict[str, str], folder: Path, *command: str | Path) -> str:
    """Return what a command says, which has to succeed."""
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{' '.join(map(str, command))}\n{done.stdout}{done.stderr}"
    return done.stdout


def driven(environment: dict[str, str], folder: Path, command: Path) -> str:
    """Open the page of `drive` with everything that it names, and end it as Ctrl-C does."""
    arguments = [command, "drive", "drift", "--port", "0"]
    with subprocess.Popen(arguments, cwd=folder, env=environment, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        (address,) = re.findall(r"http://127\.0\.0\.1:\d+", process.stdout.readline())
        page = read(f"{address}/")
        named = re.findall(r'(?:src|href)="([^"]+)"', page)
        assert named
        sizes = [len(read(f"{address}/{each.lstrip('/')}")) for each in named]
        assert all(sizes)
        process.send_signal(signal.SIGINT)
        process.wait(timeout=30)
    return f"drive answers at {address} with {len(named)} files, and ends with status {process.returncode}"


def read(address: str) -> str:
    """Return what is served at an address."""
    with urllib.request.urlopen(address, timeout=30) as answer:
        return answer.read().decode("utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
