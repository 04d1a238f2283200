"""Where work is done: what the environment may ask for, and what is said if it is not there."""

import os

import pytest
import torch

from addressed_dynamics.base.errors import DeviceError, ParamsError
from addressed_dynamics.base.torch_runtime import (
    CPU,
    DEVICE,
    checked_device,
    computing_device,
    named_generator,
    prepare_torch,
    sent,
)


def test_without_a_word_of_the_environment_everything_is_computed_on_the_cpu(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(DEVICE, raising=False)
    assert computing_device() == CPU
    monkeypatch.setenv(DEVICE, "cpu")
    assert computing_device() == CPU
    tensor = torch.zeros(3)
    assert sent(tensor, CPU) is tensor
    assert named_generator(0, "name").device == CPU


@pytest.mark.parametrize("asked", ["gpu", "cuda:", "cuda:x", "CUDA", "", "mps", "cuda:300", f"cuda:{10**30}"])
def test_a_device_that_is_none_is_refused(asked: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(DEVICE, asked)
    for ask in (computing_device, lambda: prepare_torch(threads=1)):
        with pytest.raises(ParamsError, match=f"should be 'cpu', 'cuda' or 'cuda:NUMBER', but is '{asked}'"):
            ask()


def test_a_gpu_that_is_not_there_is_one_clear_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(DEVICE, "cuda:7")
    messages = []
    for built, available in ((None, False), ("12.8", False), ("12.8", True)):
        monkeypatch.setattr(torch.version, "cuda", built)
        monkeypatch.setattr(torch.cuda, "is_available", lambda here=available: here)
        monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
        with pytest.raises(DeviceError) as caught:
            computing_device()
        messages.append(str(caught.value))
    without, hidden, other = messages
    assert f"torch {torch.__version__} is a build without CUDA; install one with it" in without
    assert "(CUDA 12.8) finds no GPU that it can use; look at what 'nvidia-smi' says" in hidden
    assert "asks for 'cuda:7', but there are GPUs 0 to 1 only" in other
    assert all(message.endswith(f"or unset {DEVICE} for the CPU") and "\n" not in message for message in messages)


@pytest.mark.parametrize("asked", ["gpu", "", "meta", "cuda:300"])
def test_a_device_that_is_none_is_refused_in_python_too(asked: str) -> None:
    with pytest.raises(ParamsError, match=f"^device= should be 'cpu', 'cuda' or 'cuda:NUMBER', but is '{asked}'"):
        checked_device(asked)


@pytest.mark.parametrize("asked", ["", "Ray", "ray:", "ray:nonsense", "ray:host:", "ray::1"])
def test_an_engine_that_is_none_is_refused_before_anything_is_read(asked: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(DEVICE, raising=False)
    monkeypatch.setenv("ADDRESSED_DYNAMICS_ENGINE", asked)
    with pytest.raises(ParamsError, match=f"should be 'local', 'ray' or 'ray:HOST:PORT', but is '{asked}'"):
        computing_device()


def test_a_gpu_and_ray_are_refused_together(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(DEVICE, "cuda")
    monkeypatch.setenv("ADDRESSED_DYNAMICS_ENGINE", "ray")
    with pytest.raises(ParamsError, match="tasks of Ray are given no GPU"):
        computing_device()


def test_a_gpu_is_asked_for_products_of_float32_and_sums_in_a_fixed_order(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(DEVICE, "cuda")
    monkeypatch.delenv("CUBLAS_WORKSPACE_CONFIG", raising=False)
    try:
        prepare_torch(threads=1)
        assert torch.are_deterministic_algorithms_enabled()
        assert torch.get_float32_matmul_precision() == "highest"
    finally:
        torch.use_deterministic_algorithms(mode=False)
        torch.utils.deterministic.fill_uninitialized_memory = True  # type: ignore[attr-defined] # set on the module
        os.environ.pop("CUBLAS_WORKSPACE_CONFIG", None)
        torch.set_flush_denormal(False)
