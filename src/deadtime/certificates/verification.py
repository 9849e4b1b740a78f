"""Verification of a certificate's file: the theorem it proves, its loop and its signals."""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Unpack

import numpy as np

from deadtime.base.checks import instance, positive
from deadtime.base.errors import ArgumentError, DeadtimeError
from deadtime.base.wording import number_of
from deadtime.certificates.certificate import plain_statement, statement
from deadtime.certificates.proof import check, load_evidence
from deadtime.certificates.proof.archive import claims_too_much
from deadtime.certificates.proof.evidence import Setting
from deadtime.certificates.proof.stretches import decay_rate
from deadtime.certificates.proof.validate import why_malformed
from deadtime.feedback import Law
from deadtime.feedback.recurrence import recurrence_of, with_lost_rows
from deadtime.plant import SwitchedSystem
from deadtime.plant.plant_set import PlantUncertainty, Polytope
from deadtime.switching import SignalClass
from deadtime.switching.constraint import PerMode, SwitchingConstraint
from deadtime.switching.signal_class import CLOCK_TOLERANCE, SignalOptions

SHOWN = 12  # digits of a digest
FIRST = 4  # numbers of an array


@dataclass(frozen=True)
class Verification:
    """The result of verifying a certificate's file (immutable).

    Attributes
    ----------
    proven : bool
        Whether the file's numbers prove its statement, and it is about what was asked.
    message : str
        A plain sentence; it names the inequality that fails, or the other loop of the file.
    statement : tuple of str
        The theorem, written from the numbers that were checked.
    decay_rate : float or None
        1/s, recomputed from them.
    seconds : float
        How long it took.
    about : tuple of str
        The plant, the table and the signals of the file: first numbers, and digests to compare.
    summary : tuple of str
        A line each on what is proved, of which loop, and what is left out; or the rejection alone.
    """

    proven: bool
    message: str
    statement: tuple[str, ...]
    decay_rate: float | None
    seconds: float
    about: tuple[str, ...] = ()
    summary: tuple[str, ...] = ()


@dataclass(frozen=True)
class ExpectedClaim:
    """Loop and signals that a certificate has to cover (immutable); None, or no entry: any."""

    plant: SwitchedSystem | PlantUncertainty | None = None
    law: Law | None = None
    step: float | None = None
    signals: dict[str, Any] = field(default_factory=dict[str, Any])

    def missing_from(self, setting: Setting) -> str:
        """The first way in which a certificate falls short; empty if it covers the claim."""
        # An option that is not given is the certificate's own.
        own: dict[str, Any] = {**vars(setting.signals), "chatter": 1, "lost_samples": 0}
        times = {"dwell_time", "maximum_dwell", "transitions"} & {*self.signals}
        if times:  # with any limit given, the others are those of `certify` by default
            own |= {"maximum_dwell": None, "transitions": None, "at": "anywhere"}
        if times or "chatter" in self.signals:
            own["clock_tolerance"] = CLOCK_TOLERANCE
        if self.law is not None or "lost_samples" in self.signals:
            own["mode_lag"] = 0  # the mode is reported at once, unless it is said how late
        asked = SignalClass(**(own | self.signals))
        return self._loop(setting, asked) or self._signals(setting, asked)

    def _loop(self, setting: Setting, asked: SignalClass) -> str:
        law, step, signals = self.law, self.step, setting.signals
        other = _other_plant(setting, self.plant)
        if other:
            return f"the certificate is about {other}."
        if step is not None and step != setting.step:
            return (
                f"the certificate is about a period of {setting.step!r} s, not {step!r} s: if the "
                f"loop's is that of the certificate, give a step of {setting.step!r} (--step)."
            )
        reads_mode = setting.context != "none" and setting.modes > 1
        if reads_mode and asked.mode_lag != signals.mode_lag:
            return (
                f"the certificate is about a mode that is reported {signals.mode_lag} periods "
                f"late, not {asked.mode_lag} (mode_lag=, --mode-lag)."
            )
        lost = asked.lost_samples
        if lost > signals.lost_samples and (setting.F.any() or setting.G.any()):
            return (
                f"the certificate is about a loop of which at most {signals.lost_samples} samples "
                f"in a row are lost, not {lost} (lost_samples=, --lost-samples)."
            )
        if law is None:
            return ""
        try:
            table = recurrence_of(law, setting.step)
        except ArgumentError as error:  # the law has a period of its own
            return f"the certificate is about another period than the law's: {error}"
        if table is None:
            return f"the certificate is about a table, and {type(law).__name__} is none."
        table = with_lost_rows(law, table) if signals.lost_samples else table
        kinds = (table.context, table.ages, table.memory)
        kinds = kinds == (setting.context, setting.ages, setting.memory)
        F, G = table.state_gain, table.input_gain
        if not (kinds and np.array_equal(F, setting.F) and np.array_equal(G, setting.G)):
            return "the certificate is about another table than that of the given law."
        return ""

    def _signals(self, setting: Setting, asked: SignalClass) -> str:
        """The signals to cover that the certificate does not; empty if there are none."""
        modes, signals = setting.modes, setting.signals
        if modes == 1:
            return ""
        proved = f"the certificate is {signals.sentence(modes)}"
        beyond = _beyond(asked.limits(modes), setting.limits)
        if beyond:
            return f"{proved}, not {beyond}."
        if asked.at != signals.at == "samples":
            return f"{proved}, not at any instant (at=, --at)."
        if asked.chatter > signals.chatter:
            return f"{proved}, not for a chatter of {asked.chatter}."
        if asked.clock_tolerance > signals.clock_tolerance:
            return (
                "the certificate allows for a clock that is off by "
                f"{signals.clock_tolerance!r}, not by {asked.clock_tolerance!r} (clock_tolerance=)."
            )
        return ""


