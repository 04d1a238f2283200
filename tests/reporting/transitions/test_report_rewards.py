"""The report's block on reward and end: who says them, how well, and from how little it was learned."""

from addressed_dynamics.evaluation.transitions.reward_records import JudgedTask, TaskRecord
from addressed_dynamics.reporting.common.blocks import Table, Text
from addressed_dynamics.reporting.transitions.rewards import FEW_ENDS, reward_blocks

LEARNED = JudgedTask(
    says_ends=True, steps=4100, reward_rmse=0.25, reward_largest_error=1.5, steps_that_go_on=4000, false_ends=2,
    ends=50, missed_ends=5,
)  # fmt: skip


def record(**values: object) -> TaskRecord:
    whole = {
        "reward_source": "learned", "end_source": "learned", "reward_deviation": 0.5, "ends_in_training": 300,
        "silent_steps": {}, "judged": {"learned": LEARNED},
    }  # fmt: skip
    return TaskRecord.model_validate(whole | values)


def words(of: TaskRecord) -> str:
    text = reward_blocks(of)[0]
    assert isinstance(text, Text)
    return text.paragraphs[0]


def test_errors_false_ends_and_misses_per_thousand_stand_beside_who_says_them() -> None:
    known = LEARNED.model_copy(update={"false_ends": 0, "missed_ends": 0, "reward_rmse": 0.0})
    both = record(reward_source="a.b:c", end_source="a.b:c", judged={"a.b:c": known, "learned": LEARNED})
    text, table = reward_blocks(both)
    assert isinstance(text, Text)
    assert "the known function a.b:c says reward and end of a step" in text.paragraphs[0]
    assert isinstance(table, Table)
    assert [(row.cells[0], row.kind) for row in table.rows] == [("c", "own"), ("learned from the logs", "")]
    assert table.rows[1].cells[1:] == ("0.25", "1.5", "0.50", "100", "50")


def test_what_is_left_out_or_little_is_said() -> None:
    assert "300 training episodes terminated." in words(record())
    few = words(record(ends_in_training=FEW_ENDS - 1, silent_steps={"walls": 1200, "sea": 34}))
    assert "19 training episodes terminated: fewer than 20, which is little to learn from." in few
    assert "1,234 training steps of “walls” and “sea”" in few


def test_logs_without_reward_or_end_are_told_apart() -> None:
    nothing = record(reward_source="none", end_source="none", ends_in_training=0, judged={})
    assert words(nothing).endswith("the reward is 0 and no episode ends: the logs have neither.")
    assert len(reward_blocks(nothing)) == 1
    assert "no episode ends, for none that was recorded terminated" in words(record(end_source="none"))
    assert "the reward is 0, for the logs have none; ends are learned" in words(record(reward_source="none"))
    silent = LEARNED.model_copy(update={"says_ends": False, "ends": 0, "missed_ends": 0, "false_ends": 0})
    _, table = reward_blocks(record(end_source="none", judged={"learned": silent}))
    assert isinstance(table, Table)
    assert table.rows[0].cells[3:] == ("–", "–", "0")
    assert reward_blocks(None) == ()
