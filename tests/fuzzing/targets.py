"""What is fuzzed: files of each kind, and the functions that read them."""

from __future__ import annotations

import json
import tomllib
from abc import ABC, abstractmethod
from pathlib import Path
from random import Random
from typing import Any

import certificate_forgeries as forgeries
import deadtime as dt
from certificate_corpus import CORPUS
from deadtime.problems.file import load_problem
from deadtime.scenarios.sweeps import load_study
from deadtime.scenarios.sweeps.run_sweep import prepare, run_block
from fuzzing import mutators, seeds
from second_verifier import both, second_verifier

WORDS = tuple(
    sorted({
        word
        for text in (*seeds.PROBLEMS, *seeds.STUDIES)
        for word in mutators.re.findall(r'"([a-z][\w-]+)"', text)
    })
)  # fmt: skip
DISTRIBUTIONS = (
    *("expon", "gamma", "uniform", "norm", "cauchy", "poisson", "rv_histogram", "weibull_min"),
    *("studentized_range", "levy_stable", "randint", "multivariate_normal"),
)


class Target(ABC):
    """A kind of file: changed copies of it, and what reads them."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    @abstractmethod
    def write(self, rng: Random) -> None:
        """Write a mutant into the folder."""

    @abstractmethod
    def read(self) -> Any:
        """Read it: an error of the package, or none."""

    @abstractmethod
    def read_seeds(self) -> None:
        """Read what mutants are made of: it has no faults, and compiles what there is to."""


class Toml(Target):
    """A file of settings: half of its mutants are changed texts, half changed trees."""

    texts: tuple[str, ...]
    name = "mutant.toml"

    def read_seeds(self) -> None:
        for text in self.texts:
            (self.folder / self.name).write_text(text, encoding="utf-8")
            self.read()

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.trees = [tomllib.loads(text) for text in self.texts]
        (folder / "plain.toml").write_text(seeds.AT_REST, encoding="utf-8")
        (folder / "log.csv").write_text(seeds.LOGS[3], encoding="utf-8")

    def write(self, rng: Random) -> None:
        if rng.random() < 0.5:
            text, other = (rng.choice(self.texts).encode() for _ in range(2))
            content = mutators.of_bytes(rng, text, other)
        else:
            tree, other = rng.choice(self.trees), rng.choice(self.trees)
            words = (*WORDS, *DISTRIBUTIONS)
            content = mutators.toml(mutators.of_tree(rng, tree, other, words)).encode()
        (self.folder / self.name).write_bytes(content)


class Problem(Toml):
    texts = seeds.PROBLEMS

    def read(self) -> Any:
        return load_problem(self.folder / self.name)


class Study(Toml):
    texts = seeds.STUDIES

    def read(self) -> Any:
        return load_study(self.folder / self.name)


class Log(Target):
    def write(self, rng: Random) -> None:
        text, other = (rng.choice(seeds.LOGS).encode() for _ in range(2))
        content = mutators.of_bytes(rng, text, other)
        (self.folder / "mutant.csv").write_bytes(content)
        self.options = rng.choice(
            ({}, {"modes": 2}, {"labels": {"idle": 0, "busy": 1}}, {"end": 100.0}, {"unit": "ms"})
        )

    def read_seeds(self) -> None:
        self.options: dict[str, Any] = {}
        for text in seeds.LOGS[:3]:
            (self.folder / "mutant.csv").write_text(text, encoding="utf-8")
            self.read()

    def read(self) -> Any:
        return dt.SwitchingSignal.from_csv(self.folder / "mutant.csv", **self.options)


class Certificate(Target):
    """Most mutants carry a digest that fits: the others are refused for it.

    Both verifiers read them, and have to agree, but where one needs hints and the other none.
    """

    names = ("rate", "single", "mean", "range-narrow", "expected", "delayed", "alike",
             "stretches-off-grid", "stretches-range", "maximum-free", "average-free",
             "lost-one-mode", "lost-tracking", "late-mode", "ways", "ways-ring", "observed-late",
             "delays-short", "polytope-mode", "stretches-late")  # fmt: skip

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        paths = [CORPUS / f"{name}.json" for name in self.names]
        self.texts = [path.read_bytes() for path in paths]
        self.trees = [json.loads(text) for text in self.texts]
        self.verifier = second_verifier()

    def write(self, rng: Random) -> None:
        if rng.random() < 0.2:
            content = mutators.of_bytes(rng, rng.choice(self.texts), rng.choice(self.texts))
        else:
            tree = mutators.of_tree(rng, rng.choice(self.trees), rng.choice(self.trees))
            tree = tree if isinstance(tree, dict) else {"": tree}
            try:
                content = forgeries.signed(tree).encode("utf-8", "surrogatepass")
            except TypeError:  # of keys that cannot be sorted
                content = json.dumps(tree).encode()
        (self.folder / "mutant.json").write_bytes(content)

    def read_seeds(self) -> None:
        for text in self.texts:
            (self.folder / "mutant.json").write_bytes(text)
            assert self.read().proven

    def read(self) -> Any:
        path = self.folder / "mutant.json"
        (first, message), (second, verdict) = both(self.verifier, path)
        alike = first == second or (second and b"linear" in path.read_bytes())
        assert alike, f"{verdict[:40]}, though: {message[:40]}"
        return dt.verify(path)


class Store(Target):
    """The files of a small sweep's store: what describes it, and its chunks."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.place = folder / "whole.zarr"
        if not self.place.exists():
            (folder / "plain.toml").write_text(seeds.AT_REST, encoding="utf-8")
            path = folder / "study.toml"
            path.write_text(seeds.STUDIES[0], encoding="utf-8")
            study = load_study(path)
            target = prepare(study, str(self.place))
            for number in target.missing():
                run_block(study, target.url, target.key, number)
        self.files = sorted(path for path in self.place.rglob("*") if path.is_file())
        self.described = [path for path in self.files if path.name == "zarr.json"]
        self.contents = {path: path.read_bytes() for path in self.files}
        self.changed: list[Path] = []

    def write(self, rng: Random) -> None:
        for path in self.changed:
            path.write_bytes(self.contents[path])
        pool = [self.place / "zarr.json"] if rng.random() < 0.7 else self.files
        path, other = rng.choice(pool), self.contents[rng.choice(self.described)]
        whole = self.contents[path]
        if path.name != "zarr.json" or rng.random() < 0.3:
            content = mutators.of_bytes(rng, whole, other)
        else:
            content = _described(rng, whole, other)
        self.changed = [path]
        path.write_bytes(content)

    def read_seeds(self) -> None:
        self.read()

    def read(self) -> Any:
        import dask

        with dask.config.set(scheduler="synchronous"):
            return dt.open_sweep(self.place).load()


def _described(rng: Random, whole: bytes, other: bytes) -> bytes:
    """A changed description; half of the time what this package writes into it."""
    tree = json.loads(whole)
    attributes = tree.get("attributes", {})
    if "definition" not in attributes or rng.random() < 0.5:
        return json.dumps(mutators.of_tree(rng, tree, json.loads(other))).encode()
    part = rng.choice(("definition", "block", "all"))
    if part == "definition":
        definition = json.loads(attributes["definition"])
        changed = mutators.of_tree(rng, definition, definition)
        attributes["definition"] = json.dumps(changed)
    elif part == "block":
        attributes["block"] = mutators.of_tree(rng, {"": attributes["block"]}, attributes).get("")
    else:
        tree["attributes"] = mutators.of_tree(rng, attributes, attributes)
    return json.dumps(tree).encode()


TARGETS: dict[str, type[Target]] = {
    "problem": Problem,
    "study": Study,
    "log": Log,
    "certificate": Certificate,
    "store": Store,
}
