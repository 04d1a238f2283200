"""What is done to the stages of a project, and what came of it."""

import json
import math
import os
import random
import signal
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from soak_commands import PATIENCE, PAUSE, Command, commands_in, has_begun, remarks, shows_traceback, stopped
from soak_mlflow import SERVER, WAYS, Server, taken_away
from soak_projects import (
    State,
    Step,
    differences,
    half_written,
    half_written_by_dvc,
    leftovers,
    make_project,
    read_state,
    repair,
    restore,
    run,
    save,
)
from soak_rooms import Room, SmallRoom

MOST_KILLS = 8
"""A stage is killed up to so many times before it may end."""
REMOVED = "an output that it was removing"
"""DVC does that file by file before a stage runs again."""
SHOWN = 5
"""So many differences are named."""


@dataclass
class Tally:
    """What came of one kind of disturbance of one stage."""

    disturbed: int = 0
    """So often it was disturbed while it ran."""
    looked: int = 0
    """At so many instants what lay there was looked at: after the disturbance, and before it while all was held."""
    ended: int = 0
    """So often it ran to its end afterwards and was compared."""
    faults: list[str] = field(default_factory=list)
    """What was wrong."""
    said: Counter[str] = field(default_factory=Counter)
    """Lines that it would not say undisturbed."""
    dvc: Counter[str] = field(default_factory=Counter)
    """So often a file of DVC's own was half written, of all the times that it was looked at."""
    left: Counter[str] = field(default_factory=Counter)
    """What was still there at the end, and harmless."""


