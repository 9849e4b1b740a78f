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
from deadtime.base.wording import number_of
from deadtime.certificates.proof import Check, Evidence, StretchEvidence, save_evidence
from deadtime.certificates.proof.box import Box
from deadtime.certificates.proof.evidence import Setting
from deadtime.certificates.proof.stretches import decay_rate
from deadtime.switching import SignalClass


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
    r"""Whether a digital loop is stable for every admissible signal (immutable).

    Attributes
    ----------
    stable : bool or None
        True: it is; False: `witness` is an admissible signal under which it is not; None: neither
        was found, `message` says why.
    decay_rate : float or None
        1/s: every solution is below :math:`C e^{-\alpha t}` with this :math:`\alpha`; None unless
        stable.
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
    limit : int
        With which `verify` proves it: how many times the work that is usual for so many numbers.
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
        pace = f"decays at least like exp(−{round_down(rate)} t)" if rate else "decays"
        message = f"Stable for every admissible signal{_also(evidence)}, proved: the loop {pace}."
        words = statement(evidence, checked.cells)
        return cls(True, message, rate, True, words, None, evidence, checked.limit)

    def lyapunov(
        self, mode: int = 0, age: int = 0, lost: int = 0
    ) -> Float[np.ndarray, "order order"]:
        r"""The matrix of the Lyapunov function of a mode and an age.

        :math:`P` of :math:`V = \xi^T P \xi` with :math:`\xi = (x_k, w_k, u_{k-1}, \dots, u_{k-W})`.

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
    plants = evidence.setting.plants
    return delays + ("" if plants.known else f" and every plant in the {plants.kind}")


def round_down(rate: float, digits: int = 4) -> str:
    """A positive rate with so many significant digits, never more than it is."""
    unit = 10.0 ** (math.floor(math.log10(rate)) - digits + 1)
    return f"{math.floor(rate / unit) * unit:.{digits}g}"


def is_box(setting: Setting) -> bool:
    """Whether every delay has a range of its own."""
    return isinstance(setting.delays, np.ndarray) and setting.delays.ndim == 3


def delays_in_words(setting: Setting) -> str:
    """The plant's delay, or delays."""
    if is_box(setting):
        low, high = np.array(setting.delays).tolist()
        return (
            f"s any constant values from {low} s to {high} s (a list per mode, "
            "with a value per input), each in its range whatever the others are"
        )
    if isinstance(setting.delays, np.ndarray):
        return f"s {setting.delays.tolist()} s (a list per mode, with a value per input)"
    low, high = setting.delays
    return f" {low!r} s" if low == high else f" any constant value in [{low!r}, {high!r}] s"


def pace_of(evidence: Evidence | StretchEvidence) -> str:
    """How a loop is proved to decay, as the end of a sentence."""
    rate = decay_rate(evidence)
    return f" decays at least like exp(−{round_down(rate, 6)} t)" if rate else " decays to zero"


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
        f"Loop: {which} of {sizes}, input delay{delays_in_words(setting)}, with a law of "
        f"{number_of(len(setting.G), 'row')}; period {setting.step!r} s.",
        not_covered(setting.signals),
    )


def statement(evidence: Evidence | StretchEvidence, cells: int) -> tuple[str, ...]:
    """Sentences: what holds, for which numbers, and how it was shown."""
    setting, rho = evidence.setting, evidence.rho
    signals, words = setting.signals, setting.signals.sentence(setting.modes)
    which, _ = setting.plants.in_words
    ends = any(map(math.isfinite, setting.limits.maximum_dwell))
    alike = ""
    if isinstance(setting.delays, np.ndarray) and not is_box(setting):
        alike = ", and parts of a period beyond one that differ by less count as the least of them"
    rate = decay_rate(evidence)
    falls = f"to at most {rho**2!r} of its value" if rate else "strictly"
    when, parts = "over a period", ""  # what else was checked but inequalities in balls
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
        memory = ", memory of the law"
        kept = (
            f" It remembers {number_of(setting.memory, 'number')} besides its inputs (an estimate, "
            "and sums of errors), whose rows are products of what it computes with, rounded; what "
            "decays is these, too, where the reference is 0, no constant disturbance acts, and "
            f"{_measured(setting)}."
        )
    elif signals.lost_samples:
        kept = f" What decays does so where {_measured(setting)}."
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
        f"Period {setting.step!r} s; input delay{delays_in_words(setting)}. A ratio of a delay to "
        f"the period within 1e-9 of an integer counts as that integer{alike}, as in the loop that "
        "runs.",
        f"The law is its table: the stored binary64 numbers, exactly: {rows}{late}."
        f"{kept} "
        "Plant entries, delay and period are all reals within half a unit in the last place of the "
        "stored ones: the decimals that were written and the binary64 numbers alike. By the "
        "controller's clock a sojourn may be shorter than the dwell time"
        f"{' or longer than the maximum' * ends} by a relative "
        f"{signals.clock_tolerance!r}. Arithmetic of the running loop is taken as exact.",
        how,
    )


def _measured(setting: Setting) -> str:
    """Which samples a law has, at the least."""
    lost = setting.signals.lost_samples
    if not lost:
        return "every sample is measured"
    return (
        f"at most {number_of(lost, 'sample')} in a row "
        f"{'is' if lost == 1 else 'are'} lost, whichever, by the table's rows of a "
        "lost sample and with the mode that was reported last"
    )
