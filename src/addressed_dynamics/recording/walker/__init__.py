"""A made-up person who stands, walks, turns and jogs: clips for machines without licensed motion capture.

From the commands of a script (`script`) to a path on the ground (`course`), to where each foot stands and how it
swings there (`feet`), to the joints of a body that these feet carry (`body`, `pose`), to the files of a clip (`clips`).
"""

from addressed_dynamics.recording.walker.clips import make_walker_clips

__all__ = ["make_walker_clips"]
