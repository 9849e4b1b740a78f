"""The exceptions of the package.

Every error raised on purpose derives from `DeadtimeError` and from the builtin that a caller would
expect. Its message names the argument, the expected and the given value, and a remedy.
"""


class DeadtimeError(Exception):
    """Base class of every error that deadtime raises on purpose."""

    def __init_subclass__(cls) -> None:
        if cls.__module__ == __name__:
            cls.__module__ = "deadtime"  # users import it from there: tracebacks show that name


DeadtimeError.__module__ = "deadtime"


class ArgumentError(DeadtimeError, ValueError):
    """An argument is malformed or asks for something that does not exist."""


class ProblemFileError(ArgumentError):
    """A problem file is malformed; the message names the file, the line and the key."""


class StudyFileError(ArgumentError):
    """A study file is malformed; the message names the file, the line and the key."""


class CertificateFileError(ArgumentError):
    """A certificate's files cannot be read as such; the message names the file and what to do."""


class InfeasibleError(DeadtimeError, ValueError):
    """A request without a solution; the message gives the solver's verdict."""


class SolverError(DeadtimeError, RuntimeError):
    """A solver failed, so nothing is concluded; the message has its status and what to install."""


class ChatteringError(DeadtimeError, RuntimeError):
    """A prediction chatters: its switches accumulate, or no boundary to slide along is known."""


class WorkerError(DeadtimeError, RuntimeError):
    """A process that computed a part of a study died."""


class StoreError(DeadtimeError, OSError):
    """A sweep's store cannot be read or written; the message names it and what to do."""


class ClusterError(DeadtimeError, RuntimeError):
    """A cluster cannot be reached, has no workers, or runs another version."""
