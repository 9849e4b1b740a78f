"""Runs mutants in a process of its own, which may run out of time, memory or patience."""

from __future__ import annotations

import multiprocessing
import os
import resource
import signal
import tempfile
import time
import traceback
import warnings
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from typing import Any

import deadtime
from deadtime.base.errors import DeadtimeError

SECONDS = 5  # of CPU, that reading a file may take
BYTES = 8 * 2**30  # of addresses; most of them are never used
LONGEST = 10_000  # characters of a message


@dataclass
class Found:
    """What came of mutants: how many were read and refused, and the faults by their place."""

    read: int = 0
    refused: int = 0
    faults: Counter[str] = field(default_factory=Counter)
    first: dict[str, int] = field(default_factory=dict)

    @property
    def count(self) -> int:
        """How many there were."""
        return self.read + self.refused + self.faults.total()

    def add(self, number: int, outcome: str) -> None:
        """Count one; an outcome is "read", "refused", or a fault."""
        if outcome in ("read", "refused"):
            setattr(self, outcome, getattr(self, outcome) + 1)
            return
        self.faults[outcome] += 1
        self.first.setdefault(outcome, number)


def fuzz(kind: str, count: int, seed: int = 0, seconds: float = 1e9, first: int = 0) -> Found:
    """Read so many mutants of a kind, or as many as the seconds allow.

    Every one is made from the seed and its number alone: `first` and a count of 1 make one again.
    """
    from fuzzing.targets import TARGETS

    found, number = Found(), first
    context = multiprocessing.get_context("fork")
    with tempfile.TemporaryDirectory() as folder:
        TARGETS[kind](Path(folder)).read_seeds()  # imported and compiled once, before the fork
        end = time.monotonic() + seconds
        while number < first + count and time.monotonic() < end:
            now = context.Value("q", number)
            mine, theirs = context.Pipe(duplex=False)
            arguments = (kind, Path(folder), seed, range(number, first + count), end, now, theirs)
            process = context.Process(target=_work, args=arguments)
            process.start()
            theirs.close()
            _listen(mine, found)
            process.join()
            number = now.value + 1
            if process.exitcode:
                name = signal.Signals(-process.exitcode).name if process.exitcode < 0 else "exit"
                late = name == "SIGXCPU"
                found.add(now.value, f"more than {SECONDS} s" if late else f"killed by {name}")
    return found


def _listen(pipe: Any, found: Found) -> None:
    """Count what the process says until it has nothing more to say."""
    while True:
        try:
            number, outcome = pipe.recv()
        except EOFError:
            return
        found.add(number, outcome)


def _work(
    kind: str, folder: Path, seed: int, numbers: range, end: float, now: Any, pipe: Any
) -> None:
    """Read mutants; the system ends this process where one takes too long."""
    from fuzzing.targets import TARGETS

    target = TARGETS[kind](folder)
    resource.setrlimit(resource.RLIMIT_AS, (BYTES, BYTES))
    warnings.simplefilter("error")  # nothing but one line may reach the terminal
    for number in numbers:
        now.value = number
        if time.monotonic() > end:
            break
        target.write(Random(f"{kind} {seed} {number}"))
        used = resource.getrusage(resource.RUSAGE_SELF)
        spent = int(used.ru_utime + used.ru_stime)
        resource.setrlimit(resource.RLIMIT_CPU, (spent + SECONDS + 1, resource.RLIM_INFINITY))
        pipe.send((number, _outcome(target)))


def _outcome(target: Any) -> str:
    try:
        target.read()
    except DeadtimeError as error:
        text = str(error)
        if "\n" in text or len(text) > LONGEST:
            return f"{type(error).__name__} of {len(text)} characters in several lines"
        return "refused"
    except BaseException as error:
        return _where(error)
    return "read"


def _where(error: BaseException) -> str:
    """An error that nobody meant to raise, by its kind and the last line of the package."""
    package = str(Path(deadtime.__file__).parent) + os.sep
    frames = traceback.extract_tb(error.__traceback__)
    inside = [frame for frame in frames if frame.filename.startswith(package)]
    last = inside[-1] if inside else frames[-1]
    place = f"{last.filename.removeprefix(package)}:{last.lineno}"
    return f"{type(error).__name__} at {place}: {str(error)[:100]!a}"