class Soak:
    """A project below a folder, and what was done to it."""

    def __init__(self, folder: Path, seed: int, steps: list[Step], *, warm: bool, looks: int) -> None:
        """Run all steps undisturbed, and keep what the project is like before and after each."""
        self.folder, self.steps, self.warm, self.looks = folder.resolve(), steps, warm, looks
        self.seed, self.draw = seed, random.Random(seed)
        self.tallies: dict[tuple[str, str], Tally] = {}
        self.seconds: dict[Step, list[float]] = {}
        self.states: list[State] = []
        took = self.folder / "states" / "seconds.json"
        clone = self.folder / "project" if took.exists() else make_project(self.folder)
        self._room = Room(self.folder / "room", clone)
        self._room.clear()
        if took.exists():
            self._use_again(json.loads(took.read_text(encoding="utf-8")))
            return
        for number, step in enumerate(steps):
            self._keep(number, clone)
            settings = {**self._room.settings, "ADDRESSED_DYNAMICS_PROCESSES": "1"}
            self.seconds[step] = [run(clone, step, self.log, settings)]
            print(f"{step}: {self.seconds[step][0]:.1f} s undisturbed", flush=True)
        self._keep(len(steps), clone)
        took.write_text(json.dumps({str(step): each for step, each in self.seconds.items()}), encoding="utf-8")

    def _keep(self, number: int, clone: Path) -> None:
        save(clone, self.folder / "states" / str(number))
        self.states.append(read_state(clone))

    def _use_again(self, took: Mapping[str, list[float]]) -> None:
        """Take over what an earlier soak in this folder ran undisturbed."""
        if list(took) != [str(step) for step in self.steps]:
            message = f"{self.folder}: an earlier soak went through other stages ({', '.join(took)})"
            raise RuntimeError(message)
        self.seconds = {step: took[str(step)] for step in self.steps}
        self.states = [read_state(self.folder / "states" / str(number)) for number in range(len(self.steps) + 1)]

    @property
    def clone(self) -> Path:
        """The project."""
        return self._room.clone

    @property
    def log(self) -> Path:
        """What the last command said."""
        return self.folder / "log"

    def tally(self, step: Step | str, kind: str) -> Tally:
        """Return what came of a kind of disturbance of a stage so far."""
        return self.tallies.setdefault((str(step), kind), Tally())

    def begin(self, step: Step, room: Room | None = None) -> Path:
        """Put the project back to where a stage begins, without what earlier rounds left anywhere."""
        room = room or self._room
        restore(self.folder / "states" / str(self.steps.index(step)), room.clone)
        room.clear()
        return room.clone

    def start(
        self,
        target: Step | str,
        *,
        options: Sequence[str] = (),
        room: Room | None = None,
        log: Path | None = None,
        warm: bool = True,
        **more: str,
    ) -> Command:
        """Start `dvc repro` of a stage, with one or two processes for trainings."""
        room = room or self._room
        processes = {"ADDRESSED_DYNAMICS_PROCESSES": "2" if self.draw.random() < 0.25 else "1"}
        arguments = ("--single-item", str(target)) if isinstance(target, Step) else (target,)
        settings = {**room.settings, **processes, **more}
        return Command(
            room.clone, *options, "repro", *arguments, log=log or self.log, settings=settings, warm=warm and self.warm
        )

    def instant(self, step: Step) -> float:
        """Draw an instant of a stage, in seconds after its begin, as long as it takes now."""
        return self.draw.random() * max(self.seconds[step][-3:])

    def fault(self, tally: Tally, what: str, command: Command | None = None) -> None:
        """Keep something that is wrong, with what was said."""
        tally.faults.append(what)
        said = "\n".join([command.log, *command.hung]) if command else ""
        with (self.folder / "faults.txt").open("a", encoding="utf-8") as file:
            file.write(f"==== {what}\n{said}\n")

    def finish(self, step: Step, kind: str, room: Room | None = None, **more: str) -> None:
        """Run a stage to its end, and hold it against the undisturbed one."""
        command = self.start(step, room=room, **more)
        self.judge(step, kind, command, room)

    def judge(self, step: Step, kind: str, command: Command, room: Room | None = None) -> None:
        """Hold a stage that runs to its end against the undisturbed one."""
        tally, room = self.tally(step, kind), room or self._room
        status = command.status()
        tally.said += remarks(command.log, step.experiment)
        if status != 0:
            how = "hangs" if status is None else f"ends with status {status}"
            self.fault(tally, f"{step} {how} once nothing disturbs it any more", command)
            return
        if kind != "MLflow gone":  # which it may wait for, and then most instants would come after its end
            self.seconds[step].append(command.seconds)
        tally.ended += 1
        if wrong := differences(room.clone, self.states[self.steps.index(step) + 1]):
            self.fault(tally, f"{step} ends otherwise: {'; '.join(wrong[:SHOWN])}", command)
        if shows_traceback(command.log):
            self.fault(tally, f"{step} shows a traceback", command)
        if kind != "MLflow gone" and "MLflow: could not" in command.log:
            self.fault(tally, f"{step} has lost MLflow for good", command)
        tally.left += Counter(leftovers(room.clone, room.temporary))

    def look(self, step: Step, kind: str, command: Command, room: Room | None = None, *, repairs: bool = True) -> None:
        """Look at what a disturbed stage left, or has written so far; in the end, repair what DVC left half written."""
        number, tally = self.steps.index(step), self.tally(step, kind)
        tally.looked += 1
        clone, states = (room or self._room).clone, self.states[number : number + 2]
        for wrong in half_written(clone, *states):
            if " is half written: " in wrong and not has_begun(command.log):
                tally.dvc[REMOVED] += 1
            else:
                self.fault(tally, f"{step}: {wrong}", command)
        mine = half_written_by_dvc(clone, *states)
        tally.dvc += Counter(name if name in {"dvc.lock", ".dvc/tmp/rwlock"} else ".dvc/cache/runs" for name in mine)
        if mine and repairs:
            repair(clone, self.folder / "states" / str(number), mine)
            tally.dvc["repaired by hand"] += 1
        if shows_traceback(command.log):
            self.fault(tally, f"{step} shows a traceback", command)

    def kill(self, step: Step, count: int) -> Iterator[None]:
        """Kill a stage with DVC and its workers so many times; look at what it has written before, too."""
        tally = self.tally(step, "killed")
        while tally.disturbed < count:
            clone = self.begin(step)
            for _ in range(min(self.draw.randint(1, MOST_KILLS), count - tally.disturbed)):
                by, command = self.instant(step), self.start(step)
                for early in sorted(self.draw.random() * by for _ in range(self.looks)):
                    if not command.has_ended(early):
                        with stopped(clone):
                            self.look(step, "killed", command, repairs=False)
                if command.has_ended(by):
                    break
                command.kill()
                tally.disturbed += 1
                tally.said += remarks(command.log, step.experiment)
                self.look(step, "killed", command)
            self.finish(step, "killed")
            yield

    def kill_alone(self, step: Step, count: int, kind: str, victims: Callable[[Path], Sequence[int]]) -> Iterator[None]:
        """Kill one of some processes of a stage, and no other, so many times, if it has any."""
        tally, met = self.tally(step, kind), False
        while tally.disturbed < count:
            clone = self.begin(step)
            command = self.start(step, ADDRESSED_DYNAMICS_PROCESSES="2")
            if not command.has_ended(math.inf, partial(victims, clone)):
                met = True
                # Mostly soon, for workers may last for a moment only.
                command.has_ended(command.seconds + self.draw.random() ** 4 * 0.5 * max(self.seconds[step][-3:]))
            if found := victims(clone):
                with suppress(ProcessLookupError):
                    os.kill(self.draw.choice(found), signal.SIGKILL)
                    tally.disturbed += 1
            elif not met:
                command.status()
                return
            status = command.status()
            tally.said += remarks(command.log, step.experiment)
            self.look(step, kind, command)
            if status is None:
                self.fault(tally, f"{step} hangs", command)
            lines = [line for line in command.log.splitlines() if line.startswith("error: ")]
            if status not in {0, None} and len(lines) != 1:
                self.fault(tally, f"{step} ends with status {status} and {len(lines)} lines of its own", command)
            self.finish(step, kind)
            yield

    def orphan(self, step: Step, count: int) -> Iterator[None]:
        """Kill DVC alone so many times, and run the stage again at once, while what DVC had started goes on."""
        kind, tally = "DVC killed alone", self.tally(step, "DVC killed alone")
        while tally.disturbed < count:
            clone = self.begin(step)
            command = self.start(step, warm=False, log=self.folder / "log0")
            command.has_ended(math.inf, partial(commands_in, clone, "-m pipeline."))
            command.has_ended(command.seconds + self.draw.random() * max(self.seconds[step][-3:]))
            for victim in commands_in(clone, "-m dvc"):
                with suppress(ProcessLookupError):
                    os.kill(victim, signal.SIGKILL)
            command.has_ended(math.inf)  # or it would be a zombie, which DVC takes for one that runs
            if not commands_in(clone, "-m pipeline."):
                continue
            tally.disturbed += 1
            again = self.start(step, warm=False)
            status = again.wait()
            end = time.monotonic() + PATIENCE
            while (left := commands_in(clone, "-m pipeline.")) and time.monotonic() < end:
                time.sleep(PAUSE)
            if left:
                self.fault(tally, f"{step}: an orphan hangs", command)
            for each in (command, again):
                tally.said += remarks(each.log, step.experiment)
            lines = [line for line in again.log.splitlines() if line.startswith("error: ")]
            if status is None or (status and len(lines) != 1) or shows_traceback(command.log + again.log):
                self.fault(tally, f"{step}: run again beside its orphan: status {status}, {lines}", again)
            self.look(step, kind, again)
            self.finish(step, kind)
            yield

    def fill(self, step: Step, count: int, room: SmallRoom) -> Iterator[None]:
        """Let the disk be full from an instant on, so many times, then make room."""
        tally = self.tally(step, "disk full")
        while tally.disturbed < count:
            self.begin(step, room)
            by, command = self.instant(step), self.start(step, room=room)
            if command.has_ended(by):
                continue
            room.fill()
            status = command.status()
            if status != 0 or _is_full(command.log):
                tally.disturbed += 1
                self._judge_full(step, tally, status, command)
            tally.said += remarks(command.log, step.experiment)
            room.make_room()  # which what DVC left half written needs to be repaired
            self.look(step, "disk full", command, room)
            self.finish(step, "disk full", room)
            yield

    def _judge_full(self, step: Step, tally: Tally, status: int | None, command: Command) -> None:
        if status is None:
            self.fault(tally, f"{step} hangs when the disk is full", command)
        errors = [line for line in command.log.splitlines() if line.startswith("error: ")]
        failed = "failed to run: python -m pipeline." in command.log
        if failed and not (len(errors) == 1 and _is_full(errors[0])):
            self.fault(tally, f"{step} says {len(errors)} lines when the disk is full: {errors[:1]}", command)

    def lose_mlflow(self, step: Step, count: int, server: Server) -> Iterator[None]:
        """Take MLflow away from an instant on, so many times, in all ways in turn."""
        tally = self.tally(step, "MLflow gone")
        while tally.disturbed < count:
            way = WAYS[(self.seed + tally.disturbed) % len(WAYS)]
            clone = self.begin(step)
            tracking = {"MLFLOW_TRACKING_URI": server.start()} if way in SERVER else {}
            by, command = self.instant(step), self.start(step, **tracking)
            if command.has_ended(by):
                continue
            with taken_away(way, clone, server):
                tally.disturbed += 1
                self.judge(step, "MLflow gone", command)
            lines = [line for line in command.log.splitlines() if "MLflow" in line and "INFO" not in line]
            tally.said[f"({way}: {len(lines)} lines about MLflow)"] += 1
            yield

    def pair(self, first: Step, second: Step, count: int, options: Sequence[str]) -> Iterator[None]:
        """Let two `dvc repro` run at once, so many times; one that is refused is run again afterwards."""
        words = "the same" if first == second else f"{first.stage} and {second.stage}"
        tally = self.tally(first, f"two at once: {words}{', waiting' if options else ''}")
        last = max((first, second), key=self.steps.index)
        begin = next(step for step in self.steps if step.stage == "convert" and step.experiment == last.experiment)
        while tally.disturbed < count:
            self.begin(begin)
            commands = []
            for number, step in enumerate((first, second)):
                commands.append(self.start(str(step), options=options, log=self.folder / f"log{number}"))
                if not number:
                    commands[0].has_ended(self.draw.random() * 2 * max(self.seconds[begin][-3:]))
            tally.disturbed += 1
            refused = 0
            for command in commands:
                status = command.wait()
                tally.said += remarks(command.log, last.experiment)
                refused += bool(status)
                refusal = "is busy" in command.log or "Unable to acquire lock" in command.log
                if status is None or shows_traceback(command.log) or (status and not refusal):
                    self.fault(tally, f"two at once: status {status}", command)
            tally.said[f"({refused} of two were refused)"] += 1
            for step in (first, second):
                again = self.start(str(step))
                if again.status() != 0:
                    self.fault(tally, f"{step} fails after two at once", again)
            tally.ended += 1
            if wrong := differences(self.clone, self.states[self.steps.index(last) + 1]):
                self.fault(tally, f"two at once end otherwise: {'; '.join(wrong[:SHOWN])}", commands[1])
            yield


def _is_full(said: str) -> bool:
    return "No space left" in said or "is full" in said
