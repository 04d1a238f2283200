"""Hypothesis strategies for the project's contracts."""

import numpy as np
from hypothesis import strategies as st

from addressed_dynamics.episodes.transitions import (
    ContinuousAction,
    Dimension,
    DiscreteAction,
    SpaceSpec,
    Transitions,
)

names = st.from_regex(r"[a-z][a-z0-9_]{0,8}", fullmatch=True)
bounds = st.sampled_from([(-1.0, 1.0), (-np.inf, np.inf), (0.0, np.inf)])


@st.composite
def dimensions(draw: st.DrawFn, max_size: int = 20) -> tuple[Dimension, ...]:
    chosen = draw(st.lists(names, min_size=1, max_size=max_size, unique=True))
    unit = draw(st.sampled_from(["", "m", "rad/s"]))
    return tuple(Dimension(name, unit, *draw(bounds)) for name in chosen)


@st.composite
def space_specs(draw: st.DrawFn, max_size: int = 20) -> SpaceSpec:
    discrete = st.integers(1, 5).map(lambda count: DiscreteAction(tuple(f"action_{i}" for i in range(count))))
    continuous = dimensions(max_size).map(ContinuousAction)
    return SpaceSpec(
        observation=draw(dimensions(max_size)),
        action=draw(discrete | continuous),
        step_seconds=draw(st.sampled_from([0.001, 1 / 30, 0.2, 1.0])),
        exogenous=draw(st.just(()) | dimensions(max_size)),
    )


@st.composite
def transitions(draw: st.DrawFn, max_episodes: int = 4, max_length: int = 6) -> Transitions:
    """Whole episodes of finite numbers of all sizes; each ends terminated, truncated or both."""
    spec = draw(space_specs())
    lengths = draw(st.lists(st.integers(1, max_length), min_size=1, max_size=max_episodes))
    first_episode = draw(st.sampled_from([0, 7, 2**40]))
    generator = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    return random_transitions(spec, lengths, generator, first_episode=first_episode)


def random_transitions(
    spec: SpaceSpec, lengths: list[int], generator: np.random.Generator, *, first_episode: int = 0
) -> Transitions:
    """Episodes of these lengths with random numbers in them."""
    total = sum(lengths)
    ends = np.cumsum(lengths) - 1

    def numbers(*shape: int) -> np.ndarray:
        return (generator.standard_normal(shape) * 10.0 ** generator.integers(-30, 30, shape)).astype(np.float32)

    states = numbers(total + len(lengths), len(spec.observation))
    before = np.concatenate([np.arange(n) + offset for n, offset in zip(lengths, _state_offsets(lengths), strict=True)])
    kind = generator.integers(1, 4, len(lengths))
    terminated, truncated = np.zeros((2, total), dtype=bool)
    terminated[ends], truncated[ends] = kind & 1 > 0, kind & 2 > 0
    discrete = isinstance(spec.action, DiscreteAction)
    return Transitions(
        spec=spec,
        episode=np.repeat(first_episode + np.arange(len(lengths)), lengths),
        step=np.concatenate([np.arange(length, dtype=np.int32) for length in lengths]),
        time_ns=np.array([round(i * (spec.step_seconds * 1e9)) for i in range(total)], dtype=np.int64),
        observation=states[before],
        action=generator.integers(0, spec.action.count, total)
        if discrete
        else numbers(total, len(spec.action.dimensions)),
        reward=numbers(total),
        next_observation=states[before + 1],
        terminated=terminated,
        truncated=truncated,
        exogenous=numbers(total, len(spec.exogenous)),
    )


def _state_offsets(lengths: list[int]) -> list[int]:
    return [sum(lengths[:i]) + i for i in range(len(lengths))]
