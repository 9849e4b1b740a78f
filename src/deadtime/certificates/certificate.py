"""A certificate: whether a loop is stable for every admissible signal, and why, in words.

The sentences are made from the numbers that were checked and from nothing else.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from deadtime.base.checks import count, index
from deadtime.base.errors import ArgumentError
from deadtime.base.wording import number_of, rounded
from deadtime.certificates.proof import Check, Evidence, StretchEvidence, save_evidence
from deadtime.certificates.proof.evidence import Setting
from deadtime.certificates.proof.stretches import decay_rate
from deadtime.switching import SignalClass


def require_json(name: str, path: str | Path) -> Path:
    """A path for a certificate; an ArgumentError if its suffix is another than .json.

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
    r"""Whether a digital loop is stable for every admissible signal (immutable).

    Attributes
    ----------
    stable : bool or None
        True: stable; False: `witness` is an admissible signal under which the loop grows; None:
        neither was found, and `message` says why.
    decay_rate : float or None
        1/s: every solution is below :math:`C e^{-\alpha t}` with this :math:`\alpha`; None unless
        stable.
    proven : bool
        Whether ball arithmetic and a rigorous factorisation have verified every inequality, the
        decay rate included.
    message : str
        One or two plain sentences.
    statement : tuple of str
        The theorem that is proved, and its numbers; empty unless stable.
    witness : WorstCase or None
        The worst signal found, when not stable.
    evidence : Evidence or StretchEvidence or None
        The numbers of the proof, when stable.
    limit : int
        The limit that `verify` needs, as a multiple of the usual work for a file of this size.
    """

    stable: bool | None
    message: str
    decay_rate: float | None = None
    proven: bool = False
    statement: tuple[str, ...] = ()
    witness: Any = None
    evidence: Evidence | StretchEvidence | None = None
    limit: int = 1

    @classmethod
    def of(cls, evidence: Evidence | StretchEvidence, checked: Check) -> Certificate:
        """A certificate of stability from evidence that passed the check."""
        rate = decay_rate(evidence)
        pace = f"decays at least like exp(−{rounded(rate, 4)} t)" if rate else "decays"
        setting, plants = evidence.setting, evidence.setting.plants
        sets = setting.delays.claim if setting.family.ranges else ""
        sets += "" if plants.known else f" and every plant in the {plants.kind}"
        message = f"Stable for every admissible switching signal{sets}, proved: the loop {pace}."
        sentences = statement(evidence, checked.cells)
        return cls(True, message, rate, True, sentences, None, evidence, checked.limit)

    def lyapunov(
        self, mode: int = 0, age: int = 0, lost: int = 0
    ) -> Float[np.ndarray, "order order"]:
        r"""The matrix of the Lyapunov function of a mode and an age.

        :math:`P` of :math:`V = \xi^T P \xi` with :math:`\xi = (x_k, w_k, u_{k-1}, \dots, u_{k-W})`.

        w is the controller's own state, (x̄, s) of `feedback.recurrence`; empty for a law of the
        plant's state.

        Parameters
        ----------
        mode : int
            The mode seen at the sample.
        age : int
            How many samples the mode has been seen before this one.
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
        mode = index("mode", mode, evidence.setting.modes)
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
                "for every admissible switching signal has one."
            )
        return save_evidence(self.evidence, require_json("path", path).with_suffix(".json"))

    def __repr__(self) -> str:
        proof = ", proven" if self.proven else ""
        return f"Certificate(stable={self.stable}{proof}: {self.message})"


def pace_of(evidence: Evidence | StretchEvidence) -> str:
    """How a loop is proved to decay, as the end of a sentence."""
    rate = decay_rate(evidence)
    return f" decays at least like exp(−{rounded(rate, 6)} t)" if rate else " decays to zero"


def not_covered(signals: SignalClass) -> str:
    """A sentence on what no certificate for these signals includes."""
    return (
        "Not covered: limits of the inputs (saturation, rates), constant forces (offsets)"
        f"{' and noise' if signals.lost_samples else ', noise and lost samples'}."
    )


def plain_statement(evidence: Evidence | StretchEvidence) -> tuple[str, ...]:
    """A line each on what is proved, of which loop, and what is left out."""
    setting = evidence.setting
    modes, n, m = setting.plants.sizes
    words = setting.signals.sentence(setting.modes)
    anywhere = ", switching at any instant" * (setting.signals.at == "anywhere")
    which, _ = setting.plants.in_words
    sizes = ", ".join((number_of(modes, "mode"), number_of(n, "state"), number_of(m, "input")))
    return (
        f"Valid: the loop{pace_of(evidence)}, {words}{anywhere}.",
        f"Loop: {which} of {sizes}, input delay{setting.delays.stated}, under a law with "
        f"{number_of(len(setting.G), 'set')} of coefficients; period {setting.step!r} s.",
        not_covered(setting.signals),
    )


def statement(evidence: Evidence | StretchEvidence, cells: int) -> tuple[str, ...]:
    """Sentences: the theorem, the numbers it is about, and the kind of proof."""
    setting, rho = evidence.setting, evidence.rho
    signals, words = setting.signals, setting.signals.sentence(setting.modes)
    # A sentence is put together from parts that are empty where they do not apply.
    which, _ = setting.plants.in_words
    ends = any(map(math.isfinite, setting.limits.maximum_dwell))
    alike = ""
    if setting.delays.ends.ndim == 2:
        alike = "; delays whose remainders differ by less arrive at one instant"
    rate = decay_rate(evidence)
    falls = f"to at most {rho**2!r} of its value" if rate else "strictly"
    when, parts = "over a period", ""  # `parts`: checks besides the inequalities in balls
    if isinstance(evidence, Evidence):
        kind = f"{'' if evidence.S.size else 'common '}Lyapunov function"
        kind += " of mode and age" if evidence.S.size else ""
        parts = "one factorisation with a rigorous error bound, and "
    elif setting.transitions.bucket is not None:
        kind = "Lyapunov function of the mode, which may rise at a switch"
        when = "over any number of periods"
        falls = f"per period {falls}" if rate else falls
        falls += f", but for one factor of at most {evidence.mu!r} to the power {signals.chatter}"
    else:
        kind = "Lyapunov function of mode and age, followed along whole stretches of periods"
        ages = ", ".join(map(str, evidence.knots))
        when = f"from one node (a mode at one of the ages {ages}) to the next"
        falls = f"per period {falls}" if rate else falls
    pace = pace_of(evidence)
    rows = {
        "none": "one row, independent of the mode",
        "mode": "a row for each sampled mode",
        "mode_age": f"a row for each sampled mode and its age in samples, {setting.ages} ages",
    }[setting.context]
    late = ""
    if signals.mode_lag:
        late = f"; the mode is reported {number_of(signals.mode_lag, 'period')} late"
    kept = memory = ""
    if setting.memory:
        memory = ", state of the law"
        kept = (
            f" Its state has {number_of(setting.memory, 'number')} besides the past inputs (an "
            "estimate, and sums of errors); their rows are products of its matrices, rounded. The "
            "decay includes these numbers, where the reference is 0, no constant disturbance acts, "
            f"and {_measured(setting)}."
        )
    elif signals.lost_samples:
        kept = f" The decay holds where {_measured(setting)}."
    anywhere = signals.at == "anywhere"
    cover = " that cover every instant of a switch within a period" * anywhere
    how = (
        f"Proved by machine: a {kind}, of order {setting.order}, {parts}{cells} inequalities in "
        f"ball arithmetic of 128 bits{cover}: {when} the Lyapunov function falls {falls}."
    )
    return (
        f"{words[0].upper()}{words[1:]},{' switching at any instant,' * anywhere} and for every "
        f"initial state{memory} and past input, the digital loop of {which} with this "
        f"table{pace}. {not_covered(signals)}",
        f"Period {setting.step!r} s; input delay{setting.delays.stated}. A delay within 1e-9 "
        f"periods of a whole number of periods is taken as that number{alike}. The running loop "
        "does the same.",
        f"The law is its table: the stored binary64 numbers, exactly: {rows}{late}."
        f"{kept} "
        "Plant entries, delay and period are any reals within half a unit in the last place of the "
        "stored ones, so both the decimals written and the binary64 numbers are covered. By the "
        "controller's clock a sojourn may be shorter than the dwell time"
        f"{' or longer than the maximum' * ends} by a relative "
        f"{signals.clock_tolerance!r}. Arithmetic of the running loop is taken as exact.",
        how,
    )


def _measured(setting: Setting) -> str:
    """The condition on the measured samples."""
    lost = setting.signals.lost_samples
    if not lost:
        return "every sample is measured"
    return (
        f"at most {number_of(lost, 'sample')} in a row "
        f"{'is' if lost == 1 else 'are'} lost, and the law then uses the table's "
        "rows for a lost sample, with the mode reported last"
    )
