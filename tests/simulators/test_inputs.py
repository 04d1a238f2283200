"""Whatever a model is given: the right answer, or one line that says what is wrong."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from learning import drive, swing, untrained_model
from motions import make_motion

from addressed_dynamics.base.errors import ModelError
from addressed_dynamics.episodes.transitions import DiscreteAction
from addressed_dynamics.features.motion.features import fit_motion_features
from addressed_dynamics.networks.stacked import StackedMLP
from addressed_dynamics.simulators.addressed import AddressedDynamics
from addressed_dynamics.simulators.modes import MODES, Mode
from addressed_dynamics.simulators.motion import MotionModel
from addressed_dynamics.sources.motion.params import MotionFeatureParams

WORLDS = {"car": drive((30, 20)), "arm": swing()}
MODELS = {
    "car": untrained_model(WORLDS["car"]),
    "arm": untrained_model(WORLDS["arm"]),
    "car of three frames": untrained_model(WORLDS["car"], history=3),
}
MOTION = make_motion(rows=6)


def motion_model() -> MotionModel:
    stacks = [
        StackedMLP(members, widths, "elu", torch.Generator().manual_seed(members)).requires_grad_(False)
        for members, widths in ((3, (342, 8, 311)), (1, (342, 8, 3)))
    ]
    return MotionModel(fit_motion_features(MOTION, MotionFeatureParams(target="change")), *stacks)


MOTION_MODEL = motion_model()
FORMS: dict[str, Callable[[np.ndarray], Any]] = {
    "array": lambda values: values,
    "list": lambda values: values.tolist(),
    "tuple": lambda values: tuple(values.tolist()) if values.ndim else values.tolist(),
    "Fortran": lambda values: np.asfortranarray(values),
    "backwards": lambda values: values[::-1].copy()[::-1] if values.ndim else values,
    "strided": lambda values: np.repeat(values, 2, axis=-1)[..., ::2] if values.ndim else values,
    "read-only": lambda values: np.frombuffer(values.tobytes(), values.dtype).reshape(values.shape),
    "other byte order": lambda values: values.astype(values.dtype.newbyteorder()),
    "tensor": lambda values: torch.tensor(values.tolist(), dtype=_tensor_type(values.dtype)),
    "strided tensor": lambda values: _turned(torch.tensor(values.tolist(), dtype=_tensor_type(values.dtype))),
    "with gradient": lambda values: torch.tensor(values.tolist(), dtype=torch.float64, requires_grad=True),
}
TYPES = ["f2", "f4", "f8", "g", "i1", "i4", "i8", "u1", "u2", "u4", "u8", "?", "c8", "U8", "O", "M8[s]"]
INTEGERS = ["i1", "i4", "i8", "u1", "u2", "u4", "u8"]
NUMBERS = ["f2", "f4", "f8", "g", *INTEGERS, "?"]
FITTING = {
    "car": [((2,), ()), ((0, 2), (0,)), ((1, 2), (1,)), ((3, 2), (3,))],
    "arm": [((2,), (2,)), ((0, 2), (0, 2)), ((1, 2), (1, 2)), ((3, 2), (3, 2))],
    "car of three frames": [((3, 2), (3,)), ((0, 3, 2), (0, 3)), ((4, 3, 2), (4, 3))],
}
"""Shapes of states and actions that go together."""


def _tensor_type(of: np.dtype[Any]) -> torch.dtype:
    return torch.from_numpy(np.zeros(1, of)).dtype if of.kind in "biufc" and of.char not in "g" else torch.float64


def _turned(tensor: torch.Tensor) -> torch.Tensor:
    return tensor.movedim(0, -1).contiguous().movedim(-1, 0) if tensor.ndim else tensor


@st.composite
def some(draw: st.DrawFn, shapes: list[tuple[int, ...]], types: list[str] = TYPES) -> Any:
    """Small whole numbers, of any of the shapes, types and forms; now and then one that is not finite, or huge."""
    shape, kind = draw(st.sampled_from(shapes)), np.dtype(draw(st.sampled_from(types)))
    values = np.random.default_rng(draw(st.integers(0, 99))).integers(0, 3, shape).astype("f8")
    if kind.kind == "f" and values.size and draw(st.integers(0, 4)) == 4:
        values.flat[draw(st.integers(0, values.size - 1))] = draw(st.sampled_from([np.nan, np.inf, -np.inf, 1e300]))
    with np.errstate(over="ignore", invalid="ignore"):
        array = values.astype("i8").astype(kind) if kind.kind in "iu?UOM" else values.astype(kind)
    form = draw(st.sampled_from(sorted(FORMS) if kind.kind in "biuf" else ["array", "list", "tuple"]))
    return FORMS[form](array)


@st.composite
def inputs(draw: st.DrawFn, name: str) -> tuple[Any, Any]:
    """States and actions, of which two in three have fitting shapes and numbers for the types."""
    if draw(st.integers(0, 2)) == 0:
        return draw(some(STATES)), draw(some(ACTIONS))
    state, action = draw(st.sampled_from(FITTING[name]))
    return draw(some([state], NUMBERS)), draw(some([action], INTEGERS if name.startswith("car") else NUMBERS))


def said_or_refused(call: Callable[[], Any]) -> Any:
    """Return what a call returns, or None if it refuses in one line."""
    try:
        return call()
    except ModelError as error:
        said = str(error)
    assert "\n" not in said
    return None


def plain(values: Any) -> np.ndarray:
    return values.detach().numpy() if isinstance(values, torch.Tensor) else np.array(values)


STATES: list[tuple[int, ...]] = [(), (0,), (2,), (3,), (0, 2), (1, 2), (3, 2), (2, 3), (3, 3, 2), (4, 3, 2), (3, 4, 2)]
ACTIONS: list[tuple[int, ...]] = [(), (0,), (1,), (2,), (3,), (4,), (0, 2), (3, 2), (1, 2), (3, 3), (4, 3), (3, 3, 2)]


@pytest.mark.parametrize("name", MODELS)
@given(data=st.data(), mode=st.sampled_from(MODES))
@settings(max_examples=400, deadline=None)
def test_a_model_is_right_or_refuses_in_one_line(name: str, data: st.DataObject, mode: Mode) -> None:
    model, (states, actions) = MODELS[name], data.draw(inputs(name))
    generator = torch.Generator().manual_seed(0)
    found = said_or_refused(lambda: model.predict(states, actions, mode, generator=generator))
    if found is None:
        return
    state, action = plain(states).astype("f4"), plain(actions)
    discrete = isinstance(model.features.spaces.action, DiscreteAction)
    batch = state if state.ndim == (2 if model.features.history == 1 else 3) else state[None]
    rows = action if len(batch.shape) == state.ndim else action[None]
    rows = rows.reshape(batch.shape[:-1] + rows.shape[batch.ndim - 1 :]).astype("i8" if discrete else "f4")
    expected = model.predict(batch, rows, mode, generator=torch.Generator().manual_seed(0))
    assert np.isfinite(expected).all()
    assert isinstance(found, torch.Tensor if isinstance(states, torch.Tensor) else np.ndarray)
    assert plain(found).dtype == np.float32
    np.testing.assert_array_equal(plain(found), expected if batch.ndim == state.ndim else expected[0])
    helpers = (model.member_outputs, model.member_predictions, model.probabilities, model.address)
    for helper, axis in zip(helpers, (1, 1, 0, 0), strict=True):
        said, of_batch = helper(states, actions), helper(batch, rows)
        np.testing.assert_array_equal(plain(said), of_batch if batch.ndim == state.ndim else of_batch.take(0, axis))
        assert isinstance(said, type(found))


@given(frames=some([(342,), (0, 342), (1, 342), (3, 342), (), (0,), (341,), (2, 311), (342, 2), (1, 1, 342)]))
@settings(max_examples=200, deadline=None)
def test_a_motion_model_is_right_or_refuses_in_one_line(frames: Any) -> None:
    found = said_or_refused(lambda: MOTION_MODEL.predict(frames))
    if found is None:
        return
    x = plain(frames).astype("f4")
    expected = MOTION_MODEL.predict(np.atleast_2d(x))
    assert np.isfinite(expected).all()
    assert isinstance(found, torch.Tensor if isinstance(frames, torch.Tensor) else np.ndarray)
    np.testing.assert_array_equal(plain(found), expected if x.ndim == 2 else expected[0])


@pytest.mark.parametrize("form", [form for form in FORMS if form != "with gradient"])
@pytest.mark.parametrize("name", ["car", "arm"])
def test_every_form_of_the_same_numbers_gets_the_same_answer(name: str, form: str) -> None:
    world, model = WORLDS[name], MODELS[name]
    found = model.predict(FORMS[form](world.observation), FORMS[form](world.action))
    np.testing.assert_array_equal(plain(found), model.predict(world.observation, world.action))


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ([[0.0, np.nan]], r"observations should be finite and fit float32, but \[0, 1\] is nan"),
        ([[1e300, 0.0]], r"\[0, 0\] is 1e\+300"),
        (torch.zeros(1, 2).to_sparse(), "dense and on the CPU"),
        (torch.zeros(1, 2, device="meta"), "on 'meta'; convert it first"),
        (torch.zeros(1, 2, dtype=torch.complex64), "complex64"),
        ([[0.0, None]], "values of type 'object'"),
        ({"position": 0.0}, "values of type 'object'"),
    ],
)
def test_values_that_no_model_can_use_are_named(values: Any, said: str) -> None:
    with pytest.raises(ModelError, match=said):
        MODELS["car"].predict(values, [0])


def test_actions_and_phases_should_be_finite_too() -> None:
    with pytest.raises(ModelError, match=r"actions should be finite and fit float32, but \[0, 1\] is inf"):
        MODELS["arm"].predict([[0.0, 0.0]], [[0.0, np.inf]])
    phased = MotionModel(MOTION_MODEL.features, StackedMLP(4, (342, 8, 311), "elu"), mode="phase")
    with pytest.raises(ModelError, match="phases should be finite"):
        phased.predict(MOTION.x[:1], phase=[np.nan])


@pytest.mark.parametrize("mode", MODES)
def test_a_rollout_that_leaves_all_bounds_goes_on(mode: Mode) -> None:
    model = untrained_model(WORLDS["car"])
    model.ensemble.weights[-1].fill_(torch.inf)
    rolled = model.rollout(np.array([[1.0, 0.5], [0.2, 0.1]]), np.ones((2, 6), int), mode)
    assert rolled.shape == (2, 6, 2)
    assert not np.isfinite(rolled[:, -1]).any()


@pytest.mark.parametrize("name", MODELS)
def test_one_sample_is_answered_without_the_axis_of_a_batch(name: str) -> None:
    model: AddressedDynamics = MODELS[name]
    world, frames = WORLDS[name[:3]], model.features.history
    state, action = world.observation[:frames].squeeze(), world.action[:frames].squeeze()
    state, action = (state, action) if frames > 1 else (world.observation[0], world.action[0])
    members, width = model.ensemble.members, len(model.features.spaces.observation)
    outputs = model.member_outputs(state, action)
    assert (outputs.shape, model.decode(outputs, state).shape) == ((members, model.features.outputs), (members, width))
    np.testing.assert_array_equal(model.decode(outputs[1], state), model.member_predictions(state, action)[1])
    assert model.member_predictions(state, action).shape == (members, width)
    assert model.probabilities(state, action).shape == (members,)
    assert model.address(state, action).shape == ()
    assert model.predict(state, action).shape == (width,)


@pytest.mark.parametrize("output", [np.zeros(()), np.zeros(3), np.zeros((2, 2)), np.zeros((1, 3, 3, 2)), [["a"]]])
def test_outputs_of_another_shape_are_not_decoded(output: Any) -> None:
    with pytest.raises(ModelError):
        MODELS["car"].decode(output, WORLDS["car"].observation[:3])


@pytest.mark.parametrize("mode", ["", "best", 3, ["argmax"]])
def test_a_mode_of_any_other_form_is_refused_even_if_nothing_is_to_be_done(mode: Any) -> None:
    with pytest.raises(ModelError, match="there is no addressing mode"):
        MODELS["car"].rollout(np.zeros((1, 2)), np.zeros((1, 0), int), mode)
    with pytest.raises(ModelError, match="there is no addressing mode"):
        MOTION_MODEL.predict(MOTION.x, mode)
