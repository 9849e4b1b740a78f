"""Plants and delays of a certificate, and the reasons why a loop cannot have one.

A plant extended by a reference or a constant disturbance (`deadtime.Servo`) has states that obey
dr/dt = 0. No law moves them, so only the other states can be stable.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from deadtime.base.checks import instance
from deadtime.base.errors import ArgumentError
from deadtime.certificates.proof.delays import Delays, Range
from deadtime.certificates.proof.evidence import Setting
from deadtime.certificates.proof.transitions import least_periods
from deadtime.certificates.proof.validate import MOST_REPORTED
from deadtime.feedback import Feedback, Law
from deadtime.feedback.law import require_match
from deadtime.feedback.recurrence import same_outputs
from deadtime.plant import SwitchedSystem
from deadtime.plant.plant_set import PlantSet, PlantUncertainty, Polytope
from deadtime.spectrum import aged_row, constant_growth, least_growth, with_memory
from deadtime.switching import SignalClass

ROUNDS = 3  # steps of the gradient ascent to the worst plant of a set
MOVE = 1e-3  # of z, for a difference quotient

Plants = SwitchedSystem | PlantUncertainty | Sequence[SwitchedSystem]  # as `certify` takes them
_NOTHING = 1e-12  # relative to the largest singular value
LARGEST = 3000  # order that memory allows


def plants_of(
    plant: Plants, law: Law, delays: Range | None
) -> tuple[PlantSet, SwitchedSystem, Range | None]:
    """The set of plants, one of the delays that they all have, and the range of delays."""
    if isinstance(plant, PlantUncertainty):
        require_match(plant.plant, law)
        return plant.plant_set(), plant.plant, plant.delay_range() if delays is None else delays
    plants: list[SwitchedSystem] = []
    if not isinstance(plant, SwitchedSystem) and not np.iterable(plant):
        raise ArgumentError(
            f"plant must be a SwitchedSystem or a sequence of them, got {type(plant).__name__}."
        )
    for corner in [plant] if isinstance(plant, SwitchedSystem) else plant:
        if isinstance(corner, PlantUncertainty):
            raise ArgumentError(
                f"plant must be one {type(corner).__name__}, got a sequence that contains one: "
                "certify each alone."
            )
        instance("plant", corner, SwitchedSystem)
        plants.append(corner)
    if not plants:
        raise ArgumentError("plant must be a SwitchedSystem or a sequence of them, got none.")
    for corner in plants:
        if not np.array_equal(corner.delays, plants[0].delays):
            raise ArgumentError(
                "plant must have the same delays at all corners of the polytope: give a range of "
                "one delay as delays=(low, high)."
            )
        require_match(corner, law)
    return Polytope.of(plants), plants[0], delays


def extremes(plants: PlantSet, delays: Delays, table: Feedback) -> list[SwitchedSystem]:
    """Plants whose constant modes are checked: the vertices, and bad points of an ellipsoid.

    Each with the delays at the ends of their ranges.
    """
    vertices = zip(plants.A, plants.B, strict=True)
    found = [SwitchedSystem(A, B, delay) for A, B in vertices for delay in delays.corners]
    moved = [mode for mode in range(plants.sizes[0]) if plants.directions[:, mode].any()]
    return found + [_worst(one, plants, table, mode) for one in found for mode in moved]


def _worst(plant: SwitchedSystem, plants: PlantSet, table: Feedback, mode: int) -> SwitchedSystem:
    """A plant of the set in which a constant mode grows fast, by gradient ascent."""
    row = aged_row(table, mode)

    def growth(z: np.ndarray) -> float:
        return constant_growth(with_memory(plants.moved(plant, z), table), table, mode, row)

    count = len(plants.directions)
    unit = np.eye(count)
    touching = np.flatnonzero(np.any(plants.directions[:, mode], axis=(1, 2)))
    z = best = np.zeros(count)
    most = growth(z)
    for _ in range(ROUNDS):
        here, gradient = growth(z), np.zeros(count)
        for k in touching:
            gradient[k] = (growth(z + MOVE * unit[k]) - here) / MOVE
        size = float(np.linalg.norm(gradient))
        if not 0.0 < size < np.inf:
            break
        # On an ellipsoid the maximum of the linear model is known in closed form: no line search.
        z = plants.farthest(gradient)
        if growth(z) > most:
            most, best = growth(z), z
    return plants.moved(plant, best)


def why_unmoved(plants: PlantSet) -> str:
    """Why no certificate exists where a part of the state never changes; empty elsewhere.

    vᵀx is constant where vᵀA_i = 0 and vᵀB_i = 0 in every mode.
    """
    vertices = zip(plants.A, plants.B, strict=True)
    motions = np.concatenate([part for A, B in vertices for part in (*A, *B)], axis=1)
    size = np.abs(motions).max(axis=1)  # not a 2-norm: squares may overflow
    still = np.flatnonzero(size == 0.0)
    # In units in which the rows are about 1, so that slow states do not count as still.
    units = np.where(size > 0.0, size, 1.0)
    values = np.linalg.svd(motions / units[:, None], compute_uv=False)
    rank = int((values > _NOTHING * max(float(values[0]), 1e-300)).sum())
    if rank == len(motions):
        return ""
    what = "a combination of the plant's states"
    if still.size == len(motions) - rank:
        what = " and ".join(f"x[{i}]" for i in still) + " of the plant"
    return (
        f"No certificate: in every mode, and under every input, {what} keeps its value, as a "
        "reference or a constant disturbance does, so that no law makes all of the state decay. "
        "Certify the states that move: of a Servo its `OutputFeedback(law, observer, "
        "servo=servo)`, or the plant `servo.driven` under a law with gains K[:, :, servo.moving]."
    )


def neutral(plant: SwitchedSystem, mode: int, growth: float) -> str:
    """Why there is no certificate where a constant mode neither grows nor decays."""
    rate = 0.0 if abs(growth) < 0.01 * least_growth(plant) else growth  # round-off
    return (
        f"Held in mode {mode} the loop neither grows nor decays (its growth rate is {rate:.2g} "
        "1/s, as an integrator's that the law leaves alone), so that no decay can be proved, and "
        "no signal was proved to grow: change the gains so that every mode decays."
    )


def out_of_reach(modes: int, law: Law, signals: SignalClass, step: float) -> str:
    """Why there can be no certificate; empty if there can."""
    if not law.is_linear:
        return _why_no_table(law)
    if law.needs_preview:
        return "The oracle knows the future switching, so there is no fixed controller to certify."
    dwell_time = min(signals.limits(modes).dwell_time)
    tolerance = signals.clock_tolerance
    several = modes > 1 and signals.at == "anywhere"
    if several and least_periods(dwell_time, step, tolerance) < 1:
        return (
            f"dwell_time = {dwell_time:g} s is not above one period of {step:g} s (by the clock's "
            f"tolerance of {tolerance:g}): two switches may fall into a step; shorten the step, "
            'or, where modes change at samples only, say so: at = "samples".'
        )
    return ""


def _why_no_table(law: Law) -> str:
    name = type(law).__name__
    if law.observer is None and law.filter is None:
        return f"{name} is no table but a nonlinear law: no certificate of this kind."
    if law.outputs is None:
        return (
            f"{name} weighs its rows by a belief, which depends on more than the signal: there is "
            "no table to certify. Certify its .law instead, with the mode reported at once or, "
            "with mode_lag, some periods late; falsify searches runs for signals under which the "
            "loop grows."
        )
    return (
        f"{name} has no linear update of its state (it weighs a belief, or runs a law that is not "
        "linear): no certificate of this kind; falsify searches runs for signals under which the "
        "loop grows."
    )


def reported_late(law: Law, mode_lag: int) -> str:
    """Why a law has no certificate when the mode is reported late; empty if it has."""
    if not mode_lag or same_outputs(law):
        return ""
    return (
        "The law measures other outputs in each mode, so its estimate depends on the plant's mode "
        "and on the reported one: certify with one C for all modes, or without mode_lag."
    )


def too_many_reported(setting: Setting) -> str:
    """Why a table with many rows has no certificate with late modes or lost samples."""
    late, rows = setting.signals.mode_lag or setting.signals.lost_samples, len(setting.F)
    if late * rows <= MOST_REPORTED:
        return ""
    name = "mode_lag" if setting.signals.mode_lag else "lost_samples"
    periods = " periods" if setting.signals.mode_lag else ""
    return (
        f"{name} = {late}{periods} with a table of {rows:,} rows: too many rows may act at a "
        "sample; lengthen the step."
    )


def too_large(order: int) -> str:
    """Memory and time for a loop of this order, where they are too much; else empty."""
    if order <= LARGEST:
        return ""
    gigabytes, minutes = 14 * 8e-9 * order**2 + 3e-7 * order**2, 0.5 * (order / 1000) ** 3
    return (
        f"the lifted loop has order {order:,}: a certificate would take about {gigabytes:.1f} GB "
        f"and {minutes:.0f} min, and {LARGEST:,} is the limit; lengthen the step."
    )
