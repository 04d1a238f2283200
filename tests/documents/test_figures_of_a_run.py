"""What the documents take from a finished run of the whole pipeline."""

import json
from pathlib import Path

import pytest
from pipeline_clones import KINDS

from publishing.figures import collect


@pytest.mark.slow
def test_the_documents_take_their_figures_from_what_the_pipeline_wrote(finished: Path, tmp_path: Path) -> None:
    files = collect(finished, tmp_path)
    assert {file.relative_to(tmp_path).as_posix() for file in files} == {f"quick/{name}.json" for name in KINDS}
    car, motion = (json.loads((tmp_path / "quick" / f"{name}.json").read_text()) for name in ("mountaincar", "pfnn"))
    evaluation = json.loads((finished / "data/evaluation/mountaincar/evaluation.json").read_text(encoding="utf-8"))
    own = evaluation["candidates"]["ensemble/argmax"]
    assert car["test"]["transitions"] == evaluation["test"]["transitions"]
    assert car["candidates"]["ensemble/argmax"]["percent"] == pytest.approx(own["one_step"]["percent"], rel=1e-3)
    assert car["summary"] == json.loads((finished / "data/reports/mountaincar/summary.json").read_text())
    assert motion["candidates"]["persistence"]["raw"] > 0.0
