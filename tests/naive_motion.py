"""The feature extraction, transcribed frame by frame with matrices: what tests and a benchmark hold ours against."""

import math
from itertools import pairwise
from pathlib import Path

import numpy as np

from addressed_dynamics.episodes.layout import PARENTS

Vector = np.ndarray
FEET = {4: 5.0, 5: 4.0, 9: 5.0, 10: 4.0}


def read_naively(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[int]]:
    """Return inputs, outputs, phases and frames of a clip on flat ground, whose joints turn about z, y and x."""
    offsets, values = _parse(path)
    places, turns = zip(*(_pose(offsets, row) for row in values[::2]), strict=True)
    phase = [float(line) for line in path.with_suffix(".phase").read_text().splitlines()][::2]
    labels = [[float(word) for word in line.split()] for line in path.with_suffix(".gait").read_text().splitlines()]
    gaits = [
        [a, b, c + d, 1 - min(max((place[16][1] - 80) / 50, 0), 1), f, h]
        for (a, b, c, d, _, f, _, h), place in zip(labels[::2], places, strict=True)
    ]
    ahead = _facing(places)
    stands = [[sum((b[j] - a[j]) ** 2) < 0.02 for j in FEET] for a, b in pairwise(places)]
    starts = [
        int(line.split()[0]) // 2 for line in path.with_name(f"{path.stem}_footsteps.txt").read_text().splitlines()
    ]
    x, y, phases, frames = [], [], [], []
    for start, end in pairwise(starts):
        if start < 60 or end >= len(places) - 61:
            continue
        level = _level(places, stands, start - 60, end + 60)
        for i in range(start, end + 1):
            x.append(_inputs(places, ahead, gaits, level, i))
            y.append(_outputs(places, turns, ahead, phase, stands, level, i))
            phases.append(0.0 if i == start else 1.0 if i == end else phase[i])
            frames.append(i)
    return np.array(x), np.array(y), np.array(phases), frames


def _parse(path: Path) -> tuple[list[Vector], list[list[float]]]:
    head, motion = path.read_text().split("MOTION")
    offsets, is_joint = [], False
    for first, *words in (line.split() for line in head.splitlines()):
        if first in ("ROOT", "JOINT", "End"):
            is_joint = first != "End"
        elif first == "OFFSET" and is_joint:
            offsets.append(5.6444 * np.array([float(word) for word in words]))
    return offsets, [[float(word) for word in line.split()] for line in motion.splitlines()[3:]]


def _turn(axis: int, degrees: float) -> Vector:
    cosine, sine = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    matrix, (a, b) = np.eye(3), ((1, 2), (2, 0), (0, 1))[axis]
    matrix[a, a] = matrix[b, b] = cosine
    matrix[a, b], matrix[b, a] = -sine, sine
    return matrix


def _pose(offsets: list[Vector], row: list[float]) -> tuple[list[Vector], list[Vector]]:
    places, turns = [], []
    for joint, parent in enumerate(PARENTS):
        z, y, x = row[3 + 3 * joint : 6 + 3 * joint]
        turn = _turn(2, z) @ _turn(1, y) @ _turn(0, x)
        if parent < 0:
            places.append(5.6444 * np.array(row[:3]))
            turns.append(turn)
        else:
            places.append(places[parent] + turns[parent] @ offsets[joint])
            turns.append(turns[parent] @ turn)
    return places, turns


def _facing(places: list[list[Vector]]) -> list[Vector]:
    forward = []
    for place in places:
        across = place[18] - place[25] + place[2] - place[7]
        across = across / math.sqrt(sum(across**2))
        forward.append(np.array([-across[2], 0, across[0]]))
    smoothed = []
    for i in range(len(forward)):
        total = sum(
            math.exp(-0.5 * (k / 20) ** 2) * forward[min(max(i + k, 0), len(forward) - 1)] for k in range(-80, 81)
        )
        smoothed.append(total / math.sqrt(sum(total**2)))
    return smoothed


def _level(places: list[list[Vector]], stands: list[list[bool]], first: int, last: int) -> float:
    told = []
    for i in range(first, last + 1):
        stand = stands[min(i, last - 1)]
        told += [places[i][j][1] - above for (j, above), still in zip(FEET.items(), stand, strict=True) if still]
    return sum(told) / len(told) if told else 0.0


def _seen(vector: Vector, ahead: Vector) -> Vector:
    return np.array([vector[0] * ahead[2] - vector[2] * ahead[0], vector[1], vector @ (ahead * [1, 0, 1])])


def _trajectory(places: list[list[Vector]], ahead: list[Vector], i: int, offsets: range) -> list[float]:
    at = [_seen(places[i + k][0] - places[i][0], ahead[i]) for k in offsets]
    to = [_seen(ahead[i + k], ahead[i]) for k in offsets]
    return [v[0] for v in at] + [v[2] for v in at] + [v[0] for v in to] + [v[2] for v in to]


def _joints(places: list[list[Vector]], ahead: list[Vector], level: float, i: int) -> list[float]:
    root = places[i][0] * [1, 0, 1] + [0, level, 0]
    at = [_seen(place - root, ahead[i]) for place in places[i]]
    moves = [_seen(after - before, ahead[i]) for before, after in zip(places[i], places[i + 1], strict=True)]
    return [number for vector in at + moves for number in vector]


def _inputs(
    places: list[list[Vector]], ahead: list[Vector], gaits: list[list[float]], level: float, i: int
) -> list[float]:
    around = [gaits[i + k][gait] for gait in range(6) for k in range(-60, 60, 10)]
    return [
        *_trajectory(places, ahead, i, range(-60, 60, 10)),
        *around,
        *_joints(places, ahead, level, i - 1),
        *[0] * 36,
    ]


def _outputs(
    places: list[list[Vector]],
    turns: list[list[Vector]],
    ahead: list[Vector],
    phase: list[float],
    stands: list[list[bool]],
    level: float,
    i: int,
) -> list[float]:
    move = _seen(places[i + 1][0] - places[i][0], ahead[i])
    angles = [math.atan2(ahead[k][0], ahead[k][2]) for k in (i, i + 1)]
    to_root = _turn(1, -math.degrees(angles[0]))
    rotations = [number for turn in turns[i] for number in _logarithm(to_root @ turn)]
    return [
        move[0], move[2], -math.remainder(angles[1] - angles[0], 2 * math.pi), (phase[i + 1] - phase[i]) % 1,
        *stands[i], *_trajectory(places, ahead, i + 1, range(0, 60, 10)),
        *_joints(places, ahead, level, i), *rotations,
    ]  # fmt: skip


def _logarithm(turn: Vector) -> Vector:
    doubled = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    sine, cosine = math.sqrt(sum(doubled**2)) / 2, (np.trace(turn) - 1) / 2
    return doubled / 2 * (math.atan2(sine, cosine) / 2 / sine if sine > 1e-9 else 0.5)
