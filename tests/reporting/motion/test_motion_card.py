"""The model card of motion."""

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from motion_report_examples import data_json, origin, write_results
from report_examples import FILES

from addressed_dynamics.reporting.common.document import Account
from addressed_dynamics.reporting.common.render import render_card
from addressed_dynamics.reporting.common.written import Subject
from addressed_dynamics.reporting.motion.card import motion_card
from addressed_dynamics.reporting.motion.document import subtitle
from addressed_dynamics.reporting.motion.front import motion_front
from addressed_dynamics.reporting.motion.results import load_motion_results


@pytest.mark.parametrize("made_up", [True, False])
def test_a_card_of_motion_says_what_it_predicts_how_well_and_whose_data_they_are(tmp_path: Path, made_up: bool) -> None:
    figures, evaluation = write_results(tmp_path)
    (tmp_path / FILES["data.json"]).write_text(json.dumps(data_json(made_up=made_up)))
    results = load_motion_results(figures, evaluation)
    params: Any = SimpleNamespace(title="Walks")
    subject = Subject("walks", params, "params.yaml", Path("data/models/walks"), figures, evaluation, "", {})
    first = motion_front(results.evaluation, "walks", made_up=made_up, films=None, loop=None)
    told = Account("It walks.", front=first, subtitle=subtitle(made_up=made_up))
    text = render_card(motion_card(subject, results, origin(), told))
    assert 'model = MotionModel.load("data/models/walks")\nmodel.predict(x)  # (B, 342) -> (B, 311)' in text
    assert "| joint velocity | 93 | cm/frame |" in text
    assert "closed loop: speed" in text
    assert "trust is calibrated for states and actions, and not for motion" in text
    assert ("Licence: unknown" in text) != made_up
    assert ("SYNTHETIC" in text) == made_up
