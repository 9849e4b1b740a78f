"""The exceptions of the package.

Every error raised on purpose derives from `DeadtimeError` and from the builtin
that a caller would expect. Its message names the argument, says what was
expected and what was given, and what to do about it.
"""


class DeadtimeError(Exception):
    """Base class of every error that deadtime raises on purpose."""

    def __init_subclass__(cls) -> None:
        if cls.__module__ == __name__:
            cls.__module__ = "deadtime"  # as users import it, and tracebacks should name it


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
    """A request that nothing meets: the message gives the solver's verdict."""


class SolverError(DeadtimeError, RuntimeError):
    """A solver is broken or gave up: nothing is known of what was asked for.

    The message says which solver said what, and what to install.
    """


class ChatteringError(DeadtimeError, RuntimeError):
    """A prediction cannot go on: its switches pile up, or it knows no boundary to slide along."""


class WorkerError(DeadtimeError, RuntimeError):
    """A process that computed a part of a study died."""


class StoreError(DeadtimeError, OSError):
    """A sweep's store cannot be read or written; the message names it and what to do."""


class ClusterError(DeadtimeError, RuntimeError):
    """A cluster cannot be reached, has no workers, or runs another version."""
