"""A design for margin as tables, as JSON, and as sections of a problem file."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from deadtime.base.json_records import plain, record
from deadtime.base.wording import as_rate, compact
from deadtime.plant import SwitchedSystem
from deadtime.plant.weight import record_of
from deadtime.synthesis import Design, TradeOff
from deadtime.synthesis.design_result import LIMIT, percent

STEP = "step, s"
HEADINGS = (
    "design", "delay margin", "cost", "decay, 1/s", "peak |u|", "filter, s", STEP, "misses"
)  # fmt: skip
LIMIT_HEADINGS = ("mode", "some reaches", "none more than", "unstable poles, 1/s")
_OF_SOURCE = ("size", "probability"), ("process", "measurement", "probability")
_FIGURES = ("margin", "cost", "decay_rate", "input_peak")


def design_rows(design: Design) -> list[tuple[str, ...]]:
    """The plain design, the trade-off, and the one chosen; what each misses of the request."""
    others = [point for point in design.points if point.law is not design.plain.law]
    rows = []
    for point in (design.plain, *others):
        names = ["plain"] if point is design.plain else []
        names += ["chosen"] if point.law is design.law and design.points else []
        missed = ["|u|" if name == LIMIT else name for name in design.missed(point)]
        rows.append(_row(", ".join(names), point, ", ".join(missed) or "–"))
    return rows


def _row(name: str, point: TradeOff, missed: str) -> tuple[str, ...]:
    T = point.time_constant
    slowest = "–" if T is None else f"{np.abs(np.linalg.eigvals(T)).max():.3g}"
    decay = f"{point.decay_rate:.3g}" if point.decay_rate > 0.0 else "–"
    step = f"{point.step:g}"
    known = [] if point.input_peak is None else point.input_peak.tolist()
    peaks = ", ".join("–" if math.isinf(peak) else compact(peak) for peak in known)
    return name, percent(point.margin), compact(point.cost), decay, peaks, slowest, step, missed


def limit_rows(design: Design, modes: Sequence[str]) -> list[tuple[str, ...]]:
    """What any linear controller can tolerate, mode by mode."""
    return [
        (
            name,
            percent(limit.reached),
            percent(limit.most, up=True),
            ", ".join(_pole(pole) for pole in limit.poles) or "none",
        )
        for name, limit in zip(modes, design.limits, strict=True)
    ]


def _pole(pole: complex) -> str:
    text = as_rate(pole.real)
    return text if pole.imag == 0.0 else f"{text}{as_rate(pole.imag)}j"


def problem_sections(
    design: Design,
    kind: str,
    plant: SwitchedSystem,
    gains: np.ndarray,
    mode: int | None = None,
) -> str:
    """The design as sections [gains], [[law]] and a step, for the problem file of a plant.

    With a mode the design is that mode's alone: the other modes keep their gains.
    """
    lines = [f"# {sentence}." for sentence in design.message.rstrip(".").split(". ")]
    lines.append("# Put these in place of [gains] and of the [[law]] sections of the problem file.")
    K = np.array(gains)
    K[slice(None) if mode is None else [mode]] = design.gains
    lines += ["", "[gains]", f"K = {_nested_lists(K)}"]
    if np.linalg.eigvals(plant.A + plant.B @ K).real.max() >= 0.0:
        lines.append("allow_unstable = true    # the filter is part of what stabilises")
    lines += ["", "[[law]]", f'kind = "{kind}"' if mode is None else 'kind = "single"']
    lines += [] if mode is None else [f"mode = {mode}"]
    T = design.time_constant
    if T is not None:
        lines.append(f"low_pass = {repr(float(T[0, 0])) if T.shape[0] == 1 else _nested_lists(T)}")
    return "\n".join([*lines, "", f"# In [run]: step = {design.step!r}", ""])


def _nested_lists(array: np.ndarray) -> str:
    return str(array.tolist())


def design_record(design: Design) -> dict[str, Any]:
    """The design for JSON; None for what is infinite."""
    points = [
        record(point, *_FIGURES, "step")
        | {"chosen": point.law is design.law, "missed": design.missed(point)}
        for point in design.points
    ]
    return plain({
        **record(design, "asked", "decay_asked", "input_limit", "reached"),
        "initial": record(design.initial, "kind", *_OF_SOURCE[design.initial.kind == "noise"]),
        "delay_margin": record(design.margin, "relative", "lower", "upper"),
        "growth_at_both_ends": design.growth,
        **record(design, "gains", "time_constant", "step", "cost"),
        **record_of(design.weight),
        **record(design, "decay_rate", "input_peak"),
        "plain": record(design.plain, *_FIGURES),
        "limits": [record(limit, "reached", "most") for limit in design.limits],
        "points": points,
        **record(design, "evaluated", "message"),
    })  # fmt: skip
