"""Bring your own logs: MCAP files, CSV and Parquet tables, LeRobot and Minari datasets become logs of transitions."""

from addressed_dynamics.importing.importer import import_logs

__all__ = ["import_logs"]
