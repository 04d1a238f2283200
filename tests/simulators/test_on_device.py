"""Models on a device: they say what they say on the CPU. Where there is no GPU, one is pretended."""

from typing import get_args

import numpy as np
import pytest
import torch
from learned_worlds import learned
from learning import drive, sail, swing, untrained_model
from pretended_gpu import GPU, GPUS, gpu, pretended_gpu

from addressed_dynamics.base.errors import DeviceError, ModelError
from addressed_dynamics.episodes.transitions import Transitions
from addressed_dynamics.evaluation.transitions.candidates import predictor_of
from addressed_dynamics.evaluation.transitions.one_step import predict_all
from addressed_dynamics.evaluation.transitions.points import Points
from addressed_dynamics.features.transitions.spec import Angle, FeatureSpec, fit_features
from addressed_dynamics.networks.stacked import StackedMLP
from addressed_dynamics.simulators import on_device
from addressed_dynamics.simulators.addressed import AddressedDynamics
from addressed_dynamics.simulators.environment import LearnedEnvironments
from addressed_dynamics.simulators.modes import Mode
from addressed_dynamics.simulators.on_device import ModelOnDevice
from addressed_dynamics.sources.transitions.params import AngleParams, FeatureParams

MODES: tuple[Mode, ...] = get_args(Mode)
WORLDS = {"discrete actions": drive((20,) * 3), "continuous actions": swing(), "exogenous inputs": sail()}


def turning() -> AddressedDynamics:
    """A model of an angle whose velocity follows from it, under the first of two actions."""
    angles = (AngleParams(name="turn", cosine="angle", sine="speed", velocity=None),)
    features = fit_features(swing(), FeatureParams(target="change", angles=angles))
    assert features.angles == (Angle("turn", "angle", "speed", None),)
    generator = torch.Generator().manual_seed(0)
    networks = (StackedMLP(3, (features.inputs, 8, features.outputs), "elu", generator),
                StackedMLP(3, (features.inputs, 8, 1), "elu", generator, shared=1))  # fmt: skip
    return AddressedDynamics(features, *networks)


def given(world: Transitions, features: FeatureSpec, rows: int = 3, steps: int = 5) -> dict[str, np.ndarray]:
    past = features.history - 1
    places = 7 * np.arange(rows)[:, None] + np.arange(past + steps)
    observation = world.observation[places[:, : past + 1]]
    return {
        "observation": observation if past else observation[:, 0],
        "actions": world.action[places],
        **({"exogenous": world.exogenous[places]} if features.spaces.exogenous else {}),
    }


@GPUS
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("name", [*WORLDS, "history", "one network", "angles and heads"])
def test_rollouts_are_those_of_the_cpu_up_to_rounding(name: str, mode: Mode, kind: str) -> None:
    world = WORLDS.get(name, WORLDS["continuous actions"])
    members, history = (1 if name == "one network" else 3), (3 if name == "history" else 1)
    model = turning() if name == "angles and heads" else untrained_model(world, members, history=history)
    inputs = given(world, model.features)
    wanted = model.rollout(**inputs, mode=mode, generator=torch.Generator().manual_seed(0))
    with gpu(kind) as device:
        there = ModelOnDevice(model, device)
        found = there.rollout(**inputs, mode=mode, generator=torch.Generator().manual_seed(0))
        assert found.device == device
        np.testing.assert_allclose(found.cpu().numpy(), wanted, rtol=1e-4, atol=1e-5)


@GPUS
def test_samples_sorted_by_member_get_what_they_get_otherwise(monkeypatch: pytest.MonkeyPatch, kind: str) -> None:
    model = untrained_model(WORLDS["discrete actions"], 4)
    inputs = given(WORLDS["discrete actions"], model.features, rows=6)
    with gpu(kind) as device:
        wanted = ModelOnDevice(model, device).rollout(**inputs).cpu()
        monkeypatch.setattr(on_device, "SORTING_COST", 0)
        found = ModelOnDevice(model, device).rollout(**inputs).cpu()
    torch.testing.assert_close(found, wanted, rtol=1e-4, atol=1e-6)


