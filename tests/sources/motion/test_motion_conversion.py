"""The conversion of motion: what is in the tables, in the statistics and in the report."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from motion_examples import assert_same_motion, concatenate, make_clip, on_patches, save_database
from pfnn_data import PFNN_DATA, needs_pfnn_data

from addressed_dynamics import read_motion
from addressed_dynamics.base.errors import MotionError
from addressed_dynamics.episodes.layout import MADE_UP, OUTPUT
from addressed_dynamics.episodes.motion import Motion
from addressed_dynamics.sources.motion.conversion import convert_motion, read_made_up
from addressed_dynamics.sources.motion.params import MotionConvertParams
from addressed_dynamics.sources.motion.splits import MOTION_SPLITS
from addressed_dynamics.sources.motion.tables import INPUTS, OUTPUTS, load_motion

PARAMS = MotionConvertParams(
    test_share=0.2, validation_share=0.1, cycles_share=0.1, rows_share=0.05, split_seed=0, row_group_rows=1000
)
CLIPS = [make_clip(f"c{number}", [9, 8, 10, 7, 6, 9, 8], seed=number) for number in range(4)]


def convert(source: Path, folder: Path, **changes: Any) -> tuple[Path, dict[str, Any], dict[str, Any]]:
    """Convert; return the folder of tables, the statistics and the report."""
    written: list[int] = []
    params = PARAMS.model_copy(update=changes)
    convert_motion(source, folder / "tables", folder / "reports", params, written.append)
    report = json.loads((folder / "reports" / "data.json").read_text())
    assert sum(written) == report["rows"]
    return folder / "tables", json.loads((folder / "tables" / "statistics.json").read_text()), report


def in_order(motion: Motion) -> Motion:
    """Put the rows of all splits back in the order of clips, cycles and frames."""
    return motion.select(np.lexsort([motion.frame, motion.cycle, motion.clip]))


def test_tables_hold_one_patch_and_the_report_counts_the_others(tmp_path: Path) -> None:
    motion = concatenate(CLIPS)
    copies, patch = on_patches(motion, 3)
    tables, statistics, report = convert(save_database(tmp_path / "d.npz", copies, patch, compressed=True), tmp_path)
    assert_same_motion(in_order(load_motion(tables)), motion)
    assert report["source"] == {
        "kind": "pfnn_database", "rows": 3 * len(motion), "exact_duplicates": 2 * len(motion), "other_patches": 0,
        "boundaries": "meta",
        "made_up": None,
    }  # fmt: skip
    assert report["rows"] == len(motion) == sum(statistics["splits"].values())
    assert report["seconds"] == pytest.approx((len(motion) - 4 * 7) / 60)
    assert list(report["clips"]) == ["c0", "c1", "c2", "c3"]
    assert sum(report["clips"]["c2"]["splits"].values()) == report["clips"]["c2"]["rows"] == len(CLIPS[2])
    assert {name: each["rows"] for name, each in report["splits"].items()} == statistics["splits"]
    for split in MOTION_SPLITS:
        assert statistics["splits"][split] == len(load_motion(tables, split))


def test_statistics_are_those_of_the_training_rows_alone(tmp_path: Path) -> None:
    tables, statistics, _ = convert(save_database(tmp_path / "d.npz", concatenate(CLIPS)), tmp_path)
    train = load_motion(tables, "train")
    values = np.concatenate([train.x, train.y], axis=1).astype(np.float64)
    assert list(statistics["train"]) == [*INPUTS, *OUTPUTS]
    found = np.array([[each["mean"], each["std"]] for each in statistics["train"].values()]).T
    np.testing.assert_allclose(found[0], values.mean(axis=0), atol=1e-12)
    np.testing.assert_allclose(found[1], values.std(axis=0), atol=1e-12)


def test_the_same_source_gives_the_same_bytes(tmp_path: Path) -> None:
    source = save_database(tmp_path / "d.npz", concatenate(CLIPS))
    for name in ("a", "b"):
        convert(source, tmp_path / name)
    files = [path.relative_to(tmp_path / "a") for path in sorted((tmp_path / "a").rglob("*")) if path.is_file()]
    assert len(files) == 2 + len(MOTION_SPLITS)
    for file in files:
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()


def test_the_report_finds_constant_columns_and_jumps_between_rows(tmp_path: Path) -> None:
    jump = CLIPS[0].y.copy()
    jump[3, OUTPUT.joint_velocity.start] += 1.5
    clip = CLIPS[0]
    motion = concatenate([type(clip)(clip.x, jump, clip.phase, clip.clip, clip.frame, clip.cycle), *CLIPS[1:]])
    source = save_database(tmp_path / "d.npz", motion, np.zeros(len(motion), np.int64))
    _, _, report = convert(source, tmp_path)
    quality = report["quality"]
    assert quality["flat_terrain"] is True
    assert {name.split(".")[1] for name in quality["constant_columns"]} == {
        "height_right", "height_centre", "height_left"
    }  # fmt: skip
    jumps = quality["greatest_jump_inside_cycles"]
    assert jumps["joint_velocity"] == {"value": pytest.approx(1.5), "unit": "cm/frame"}
    assert jumps["joint_position_x"] == {"value": 0.0, "unit": "cm"}
    assert jumps["trajectory_position_x"]["value"] > 0.1  # the made-up trajectories are noise


def test_a_failed_conversion_leaves_what_was_there(tmp_path: Path) -> None:
    convert(save_database(tmp_path / "d.npz", concatenate(CLIPS)), tmp_path)
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    whole = (tmp_path / "d.npz").read_bytes()
    (tmp_path / "bad.npz").write_bytes(whole[:5000] + bytes(100) + whole[5100:])
    with pytest.raises(MotionError, match=r"bad\.npz: Xun: is damaged"):
        convert(tmp_path / "bad.npz", tmp_path)
    (tmp_path / "bad.npz").unlink()
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


@pytest.mark.parametrize(("test_clips", "purpose"), [(("clip_0000",), "to train on"), ((), "to test on")])
def test_nothing_left_for_a_purpose_is_an_error(tmp_path: Path, test_clips: tuple[str, ...], purpose: str) -> None:
    source = save_database(tmp_path / "d.npz", CLIPS[0])
    with pytest.raises(
        MotionError, match=f"its 1 clips leave no frames {purpose}; give more clips, or change the shar"
    ):
        convert(source, tmp_path, test_clips=test_clips)
    assert not (tmp_path / "tables").exists()


@needs_pfnn_data
def test_real_clips_are_continuous_flat_and_move_at_the_pace_of_people(tmp_path: Path) -> None:
    source = PFNN_DATA / "database_flat.npz"
    tables, _, report = convert(source, tmp_path, test_clips=("LocomotionFlat09_000",))
    assert_same_motion(in_order(load_motion(tables)), in_order(read_motion(source)))
    assert set(report["clips"]["LocomotionFlat09_000_mirror"]["splits"]) == {"test"}
    assert all(each["value"] == 0.0 for each in report["quality"]["greatest_jump_inside_cycles"].values())
    assert report["quality"]["flat_terrain"] is True
    assert report["gaits"]["jog"] == pytest.approx(0.83, abs=0.01)
    assert 100 < report["speed"]["jog"]["q50"] < 150


def test_what_made_the_clips_up_is_carried_into_the_report_and_a_damaged_word_of_it_is_refused(tmp_path: Path) -> None:
    assert read_made_up(tmp_path) is None
    (tmp_path / MADE_UP).write_text('{"program": "walker", "seed": 3}')
    assert read_made_up(tmp_path) == {"program": "walker", "seed": 3}
    assert read_made_up(tmp_path / "database.npz") is None
    (tmp_path / MADE_UP).write_text("{")
    with pytest.raises(MotionError, match=r"made_up\.json: should say how the clips were made up"):
        read_made_up(tmp_path)
