"""The HIERARCHY of a BVH file: joints, how they hang together, and which channels turn them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import permutations
from pathlib import Path
from typing import NoReturn

import numpy as np
from jaxtyping import Float64

from addressed_dynamics.base.errors import MotionError

ORDERS = tuple("".join(axes) for count in range(4) for axes in permutations("xyz", count))
"""Orders in which a joint may list its rotations, three or fewer; BVH applies the last of them first."""

CHANNELS = frozenset(f"{axis}{what}" for axis in "XYZ" for what in ("rotation", "position"))
"""What can be given of a joint in every frame."""
MOST_DIGITS = 18
"""Most digits of a count."""


@dataclass(frozen=True)
class Skeleton:
    """Joints, as the HIERARCHY of a BVH file lists them."""

    names: tuple[str, ...]
    """Name of each joint; the first is the root."""
    parents: tuple[int, ...]
    """Index of each joint's parent, which comes before it; -1 for the root."""
    offsets: Float64[np.ndarray, "joint 3"]
    """Where a joint sits in the frame of its parent, in the file's own unit of length."""
    orders: tuple[str, ...]
    """The order of each joint's rotations, one of `ORDERS`; empty for a joint that does not turn."""


@dataclass(frozen=True)
class Channel:
    """What a column of the motion is."""

    joint: int
    """Index of the joint that it moves or turns."""
    turns: bool
    """Whether it is a rotation (in degrees); otherwise a position (in the file's unit of length)."""
    axis: int
    """Its axis: 0 for x, 1 for y, 2 for z."""


class Words:
    """The words of a file one by one, with the line that each stands in."""

    def __init__(self, path: Path, lines: list[str]) -> None:
        """Begin at the first of `lines`; errors name `path`."""
        self._path = path
        self._words = ((number, word) for number, line in enumerate(lines, 1) for word in line.split())
        self.line = 1
        """Line of the last word, counted from 1."""

    def fail(self, expected: str, found: str) -> NoReturn:
        """Raise a MotionError that names the line."""
        message = f"{self._path}, line {self.line}: expected {expected}, but found {found}"
        raise MotionError(message)

    def next(self, expected: str) -> str:
        """Return the next word; `expected` says what it should be, in case there is none."""
        try:
            self.line, word = next(self._words)
        except StopIteration:
            self.fail(expected, "the end of the file")
        return word

    def expect(self, *expected: str) -> str:
        """Return the next word, which must be one of `expected`."""
        word = self.next(" or ".join(expected))
        if word not in expected:
            self.fail(" or ".join(expected), f"'{word[:40]}'")
        return word

    def number(self) -> float:
        """Return the next word, which must be a finite number."""
        word = self.next("a number")
        try:
            value = float(word)
        except ValueError:
            value = np.nan
        if not np.isfinite(value):
            self.fail("a finite number", f"'{word[:40]}'")
        return value

    def count(self, *, at_least: int) -> int:
        """Return the next word, which must be a whole number that is not below `at_least`."""
        expected = f"a whole number from {at_least}"
        word = self.next(expected)
        if not (word.isascii() and word.isdecimal() and len(word) <= MOST_DIGITS and int(word) >= at_least):
            self.fail(expected, f"'{word[:40]}'")
        return int(word)


def read_hierarchy(words: Words) -> tuple[Skeleton, list[Channel]]:
    """Read from the word HIERARCHY to the word MOTION; return the joints, and the channels in the order of columns.

    Raises:
        MotionError: the words are not a hierarchy, a name occurs twice, a joint has other channels than
            rotations and positions in any order, none of them twice, or no joint has any.
    """
    joints = _Joints()
    words.expect("HIERARCHY")
    words.expect("ROOT")
    unfinished = [_read_joint(words, joints, parent=-1)]
    while unfinished:
        match words.expect("JOINT", "End", "}"):
            case "JOINT":
                unfinished.append(_read_joint(words, joints, parent=unfinished[-1]))
            case "End":
                words.expect("Site")
                words.expect("{")
                _read_offset(words)
                words.expect("}")
            case _:
                unfinished.pop()
    words.expect("MOTION")
    if not joints.channels:
        words.fail("at least one joint with channels", "none that moves")
    skeleton = Skeleton(tuple(joints.names), tuple(joints.parents), np.array(joints.offsets), tuple(joints.orders))
    return skeleton, joints.channels


def hierarchy_lines(skeleton: Skeleton, joint: int = 0, depth: int = 0) -> Iterator[str]:
    """Yield the lines that describe `joint` and what hangs on it, depth first.

    The root has its three positions before its rotations, other joints have rotations only, if any.
    """
    indent, children = "\t" * depth, [child for child, parent in enumerate(skeleton.parents) if parent == joint]
    channels = [f"{axis.upper()}rotation" for axis in skeleton.orders[joint]]
    if depth == 0:
        channels = ["Xposition", "Yposition", "Zposition", *channels]
    yield f"{indent}{'JOINT' if depth else 'ROOT'} {skeleton.names[joint]}"
    yield f"{indent}{{"
    yield f"{indent}\tOFFSET {' '.join(f'{value:.6f}' for value in skeleton.offsets[joint])}"
    yield f"{indent}\tCHANNELS {' '.join([str(len(channels)), *channels])}"
    for child in children:
        yield from hierarchy_lines(skeleton, child, depth + 1)
    if not children:
        yield from (f"{indent}\t{line}" for line in ("End Site", "{", "\tOFFSET 0.000000 0.000000 0.000000", "}"))
    yield f"{indent}}}"


@dataclass
class _Joints:
    names: list[str] = field(default_factory=list)
    parents: list[int] = field(default_factory=list)
    offsets: list[tuple[float, float, float]] = field(default_factory=list)
    orders: list[str] = field(default_factory=list)
    channels: list[Channel] = field(default_factory=list)


def _read_joint(words: Words, joints: _Joints, parent: int) -> int:
    """Read a joint from its name to its channels; return its index."""
    joint, name = len(joints.names), words.next("the name of a joint")
    if name in joints.names:
        words.fail("a joint with a name of its own", f"a second '{name}'")
    words.expect("{")
    joints.names.append(name)
    joints.parents.append(parent)
    joints.offsets.append(_read_offset(words))
    words.expect("CHANNELS")
    channels = [words.next("a channel") for _ in range(words.count(at_least=0))]
    if len(set(channels)) < len(channels) or not CHANNELS.issuperset(channels):
        expected = f"'{name}' to have rotations (Xrotation, …) and positions (Xposition, …) in any order, none twice"
        words.fail(expected, f"the channels {' '.join(channels)[:80]}")
    joints.orders.append("".join(each[0].lower() for each in channels if each[1:] == "rotation"))
    joints.channels += [Channel(joint, each[1:] == "rotation", "XYZ".index(each[0])) for each in channels]
    return joint


def _read_offset(words: Words) -> tuple[float, float, float]:
    words.expect("OFFSET")
    return words.number(), words.number(), words.number()
