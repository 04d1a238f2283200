"""What the report says of a policy that was learned in the model."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from learning import CHANGE, drive

from addressed_dynamics.base.errors import ReportError
from addressed_dynamics.base.files import save_arrays, write_json, write_rows
from addressed_dynamics.features.transitions.spec import FeatureSpec, fit_features
from addressed_dynamics.policies.records import Estimate, PolicyFigures, Score, TrustAlong
from addressed_dynamics.reporting.common.blocks import Block, Chart, Figure, Fold, Table, Text
from addressed_dynamics.reporting.transitions.policy import policy_blocks
from addressed_dynamics.reporting.transitions.policy_results import PolicyResult, read_policy


def score(value: float, ended: float = 0.97) -> Score:
    return Score(100, Estimate(value, value - 3, value + 3), -value, Estimate(ended, ended - 0.05, ended))


MODEL_ALONE = PolicyFigures(
    reward="somebody:says", candidate=None, environment=None, hold=1, decisions=7680, copies=64, episode_steps=200,
    least_ended=None, kept_decisions=5120, model=score(-75), offline_decisions=4278, offline=score(-150),
)  # fmt: skip
WITH_TRUTH = replace(
    MODEL_ALONE, environment="MountainCar-v0", least_ended=0.95, truth=score(-110), beside=score(-100),
    gap=Estimate(-10.0, -14.0, -6.0), trust=TrustAlong(11_000, 0.021, 0.04), true_learner=score(-105),
)  # fmt: skip


@pytest.fixture(scope="module")
def features() -> FeatureSpec:
    return fit_features(drive(), CHANGE)


def result(figures: PolicyFigures) -> PolicyResult:
    checks = {"decisions": np.array([10.0, 20.0]), "return": np.array([-9.0, -5.0]), "ended": np.array([0.0, 1.0])}
    if figures.truth is None:
        return PolicyResult(figures, {"model": checks})
    trust = np.linspace(0.0, 1.0, 50)
    trust[3] = np.nan
    return PolicyResult(figures, {"model": checks, "truth": checks}, drive().observation[:50], trust)


def words(blocks: tuple[Block, ...]) -> str:
    return " ".join(line for block in blocks if isinstance(block, Text) for line in block.paragraphs)


def tables(blocks: tuple[Block, ...]) -> list[Table]:
    return [block for block in blocks if isinstance(block, Table)]


def test_it_says_the_return_in_truth_the_gap_and_where_trust_ends(features: FeatureSpec) -> None:
    blocks = policy_blocks(result(WITH_TRUTH), features)
    said = words(blocks)
    assert "-110 (-113 to -107)" in said
    assert "the gap is -10.0 (-14.0 to -6.00), 9.1\u202f% of the return, more than chance explains" in said
    assert "2.1\u202f% have a trust below 0.05" in said
    assert "it stays where the model knows its way" in said
    everything, target = tables(blocks)
    assert [row.cells[1] for row in everything.rows] == [
        "in the model, recorded starts", "in the model, true starts", "in truth", "in truth", "in truth",
    ]  # fmt: skip
    assert [row.kind for row in target.rows] == ["reached"]
    assert any(isinstance(block, Figure) for block in blocks)
    (fold,) = (block for block in blocks if isinstance(block, Fold))
    (chart,) = (block for block in fold.blocks if isinstance(block, Chart))
    assert [line.values for line in chart.views[0].lines] == [(-9.0, -5.0), (-9.0, -5.0)]


def test_a_missed_target_is_said_and_so_is_a_policy_that_leaves_what_the_model_knows(features: FeatureSpec) -> None:
    lost = replace(WITH_TRUTH, truth=score(-190, ended=0.3), trust=TrustAlong(11_000, 0.4, 0.9))
    blocks = policy_blocks(result(lost), features)
    assert "it goes where the model knows less" in words(blocks)
    assert [row.kind for row in tables(blocks)[1].rows] == ["missed"]
    unknown = policy_blocks(result(replace(WITH_TRUTH, trust=None)), features)
    assert "was not calibrated" in words(unknown)


def test_without_an_environment_it_says_that_nothing_was_held_against_truth(features: FeatureSpec) -> None:
    blocks = policy_blocks(result(MODEL_ALONE), features)
    assert "no true environment at hand" in words(blocks)
    (table,) = tables(blocks)
    assert [row.cells[1] for row in table.rows] == ["in the model, recorded starts", "in the model"]
    assert not any(isinstance(block, Figure) for block in blocks)


def test_what_the_stage_writes_is_read_again_and_no_policy_is_no_section(tmp_path: Path, features: FeatureSpec) -> None:
    assert read_policy(tmp_path / "nowhere") is None
    assert policy_blocks(None, features) == ()
    folder = tmp_path / "policies" / "car"
    write_json(folder / "policy.json", {"format": 1, "policy": None})
    assert read_policy(folder) is None
    write_json(folder / "policy.json", {"format": 1, "policy": {"hold": 1}})
    with pytest.raises(ReportError, match="dvc repro train_policy@car"):
        read_policy(folder)
    write_json(folder / "figures.json", WITH_TRUTH.to_json())
    write_rows(folder / "learning.csv", [{"learner": "model", "decisions": 10, "return": -5.0, "ended": 0.5}])
    save_arrays(folder / "arrays.npz", {"state": np.zeros((2, 2)), "trust": np.ones(2)})
    found = read_policy(folder)
    assert found is not None
    assert found.figures == WITH_TRUTH
    assert found.curves["model"]["return"].tolist() == [-5.0]
