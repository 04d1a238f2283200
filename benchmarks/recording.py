"""What the recorder costs: the same DQN learns in the same environments, with and without it."""

import tempfile
from contextlib import ExitStack, closing
from itertools import count
from pathlib import Path

from measuring import median_ratio, print_table, take_turns

from addressed_dynamics import TransitionRecorder
from addressed_dynamics.base.params.experiments import load_experiment
from addressed_dynamics.base.params.recording import DqnBehaviour
from addressed_dynamics.recording.dqn import learn
from addressed_dynamics.recording.plan import make_environment

PARAMS_FILE = Path(__file__).parents[1] / "params.yaml"
TRANSITIONS = 40_000
ROUNDS = 5


def learn_in(folder: Path | None) -> None:
    """Let the DQN of params.yaml learn, recorded into `folder` if there is one."""
    segment = load_experiment(PARAMS_FILE, "mountaincar", "transitions").record.segments[0]
    assert isinstance(segment.behaviour, DqnBehaviour)
    with ExitStack() as stack:
        environments = [make_environment(segment.environment) for _ in range(segment.environments)]
        if folder is not None:
            recorded = [TransitionRecorder(each, folder / f"{i}.mcap") for i, each in enumerate(environments)]
            environments = [stack.enter_context(closing(each)) for each in recorded]
        learn(environments, segment.behaviour, transitions=TRANSITIONS, seed=0, progress=lambda _: None)


def main() -> None:
    """Print the time per transition with and without the recorder, by both clocks."""
    rows = []
    with tempfile.TemporaryDirectory() as temporary:
        number = count()

        def with_recorder() -> None:
            folder = Path(temporary) / str(next(number))
            folder.mkdir()
            learn_in(folder)

        readings = take_turns({"without": lambda: learn_in(None), "with": with_recorder}, rounds=ROUNDS)
        without, with_it = readings["without"], readings["with"]
        for clock, base, more in (("CPU", without.cpu, with_it.cpu), ("wall", without.wall, with_it.wall)):
            overhead, least = median_ratio(more, base) - 1, min(more) / min(base) - 1
            rows.append([
                f"{clock} time", f"{1e6 * min(base) / TRANSITIONS:.0f} µs", f"{1e6 * min(more) / TRANSITIONS:.0f} µs",
                f"{100 * overhead:+.1f} % (target: below 5)", f"{100 * least:+.1f} %",
            ])  # fmt: skip
    print_table(["per transition", "without", "with", "median overhead", "of the best rounds"], rows)


if __name__ == "__main__":
    main()
