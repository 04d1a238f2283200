"""MCAP logs of transitions: the message schema, the writer, the reader and the recovery of damaged files."""

from addressed_dynamics.logs.bulk import write_log
from addressed_dynamics.logs.contents import EpisodeRecord, LogContents, RunInfo
from addressed_dynamics.logs.reader import read_blocks, read_episodes, read_log
from addressed_dynamics.logs.recovery import Gap, Loss, RecoveryReport, recover_log
from addressed_dynamics.logs.writer import TransitionLogWriter

__all__ = [
    "EpisodeRecord",
    "Gap",
    "LogContents",
    "Loss",
    "RecoveryReport",
    "RunInfo",
    "TransitionLogWriter",
    "read_blocks",
    "read_episodes",
    "read_log",
    "recover_log",
    "write_log",
]
