"""The benchmark for a card that nobody may have: it says so, and all of it runs on the CPU."""

import json
import os
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
import torch

from addressed_dynamics.base.torch_runtime import DEVICE


@pytest.fixture
def benchmark(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(str(Path(__file__).parents[1] / "benchmarks"))
    monkeypatch.setenv(DEVICE, os.environ.get(DEVICE, "cpu"))
    return import_module("gpu")


def test_without_a_gpu_it_says_so_and_writes_nothing(
    benchmark: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    benchmark.main(["--figures", str(tmp_path / "gpu.json")])
    said = capsys.readouterr().out
    assert said.startswith("nothing was measured: --device asks for 'cuda:0', but torch")
    assert said.endswith("or give --device cpu for the CPU\n")
    assert not list(tmp_path.iterdir())


def test_all_of_it_runs_on_the_cpu_at_tiny_sizes(
    benchmark: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    figures = tmp_path / "gpu.json"
    tiny = benchmark.Sizes((2,), 100, 4, 2, rounds=1, seconds=0.0)
    threads = torch.get_num_threads()
    try:
        benchmark.main(["--device", "cpu", "--figures", str(figures)], tiny)
    finally:
        torch.set_num_threads(threads)
        torch.set_flush_denormal(False)
    found = json.loads(figures.read_text())
    assert found["algorithm_1"]["same_bins"] is True
    assert found["rollouts"]["states_per_second"] > 0
    assert [each["batch"] for each in found["updates"]] == [2]
    assert "update, n=8 54-256x3-4, B=2" in capsys.readouterr().out
