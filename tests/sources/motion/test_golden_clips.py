import numpy as np
import pytest
from pfnn_data import PFNN_DATA, needs_pfnn_data

from addressed_dynamics.episodes.layout import INPUT, OUTPUT, Layout
from addressed_dynamics.episodes.motion import Motion
from addressed_dynamics.sources.motion.clips import read_clips

pytestmark = needs_pfnn_data
TOLERANCE = 1e-3
"""In the unit of each column."""


@pytest.fixture(scope="module")
def extracted() -> dict[str, Motion]:
    return {str(motion.clip[0]): motion for motion in read_clips(PFNN_DATA / "animations")}


@pytest.fixture(scope="module")
def published() -> dict[str, Motion]:
    """The rows that the original feature extraction makes, by clip."""
    with np.load(PFNN_DATA / "database_flat.npz") as database:
        clip, frame, cycle, _ = database["meta"].astype(np.int64).T
        everything = Motion(database["Xun"], database["Yun"], database["Pun"], database["clips"][clip], frame, cycle)
    return {str(name): everything.select(everything.clip == name) for name in np.unique(everything.clip)}


def test_the_rows_of_every_clip_are_the_published_ones(
    extracted: dict[str, Motion], published: dict[str, Motion]
) -> None:
    assert {name: len(motion) for name, motion in extracted.items()} == {
        name: len(motion) for name, motion in published.items()
    }
    assert sum(map(len, extracted.values())) == 2899
    for name, motion in extracted.items():
        np.testing.assert_array_equal(motion.frame, published[name].frame)
        np.testing.assert_array_equal(motion.cycle, published[name].cycle)
        np.testing.assert_array_equal(motion.phase, published[name].phase)


@pytest.mark.parametrize(
    ("side", "layout", "block"),
    [(side, layout, each.name) for side, layout in (("x", INPUT), ("y", OUTPUT)) for each in layout.blocks],
)
def test_every_column_is_the_published_one(
    extracted: dict[str, Motion], published: dict[str, Motion], side: str, layout: Layout, block: str
) -> None:
    columns = layout[block]
    worst = np.max(
        [
            np.abs(getattr(motion, side)[:, columns] - getattr(published[name], side)[:, columns]).max(axis=0)
            for name, motion in extracted.items()
        ],
        axis=0,
    )
    column = int(worst.argmax())
    name, unit = layout.names[columns][column], layout.units[columns][column]
    assert worst[column] < TOLERANCE, f"{name} is off by up to {worst[column]:.2g} {unit}"
