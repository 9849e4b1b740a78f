"""The verdict: what a comparison measured, in plain sentences."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from deadtime.comparison import Comparison
from deadtime.wording import amount, compact, signed


def verdict(result: Comparison) -> list[str]:
    """Up to five plain sentences, each made from measured figures.

    Examples
    --------
    >>> import deadtime as dt
    >>> from deadtime.comparison import compare
    >>> print(verdict(compare(dt.problems.paper()))[2])
    Ignoring the delay fails: |x| reaches 2.2 × 10¹³ by the end.
    """
    sentences = [_headline(result), _without_switching(result)]
    sentences += [_baseline(result)] if "delay ignored" in result.runs else []
    singles = [name for name in result.runs if name.endswith(" only")]
    sentences += [_believing_one_mode(result, singles)] if singles else []
    sentences += [_against_the_oracle(result)] if "oracle" in result.runs else []
    return sentences


def _law(name: str) -> str:
    return {"averaged": "the averaged law", "mean": "the mean law"}.get(name, f"the law “{name}”")


def _start(result: Comparison) -> float:
    return float(np.linalg.norm(result.problem.x0))


def _headline(result: Comparison) -> str:
    problem, run = result.problem, result.runs[result.lead]
    signal = problem.signal
    switches = int(np.sum(signal.times[1:] < run.end))
    setting = f"on a signal with {switches} switches in {problem.horizon:g} s"
    if switches:
        setting += f" (dwell time {signal.dwell_time:.2g} s)"
    law = _law(result.lead)
    law = law[0].upper() + law[1:]
    if run.diverged:
        return f"{law} loses the plant {setting}: {run.message}"
    start, end = _start(result), result.metrics[result.lead]["final_norm"]
    if end < start:
        return f"{law} works {setting}: |x| falls from {amount(start)} to {amount(end)}."
    return f"{law} fails {setting}: |x| grows from {amount(start)} to {amount(end)}."


def _without_switching(result: Comparison) -> str:
    names, growth = result.problem.modes, result.growth
    unstable = [i for i, rate in enumerate(growth) if rate > 0.0]
    rates = [f"held in {names[i]} it grows at {signed(growth[i])} /s" for i in unstable]
    if not unstable:
        slowest = int(np.argmax(growth))
        return (
            f"The same loop is stable without switching, too: held in any one mode it decays, "
            f"slowest in {names[slowest]} at {signed(growth[slowest])} /s."
        )
    rates[1:] = [text.replace("it grows ", "") for text in rates[1:]]
    decays = "" if len(unstable) == len(growth) else " (in the other modes it decays)"
    return "Yet the same loop is unstable if it stops switching: " + ", ".join(rates) + decays + "."


def _baseline(result: Comparison) -> str:
    figures = result.metrics["delay ignored"]
    start, end = _start(result), figures["final_norm"]
    if result.runs["delay ignored"].diverged:
        return "Ignoring the delay fails: " + result.runs["delay ignored"].message
    if end > start:
        return f"Ignoring the delay fails: |x| reaches {amount(end)} by the end."
    ratio = figures["cost"] / result.metrics[result.lead]["cost"]
    return (
        f"Even ignoring the delay, the loop settles here, at {amount(ratio)} times the cost "
        f"(∫|x|² + ∫|u|²) of {_law(result.lead)}."
    )


def _believing_one_mode(result: Comparison, singles: list[str]) -> str:
    lead = result.metrics[result.lead]["cost"]
    ratios = [
        f"{amount(result.metrics[name]['cost'] / lead)} times"
        + (" (and |x| grows)" if result.metrics[name]["final_norm"] > _start(result) else "")
        for name in singles
    ]
    modes = [name.removesuffix(" only") for name in singles]
    return (
        f"Predicting as if the plant stayed in one mode costs, compared with {_law(result.lead)}, "
        + ", ".join(f"{r} for {m}" for r, m in zip(ratios, modes, strict=True))
        + "."
    )


def _against_the_oracle(result: Comparison) -> str:
    oracle = result.metrics["oracle"]["cost"]

    def ratio(name: str) -> str:
        return f"{amount(result.metrics[name]['cost'] / oracle)} times"

    text = (
        f"Compared with an oracle that knows the future, {_law(result.lead)} costs "
        f"{ratio(result.lead)} as much"
    )
    if "mean" not in result.metrics:
        return text + "."
    lead, mean = (result.metrics[name]["cost"] for name in (result.lead, "mean"))
    better = _law("mean") if mean < lead else _law(result.lead)
    return text + f", the mean law {ratio('mean')}: on this signal {better} is the cheaper."


def table(metrics: Mapping[str, Mapping[str, float]]) -> list[tuple[str, ...]]:
    """Rows of the table of metrics, columns as in `HEADINGS`."""
    return [
        (
            name,
            compact(row["ise"]),
            compact(row["energy"]),
            compact(row["cost"]),
            compact(row["peak"]),
            f"{row['settling_time']:.2f}" if math.isfinite(row["settling_time"]) else "–",
            signed(row["decay_rate"]),
            compact(row["final_norm"]),
        )
        for name, row in metrics.items()
    ]


HEADINGS = ("law", "∫|x|²", "∫|u|²", "cost", "peak |x|", "settles, s", "decay, 1/s", "|x(T)|")
