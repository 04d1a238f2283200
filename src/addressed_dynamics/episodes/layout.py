"""What each of the 342 inputs and 311 outputs of a motion frame is: the one place that knows their offsets.

The layout is that of Holden, Komura and Saito, *Phase-Functioned Neural Networks for Character Control* (SIGGRAPH
2017). Positions are in cm, velocities in cm per frame at 60 Hz, angles in rad; the y axis points up. Frame i has a
root: the hips on the ground, with the z axis where the character faces. Rotations are logarithms of quaternions (half
angles).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

FRAME_RATE = 60
"""Frames per second."""
OFFSETS = tuple(range(-60, 60, 10))
"""Frames, seen from now, at which an input samples the trajectory; `OFFSETS[NOW]` is 0."""
NOW = OFFSETS.index(0)
FUTURE_OFFSETS = OFFSETS[NOW:]
"""Frames, seen from the next one, at which an output predicts the trajectory."""
GAITS = ("stand", "walk", "jog", "crouch", "jump", "bump")
"""Gaits, in the order of the inputs; jog includes run, and crouch includes crawl."""
CONTACTS = ("left_heel", "left_toe", "right_heel", "right_toe")
AXES = ("x", "y", "z")

SKELETON = (
    ("Hips", -1), ("LHipJoint", 0), ("LeftUpLeg", 1), ("LeftLeg", 2), ("LeftFoot", 3), ("LeftToeBase", 4),
    ("RHipJoint", 0), ("RightUpLeg", 6), ("RightLeg", 7), ("RightFoot", 8), ("RightToeBase", 9),
    ("LowerBack", 0), ("Spine", 11), ("Spine1", 12), ("Neck", 13), ("Neck1", 14), ("Head", 15),
    ("LeftShoulder", 13), ("LeftArm", 17), ("LeftForeArm", 18), ("LeftHand", 19), ("LeftFingerBase", 20),
    ("LeftHandIndex1", 21), ("LThumb", 20),
    ("RightShoulder", 13), ("RightArm", 24), ("RightForeArm", 25), ("RightHand", 26), ("RightFingerBase", 27),
    ("RightHandIndex1", 28), ("RThumb", 27),
)  # fmt: skip
"""Name of each joint and the index of its parent."""
JOINTS = tuple(name for name, _ in SKELETON)
PARENTS = tuple(parent for _, parent in SKELETON)


@dataclass(frozen=True)
class Block:
    """Columns that belong together."""

    name: str
    """What they are, for instance `joint_velocity`."""
    columns: tuple[str, ...]
    """What each of them is within the block, for instance `Hips.x`; empty text for a block of one column."""
    unit: str
    """Their unit; empty for shares, directions and probabilities."""


class Layout:
    """Consecutive blocks of columns. A block's columns are an attribute: `values[:, INPUT.joint_velocity]`."""

    def __init__(self, *blocks: Block) -> None:
        """Lay the blocks side by side."""
        self.blocks = blocks
        self._slices: dict[str, slice] = {}
        start = 0
        for block in blocks:
            self._slices[block.name] = slice(start, start + len(block.columns))
            start += len(block.columns)
        self.width = start

    def __getattr__(self, name: str) -> slice:
        """Return the columns of the block `name`."""
        slices = self.__dict__.get("_slices", {})
        if name not in slices:
            message = f"there is no block of columns '{name}' (blocks: {', '.join(slices)})"
            raise AttributeError(message)
        return slices[name]  # type: ignore[no-any-return] # the attribute is typed in the constructor

    def __getitem__(self, name: str) -> slice:
        """Return the columns of the block `name`, where the name is a value."""
        return self._slices[name]

    def span(self, first: str, last: str) -> slice:
        """Return the columns from the block `first` to the end of the block `last`."""
        return slice(self._slices[first].start, self._slices[last].stop)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Name of every column, for instance `joint_velocity.Hips.x`."""
        return tuple(
            f"{block.name}.{column}" if column else block.name for block in self.blocks for column in block.columns
        )

    @cached_property
    def units(self) -> tuple[str, ...]:
        """Unit of every column."""
        return tuple(block.unit for block in self.blocks for _ in block.columns)


_SAMPLES = tuple(f"{offset:+d}" for offset in OFFSETS)
_FUTURE = tuple(f"{offset:+d}" for offset in FUTURE_OFFSETS)
_PER_JOINT = tuple(f"{joint}.{axis}" for joint in JOINTS for axis in AXES)

INPUT = Layout(
    Block("trajectory_position_x", _SAMPLES, "cm"),
    Block("trajectory_position_z", _SAMPLES, "cm"),
    Block("trajectory_direction_x", _SAMPLES, ""),
    Block("trajectory_direction_z", _SAMPLES, ""),
    *(Block(f"gait_{gait}", _SAMPLES, "") for gait in GAITS),
    Block("joint_position", _PER_JOINT, "cm"),
    Block("joint_velocity", _PER_JOINT, "cm/frame"),
    Block("height_right", _SAMPLES, "cm"),
    Block("height_centre", _SAMPLES, "cm"),
    Block("height_left", _SAMPLES, "cm"),
)
"""Inputs: the trajectory around frame i in the root of frame i, the joints of frame i - 1 in the root of frame i - 1,
and the terrain 25 cm to the right, below and 25 cm to the left of the trajectory, less its mean."""
INPUT_GAITS = INPUT.span("gait_stand", "gait_bump")
"""All gaits of an input, gait by gait."""
INPUT_HEIGHTS = INPUT.span("height_right", "height_left")

OUTPUT = Layout(
    Block("root_velocity", ("x", "z"), "cm/frame"),
    Block("root_turn", ("",), "rad/frame"),
    Block("phase_change", ("",), ""),
    Block("contact", CONTACTS, ""),
    Block("trajectory_position_x", _FUTURE, "cm"),
    Block("trajectory_position_z", _FUTURE, "cm"),
    Block("trajectory_direction_x", _FUTURE, ""),
    Block("trajectory_direction_z", _FUTURE, ""),
    Block("joint_position", _PER_JOINT, "cm"),
    Block("joint_velocity", _PER_JOINT, "cm/frame"),
    Block("joint_rotation", _PER_JOINT, "rad"),
)
"""Outputs: how the root moves and turns (minus the change of heading), the change of phase, which feet touch the
ground, the trajectory from frame i + 1 on in the root of frame i + 1, and the joints of frame i in its own root."""

MADE_UP = "made_up.json"
"""File in a folder of clips that a program made up: which program, and from what."""
