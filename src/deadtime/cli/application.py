"""The application that the commands register with, and its entry point."""

from __future__ import annotations

import atexit
import contextlib
import functools
import logging
import os
import re
import shlex
import sys
import traceback
from collections.abc import Sequence
from contextvars import ContextVar
from io import TextIOWrapper
from itertools import islice
from typing import NoReturn

from cyclopts import (
    App,
    CycloptsError,
    Group,
    MissingArgumentError,
    Parameter,
    UnusedCliTokensError,
)

from deadtime.base import notices
from deadtime.base.errors import DeadtimeError
from deadtime.base.interrupts import INTERRUPTED, raising_on_interrupt
from deadtime.base.threads import at_work
from deadtime.base.version import __version__

START = Group.create_ordered("Start")
JUDGE = Group.create_ordered("Judge one loop")
COMPARE = Group.create_ordered("Compare laws on many signals")
BUILD = Group.create_ordered("Build a controller")
FILES = Group.create_ordered("Files and shell")
_OPTIONS = Group.create_ordered("Options")


def lines(*commands: str, title: str = "Examples") -> str:
    """Commands for the end of a help page, each on a line of its own, to be copied.

    Examples
    --------
    >>> lines("deadtime init", "deadtime simulate problem.toml")
    '**Examples**\\n\\n`deadtime init`  \\n`deadtime simulate problem.toml`'
    """
    return f"**{title}**\n\n" + "  \n".join(f"`{command}`" for command in commands)


app = App(
    name="deadtime",
    help="Predictor feedback for switched linear plants with a long input delay.\n\n"
    "`deadtime COMMAND --help` ends with examples; every command takes `--json`.",
    help_epilogue=lines(
        "deadtime init problem.toml       # a commented file: change its numbers to yours",
        "deadtime simulate problem.toml   # a verdict, metrics and a figure",
        "deadtime certify problem.toml    # stable for every signal? a proof, or a counterexample",
        "deadtime app                     # the same with sliders, in a browser",
        title="Start here",
    )
    + "\n\nExit codes: 0 done, 1 the answer is no, 2 the request is wrong, 70 a bug, "
    "130 interrupted.",
    version=__version__,
    group_commands=_OPTIONS,
    default_parameter=Parameter(negative_iterable=()),
    suppress_keyboard_interrupt=False,  # `main` says that the command was interrupted
)

_ARGUMENT = r'\b\w+=(?:\([^()]*\)|\[[^\]]*\]|"[^"]*"|\w*)'  # of Python, such as modes=2

_tokens: ContextVar[tuple[str, ...]] = ContextVar("tokens", default=())


def command_line() -> str:
    """The running command, quoted for a shell, for the reports that it writes."""
    return shlex.join(("deadtime", *_tokens.get()))


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the command line and exit with the command's code; an error is printed as one line."""
    _repair_environment()
    from deadtime.cli.console import Terminal

    # Before NumPy is loaded: a second BLAS thread costs more than it saves on small matrices.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    notices.compiling = _say_compiling
    tokens = as_command(sys.argv[1:] if arguments is None else list(arguments))
    _tokens.set(tuple(tokens))
    for stream in (sys.stdout, sys.stderr):
        # Where the encoding lacks • or ∞, a question mark is better than no result.
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="replace")
    try:
        with raising_on_interrupt():
            code = app(
                tokens,
                console=Terminal(),
                exit_on_error=False,
                print_error=False,
                result_action="return_value",
            )
            sys.stdout.flush()
    except (DeadtimeError, CycloptsError) as error:
        _stop(2, f"error: {_one_line(error)}{_where_to_look(error)}")
    except KeyboardInterrupt:
        _stop(INTERRUPTED, "interrupted")
    except BrokenPipeError:  # the reader, such as `head`, has closed the pipe
        _abandon_stdout()
        _stop(141, "")
    except OSError as error:
        _abandon_stdout()
        place = "" if error.filename is None else f"{error.filename}: "
        _stop(2, f"error: {place}{error.strerror or _one_line(error)}")
    except MemoryError as error:
        _stop(
            2, f"error: out of memory ({_one_line(error) or 'no details'}): ask for less at once."
        )
    except Exception as error:
        _stop(70, _unexpected(error))
    raise SystemExit(code if isinstance(code, int) else 0)


