"""What a page assumes of the switching where a problem file does not say it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from deadtime.app.delays import longest_delay
from deadtime.scenarios.sweeps.axes import Draft, sojourn_section

_SHARE = 0.2  # of the delay, where a file says nothing that a dwell time could be read from


def dwell_time_of(draft: Mapping[str, Any]) -> float:
    """The dwell time that a problem file states or its signal keeps, seconds.

    Examples
    --------
    >>> dwell_time_of({"signal": {"kind": "switches", "times": [0, 0.5, 1.5], "modes": [0, 1, 0]}})
    0.5
    >>> dwell_time_of({"signal": {"kind": "constant"}, "plant": {"delay": 2.0}})
    0.4
    """
    signal = draft["signal"]
    stated = [signal.get("dwell_time"), *(law.get("dwell_time") for law in draft.get("law", []))]
    stated = [min(one, default=0.0) if isinstance(one, list) else one for one in stated]
    for one in stated:
        if isinstance(one, (int, float)) and one > 0.0:
            return float(one)
    if signal["kind"] == "switches" and len(signal["times"]) > 1:
        return float(np.diff(signal["times"]).min())
    if signal["kind"] == "periodic":
        return float(min(signal["sojourns"]))
    return _SHARE * longest_delay(draft)


def with_model(draft: Mapping[str, Any]) -> Draft:
    """The draft with a [switching] model: its own, that of its random signal, or a usual one."""
    if "switching" in draft:
        return dict(draft)
    signal, dwell_time = draft["signal"], dwell_time_of(draft)
    sojourn: Any = sojourn_section("exponential", dwell_time)
    if signal["kind"] == "random" and signal.get("mean_sojourn") and signal.get("dwell_time"):
        rest = signal["mean_sojourn"] - dwell_time
        sojourn = (
            {"distribution": "expon", "loc": dwell_time, "scale": rest}
            if rest > 0
            else (dwell_time)
        )
    return {**draft, "switching": {"kind": "semi-markov", "sojourn": sojourn}}
