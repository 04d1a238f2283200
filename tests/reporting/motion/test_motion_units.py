"""The errors of motion in units that one can imagine, in the report."""

import json

from motion_report_examples import candidate, evaluation_json

from addressed_dynamics.evaluation.motion.records import MotionEvaluation
from addressed_dynamics.evaluation.motion.unit_errors import UNITS
from addressed_dynamics.reporting.motion.tables import block_table


def measured(document: dict) -> MotionEvaluation:
    """Results in which each candidate has errors of its place, from 1 on, in every unit."""
    found = json.loads(json.dumps(document))
    for place, each in enumerate(found["candidates"].values(), start=1):
        each["one_step"]["test"]["units"] = [
            {"name": name, "unit": unit, "value": float(place)} for name, unit in UNITS.items()
        ]
    return MotionEvaluation.model_validate(found)


def test_every_model_has_a_row_with_its_errors_block_by_block() -> None:
    evaluation = measured(evaluation_json(candidate("phase_functioned"), candidate("ridge", None)))
    table = block_table(evaluation)
    headers = [column.header for column in table.columns]
    assert headers[:4] == ["Model", "root velocity, cm/s", "root turn, degrees/s", "phase change, cycles/s"]
    assert headers[-2:] == ["joint velocity, cm/s", "joint rotation, degrees"]
    # The second is the ensemble in another mode, which is no other model.
    assert [row.cells[1] for row in table.rows] == ["1.00", "3.00", "4.00"]
    assert [row.kind for row in table.rows] == ["own", "", "reference"]
    assert "One step ahead on 300 frames of held-out clips" in table.caption


def test_of_several_seeds_it_is_the_median() -> None:
    document = evaluation_json()
    own = document["candidates"]["ensemble/argmax/seed-0"]
    document["candidates"] |= {f"ensemble/argmax/seed-{seed}": own | {"seed": seed} for seed in (1, 2)}
    evaluation = measured(document)
    values = [each.test.units[0].value for each in evaluation.models[evaluation.own_group]]
    assert len(set(values)) == 3
    assert block_table(evaluation).rows[0].cells[1] == f"{sorted(values)[1]:.2f}"
    assert "and the median over seeds" in block_table(evaluation).caption


def test_results_of_earlier_versions_have_mean_absolute_errors() -> None:
    table = block_table(MotionEvaluation.model_validate(evaluation_json()))
    assert [column.header for column in table.columns][:3] == ["Outputs", "unit", "columns"]