def _beyond(asked: SwitchingConstraint, proved: SwitchingConstraint) -> str:
    """Signals to cover that are not proved, in words; empty if there are none."""
    several = any(
        len(set(times)) > 1 for times in (proved.dwell_time, asked.dwell_time, proved.maximum_dwell)
    )
    for i in range(proved.modes):
        where = f" in mode {i}" if several else ""
        if asked.dwell_time[i] < proved.dwell_time[i]:
            return f"{asked.dwell_time[i]!r} s{where}"
        longest = asked.maximum_dwell[i]
        if longest > proved.maximum_dwell[i]:
            endless = math.isinf(longest)
            return f"for sojourns of any length{where}" if endless else f"{longest!r} s{where}"
        more = set(asked.following[i]) - set(proved.following[i])
        if more:
            return f"for a switch from mode {i} to mode {min(more)}"
    return ""


def verify(
    path: str | Path,
    plant: SwitchedSystem | PlantUncertainty | None = None,
    law: Law | None = None,
    *,
    step: float | None = None,
    dwell_time: PerMode | SignalClass | None = None,
    limit: float = 1.0,
    **signals: Unpack[SignalOptions],
) -> Verification:
    """Verify a certificate from its file, without a solver, from its numbers alone.

    The certificate must be about everything else that is given: the plant and the law's table
    number by number, and every signal of the class that the other arguments describe.

    Parameters
    ----------
    path : path
        The JSON file that `Certificate.save` wrote.
    plant : SwitchedSystem or UncertainPlant, optional
        The plant; for a polytope, one of its corners, for an ellipsoid its centre. For an uncertain
        plant the certificate must cover its ellipsoid of 95 % and the intervals of its delays.
    law : Law, optional
        The law whose table the certificate must have.
    step : float, optional
        The period, in seconds.
    dwell_time : float, one per mode, or SignalClass, optional
        The signals, as `certify` takes them. A dwell time without a maximum includes sojourns of
        any length, and without transitions all switches.
    limit : float
        The work allowed, as a multiple of the usual work for a file of this size. At 1 a short file
        is refused after a few seconds at most, a long one that is no proof after some minutes.
    **signals
        Further options of the signals, as `certify` takes them. An option that is left out may
        have any value, with two exceptions: where signals are given the clock may be off by 1e-5,
        and to a law that is given the mode is reported at once. A certificate for more lost
        samples also covers fewer.

    Raises
    ------
    ArgumentError
        If an argument is malformed.
    CertificateFileError
        If the file is missing, cut short, altered, or no certificate.

    Examples
    --------
    >>> import tempfile, deadtime as dt
    >>> plant = dt.problems.paper().plant.apart(0.5)
    >>> law = dt.AveragedPredictor(plant, dt.place(plant, [-1.0, -2.0]))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = dt.certify(plant, law, 0.2, step=0.1).save(f"{folder}/cert.json")
    ...     longer = dt.verify(path, plant, law, dwell_time=0.25)
    ...     shorter = dt.verify(path, plant, law, dwell_time=0.15)
    >>> longer.proven, shorter.proven
    (True, False)
    """
    began = time.perf_counter()
    step = None if step is None else positive("step", step)
    middle = plant.plant if isinstance(plant, PlantUncertainty) else plant
    for name, value, kind in (("plant", middle, SwitchedSystem), ("law", law, Law)):
        if value is not None:
            instance(name, value, kind)
    limit = positive("limit", limit)
    given: dict[str, Any] = {k: value for k, value in signals.items() if value is not None}
    # Malformed options are refused here, before the file is read.
    whole = SignalClass.of(1.0 if dwell_time is None else dwell_time, **given)
    if isinstance(dwell_time, SignalClass):
        given = vars(whole)
    elif dwell_time is not None:
        given["dwell_time"] = dwell_time
    asked = ExpectedClaim(plant, law, step, given)
    archived = load_evidence(Path(path))
    evidence, setting = archived.evidence, archived.evidence.setting

    def rejection(why: str, about: tuple[str, ...] = ()) -> Verification:
        seconds = time.perf_counter() - began
        message = f"Rejected: {why}"
        return Verification(False, message, (), None, seconds, about, (message,))

    reason = why_malformed(evidence)
    if reason:
        return rejection(f"{reason}.")
    about = in_first_numbers(setting, archived.digest)
    other = asked.missing_from(setting)
    if other:
        return rejection(other, about)
    excess = claims_too_much(archived)
    if excess:
        return rejection(f"{excess}.", about)
    outcome = check(evidence, limit)
    if not outcome.proven:
        return rejection(f"{outcome.reason}.", about)
    sentences, seconds = statement(evidence, outcome.cells), time.perf_counter() - began
    message = f"Proved: {sentences[0]}"
    plainly = plain_statement(evidence)
    return Verification(True, message, sentences, decay_rate(evidence), seconds, about, plainly)


