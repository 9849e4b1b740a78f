"""What can be certified at all: laws, dwell times and orders beyond reach are told so at once."""

from __future__ import annotations

from deadtime.certificates.proof.evidence import Setting
from deadtime.certificates.proof.leaving_ages import least_periods
from deadtime.certificates.proof.validate import MOST_TOLD
from deadtime.feedback import Law
from deadtime.feedback.law import TableLaw
from deadtime.feedback.memory import WithMemory
from deadtime.feedback.recurrence import same_outputs
from deadtime.plant import SwitchedSystem
from deadtime.switching import SignalClass

LARGEST = 3000  # order that memory allows


def out_of_reach(plants: list[SwitchedSystem], law: Law, signals: SignalClass, step: float) -> str:
    """Why there can be no certificate, if so."""
    if not isinstance(law, TableLaw | WithMemory):
        return why_no_table(law)
    if law.foresees:
        return (
            f"{type(law).__name__} foresees the signal, so its table is one for each signal: there "
            "is no one loop to certify."
        )
    dwell_time = min(signals.limits(plants[0].modes).dwell_time)
    tolerance = signals.clock_tolerance
    several = plants[0].modes > 1 and signals.at == "anywhere"
    if several and least_periods(dwell_time, step, tolerance) < 1:
        return (
            f"dwell_time = {dwell_time:g} s is not above one period of {step:g} s (by the clock's "
            f"tolerance of {tolerance:g}): two switches may fall into a step; shorten the step, "
            'or, where modes change at samples only, say so: at = "samples".'
        )
    return ""


def why_no_table(law: Law) -> str:
    """Why a law that has no table has no certificate."""
    name = type(law).__name__
    if not isinstance(law, WithMemory):
        return f"{name} is no table but a nonlinear law: no certificate of this kind."
    if law.outputs is None:
        return (
            f"{name} weighs its rows by a belief, which no signal decides: there is "
            "no table to certify. What can be proved is its .law, told the mode at once or, with "
            "mode_lag, some periods late; falsify searches in runs for signals that it grows under."
        )
    return (
        f"{name} is no linear update of what it remembers (it weighs a belief, or runs a law that "
        "is not linear): no certificate of this kind; falsify searches in runs for signals that it "
        "grows under."
    )


def told_late(law: Law, mode_lag: int) -> str:
    """Why a law that is told the mode late has no certificate, if so."""
    if not mode_lag or same_outputs(law):
        return ""
    return (
        "The law measures other outputs in each mode, so what it makes of them depends on the "
        "plant's mode and on the one that it is told: certify with one C for all modes, or without "
        "mode_lag."
    )


def too_many_told(setting: Setting) -> str:
    """Why a mode told late, or not told, has no certificate with so many rows, if so."""
    late, rows = setting.signals.mode_lag or setting.signals.lost_samples, len(setting.F)
    if late * rows <= MOST_TOLD:
        return ""
    name = "mode_lag" if setting.signals.mode_lag else "lost_samples"
    periods = " periods" if setting.signals.mode_lag else ""
    return (
        f"{name} = {late}{periods} with a table of {rows:,} rows leaves too many rows that may be "
        "told: lengthen the step."
    )


def too_large(order: int) -> str:
    """An estimate of what a loop of this order would take, if that is too much."""
    if order <= LARGEST:
        return ""
    gigabytes, minutes = 14 * 8e-9 * order**2 + 3e-7 * order**2, 0.5 * (order / 1000) ** 3
    return (
        f"the lifted loop has order {order:,}: a certificate would take about {gigabytes:.1f} GB "
        f"and {minutes:.0f} min, and {LARGEST:,} is the limit; lengthen the step."
    )
