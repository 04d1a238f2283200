"""The order of a report's sections is the same for every kind of data, and what a kind leaves out is left out."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from example_params import EXAMPLE
from report_examples import write_results

from addressed_dynamics.base.params.training import AddressingParams, EnsembleParams
from addressed_dynamics.reporting.common.blocks import Chart, Facts, Report, Section, Table, Text
from addressed_dynamics.reporting.common.document import Account, build_report, write_unfinished
from addressed_dynamics.reporting.common.figures.specialisation import Words
from addressed_dynamics.reporting.common.origin import ModelWords, Origin
from addressed_dynamics.reporting.common.paper import CITATION
from addressed_dynamics.reporting.common.render import render_html, render_markdown
from addressed_dynamics.reporting.common.results import AddressingTrainings, Trainings
from addressed_dynamics.reporting.common.targets import Target
from addressed_dynamics.reporting.common.written import Subject

EPOCHS = np.arange(1.0, 4.0)
CURVES = dict.fromkeys(("epoch", "loss/train", "loss/validation", "bins/changed", "loss_member/0"), EPOCHS)
TRAININGS = Trainings(
    addressing=AddressingTrainings(delivered={"1": "plain"}, validation={}),
    baselines={},
    ensemble_curves={"seed-1": CURVES},
    addressing_curves={"seed-1/plain": dict.fromkeys(("epoch", "agreement", "regret/mean", "regret/max"), EPOCHS)},
)
TEXT = (Text(("Something.",)),)
FULL: dict[str, Any] = {
    "data": TEXT,
    "found": (Section("First", TEXT), Section("Nothing found", ()), Section("Second", TEXT)),
    "method": (Section("How it works", TEXT), Section("Nothing to say", ())),
    "seeds": TEXT,
}


def report(*, further: bool = False, **parts: Any) -> Report:
    origin = Origin(
        title="A room",
        params_file="params.yaml",
        recipe="default",
        commit="",
        versions={},
        features=None,
        ensemble=EnsembleParams.model_validate(EXAMPLE["ensemble"] | {"seeds": [1, 2]}, strict=False),
        addressing=AddressingParams.model_validate(EXAMPLE["addressing"], strict=False),
        runs={},
    )
    return build_report(Account("It is warm.", **parts), TRAININGS, origin, TEXT if further else ())


def titles(found: Report) -> list[str]:
    return [section.title for section in found.sections]


def facts(found: Report) -> dict[str, str]:
    _, block = (block for block in found.blocks if isinstance(block, Facts))
    return dict(block.items)


def test_a_verdict_alone_makes_a_report_of_what_was_run_and_of_the_trainings() -> None:
    found = report()
    assert titles(found) == ["Training", "What was run"]
    assert (found.title, found.verdict, found.front) == ("A room", "It is warm.", None)
    assert found.blocks[-1] == Text((CITATION,))
    assert list(facts(found)) == ["Recipe", "Subnetworks", "Phase 1", "Addressing", "Phase 2", "Seeds"]
    assert facts(found)["Seeds"] == "1 and 2; the report is about seed 1"
    assert "predict" not in facts(found)["Subnetworks"]
    assert "Figure | Target" not in render_markdown(found)
    assert "It is warm." in render_html(found)


def test_the_sections_of_a_kind_stand_between_those_of_every_report_and_empty_ones_are_left_out() -> None:
    found = report(**FULL, further=True, findings=("It was not cold.",))
    assert titles(found) == [
        "The data", "First", "Second", "In words", "How it works", "Seeds", "Further measures", "Training",
        "What was run",
    ]  # fmt: skip
    folded = [section.title for section in found.sections if section.folded]
    assert folded == ["In words", "How it works", "Seeds", "Further measures", "Training"]
    assert not any(section.opened for section in found.sections)


def test_what_a_kind_says_of_its_networks_stands_among_the_facts() -> None:
    words = ModelWords({"Inputs": "one"}, "the next", {"Angles": "two", "Others": ""}, "argmax", {"Scale": "three"})
    said = facts(report(model=words, seed=2))
    assert list(said) == [
        "Recipe", "Inputs", "Subnetworks", "Angles", "Phase 1", "Addressing", "Phase 2", "Seeds", "Scale",
    ]  # fmt: skip
    assert said["Subnetworks"].endswith("; they predict the next")
    assert said["Seeds"] == "1 and 2; the report is about seed 2 with argmax addressing"


@pytest.mark.parametrize("paper", [False, True])
def test_targets_are_unfolded_for_the_paper_s_experiments_alone(paper: bool) -> None:
    targets = (Target("Warmth", "at least 20", "21", met=True),)
    found = report(targets=targets, targets_caption="In degrees.", targets_title="Wanted", paper=paper)
    section = found.sections[0]
    assert (section.title, section.folded, section.opened) == ("Wanted", True, paper)
    (table,) = section.blocks
    assert isinstance(table, Table)
    assert (table.caption, table.stacked) == ("In degrees.", True)
    assert "| Warmth | at least 20 | 21 | reached |" in render_markdown(found)


def test_the_captions_of_the_trainings_use_the_words_of_the_kind() -> None:
    (training,) = (
        section for section in report(words=Words("x", "degrees", "cold days")).sections if section.title == "Training"
    )
    captions = [block.caption for block in training.blocks if isinstance(block, Chart)]
    assert len(captions) == 2
    assert "All losses are of degrees." in captions[0]
    assert "on cold days:" in captions[1]


def test_a_report_on_what_was_not_evaluated_has_its_trainings_and_says_what_is_to_be_run(tmp_path: Path) -> None:
    figures, evaluation = write_results(tmp_path)
    params = SimpleNamespace(title="A room")
    subject = Subject("room", params, "params.yaml", tmp_path / "models", figures, evaluation, "", {})
    written = write_unfinished(subject, tmp_path / "report")
    assert written.verdict == "Nothing was evaluated: 'dvc repro evaluate@room' makes what is missing here."
    assert written.headline == {}
    page = (tmp_path / "report" / "report.html").read_text()
    assert "dvc repro evaluate@room" in page.partition('<section id="front">')[2].partition("</section>")[0]
    assert "chart-ensemble-training" in page
    (figures / "ensemble" / "ensemble.csv").unlink()
    write_unfinished(subject, tmp_path / "report")
    assert "dvc repro train_ensemble@room" in (tmp_path / "report" / "report.html").read_text()


def test_of_a_seed_without_curves_of_its_addressing_those_of_the_ensemble_are_shown() -> None:
    (training,) = (section for section in report(seed=2).sections if section.title == "Training")
    assert [isinstance(block, Chart) for block in training.blocks] == [True]
