"""A fitted model of the switching in words, as a table, as TOML and as JSON."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from deadtime.base.json_records import plain, record
from deadtime.base.wording import amount
from deadtime.switching import SemiMarkov
from deadtime.switching.models.sojourn_families import Goodness
from deadtime.switching.models.sojourns import Distribution, Fixed
from deadtime.switching.models.truncation import Truncated

HEADINGS = ("mode", "sojourns", "cut off", "mean (s)", "family", "KS distance", "p")
DOUBTFUL = 0.05
SHORTEST = 1e-9  # seconds: a dwell time of none, for a file, where they are positive


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


def switching_section(model: SemiMarkov) -> str:
    """The [switching] section of a problem file that describes the model.

    Examples
    --------
    >>> from scipy import stats
    >>> import deadtime as dt
    >>> print(switching_section(dt.SemiMarkov([0.5, stats.expon(loc=0.2, scale=0.3)])))
    [switching]
    kind = "semi-markov"
    sojourn = [
      0.5,
      { distribution = "expon", loc = 0.2, scale = 0.3 },
    ]
    transition = [
      [0.0, 1.0],
      [1.0, 0.0],
    ]
    """
    sojourns = "".join(f"  {_sojourn(dist)},\n" for dist in model.sojourn)
    rows = "".join(f"  [{', '.join(map(repr, row))}],\n" for row in model.transition.tolist())
    text = f'[switching]\nkind = "semi-markov"\nsojourn = [\n{sojourns}]\ntransition = [\n{rows}]'
    if any(isinstance(dist, Truncated) for dist in model.sojourn):
        least, most = zip(*map(_limits, model.sojourn), strict=True)
        text += f"\ndwell_time = {list(least)}\nmaximum_dwell = {list(most)}"
    return text


def _limits(dist: Distribution) -> tuple[float, float]:
    """The shortest and the longest sojourn that a file can state."""
    if isinstance(dist, Truncated):
        return max(dist.low, SHORTEST), dist.high
    return (dist.length, dist.length) if isinstance(dist, Fixed) else (SHORTEST, math.inf)


def _sojourn(dist: Any) -> str:
    if isinstance(dist, Fixed):
        return repr(float(dist.length))
    dist = dist.dist if isinstance(dist, Truncated) else dist
    keys = [*(dist.dist.shapes or "").split(", ")[: len(dist.args)], "loc", "scale"]
    named = dict(zip(filter(None, keys), dist.args, strict=False)) | dist.kwds
    words = "".join(f", {key} = {float(value)!r}" for key, value in named.items())
    return f'{{ distribution = "{dist.dist.name}"{words} }}'


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
