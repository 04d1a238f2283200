"""Definitions of ROS 2 message types that a recording does not carry."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from pathlib import Path

from rosbags.typesys import Stores, get_typestore

from addressed_dynamics.base.errors import LogError

SEPARATOR = "=" * 80
"""Stands between the definition of a message and those of the types in it."""

_FIELD = re.compile(r"^\s*([A-Za-z][\w/]*)[^\s#]*\s+[A-Za-z]\w*", re.MULTILINE)
# Constants are fields here too; their types are primitive.
_PRIMITIVE = re.compile(r"bool|byte|char|float(32|64)|u?int(8|16|32|64)|w?string")
_BUILT_IN = {f"builtin_interfaces/msg/{name}": "int32 sec\nuint32 nanosec\n" for name in ("Time", "Duration")}


class Definitions:
    """Finds the definitions of types: in what is given first, then among those of ROS 2 itself.

    Args:
        where: the recording, for errors.
        given: `.msg` files, or folders that have some, each in a folder called like its package or in `msg` within it.
        distro: the distribution of ROS 2 that made the recording; empty if it does not say.
    """

    def __init__(self, where: Path, given: Sequence[str], distro: str) -> None:
        self._where, self._given, self._distro = where, given, distro

    def complete(self, names: Iterable[str]) -> dict[str, str]:
        """Return the definition of each type and, after it, those of all types in it, as MCAP has them (`ros2msg`).

        Args:
            names: the types, for instance `sensor_msgs/msg/JointState`.

        Raises:
            LogError: types are found nowhere, what is given is not there or defines a type twice, or the distributions
                of ROS 2 define it differently and it is not known which one counts.
        """
        found = {name: self._with_parts(name) for name in names}
        missing = sorted({part for parts in found.values() for part, text in parts.items() if text is None})
        if missing:
            message = (
                f"{self._where}: the file, as is usual before ROS 2 Iron, does not say how these types are defined: "
                f"{', '.join(missing)}; name the folder or the .msg files with them as 'types' of the source"
            )
            raise LogError(message)
        return {name: _joined(parts) for name, parts in found.items()}

    def _with_parts(self, name: str) -> dict[str, str | None]:
        """Return the text of a type, which comes first, and of all types in it; None for what is found nowhere."""
        texts: dict[str, str | None] = {}
        wanted = [name]
        while wanted:
            each = wanted.pop()
            if each not in texts:
                texts[each] = text = self._text(each)
                wanted += _types_in(each, text or "")
        return texts

    def _text(self, name: str) -> str | None:
        file = self._files.get(name)
        return _read(file) if file else _BUILT_IN.get(name) or _standard(self._where, name, self._distro)

    @cached_property
    def _files(self) -> dict[str, Path]:
        """The file of each type that is given."""
        files: dict[str, Path] = {}
        for each in map(Path, self._given):
            if not each.exists():
                message = f"{each}: there is no such file or folder; correct the 'types' of the source"
                raise LogError(message)
            for file in sorted(each.rglob("*.msg")) if each.is_dir() else [each]:
                folder = file.absolute().parent
                name = f"{(folder.parent if folder.name == 'msg' else folder).name}/msg/{file.stem}"
                first = files.setdefault(name, file)
                if _read(first) != _read(file):
                    message = (
                        f"{file}: defines {name} otherwise than {first}; leave one of them in 'types' of the source"
                    )
                    raise LogError(message)
        return files


def _joined(texts: Mapping[str, str | None]) -> str:
    first, *others = texts.items()
    parts = [f"{SEPARATOR}\nMSG: {name.replace('/msg/', '/')}\n{text}" for name, text in others]
    return "\n".join([str(first[1]), *parts])


def _types_in(name: str, text: str) -> list[str]:
    package = name.split("/")[0]
    found = [each for each in _FIELD.findall(text) if not _PRIMITIVE.fullmatch(each)]
    parts = [each.split("/") for each in found]
    return [f"{package if len(each) == 1 else each[0]}/msg/{each[-1]}" for each in parts]


def _read(file: Path) -> str:
    try:
        return file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        message = f"{file}: the definition of a message cannot be read ({error}); correct the 'types' of the source"
        raise LogError(message) from error


def _standard(where: Path, name: str, distro: str) -> str | None:
    """Return the definition that ROS 2 has for a type, None if it has none."""
    every = {each.value: each for each in Stores if each.value.startswith("ros2_")}
    own = f"ros2_{distro}"
    stores = [get_typestore(each) for each in ([every[own]] if own in every else every.values())]
    found = {
        store.generate_msgdef(name, ros_version=2)[0].split(SEPARATOR)[0] for store in stores if name in store.fielddefs
    }
    if len(found) > 1:
        message = (
            f"{where}: the distributions of ROS 2 define {name} differently, and the file does not say of which it is; "
            "name the folder or the .msg file with the definition that counts as 'types' of the source"
        )
        raise LogError(message)
    return found.pop() if found else None
