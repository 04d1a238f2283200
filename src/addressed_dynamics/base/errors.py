"""The exception tree: everything this package raises on purpose is an `AddressedDynamicsError`.

A message is one line and says what was expected, what was found, where, and what to do.
"""


class AddressedDynamicsError(Exception):
    """Base of all errors raised on purpose; catch it to handle any of them."""


class ParamsError(AddressedDynamicsError):
    """A params file is missing, is not YAML, or has an unknown key, a missing key or a wrong type."""


class SpaceError(AddressedDynamicsError):
    """An environment has an observation or action space that cannot be recorded or modelled."""


class TransitionsError(AddressedDynamicsError):
    """Transitions or samples break their contract: a wrong shape, a value that is not finite, a broken episode."""


class LogError(AddressedDynamicsError):
    """An MCAP log cannot be written, or what is read from it is damaged or is not a log of transitions."""


class TableError(AddressedDynamicsError):
    """A Parquet table is missing, damaged, of another version, or holds values that must not be there."""


class MotionError(AddressedDynamicsError):
    """Motion capture cannot be read: a file is missing or damaged, or holds another skeleton or another layout."""


class RecordingError(AddressedDynamicsError):
    """A recording plan cannot be carried out."""


class ModelError(AddressedDynamicsError):
    """A model folder is incomplete or damaged, or a model is given inputs of the wrong shape."""


class TrainingError(AddressedDynamicsError):
    """Training cannot start or go on: no samples, a loss that is not finite, a checkpoint that does not fit."""


class PlanningError(AddressedDynamicsError):
    """A plan cannot be made: settings that no planner has, a cost that is no number, or a state of another shape."""


class EvaluationError(AddressedDynamicsError):
    """A model cannot be evaluated on the data it was given."""


class ReportError(AddressedDynamicsError):
    """The report cannot be written from the results that are there."""


class ClusterError(AddressedDynamicsError):
    """Ray cannot be used, or lost what it was given to do."""


class DeviceError(AddressedDynamicsError):
    """A GPU is asked for that is not there."""


class TrackingError(AddressedDynamicsError):
    """The tracking store cannot be opened by a command that needs it (a stage only warns)."""


class DriveError(AddressedDynamicsError):
    """A model cannot be driven, or a message asks for what its world has not."""
