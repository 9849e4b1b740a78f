"""A reader with a fault of every kind, which the runner must see."""

from __future__ import annotations

import time
from random import Random

import numpy as np

from fuzzing import runner, targets


class Broken(targets.Log):
    def read_seeds(self) -> None:
        pass

    def write(self, rng: Random) -> None:
        self.number = rng.randrange(4)

    def read(self) -> None:
        if self.number == 0:
            raise KeyError("x")
        if self.number == 1:
            np.float64(1e308) * 10.0  # pyright: ignore
        if self.number == 2:
            np.ones(2**45)
        while self.number == 3:
            time.process_time()


def fuzz_broken(count: int, seed: int) -> runner.Found:
    """Read so many of its mutants, a second each at most."""
    targets.TARGETS["broken"] = Broken
    runner.SECONDS = 1
    return runner.fuzz("broken", count, seed)
