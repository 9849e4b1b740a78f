"""A fitted model of the switching in words, as a table and as JSON."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from deadtime.base.json_records import plain, record
from deadtime.base.wording import amount
from deadtime.switching.models.semi_markov import SemiMarkov
from deadtime.switching.models.sojourn_families import Goodness

HEADINGS = ("mode", "sojourns", "cut off", "mean (s)", "family", "KS distance", "p")
DOUBTFUL = 0.05


def fit_rows(model: SemiMarkov, names: Sequence[str]) -> list[tuple[str, ...]]:
    """One row per mode, under `HEADINGS`."""
    return [
        (
            name,
            str(good.complete),
            str(good.censored),
            amount(float(mean)),
            good.family,
            f"{good.distance:.3f}",
            f"{good.p_value:.2g}",
        )
        for name, good, mean in zip(names, _goodness(model), model.mean, strict=True)
    ]


def fit_sentence(model: SemiMarkov, names: Sequence[str]) -> str:
    """Whether the families describe the logs.

    Examples
    --------
    >>> import deadtime as dt
    >>> model = dt.SemiMarkov.fit(dt.SwitchingSignal.random(2, 200.0, dwell_time=0.2, seed=1))
    >>> fit_sentence(model, ["throttle", "brake"])
    'The families describe the logged sojourns: no distance is larger than chance makes it.'
    """
    doubtful = [
        name for name, good in zip(names, _goodness(model), strict=True) if good.p_value < DOUBTFUL
    ]
    if not doubtful:
        return (
            "The families describe the logged sojourns: no distance is larger than chance makes it."
        )
    return (
        f"Doubtful for {', '.join(doubtful)}: sojourns differ from the family more than chance "
        f"explains (p < {DOUBTFUL:g}). Look at the figure, and try another family."
    )


def fit_record(model: SemiMarkov, names: Sequence[str]) -> dict[str, Any]:
    """The fit for JSON."""
    modes = {
        name: {
            **record(good, "family", "parameters"),
            "mean": mean,
            **record(good, "complete", "censored"),
            "ks_distance": good.distance,
            **record(good, "p_value", "aic"),
        }
        for name, good, mean in zip(names, _goodness(model), model.mean, strict=True)
    }
    return plain({"modes": modes, "transition": model.transition})


def _goodness(model: SemiMarkov) -> tuple[Goodness, ...]:
    assert model.goodness is not None
    return model.goodness