def laws_of(path: str | Path, laws: Mapping[str, Law]) -> list[str]:
    """Names of the laws whose table a certificate's file holds.

    Raises
    ------
    CertificateFileError
        If the file is missing, cut short, altered, or no certificate.
    """
    setting = load_evidence(Path(path)).evidence.setting
    matching = []
    for name, law in laws.items():
        with suppress(DeadtimeError):  # raised by a law that has no table at this period
            asked = ExpectedClaim(law=law, signals={"mode_lag": setting.signals.mode_lag})
            if not asked.missing_from(setting):
                matching.append(name)
    return matching


def in_first_numbers(setting: Setting, digest: str) -> tuple[str, ...]:
    """The loop and the signals of a certificate, by first numbers and digests."""
    plants = setting.plants
    known = plants.A, plants.B, setting.delays.ends, *plants.arrays.values()
    (modes, n, m), (_, short) = plants.sizes, plants.in_words
    several = f", {short}" if short else ""
    rows, taps = setting.G.shape[:2]
    signals = setting.signals
    late = f" of {number_of(signals.mode_lag, 'period')} ago" if signals.mode_lag else ""
    kept = f", state of {number_of(setting.memory, 'number')}" if setting.memory else ""
    return (
        f"Plant {_digest(*known)}: "
        f"{number_of(modes, 'mode')}, {number_of(n, 'state')}, {number_of(m, 'input')}, "
        f"{setting.delays.in_figures}{several}; A[0] = {_first(plants.A[0, 0])}, "
        f"B[0] = {_first(plants.B[0, 0])}",
        f"Table {_digest(setting.F, setting.G)}: period {setting.step!r} s, rows by "
        f"{setting.context}{late}, {number_of(rows, 'row')} of {number_of(taps, 'past input')}"
        f"{kept}; state gain {_first(setting.F[0])}",
        f"Signals: {signals.sentence(modes)}; clock tolerance {signals.clock_tolerance!r}",
        f"File {digest[:SHOWN]}",
    )


def _other_plant(setting: Setting, plant: SwitchedSystem | PlantUncertainty | None) -> str:
    """The plants of a certificate, if the given ones are not among them; else empty."""
    if plant is None:
        return ""
    if isinstance(plant, PlantUncertainty):
        middle, plants, ends = plant.plant, plant.plant_set(), plant.delay_range()
    else:
        middle, plants, ends = plant, Polytope.of([plant]), None
    lacking = setting.plants.lacks(plants)
    if lacking:
        return lacking
    asked = [middle, *(SwitchedSystem(middle.A, middle.B, end) for end in ends or ())]
    covered = all(map(setting.delays.include, asked))
    return "" if covered else f"a plant with {setting.delays.in_words}"


def _digest(*arrays: np.ndarray) -> str:
    data = b"".join(np.ascontiguousarray(array, "<f8").tobytes() for array in arrays)
    return hashlib.sha256(data).hexdigest()[:SHOWN]


def _first(array: np.ndarray) -> str:
    numbers = [f"{value:.6g}" for value in array.ravel()[:FIRST]]
    return f"[{', '.join(numbers)}{', …' if array.size > FIRST else ''}]"
