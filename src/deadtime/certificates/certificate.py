"""Certificate: whether a loop is stable for every admissible signal, and why."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from deadtime.base.checks import count, index
from deadtime.base.errors import ArgumentError
from deadtime.certificates.proof import Evidence, StretchEvidence, save_evidence
from deadtime.certificates.proof.box import Box
from deadtime.certificates.proof.statement import decay_rate, round_down, statement


def require_json(name: str, path: str | Path) -> Path:
    """A path for a certificate; an ArgumentError if it asks for another kind of file.

    Examples
    --------
    >>> require_json("path", "proofs/cert").name
    'cert'
    """
    path = Path(path)
    if path.suffix not in ("", ".json"):
        raise ArgumentError(
            f"{name} must end in .json, or have no suffix, got {str(path)!r}: certificates are "
            f"JSON files, such as {str(path.with_suffix('.json'))!r}."
        )
    return path


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
    evidence : Evidence or StretchEvidence or None
        The numbers of the proof, when stable.
    """

    stable: bool | None
    message: str
    decay_rate: float | None = None
    proven: bool = False
    statement: tuple[str, ...] = ()
    witness: Any = None
    evidence: Evidence | StretchEvidence | None = None

    @classmethod
    def of(cls, evidence: Evidence | StretchEvidence, cells: int) -> Certificate:
        """A certificate of stability from evidence that passed the check."""
        rate = decay_rate(evidence)
        pace = f"decays at least like exp(−{round_down(rate)} t)" if rate else "decays"
        message = f"Stable for every admissible signal{_also(evidence)}, proved: the loop {pace}."
        return cls(True, message, rate, True, statement(evidence, cells), None, evidence)

    def lyapunov(
        self, mode: int = 0, age: int = 0, lost: int = 0
    ) -> Float[np.ndarray, "order order"]:
        """P_{mode,age} of V = ξᵀ P ξ, ξ = (x_k, w_k, u_{k−1}, …, u_{k−W}).

        w is what a law remembers of its outputs, (x̄, s) of `feedback.recurrence`; nothing of a law
        of the state.

        Parameters
        ----------
        mode : int
            The mode seen at the sample.
        age : int
            How many samples it has been seen for before.
        lost : int
            How many samples in a row were lost just before this one.

        Raises
        ------
        ArgumentError
            If there is no Lyapunov function.
        """
        evidence = self.evidence
        if evidence is None:
            raise ArgumentError(f"certificate has no Lyapunov function: {self.message}")
        mode = index("mode", mode, evidence.setting.A.shape[1])
        last = evidence.setting.transitions.clocks[mode].last
        most = evidence.setting.signals.lost_samples
        if count("lost", lost, 0) > most:
            raise ArgumentError(f"lost must be at most {most}, the certificate's, got {lost}.")
        return evidence.lyapunov(mode, min(count("age", age, 0), last), lost)

    def save(self, path: str | Path) -> Path:
        """Write the certificate to a JSON file, which `verify` proves again.

        A path without a suffix gets `.json`.

        Raises
        ------
        ArgumentError
            If there is nothing to save, the path ends otherwise, or it cannot be written.
        """
        if self.evidence is None:
            raise ArgumentError(
                f"certificate has no proof to save ({self.message}): only a loop that is stable "
                "for every admissible signal has one."
            )
        return save_evidence(self.evidence, require_json("path", path).with_suffix(".json"))

    def __repr__(self) -> str:
        proof = ", proven" if self.proven else ""
        return f"Certificate(stable={self.stable}{proof}: {self.message})"


def _also(evidence: Evidence | StretchEvidence) -> str:
    """For what else than every signal a certificate holds."""
    delays = ""
    if isinstance(evidence.setting.family, Box):
        delays = " and all constant delays in the given ranges"
    elif evidence.setting.family.ranges:
        low, high = evidence.setting.delays
        delays = f" and every constant delay from {low:.6g} s to {high:.6g} s"
    many = len(evidence.setting.A) > 1, evidence.setting.axes is not None
    kinds = " and every plant in the polytope", " and every plant in the ellipsoid"
    return delays + "".join(kind for kind, there in zip(kinds, many, strict=True) if there)
