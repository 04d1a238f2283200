"""The model card of transitions: what one has to know of a model without a look at its report."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from learning import ARM, BOAT
from report_examples import CAR, DATA, FILES, features_of, origin, write_results

from addressed_dynamics.episodes.transitions import SpaceSpec
from addressed_dynamics.features.transitions.spec import FeatureSpec
from addressed_dynamics.reporting.common.card import plain_card
from addressed_dynamics.reporting.common.document import Account
from addressed_dynamics.reporting.common.render import render_card
from addressed_dynamics.reporting.common.written import Subject
from addressed_dynamics.reporting.transitions.card import _load, _quantities, transitions_card
from addressed_dynamics.reporting.transitions.front import front
from addressed_dynamics.reporting.transitions.recorded import DataResult
from addressed_dynamics.reporting.transitions.results import load_results

RANGES = {
    "position": {"min": -1.2, "max": 0.55, "low": -1.2, "high": 0.6, "unit": "m"},
    "velocity": {"min": -0.07, "max": 0.06, "low": -0.07, "high": 0.07, "unit": "m/step"},
}
IMPORTED = {
    "files": {f"logs/{index}.csv": {"dropped": 0} for index in range(12)},
    "totals": {"dropped": 3, "short": 1},
    "kind": "tables",
    "rate_hz": 20.0,
}


def subject(*, recorded: bool = True, models: Path = Path("data/models/car")) -> Subject:
    params: Any = SimpleNamespace(title="A car", record=object() if recorded else None)
    return Subject("car", params, "params.yaml", models, Path(), Path(), "", {"ensemble/seed-0": "0123abcd"}, "today")


def card(folder: Path, *, data: dict[str, Any] | None = None, recorded: bool = True, **changes: Any) -> str:
    figures, evaluation = write_results(folder, **changes)
    (folder / FILES["data.json"]).write_text(json.dumps({**DATA, "ranges": RANGES, **(data or {})}))
    results = load_results(figures, evaluation)
    of = subject(recorded=recorded)
    told = Account("It is off by little.", front=front(results, origin(), None))
    return render_card(transitions_card(of, results, origin(), told))


def section(text: str, title: str) -> str:
    return text.partition(f"\n## {title}\n")[2].partition("\n## ")[0]


def test_a_card_says_what_is_predicted_in_which_units_and_how_it_is_loaded(tmp_path: Path) -> None:
    text = card(tmp_path)
    assert text.startswith("# MountainCar: model card\n")
    assert "\n**It is off by little.**\n" in text
    assert 'model = AddressedDynamics.load("data/models/car")' in text
    assert "model.predict(states, actions)  # (B, 2) and (B) -> (B, 2)" in text
    predicted = section(text, "What it predicts")
    assert "| position | state | m | -1.2 to 0.6 | -1.2 to 0.55 | 1.00 |" in predicted
    assert f"- Actions: 0: {CAR.action.names[0]}" in predicted
    assert f"- A step: {CAR.step_seconds:.4f} s" in predicted


def test_a_card_of_recorded_data_says_that_nobody_elses_are_in_it_and_names_the_networks(tmp_path: Path) -> None:
    text = card(tmp_path)
    assert "learning: 1,000 transitions of 6 episodes, by dqn" in section(text, "The data")
    assert "Licence: the data were made by this package itself" in section(text, "The data")
    assert "| train | 4 | 300 |" in section(text, "The data")
    assert "torch" in section(text, "Files and versions")


def test_a_card_of_somebodys_logs_names_them_counts_what_was_left_out_and_knows_no_licence(tmp_path: Path) -> None:
    found = section(card(tmp_path, data={"import": IMPORTED}, recorded=False), "The data")
    assert "12 files, at 20.0 Hz: logs/0.csv" in found
    assert "logs/7.csv and 4 more; left out: 3 dropped, 1 short, 0 not finite, 0 out of range" in found
    assert "Licence: unknown" in found


def test_a_card_says_why_this_model_where_it_knows_nothing_and_what_was_not_measured(tmp_path: Path) -> None:
    text = card(tmp_path)
    assert "(as the params file asks)" in section(text, "Which model it is, and why")
    assert "It has seen nothing beyond" in section(text, "Where it knows nothing")
    assert "that was not measured" in section(text, "Where it knows nothing")
    assert "'dvc repro evaluate@" in section(text, "How good it is")


def test_trust_stands_in_a_card_with_the_coverage_and_what_is_told_of_shifts(tmp_path: Path) -> None:
    trust = {
        "coverage": [{"steps": 1, "asked": 0.9, "of_all": 0.881, "dimensions": {"position": 0.87, "velocity": 0.9}}],
        "shifts": {"engine": {"kind": "mechanics", "auroc": {"trust": 0.4, "surprise": 0.95}}},
        "trusted_steps": 20, "trusted_share": 0.1, "rollout_steps": 100, "step_seconds": 0.1,
    }  # fmt: skip
    text = card(tmp_path, trust=trust)
    assert "Trust it for: 2.00 s, 20 steps" in section(text, "How good it is")
    assert "| 1 | 90\u202f% | 88.1\u202f% |" in section(text, "How good it is")
    assert "nder “engine” only the surprise after the step does" in section(text, "Where it knows nothing")


def test_the_same_results_make_the_same_bytes_and_no_date(tmp_path: Path) -> None:
    (tmp_path / "one").mkdir()
    (tmp_path / "two").mkdir()
    first, second = card(tmp_path / "one"), card(tmp_path / "two")
    assert first == second
    assert "today" not in first
    assert "\n\n\n\n" not in first


def loading(spaces: SpaceSpec, **changes: Any) -> str:
    return _load(subject(), features_of(spaces, **changes))[-1]


def test_shapes_are_those_of_histories_continuous_actions_and_exogenous_inputs() -> None:
    assert loading(CAR, history=4).endswith("# (B, 4, 2) and (B, 4), oldest first -> (B, 2)")
    assert loading(ARM).endswith("# (B, 2) and (B, 2) -> (B, 2)")
    assert loading(BOAT, history=3) == (
        "model.predict(states, actions, exogenous=inputs)  "
        "# (B, 3, 2) and (B, 3, 1) and (B, 3, 1), oldest first -> (B, 2)"
    )


def test_what_has_no_bounds_and_was_not_recorded_has_none() -> None:
    features: FeatureSpec = replace(features_of(BOAT), scale=(2.0, 3.0))
    exogenous = {"wind": {"min": -1.5, "max": 1.0, "low": -2.0, "high": 2.0, "unit": "m/s"}}
    table = _quantities(DataResult.model_validate(DATA | {"exogenous": exogenous}), features)
    assert [row.cells for row in table.rows] == [
        ("position", "state", "m", "–", "–", "2.00"),
        ("speed", "state", "m/s", "–", "–", "3.00"),
        ("thrust", "action", "N", "-1 to 1", "–", "–"),
        ("wind", "exogenous", "m/s", "-2 to 2", "-1.5 to 1", "–"),
    ]


def test_a_kind_without_a_card_of_its_own_gets_the_verdict() -> None:
    text = render_card(plain_card(subject(), "The room is off by 2 degrees."))
    assert "**The room is off by 2 degrees.**" in text
    assert "'dvc repro report@car'" in text
