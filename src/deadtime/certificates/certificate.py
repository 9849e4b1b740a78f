"""Certificate: whether a loop is stable for every admissible signal, and why."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from deadtime.certificates.proof import Evidence, check, load_evidence, save_evidence
from deadtime.certificates.proof.statement import decay_rate, rounded_down, statement
from deadtime.certificates.proof.transitions import interpolation
from deadtime.checks import index
from deadtime.errors import ArgumentError
from deadtime.laws.base import Law
from deadtime.plant import SwitchedSystem


@dataclass(frozen=True, eq=False, repr=False)
class Certificate:
    """Whether a digital loop is stable for every admissible signal (immutable).

    Attributes
    ----------
    stable : bool or None
        True: it is; False: `witness` is an admissible signal under which it is not; None: neither
        was found, `message` says why.
    decay_rate : float or None
        1/s: every solution is below C e^{−decay_rate t}; None unless stable.
    proven : bool
        Whether ball arithmetic and a rigorous factorisation have verified every inequality, the
        decay rate included.
    message : str
        One or two plain sentences.
    statement : tuple of str
        What is proved, and about which numbers; empty unless stable.
    witness : WorstCase or None
        The worst signal found, when not stable.
    evidence : Evidence or None
        The numbers of the proof, when stable.
    """

    stable: bool | None
    message: str
    decay_rate: float | None = None
    proven: bool = False
    statement: tuple[str, ...] = ()
    witness: Any = None
    evidence: Evidence | None = None

    @classmethod
    def of(cls, evidence: Evidence, cells: int) -> Certificate:
        """A certificate of stability from evidence that passed the check."""
        rate = decay_rate(evidence)
        pace = f"decays at least like exp(−{rounded_down(rate)} t)" if rate else "decays"
        message = f"Stable for every admissible signal{_also(evidence)}, proved: the loop {pace}."
        return cls(True, message, rate, True, statement(evidence, cells), None, evidence)

    def lyapunov(self, mode: int = 0, age: int = 0) -> Float[np.ndarray, "order order"]:
        """P_{mode,age} of V = ξᵀ P ξ, ξ = (x_k, u_{k−1}, …, u_{k−W}).

        Parameters
        ----------
        mode : int
            The mode seen at the sample.
        age : int
            How many samples it has been seen for before.

        Raises
        ------
        ArgumentError
            If there is no Lyapunov function.
        """
        evidence = self.evidence
        if evidence is None:
            raise ArgumentError(f"certificate has no Lyapunov function: {self.message}")
        mode = index("mode", mode, evidence.setting.A.shape[1])
        age = min(age, evidence.setting.transitions.last)
        Psi = evidence.centre.Psi
        S = sum(
            float(weight) * evidence.S[mode, knot]
            for knot, weight in interpolation(evidence.knots, age)
        )
        return evidence.P + Psi.T @ S @ Psi

    def save(self, path: str | Path) -> Path:
        """Write a JSON file, and a binary file of the same name beside it, for `verify`.

        Raises
        ------
        ArgumentError
            If there is nothing to save, or the files cannot be written.
        """
        if self.evidence is None:
            raise ArgumentError(
                f"certificate has no proof to save ({self.message}): only a loop that is stable "
                "for every admissible signal has one."
            )
        words = {
            "claim": self.message,
            "statement": self.statement,
            "decay_rate": self.decay_rate,
            "proven_when_written": self.proven,
        }
        return save_evidence(self.evidence, Path(path).with_suffix(".json"), words)[0]

    def __repr__(self) -> str:
        proof = ", proven" if self.proven else ""
        return f"Certificate(stable={self.stable}{proof}: {self.message})"


def _also(evidence: Evidence) -> str:
    """For what else than every signal a certificate holds."""
    low, high = evidence.setting.delays
    delays = f" and every constant delay from {low:.6g} s to {high:.6g} s" if low < high else ""
    return delays + " and every plant in the polytope" * (len(evidence.setting.A) > 1)


@dataclass(frozen=True)
class Verification:
    """What re-verifying a certificate's file found.

    Attributes
    ----------
    proven : bool
        Whether the file's numbers prove its statement.
    message : str
        A plain sentence; which inequality fails, if one does.
    statement : tuple of str
        What is proved, made from the numbers that were checked.
    decay_rate : float or None
        1/s, recomputed from them.
    seconds : float
        How long it took.
    """

    proven: bool
    message: str
    statement: tuple[str, ...]
    decay_rate: float | None
    seconds: float


def verify(
    path: str | Path, plant: SwitchedSystem | None = None, law: Law | None = None
) -> Verification:
    """Re-verify a certificate from its files: no solver, nothing believed but the numbers.

    Parameters
    ----------
    path : path
        The JSON file that `Certificate.save` wrote; its binary file lies beside it.
    plant, law : optional
        If given, the certificate must be about this plant and this law's table, number by number.

    Raises
    ------
    CertificateFileError
        If the files are missing, cut short, altered, or no certificate.
    """
    began = time.perf_counter()
    evidence, _ = load_evidence(Path(path))
    other = _mismatch(evidence, plant, law)
    if other:
        return Verification(False, f"Rejected: {other}", (), None, time.perf_counter() - began)
    outcome = check(evidence)
    seconds = time.perf_counter() - began
    if not outcome.proven:
        message = f"Rejected: {outcome.reason}."
        return Verification(False, message, (), None, seconds)
    sentences = statement(evidence, outcome.cells)
    return Verification(True, f"Proved: {sentences[0]}", sentences, decay_rate(evidence), seconds)


def _mismatch(evidence: Evidence, plant: SwitchedSystem | None, law: Law | None) -> str:
    """How a certificate is about something else than what is asked for, if it is."""
    setting = evidence.setting
    if plant is not None:
        known = [(setting.A[k], setting.B[k]) for k in range(len(setting.A))]
        if not any(np.array_equal(A, plant.A) and np.array_equal(B, plant.B) for A, B in known):
            return "the certificate is about a plant with other matrices."
        low, high = setting.delays
        if not low <= plant.delay <= high:
            return f"the certificate is about a plant with a delay in [{low}, {high}] s."
    if law is not None:
        table = law.digital(setting.step)
        same = np.array_equal(table.state_gain, setting.F) and np.array_equal(
            table.input_gain, setting.G
        )
        kinds = (table.context, table.ages) == (setting.context, setting.ages)
        if not (same and kinds):
            return "the certificate is about another table than that of the given law."
    return ""