def test_a_rollout_of_few_samples_waits_for_nothing_and_launches_each_step_at_once() -> None:
    world, counts = WORLDS["exogenous inputs"], list[tuple[int, int]]()
    model = untrained_model(world)
    for steps in (5, 15):
        with pretended_gpu() as pretended:
            there = ModelOnDevice(model, GPU)
            inputs = given(world, model.features, rows=2, steps=steps)
            there.rollout(**inputs)  # the constants of features are sent once
            before = pretended.waits, pretended.launches
            there.rollout(**inputs)
            counts.append((pretended.waits - before[0], pretended.launches - before[1]))
    (waits, launches), (more_waits, more_launches) = counts
    assert more_waits == waits
    assert (more_launches - launches) / 10 < 20


@GPUS
def test_what_a_model_does_not_take_is_refused_before_the_device_sees_it(kind: str) -> None:
    world = WORLDS["discrete actions"]
    model = untrained_model(world)
    inputs = given(world, model.features)
    with gpu(kind) as device:
        there = ModelOnDevice(model, device)
        for changed, message in (
            ({"actions": inputs["actions"] + 2}, "actions should be integers in 0..2"),
            ({"actions": inputs["actions"].astype(np.float32)}, "actions should be integers"),
            ({"actions": inputs["actions"][:2]}, r"actions should have shape \(3, T, ...\), but have \(2, 5\)"),
            ({"observation": inputs["observation"] * np.float32("nan")}, "observations should be finite"),
            ({"observation": inputs["observation"][:, :1]}, "observations should have shape"),
            ({"exogenous": inputs["observation"]}, "no exogenous inputs"),
            ({"mode": "best"}, "there is no addressing mode 'best'"),
        ):
            with pytest.raises(ModelError, match=message):
                there.rollout(**inputs | changed)


@GPUS
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize(("world", "history"), [("car", 1), ("boat", 3)])
def test_copies_of_an_environment_step_as_on_the_cpu(world: str, history: int, mode: Mode, kind: str) -> None:
    made = learned(world, history, mode)

    def states(device: torch.device | None) -> list[np.ndarray]:
        copies = LearnedEnvironments(made.model, 5, starts=made.starts, device=device, max_episode_steps=4)
        copies.action_space.seed(5)
        found = [copies.reset(seed=3)[0]]
        return found + [copies.step(copies.action_space.sample())[0] for _ in range(7)]

    wanted = states(None)
    with gpu(kind) as device:
        np.testing.assert_allclose(states(device), wanted, rtol=1e-4, atol=1e-5)


def test_an_environment_says_what_it_does_not_do_on_a_device(monkeypatch: pytest.MonkeyPatch) -> None:
    made = learned("car")
    with pytest.raises(ModelError, match="computes in double precision, which it does on the CPU, but not on 'cuda'"):
        LearnedEnvironments(made.model, exact=True, device="cuda")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(DeviceError, match=r"device= asks for 'cuda:0', but torch .* or leave device= out for the CPU"):
        LearnedEnvironments(made.model, device="cuda")


@GPUS
@pytest.mark.parametrize("mode", MODES)
def test_points_are_evaluated_on_the_device_and_what_is_said_of_them_lies_on_the_cpu(mode: Mode, kind: str) -> None:
    world = WORLDS["discrete actions"]
    model = untrained_model(world, history=2)

    def said(points: Points) -> list[torch.Tensor]:
        predictor = predictor_of(model, mode, torch.Generator().manual_seed(0))
        return [points.outputs(model), points.probabilities(model), points.losses(model, "mae"),
                predict_all(predictor, points)]  # fmt: skip

    wanted = said(Points.of(world, model.features))
    with gpu(kind) as device:
        found = said(Points.of(world, model.features, device))
    for mine, theirs in zip(found, wanted, strict=True):
        torch.testing.assert_close(mine, theirs, rtol=1e-4, atol=1e-6, check_dtype=True)
