"""The stability theorem's constants in three forms, as rows for reports and terminals."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from deadtime.base.json_records import record
from deadtime.base.wording import compact
from deadtime.certificates import TheoremBound, theorem_bound
from deadtime.certificates.theorem.bound import stated_forms
from deadtime.problems import Problem

HEADINGS = {"printed": "as printed", "corrected": "corrected", "sharp": "sharp"}


def bound_headings(
    bounds: Mapping[str, TheoremBound], published: Mapping[str, float] | None = None
) -> tuple[str, ...]:
    """Of the columns of `bound_rows`."""
    headings = ("constant", *(HEADINGS[form] for form in bounds))
    return (*headings, "figure in the text") if published else headings


def bounds_of(problem: Problem, dwell_time: float) -> dict[str, TheoremBound]:
    """The bound in those of its forms that the delays allow: printed, corrected, sharp."""
    forms = stated_forms(problem.plant) or ("sharp",)
    return {
        form: theorem_bound(problem.plant, problem.gains, dwell_time, form=form) for form in forms
    }


def bound_rows(
    bounds: Mapping[str, TheoremBound], published: Mapping[str, float] | None = None
) -> list[tuple[str, ...]]:
    """Rows (quantity, a value per form), and a column of published figures if any.

    Examples
    --------
    >>> import deadtime as dt
    >>> rows = bound_rows(bounds_of(dt.problems.paper(), 0.2), dt.problems.paper().constants)
    >>> rows[0]
    ('distance ε', '0.7895', '0.7895', '0.7895', '0.7895')
    """

    def large(name: str, log_name: str):
        def write(bound: TheoremBound) -> str:
            value, logarithm = getattr(bound, name), getattr(bound, log_name)
            if value is None:
                return "–"
            return compact(value) if 0.0 < value < float("inf") else f"10^{logarithm:.1f}"

        return write

    quantities = {
        "distance ε": lambda bound: f"{bound.epsilon:.4g}",
        "allowed distance ε*": large("epsilon_star", "log10_epsilon_star"),
        "ν₁": large("nu1", "log10_nu1"),
        "ν₂": large("nu2", "log10_nu2"),
        "κ": large("kappa", "log10_kappa"),
        "b": lambda bound: _optional(bound.b),
        "δ₁(ε)": lambda bound: compact(bound.delta1(bound.epsilon)),
        "δ₂(ε)": lambda bound: compact(bound.delta2(bound.epsilon)),
        "μ, 1/s": lambda bound: _optional(bound.mu),
        "ρ": large("rho", "log10_rho"),
        "ξ, 1/s": lambda bound: _optional(bound.xi),
        "ε < ε*": lambda bound: "yes" if bound.holds else "no",
    }
    rows = []
    for name, write in quantities.items():
        row = (name, *(write(bound) for bound in bounds.values()))
        if published:
            row += (f"{published[name]:.4g}" if name in published else "",)
        rows.append(row)
    return rows


def bound_sentence(bounds: Mapping[str, TheoremBound]) -> str:
    """What the constants say about the plant at hand."""
    sharp, printed, ratio = bounds["sharp"], bounds.get("printed"), ""
    if printed is not None:
        gained = sharp.log10_epsilon_star - printed.log10_epsilon_star
        ratio = (
            f" The sharp form allows 10^{gained:.1f} times the distance that the printed one does."
        )
    if sharp.holds:
        return (
            f"The theorem proves this loop stable, updated continuously: |x| decays at least as "
            f"e^(−{sharp.xi:.2g} t), for every signal with the dwell time.{ratio}"
        )
    return (
        f"The theorem says nothing about this loop: its modes and gains differ by ε = "
        f"{compact(sharp.epsilon)}, and even the sharp form allows {compact(sharp.epsilon_star)}."
        f"{ratio}"
    )


def bounds_record(bounds: Mapping[str, TheoremBound]) -> dict[str, dict[str, Any]]:
    """The constants for JSON, which knows no infinity: their logarithms are always there."""
    names = ("epsilon", "epsilon_star", "nu1", "nu2", "kappa", "b", "mu", "rho", "xi")
    logs = [f"log10_{name}" for name in ("epsilon_star", "nu1", "nu2", "kappa", "rho")]
    told = (*names, *logs, "holds", "message")
    return {form: record(bound, *told) for form, bound in bounds.items()}


def _optional(value: float | None) -> str:
    return "–" if value is None else compact(value)
