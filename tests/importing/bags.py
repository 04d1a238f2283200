"""Bags as ROS 2 writes them: databases by hand, and folders by the writer of `rosbags`."""

import io
import sqlite3
from collections.abc import Iterable, Mapping
from pathlib import Path

import yaml  # type: ignore[import-untyped]  # the stubs are a package of their own
from foreign_logs import ROS2, Timed, ros2_log
from mcap.reader import make_reader
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

TABLES = """
    CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,
        serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL);
    CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL,
        data BLOB NOT NULL);
    CREATE INDEX timestamp_idx ON messages (timestamp ASC);
"""
DEFINITIONS = """
    CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT NOT NULL, encoding TEXT NOT NULL,
        encoded_message_definition TEXT NOT NULL, type_description_hash TEXT NOT NULL);
"""
Encoded = tuple[str, int, bytes]
"""Topic, time in nanoseconds, and message in CDR."""
TYPES = {topic: (name.replace("/", "/msg/"), text) for topic, (name, text) in ROS2.items()}
"""Type and definition of each topic of `foreign_logs`."""


def encoded(messages: Iterable[Timed]) -> list[Encoded]:
    """The messages as `ros2_log` encodes them."""
    reader = make_reader(io.BytesIO(ros2_log(messages)))
    found = reader.iter_messages(log_time_order=False)
    return [(channel.topic, message.log_time, message.data) for _, channel, message in found]


def write_database(
    path: Path,
    messages: Iterable[Encoded],
    *,
    types: Mapping[str, tuple[str, str]] = TYPES,
    defined: bool = True,
    distro: str | None = None,
) -> Path:
    """Write a `.db3` file, with the definitions of its types or, as before Iron, without."""
    path.parent.mkdir(parents=True, exist_ok=True)
    database = sqlite3.connect(path)
    database.executescript(TABLES + (DEFINITIONS if defined else ""))
    if distro is not None:
        database.execute("CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL)")
        database.execute("INSERT INTO schema VALUES (3, ?)", (distro,))
    numbers = {topic: number for number, topic in enumerate(types, 1)}
    for topic, (name, text) in types.items():
        database.execute("INSERT INTO topics VALUES (?, ?, ?, 'cdr', '')", (numbers[topic], topic, name))
        if defined:
            database.execute("INSERT INTO message_definitions VALUES (NULL, ?, 'ros2msg', ?, '')", (name, text))
    rows = [(numbers[topic], time, data) for topic, time, data in messages]
    database.executemany("INSERT INTO messages VALUES (NULL, ?, ?, ?)", rows)
    database.commit()
    database.close()
    return path


def write_metadata(folder: Path, files: Iterable[str], **changes: object) -> Path:
    """Write the metadata of a bag."""
    folder.mkdir(parents=True, exist_ok=True)
    about = {"version": 5, "storage_identifier": "sqlite3", "relative_file_paths": list(files)} | changes
    (folder / "metadata.yaml").write_text(yaml.safe_dump({"rosbag2_bagfile_information": about}))
    return folder


def write_bag(
    folder: Path,
    messages: Iterable[Encoded],
    storage: StoragePlugin,
    compression: CompressionMode = CompressionMode.NONE,
) -> Path:
    """Write a bag with the writer of `rosbags`."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    writer = Writer(folder, version=9, storage_plugin=storage)
    if compression != CompressionMode.NONE:
        writer.set_compression(compression, CompressionFormat.ZSTD)
    with writer:
        connections = {
            topic: writer.add_connection(topic, name, msgdef=text, rihs01="RIHS01_" + 64 * "0")
            for topic, (name, text) in TYPES.items()
        }
        for topic, time, data in messages:
            writer.write(connections[topic], time, data)
    return folder