def _repair_environment() -> None:
    """Reopen closed streams and drop window sizes of 0, which libraries do not expect."""
    # Of a stream closed by `>&-` the next file that is opened would get the descriptor.
    for name in ("stdin", "stdout", "stderr"):
        if getattr(sys, name) is None:
            stream = os.fdopen(os.open(os.devnull, os.O_RDWR), "r" if name == "stdin" else "w")
            setattr(sys, name, stream)
            setattr(sys, f"__{name}__", stream)
    # Without a writable home Matplotlib warns of its font cache.
    logging.getLogger("matplotlib").setLevel(logging.ERROR)
    for name in ("COLUMNS", "LINES"):  # 0 means unknown
        if not os.environ.get(name, "").strip("0"):
            os.environ.pop(name, None)


@functools.cache
def _say_compiling() -> None:
    """Print once, on a terminal, that code is being compiled."""
    if sys.stderr.isatty():
        print("deadtime: compiling, once per machine …", file=sys.stderr, flush=True)


def as_command(tokens: list[str]) -> list[str]:
    """Translate `help COMMAND` and `--install-completion`, which other tools have."""
    if tokens[:1] == ["help"]:
        return [*tokens[1:], "--help"]
    if tokens[:1] == ["--install-completion"]:
        return ["completion", *tokens[1:], "--install"]
    return tokens


def with_options(text: str) -> str:
    """A message of the library with options alone, without the Python arguments beside them.

    Examples
    --------
    >>> with_options("Widen delay=(low, high), --delay LOW HIGH; or say modes=None (--one-mode).")
    'Widen --delay LOW HIGH; or say --one-mode.'
    """
    text = re.sub(rf"{_ARGUMENT}(?: or {_ARGUMENT})*, (?=--)", "", text)
    return re.sub(rf"{_ARGUMENT} \((--[^()]*)\)", r"\1", text)


def _one_line(error: BaseException) -> str:
    if isinstance(error, UnusedCliTokensError) and error.unused_tokens:
        return f"unexpected argument {error.unused_tokens[0]!r}."
    return with_options(" ".join(str(error).split()))


def _unexpected(error: Exception) -> str:
    """One line on a bug: the exception, and a request to report it."""
    if os.environ.get("DEADTIME_DEBUG"):
        traceback.print_exception(error)
    return (
        f"internal error: {type(error).__name__}: {_one_line(error):.300}: this is a bug in "
        "deadtime, please report it with the command and its files; DEADTIME_DEBUG=1 shows where."
    )


def _where_to_look(error: BaseException) -> str:
    if not isinstance(error, CycloptsError):
        return ""
    chain = error.command_chain or ()
    command = " ".join(("deadtime", *chain, "--help"))
    return f"{_example_of(error, chain)} See {command}."


def _example_of(error: CycloptsError, chain: Sequence[str]) -> str:
    """An example of a missing option from the command's help; empty if it has none."""
    if not isinstance(error, MissingArgumentError) or error.argument is None or not chain:
        return ""
    examples = str(app[chain[0]].help_epilogue).split("`")
    fitting = (text for text in examples if f" {error.argument.name} " in text)
    return "".join(f" Such as: {text}." for text in islice(fitting, 1))


def _stop(code: int, message: str) -> NoReturn:
    if message:
        print(f"deadtime: {message}", file=sys.stderr)
    if at_work():
        atexit.register(_leave, code)
    raise SystemExit(code) from None


def _leave(code: int) -> None:
    """Exit without Python's shutdown while threads still run compiled code."""
    if not at_work():
        return
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):  # full or closed
            stream.flush()
    os._exit(code)


def _abandon_stdout() -> None:
    """Discard further output where the pipe is closed or the disk is full.

    Python flushes stdout again at exit and would report a second error.
    """
    if sys.stdout is sys.__stdout__:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)
