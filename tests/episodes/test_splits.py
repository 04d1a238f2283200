"""Splits: by episode, stable, and never without an episode where a segment has enough of them."""

import hashlib
from pathlib import PurePath
from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from addressed_dynamics.episodes.splits import assign_splits, episode_places, file_names

shares = st.sampled_from([0.0, 0.05, 0.1, 0.3, 0.45])
identifiers = st.lists(st.integers(0, 2**62).map(str), unique=True, max_size=40)


def split(episodes: list[str], validation: float = 0.1, test: float = 0.1, seed: int = 0) -> dict[str, str]:
    splits = assign_splits(episodes, seed=seed, validation_share=validation, test_share=test)
    return dict(zip(episodes, splits, strict=True))


@given(identifiers, shares, shares, st.data())
def test_the_order_of_the_episodes_does_not_matter(
    episodes: list[str], validation: float, test: float, data: Any
) -> None:
    shuffled = data.draw(st.permutations(episodes))
    assert split(episodes, validation, test) == split(shuffled, validation, test)


def by_hash(episodes: list[str], validation: float, test: float, seed: int) -> dict[str, str]:
    places = episode_places(episodes, seed)
    found = np.where(places < test, "test", np.where(places < test + validation, "validation", "train")).tolist()
    return dict(zip(episodes, found, strict=True))


files = st.lists(st.integers(1, 9), min_size=1, max_size=12)
"""Numbers of episodes of files."""


def episodes_of(file: str, count: int) -> list[str]:
    return [f"{file}#{number}" for number in range(count)]


@given(files, st.integers(1, 9), st.sampled_from([0.1, 0.3, 0.45]), st.integers(0, 99))
def test_one_more_file_moves_no_episode_of_the_others_but_those_that_would_have_left_a_split_empty(
    lengths: list[int], more: int, share: float, seed: int
) -> None:
    before = [name for index, count in enumerate(lengths) for name in episodes_of(f"log-{index}", count)]
    one, two = (split(names, share, share, seed) for names in (before, episodes_of("a-new-log", more) + before))
    hashed = by_hash(before, share, share, seed)
    moved = {name for name in before if one[name] != two[name]}
    assert all(one[name] != hashed[name] or two[name] != hashed[name] for name in moved)
    if set(hashed.values()) == {"train", "validation", "test"}:
        assert not moved
        assert one == hashed
    assert sum(one[name] != hashed[name] for name in before) <= 2


def test_the_name_of_a_file_is_its_stem_and_of_two_with_the_same_as_much_of_the_path_as_tells_them_apart() -> None:
    paths = [PurePath(name) for name in ("logs/run.1.mcap", "logs/b.csv", "data/x/a.csv", "data/y/a.csv", "/z/c.bag")]
    assert file_names(paths) == ["run.1", "b", "x/a", "y/a", "c"]
    assert file_names([*paths, PurePath("more/d.csv")])[:5] == file_names(paths)
    assert file_names([PurePath("d/a.csv"), PurePath("d/a.parquet"), PurePath("a.csv")]) == ["a.csv", "a.parquet", "a"]
    assert file_names([]) == []


@given(st.lists(st.from_regex(r"(a/|b/){0,3}[ab]\.(csv|mcap)", fullmatch=True).map(PurePath), unique=True, max_size=8))
def test_no_two_files_have_the_same_name(paths: list[PurePath]) -> None:
    names = file_names(paths)
    assert len(set(names)) == len(paths)


@given(
    st.lists(st.integers(0, 2**62).map(str), unique=True, min_size=3, max_size=8), shares, shares, st.integers(0, 99)
)
def test_three_episodes_are_enough_for_every_split_that_has_a_share(
    episodes: list[str], validation: float, test: float, seed: int
) -> None:
    found = set(split(episodes, validation, test, seed).values())
    expected = {"train"} | ({"validation"} if validation else set()) | ({"test"} if test else set())
    assert found == expected


def test_shares_are_about_as_asked_and_depend_on_the_seed() -> None:
    episodes = episodes_of("run", 20_000)
    splits = np.array(list(split(episodes, 0.1, 0.2).values()))
    assert abs((splits == "test").mean() - 0.2) < 0.01
    assert abs((splits == "validation").mean() - 0.1) < 0.01
    assert split(episodes, seed=1) != split(episodes, seed=2)


def test_one_or_two_episodes_go_where_their_hash_sends_them() -> None:
    found = {split([name])[name] for name in episodes_of("run", 100)}
    assert found == {"train", "validation", "test"}
    assert assign_splits([], seed=0, validation_share=0.1, test_share=0.1) == []


def test_the_hash_never_changes() -> None:
    digests = [hashlib.blake2b(text, digest_size=8).digest() for text in (b"7:run-1#0", b"7:run-2#13")]
    expected = [int.from_bytes(digest) / 2**64 for digest in digests]
    np.testing.assert_allclose(episode_places(["run-1#0", "run-2#13"], seed=7), expected, rtol=1e-15)
    assert episode_places(["run-1#0"], seed=7)[0] == 0.17856446792626235
