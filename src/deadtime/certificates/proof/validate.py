"""Shapes, types and magnitudes of evidence, checked before anything is computed with it.

A certificate's file may contain anything. After these checks the arithmetic neither overflows nor
reads a row that the loop would not.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np

from deadtime.base.errors import ArgumentError
from deadtime.certificates.proof.evidence import Centre, Evidence, Setting
from deadtime.certificates.proof.stretches import StretchEvidence

SMALLEST, LARGEST = 1e-100, 1e100  # of any number but 0: products of three stay in range
MOST_AGES = 100_000
MOST_STRETCHES = 5_000
MOST_REPORTED = 1_000_000  # rows of the table, times the lag of the mode


def why_malformed(evidence: Evidence | StretchEvidence) -> str:
    """The first fault of the evidence; empty if it has none.

    In this order, since each check relies on those before it.
    """
    setting = evidence.setting
    return (
        _numbers(setting)
        or _plants_and_table(setting)
        or _context(setting)
        or _times(setting)
        or _rho_and_knots(evidence.rho, evidence.knots)
        or (
            _stretches(evidence)
            if isinstance(evidence, StretchEvidence)
            else _matrices(evidence, evidence.centre)
        )
    )


def _numbers(setting: Setting) -> str:
    times: dict[str, Any] = {
        **{f"delays{list(at)}": delay.item() for at, delay in np.ndenumerate(setting.delays.ends)},
        "step": setting.step,
    }
    times |= {"dwell_time": np.min(setting.signals.dwell_time or 0.0).item()}
    for name, value in times.items():
        if not (isinstance(value, float) and SMALLEST <= value <= LARGEST):
            return f"{name} is not a positive number, or beyond 1e±100"
    for name, least in (("ages", 1), ("memory", 0)):
        value = getattr(setting, name)
        if not isinstance(value, int) or isinstance(value, bool) or value < least:
            return f"{name} is not a whole number of at least {least}"
    return ""


def _plants_and_table(setting: Setting) -> str:
    plants, F, G = setting.plants, setting.F, setting.G
    A, B = plants.A, plants.B
    if (A.ndim, B.ndim, F.ndim, G.ndim) != (4, 4, 3, 4) or not (A.size and B.size and F.size):
        return "A, B, F or G lacks an axis"
    corners, modes, n, _ = A.shape
    m, rows, taps, q = B.shape[3], F.shape[0], G.shape[1], setting.memory
    expected = {
        "A": (A, (corners, modes, n, n)),
        "B": (B, (corners, modes, n, m)),
        "F": (F, (rows, q + m, n)),
        "G": (G, (rows, taps, q + m, q + m)),
        "delays": (setting.delays.ends, setting.delays.shape(modes, m)),
    }
    misfit = plants.misfit()
    if misfit:
        return misfit
    for name, array in plants.arrays.items():
        expected[name] = array, (len(array), modes, n, n + m)
    late = np.any(G[:, 1:, :, :q])
    return (
        _misshapen(expected)
        or ("G has no taps" if taps < 1 else "")
        or ("G reads the law's state of more than a period ago" if late else "")
        or ("memory is not 0, though F and G are all zero" if q and not setting.inputs else "")
    )


def _context(setting: Setting) -> str:
    modes = setting.modes
    rows = {"none": 1, "mode": modes, "mode_age": modes * setting.ages}.get(setting.context)
    if rows is None:
        return "context is none of none, mode, mode_age"
    if setting.context != "mode_age" and setting.ages != 1:
        return "ages is not 1, though the rows do not depend on the age"
    if setting.signals.mode_lag and (setting.context == "none" or modes == 1):
        return "mode_lag is not 0, though the rows do not depend on the mode"
    if (setting.signals.mode_lag + setting.signals.lost_samples) * len(setting.F) > MOST_REPORTED:
        return "mode_lag or lost_samples is too long for a table of so many rows"
    if setting.signals.lost_samples:
        if not setting.inputs:
            return "lost_samples is not 0, though F and G are all zero"
        rows = rows * 2
    return "" if len(setting.F) == rows else f"the table has {len(setting.F)} rows, not {rows}"


def _times(setting: Setting) -> str:
    signals = setting.signals
    try:
        signals.require_clock()
        limits = setting.limits
    except ArgumentError as error:
        return str(error).removesuffix(".")
    low, high = setting.delays.bounds
    if np.any(low > high):
        return "delays do not ascend"
    # Both limits before the graph is built: its size is the number of ages.
    chattering = min(signals.chatter, MOST_AGES + 1) * max(limits.dwell_time)
    longest = [most for most in limits.maximum_dwell if math.isfinite(most)]
    longest = max(float(high.max()), chattering, *longest)
    if signals.chatter > MOST_AGES or longest / setting.step > MOST_AGES:
        return "the period is too short for these times"
    try:
        family = setting.family
    except ValueError as error:
        return str(error)
    if not family.sound:
        return "the delays lie in no period"
    if setting.transitions.first < 0:
        return "the dwell time is below one period"
    if any(own.last < own.first for own in setting.transitions.clocks):
        return "maximum_dwell leaves no sojourn of whole periods"
    return ""


def _rho_and_knots(rho: object, knots: tuple[object, ...]) -> str:
    if not (isinstance(rho, float) and 0.01 <= rho <= 1.0):
        return "rho is not in [0.01, 1]"
    # A bool is an int in Python, and 1.0 an index that NumPy refuses.
    ages = [knot for knot in knots if isinstance(knot, int) and not isinstance(knot, bool)]
    if not ages or len(ages) < len(knots):
        return "knots are not whole numbers"
    return "knots do not ascend" if ages[0] < 0 or any(b <= a for a, b in pairwise(ages)) else ""


def _matrices(evidence: Evidence, centre: Centre) -> str:
    setting = evidence.setting
    d, rows = setting.order, len(setting.F)
    n, o = setting.states, setting.outputs
    y = n + len(setting.family.reads)
    r, s = centre.R.shape[0], centre.Psi.shape[0]
    size = y + r + s + n + o * setting.rows_differ
    misfit = _misshapen(
        {
            "E": (centre.E, (n, y)),
            "row": (centre.row, (o, d)),
            "R": (centre.R, (r, d)),
            "T": (centre.T, (rows, o, y + r)),
            "Psi": (centre.Psi, (s, d)),
            "filter": (centre.F, (s, size)),
            "P": (evidence.P, (d, d)),
            "Pi": (evidence.Pi, (size, size)),
            "S": (evidence.S, (setting.transitions.places, len(evidence.knots), s, s)),
        }
    )
    if misfit:
        return misfit
    for name in ("P", "Pi", "S"):
        array = getattr(evidence, name)
        if not np.array_equal(array, np.swapaxes(array, -1, -2)):
            return f"{name} is not symmetric"
    if evidence.knots[0] != 0:
        return "knots do not ascend from 0"
    if not setting.rows_differ and not np.array_equal(centre.row, setting.rows[0]):
        return "row is not the table's row"
    return ""


def _stretches(evidence: StretchEvidence) -> str:
    """P, and knots that every path through the graph passes."""
    setting, knots = evidence.setting, evidence.knots
    graph, family, d = setting.transitions, setting.family, setting.order
    sizes = _misshapen({"P": (evidence.P, (graph.places, len(knots), d, d))})
    if sizes:
        return sizes
    if not np.array_equal(evidence.P, np.swapaxes(evidence.P, -1, -2)):
        return "P is not symmetric"
    if not (isinstance(evidence.mu, float) and 1.0 <= evidence.mu <= LARGEST):
        return f"mu is not in [1, {LARGEST:g}]"
    if graph.bucket is not None:
        if knots != (0,):
            return "knots are not 0 alone, as an average dwell time has them"
        many = len(setting.F) * graph.modes * graph.places > MOST_STRETCHES
        return "there are too many rows" if many else ""
    if evidence.mu != 1.0:
        return "mu is not 1, without an average dwell time"
    if setting.signals.mode_lag > knots[0]:
        return f"knots must begin at the lag of the mode, {setting.signals.mode_lag}, or later"
    if knots[0] > graph.first or knots[-1] > graph.last:
        return f"knots must begin at {graph.first} or before, and end at {graph.last}"
    for own in graph.clocks:
        if not own.ends and own.last not in knots:
            return f"knots must hold {own.last}, from where a mode may last"
    varies = family.ranges or not family.plants.known or setting.signals.lost_samples
    if varies and knots != tuple(range(graph.last + 1)):
        return "knots must be all ages where the steps of a stretch are not known"
    if max(graph.switching, graph.places * len(knots)) > MOST_STRETCHES:
        return "there are too many stretches"
    return ""


def _misshapen(expected: dict[str, tuple[np.ndarray, tuple[int, ...]]]) -> str:
    """The first array with a wrong shape or a number out of range."""
    for name, (array, shape) in expected.items():
        if array.shape != shape:
            return f"{name} has the shape {array.shape}, not {shape}"
        # A nan fails both comparisons.
        size = np.abs(array[array != 0.0])
        if not np.all((size >= SMALLEST) & (size <= LARGEST)):
            return f"{name} holds a number that is not finite, or beyond 1e±100"
    return ""
