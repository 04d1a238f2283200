"""What recording costs a DQN that learns: the same learner with and without recorders round its environments."""

import tempfile
import time
from pathlib import Path

import gymnasium

from addressed_dynamics.params import DqnBehaviour, load_params
from addressed_dynamics.recording.dqn import learn
from addressed_dynamics.recording.recorder import TransitionRecorder

TRANSITIONS = 8_000
ROUNDS = 5


def run(behaviour: DqnBehaviour, copies: int, folder: Path | None) -> tuple[float, float]:
    """Let the DQN learn; return seconds and processor seconds of a transition."""
    environments: list[gymnasium.Env] = [gymnasium.make("MountainCar-v0") for _ in range(copies)]
    wall, processor = time.perf_counter(), time.process_time()
    if folder is not None:
        environments = [TransitionRecorder(env, folder / f"env{i:02d}.mcap") for i, env in enumerate(environments)]
    learn(environments, behaviour, transitions=TRANSITIONS, seed=0, progress=lambda _count: None)
    for environment in environments:
        environment.close()
    return (time.perf_counter() - wall) / TRANSITIONS, (time.process_time() - processor) / TRANSITIONS


def main() -> None:
    """Print the overhead in wall and processor time."""
    segment = load_params(Path(__file__).parents[1] / "params.yaml", "mountaincar").record.segments[0]
    if not isinstance(segment.behaviour, DqnBehaviour):
        message = "the first segment of params.yaml is no dqn"
        raise TypeError(message)
    times: dict[bool, list[tuple[float, float]]] = {False: [], True: []}
    for _ in range(ROUNDS):
        for recorded in (False, True):
            with tempfile.TemporaryDirectory() as folder:
                times[recorded].append(run(segment.behaviour, segment.environments, Path(folder) if recorded else None))
    for index, clock in enumerate(("wall", "processor")):
        bare, logged = (min(row[index] for row in times[recorded]) for recorded in (False, True))
        cost = f"{(logged - bare) * 1e6:.1f} µs more recorded, {100 * (logged / bare - 1):.1f} %"
        print(f"{clock:>10}: {bare * 1e6:.1f} µs a transition bare, {cost} (target 5 %)")


if __name__ == "__main__":
    main()
