"""From what files hold to the section `source` that imports them: what the user said, the rest guessed and told."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from addressed_dynamics.base.errors import ParamsError
from addressed_dynamics.importing.looking import MOST_TEXTS, Field, Look, longest_silence, unit_in
from addressed_dynamics.importing.paths import Label, Step, expand_slice, parse_path

ACTION_WORDS = frozenset(
    ["act", "action", "actions", "brake", "cmd", "command", "commands", "control", "controls", "effort", "force",
     "motor", "power", "push", "pwm", "steer", "steering", "thrust", "throttle", "torque", "u", "voltage"]
)  # fmt: skip
"""A topic or column with one of these words is taken for an action."""
REWARD_WORDS = frozenset(["reward", "rewards"])
EPISODE_WORDS = frozenset(["episode", "ep", "run", "trial", "traj", "trajectory"])
TERMINATED_WORDS = frozenset(["terminated", "terminals", "terminal", "done"])
TRUNCATED_WORDS = frozenset(["truncated", "timeouts", "timeout"])
TIME_WORDS = frozenset(["t", "time", "timestamp", "stamp", "sec", "secs", "seconds", "nanosec", "nsec"])
NO_STATE = frozenset(["covariance", "frame", "id", "index", "seq", "status"])
"""A field with one of these words is no state."""
MOST_GUESSED = 24
"""More changing numbers than these are not all a state; which are is for the user to say."""
MIN_LENGTH = 20
"""Samples that an episode needs."""
RARE = 10.0
"""Commands that come so many times as seldom as the state do not set the rate."""
FLOAT32 = 2.0**-23
"""Part of a number below which float32 does not see a change of it."""
LATE = 1.5
"""Periods of a topic after which its newest value no longer holds."""


_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")


@dataclass(frozen=True)
class Wishes:
    """What the user says; what is empty is guessed, where it can be."""

    observation: tuple[str, ...] = ()
    """Fields of the state, each `FIELD` or `NAME=FIELD`; a topic, an array or a slice stands for all its numbers."""
    action: tuple[str, ...] = ()
    exogenous: tuple[str, ...] = ()
    reward: str | None = None
    rate_hz: float | None = None
    episode: str | None = None
    """`file`, `end`, `reset`, or the field whose value changes from episode to episode."""
    types: tuple[str, ...] = ()
    """Folders or files with definitions of messages, for logs that do not carry them."""


@dataclass(frozen=True)
class Proposal:
    """A section `source`, with how it came about."""

    source: dict[str, Any]
    """The section; whole only if nothing is unknown."""
    notes: dict[str, str]
    """What the log says of a dimension, by its name, for a comment: range and rate."""
    guessed: tuple[str, ...]
    """What nobody said, in lines."""
    unknown: tuple[str, ...]
    """What has to be said before anything can be imported: `observation`, `action`, `rate`."""


@dataclass
class _Draft:
    guessed: list[str] = field(default_factory=list)
    unknown: list[str] = field(default_factory=list)


def propose(look: Look, files: Sequence[str], wishes: Wishes) -> Proposal:
    """Propose how to import what was looked at.

    Args:
        look: what there is.
        files: the patterns of the files, as `source` names them; for Minari the dataset, for LeRobot the folder.
        wishes: what the user says.

    Raises:
        ParamsError: a wish names a field that is not there, or one that holds texts where numbers are needed.
    """
    draft = _Draft()
    chosen = {role: _chosen(look, getattr(wishes, role)) for role in ("observation", "action", "exogenous")}
    taken = {each.field for fields in chosen.values() for each in fields.values()}
    special = _special(look, wishes, taken, draft)
    taken |= set(special.values())
    if not chosen["action"]:
        chosen["action"] = _guessed_actions(look, taken, draft)
        taken |= {each.field for each in chosen["action"].values()}
    if not chosen["observation"]:
        chosen["observation"] = _guessed_states(look, taken, draft)
    source: dict[str, Any] = {"kind": look.kind, **_origin(look.kind, files), **look.options}
    source["observation"] = _dimensions(chosen["observation"], draft)
    source["action"] = _action(chosen["action"], draft)
    if chosen["exogenous"]:
        source["exogenous"] = _dimensions(chosen["exogenous"], draft)
    source["reward"] = special.get("reward")
    source |= {role: special[role] for role in ("terminated", "truncated") if role in special}
    source |= _timing(look, chosen, special, wishes, draft)
    source["min_length"] = MIN_LENGTH
    notes = {name: _note(each) for fields in chosen.values() for name, each in fields.items()}
    return Proposal(source, notes, tuple(draft.guessed), tuple(draft.unknown))


def _origin(kind: str, files: Sequence[str]) -> dict[str, Any]:
    match kind:
        case "minari":
            return {"dataset": files[0]}
        case "lerobot":
            return {"folder": files[0]}
        case _:
            return {"files": files[0] if len(files) == 1 else list(files)}


def _chosen(look: Look, wishes: Iterable[str]) -> dict[str, Field]:
    """Return the fields that were wished for, by the names of their dimensions."""
    found: dict[str, Field] = {}
    for wish in wishes:
        name, _, text = wish.rpartition("=")
        if name and not _NAME.fullmatch(name.strip()):
            message = f"'{name.strip()}' cannot be the name of a dimension; give letters, digits and _, a letter first"
            raise ParamsError(message)
        fields = _matching(look, text.strip())
        for number, each in enumerate(fields):
            own = _unused(_name(each.field, look), found) if not name else name.strip()
            found[own if not name or len(fields) == 1 else f"{own}_{number}"] = each
    return found


def _matching(look: Look, wish: str) -> list[Field]:
    """Return the field of this name, the elements of a slice, or all numbers in a topic, an array or a part."""
    by_name = {each.field: each for each in look.fields}
    wanted = [text for _, text in expand_slice(wish)]
    if all(each in by_name for each in wanted):
        found = [by_name[each] for each in wanted]
    else:
        found = [each for each in look.fields if re.match(re.escape(wish) + r"[.\[]", each.field) and each.is_number]
    if not found:
        known = ", ".join(each.field for each in look.fields[:40]) or "none"
        more = f" and {len(look.fields) - 40} more" if len(look.fields) > 40 else ""
        message = f"there is no field '{wish}'; the fields are: {known}{more}"
        raise ParamsError(message)
    return found


def _special(look: Look, wishes: Wishes, taken: set[str], draft: _Draft) -> dict[str, str]:
    """Return the fields of the reward, of ends and of episodes."""
    found: dict[str, str] = {}
    if wishes.reward is not None:
        found["reward"] = _matching(look, wishes.reward)[0].field
    if wishes.episode not in (None, "file", "end", "reset"):
        found["episode"] = _matching(look, str(wishes.episode))[0].field
    words = {"reward": REWARD_WORDS, "terminated": TERMINATED_WORDS, "truncated": TRUNCATED_WORDS,
             "episode": EPISODE_WORDS}  # fmt: skip
    for role, known in words.items():
        for each in look.fields:
            if role not in found and each.field not in taken | set(found.values()) and _last_words(each.field) & known:
                found[role] = each.field
                draft.guessed.append(f"{role}: {each.field}, for its name")
    return found


def _guessed_actions(look: Look, taken: set[str], draft: _Draft) -> dict[str, Field]:
    candidates = [each for each in look.fields if each.field not in taken and _words(each.field) & ACTION_WORDS]
    numbers = [each for each in candidates if each.is_number and not each.constant and _may_be_state(each)]
    texts = [each for each in candidates if 1 < len(each.texts) <= MOST_TEXTS]
    found = numbers or texts[:1]
    if not found:
        draft.unknown.append("action")
        return {}
    draft.guessed.append(f"action: {', '.join(each.field for each in found)}, for the words in its name")
    return _named(found, look)


def _guessed_states(look: Look, taken: set[str], draft: _Draft) -> dict[str, Field]:
    found = [each for each in look.fields
             if each.is_number and not each.constant and each.field not in taken and _may_be_state(each)]  # fmt: skip
    if not found or len(found) > MOST_GUESSED:
        draft.unknown.append("observation")
        return {}
    draft.guessed.append(f"observation: {', '.join(each.field for each in found)}, which are all other numbers")
    return _named(found, look)


def _may_be_state(each: Field) -> bool:
    values = each.finite
    # What only ever grows by one, or of which so many are left out, counts something.
    steps = np.diff(values)
    counts = len(steps) > 1 and bool((steps == steps[0]).all()) and steps[0] >= 1 and float(steps[0]).is_integer()
    return not (_last_words(each.field) & TIME_WORDS) and not (_words(each.field) & NO_STATE) and not counts


def _timing(
    look: Look, chosen: Mapping[str, Mapping[str, Field]], special: Mapping[str, str], wishes: Wishes, draft: _Draft
) -> dict[str, Any]:
    """Return the keys that say when: the rate, what is late, and where episodes end."""
    if look.kind == "lerobot" and wishes.rate_hz is None:
        return {}
    timing: dict[str, Any] = _rate(chosen, wishes, draft)
    if look.kind in ("minari", "lerobot"):
        return timing
    rate = timing.get("rate_hz", 1.0)
    if look.kind == "mcap":
        timing["tolerance_s"] = max(
            [_age(each, each.late_s) for each in chosen["observation"].values()], default=_rounded(LATE / rate)
        )
        others = [each for role in ("action", "exogenous") for each in chosen[role].values()]
        observed = {each.topic for each in chosen["observation"].values()}
        topics = _topics([each for each in others if each.topic not in observed], timing["tolerance_s"])
        timing |= {"topics": topics} if topics else {}
    elif look.clock is not None:
        timing["clock"] = look.clock
        column = look.clock.get("frame") or f"{look.clock['column']} in {look.clock.get('unit', 's')}"
        draft.guessed.append(f"clock: {column}, for its name; gaps end episodes")
    timing["episode"] = _episode(look, special, wishes, rate, draft)
    return timing


def _rate(chosen: Mapping[str, Mapping[str, Field]], wishes: Wishes, draft: _Draft) -> dict[str, Any]:
    if wishes.rate_hz is not None:
        return {"rate_hz": wishes.rate_hz}
    rates = [each.rate_hz for each in chosen["observation"].values() if each.rate_hz]
    # A step is what follows a command, unless commands are rare.
    fastest = max(rates, default=0.0)
    rates += [each.rate_hz for each in chosen["action"].values() if each.rate_hz and each.rate_hz * RARE > fastest]
    if not rates:
        draft.unknown.append("rate")
        return {}
    # A rate a little off is the same rate, measured.
    slowest = min(rates)
    rate = (
        float(round(slowest)) if slowest >= 1 and abs(slowest - round(slowest)) < 0.01 * slowest else _rounded(slowest)
    )
    draft.guessed.append(f"rate: {rate:g} Hz, at which the slowest of them was logged")
    return {"rate_hz": rate}


def _topics(fields: Sequence[Field], tolerance_s: float) -> dict[str, dict[str, Any]]:
    """Give commands that speak more seldom than the clock ticks a tolerance of their own."""
    topics: dict[str, dict[str, Any]] = {}
    for each in fields:
        if each.total <= 2 or each.rate_hz is None:
            topics[each.topic] = {"hold": True}
        elif _age(each, each.silent_s) > tolerance_s:
            topics[each.topic] = {"tolerance_s": _age(each, each.silent_s)}
    return topics


def _age(each: Field, late_s: float) -> float:
    """Return how old the newest value of a field usually gets, in seconds."""
    return _rounded(max(LATE / each.rate_hz, late_s)) if each.rate_hz else 0.0


def _episode(look: Look, special: Mapping[str, str], wishes: Wishes, rate: float, draft: _Draft) -> dict[str, Any]:
    if "episode" in special:
        key = "field" if look.kind == "mcap" else "column"
        return {"by": "topic" if look.kind == "mcap" else "column", key: special["episode"]}
    if wishes.episode in ("file", "end", "reset"):
        return {"by": wishes.episode}
    if look.kind != "mcap" and {"terminated", "truncated"} & set(special):
        return {"by": "end"}
    if look.kind == "mcap":
        seconds = _rounded(longest_silence(rate))
        draft.guessed.append(f"episodes: a silence of {seconds:g} s ends one")
        return {"by": "gap", "seconds": seconds}
    draft.guessed.append("episodes: a file is one")
    return {"by": "file"}


def _dimensions(fields: Mapping[str, Field], draft: _Draft) -> dict[str, Any]:
    dimensions: dict[str, Any] = {}
    for name, each in fields.items():
        dimensions[name] = {"field": each.field, **({"unit": each.unit} if each.unit else {})}
        if offset := _offset(each):
            dimensions[name]["offset"] = offset
            draft.guessed.append(f"offset of {name}: {offset:.12g}, without which float32 cannot hold its steps")
    return dimensions


def _offset(each: Field) -> float:
    """Return what to take off values whose usual step is too small for float32; 0 if it is not."""
    steps = np.abs(np.diff(each.finite))
    steps = steps[steps > 0]
    if not len(steps) or np.median(steps) > FLOAT32 * np.abs(each.finite).max():
        return 0.0
    return float(round(float(np.median(each.finite))))


def _action(fields: Mapping[str, Field], draft: _Draft) -> dict[str, Any]:
    texts = [each for each in fields.values() if each.texts]
    if texts and len(fields) > 1:
        message = (
            f"the action would be {', '.join(each.field for each in fields.values())}, but one of words, such as "
            f"'{texts[0].field}', has no other one beside it; give one --action, or numbers alone"
        )
        raise ParamsError(message)
    if texts and len(texts[0].texts) > MOST_TEXTS:
        message = f"'{texts[0].field}' has more than {MOST_TEXTS} different texts; an action of words is one of few"
        raise ParamsError(message)
    if texts:
        return {"discrete": {"field": texts[0].field, "names": sorted(texts[0].texts)}}
    return {"continuous": _dimensions(fields, draft)}


def _note(each: Field) -> str:
    words = [] if each.range is None else ["{:.4g} to {:.4g}".format(*each.range)]
    words += [] if each.rate_hz is None else [f"{each.rate_hz:.3g} Hz"]
    return ", ".join(words)


def _named(fields: Iterable[Field], look: Look) -> dict[str, Field]:
    found: dict[str, Field] = {}
    for each in fields:
        found[_unused(_name(each.field, look), found)] = each
    return found


def _name(text: str, look: Look) -> str:
    """Return a name for the dimension of a field: its last word, and those before it as far as that says too little."""
    if look.kind == "mcap":
        path = parse_path(text)
        words = [path.topic.rsplit("/", maxsplit=1)[-1], *(_step_word(step) for step in path.steps)]
    elif look.kind == "lerobot":
        vector, _, name = text.rstrip("]").partition("[")
        words = [*vector.split("."), *([name] if name else [])]
    else:
        without_unit = text[: text.rindex(unit) - 1] if (unit := unit_in(text)) else text
        words = re.split(r"[.\[\]]+", without_unit)
    words = [word for word in (re.sub(r"[^A-Za-z0-9]+", "_", _plain(word)).strip("_") for word in words) if word]
    start = len(words) - 1
    while start > 0 and (words[start].isdigit() or len(words[start]) < 2 or words[start] in ("data", "value")):
        start -= 1
    kept = [word for word in words[start:] if word not in ("data", "value")] or words[-1:]
    name = "_".join(kept) if kept else "field"
    return name if re.match(r"[A-Za-z]", name) else f"x_{name}"


def _plain(text: str) -> str:
    """Return a text without what letters have on them: `große Höhe` is `groe Hohe`."""
    return unicodedata.normalize("NFKD", text).encode("ascii", "ignore").decode()


def _step_word(step: Step) -> str:
    return step.name if isinstance(step, Label) else str(step)


def _unused(name: str, taken: Mapping[str, Any]) -> str:
    return next(each for each in [name, *(f"{name}_{number}" for number in range(2, 10_000))] if each not in taken)


def _words(text: str) -> set[str]:
    return set(re.split(r"[^a-z]+", re.sub(r"([a-z])([A-Z])", r"\1 \2", text).lower()))


def _last_words(text: str) -> set[str]:
    """Return the words of the last part of a path that has any: `/ep.data` is about ep."""
    parts = [_words(part) - {"", "data", "value"} for part in re.split(r"[./]", text)]
    return next((part for part in reversed(parts) if part), set())


def _rounded(value: float) -> float:
    return float(f"{value:.3g}")
