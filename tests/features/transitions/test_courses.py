"""Networks that go on from their own predictions: the same as a model's rollouts, and differentiable."""

import math
from dataclasses import fields

import pytest
import torch
from acrobot_recordings import acrobot_recording
from learning import drive, sail, swing
from torch import Tensor

from addressed_dynamics.episodes.transitions import Transitions
from addressed_dynamics.features.common.samples import Samples
from addressed_dynamics.features.transitions.angles import angle_of, weighted_angle
from addressed_dynamics.features.transitions.spec import fit_features
from addressed_dynamics.networks.stacked import StackedMLP
from addressed_dynamics.simulators.addressed import AddressedDynamics
from addressed_dynamics.sources.transitions.params import AngleParams, FeatureParams

LENGTHS = (12, 9)
ANGLES = tuple(
    AngleParams(name=f"angle_{i}", cosine=f"cos_angle_{i}", sine=f"sin_angle_{i}", velocity=f"velocity_{i}")
    for i in (1, 2)
)
ROWS = [field.name for field in fields(Transitions) if field.name != "spec"]
WORLDS = {
    "discrete": (drive(LENGTHS), {}),
    "continuous": (swing(LENGTHS), {"target": "absolute"}),
    "exogenous": (sail(LENGTHS), {}),
    "history": (sail(LENGTHS), {"history": 3, "history_weight": 0.5}),
    "angles": (acrobot_recording(LENGTHS), {"angles": ANGLES, "angle_from": "atan2"}),
    "paper's angles": (
        acrobot_recording(LENGTHS),
        {"angles": ANGLES, "angle_from": "weighted", "velocity": "difference", "history": 2, "target": "absolute"},
    ),
}


def model_of(world: Transitions, params: dict[str, object], members: int = 1) -> AddressedDynamics:
    features = fit_features(world, FeatureParams.model_validate(params))
    generator = torch.Generator().manual_seed(0)
    stack = StackedMLP(members, (features.inputs, 8, features.outputs), "tanh", generator)
    addressing = StackedMLP(1, (features.inputs, members), "relu", generator) if members > 1 else None
    return AddressedDynamics(features, stack, addressing)


def courses_of(model: AddressedDynamics, world: Transitions) -> Samples:
    samples = model.features.samples(world, courses=True)
    assert samples.courses is not None
    return samples


def test_steps_are_counted_to_the_end_of_an_episode() -> None:
    world, _ = WORLDS["discrete"]
    samples = courses_of(model_of(world, {}), world)
    assert samples.courses.steps(torch.arange(21)).tolist() == [*range(12, 0, -1), *range(9, 0, -1)]
    samples = courses_of(model_of(world, {"history": 4}), world)
    assert samples.courses.steps(torch.arange(15)).tolist() == [*range(9, 0, -1), *range(6, 0, -1)]


def test_nobody_gets_courses_who_does_not_ask() -> None:
    world, _ = WORLDS["discrete"]
    assert model_of(world, {}).features.samples(world).courses is None


@pytest.mark.parametrize("name", WORLDS)
def test_a_network_goes_the_way_of_a_rollout_and_what_is_right_leads_back_to_the_truth(name: str) -> None:
    world, params = WORLDS[name]
    model = model_of(world, params)
    features, samples, horizon = model.features, courses_of(model, world), 5
    history = features.history
    starts = torch.tensor([0, 12 - (history - 1)])
    output, target = samples.courses.unroll(model.ensemble, starts.unsqueeze(0), horizon)
    rows = torch.tensor([[0], [12]]) + torch.arange(history - 1 + horizon)
    states, actions = (torch.from_numpy(each)[rows] for each in (world.observation, world.action))
    exogenous = torch.from_numpy(world.exogenous)[rows] if world.exogenous.shape[1] else None
    first = states[:, 0] if history == 1 else states[:, :history]
    predicted = model.rollout(first, actions, exogenous=exogenous)
    before = torch.cat([states[:, history - 1 : history], predicted[:, :-1]], dim=1)
    after = torch.from_numpy(world.next_observation)[rows[:, history - 1 :]]
    for step in range(horizon):
        decoded = features.decode(output[0, step], before[:, step])
        torch.testing.assert_close(decoded, predicted[:, step], rtol=1e-4, atol=1e-5)
        right = features.encode_target(before[:, step], after[:, step])
        torch.testing.assert_close(target[0, step], right, rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(output[0, 0], model.ensemble(samples.x[starts])[0])
    torch.testing.assert_close(target[0, 0], samples.y[starts])


def test_every_member_goes_its_own_way() -> None:
    world, params = WORLDS["history"]
    model = model_of(world, params, members=2)
    samples = courses_of(model, world)
    starts = torch.tensor([[0, 3], [4, 1]])
    output, target = samples.courses.unroll(model.ensemble, starts, 4)
    for member in range(2):
        alone = StackedMLP(1, model.ensemble.widths, "tanh")
        alone.load_state_dict({name: each[member : member + 1] for name, each in model.ensemble.state_dict().items()})
        found = samples.courses.unroll(alone, starts[member : member + 1], 4)
        torch.testing.assert_close(output[member], found[0][0])
        torch.testing.assert_close(target[member], found[1][0])


def test_steps_beyond_the_end_of_an_episode_take_nothing_of_the_next() -> None:
    world, params = WORLDS["exogenous"]
    model = model_of(world, params)
    alone = Transitions(world.spec, **{name: getattr(world, name)[:12] for name in ROWS})
    both = [courses_of(model, each).courses.unroll(model.ensemble, torch.tensor([[10]]), 4) for each in (world, alone)]
    for found, expected in zip(*both, strict=True):
        assert torch.equal(found, expected)


def slopes(cosine: Tensor, sine: Tensor, *, weighted: bool) -> tuple[Tensor, Tensor, Tensor]:
    cosine, sine = cosine.clone().requires_grad_(), sine.clone().requires_grad_()
    angle = angle_of(cosine, sine, weighted=weighted)
    by_cosine, by_sine = torch.autograd.grad(angle.sum(), (cosine, sine))
    return angle.detach(), by_cosine, by_sine


@pytest.mark.parametrize("size", [0.5, 1.0, 1.2])
def test_the_slope_of_an_angle_is_finite_on_the_whole_circle(size: float) -> None:
    turn = torch.linspace(-math.pi, math.pi, 25)
    cosine, sine = size * turn.cos(), size * turn.sin()
    cosine, sine = torch.cat([cosine, torch.tensor([1.0, 0.0])]), torch.cat([sine, torch.tensor([0.0, 1.0])])
    angle, *found = slopes(cosine, sine, weighted=True)
    _, *expected = slopes(cosine, sine, weighted=False)
    torch.testing.assert_close(angle, weighted_angle(cosine, sine), rtol=0, atol=1e-6)
    for slope, wanted in zip(found, expected, strict=True):
        assert slope.isfinite().all()
        torch.testing.assert_close(slope, wanted)
