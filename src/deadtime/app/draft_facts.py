"""Facts read from a draft of a problem file: its delays, its dwell time and its switching model."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from deadtime.base.wording import input_names
from deadtime.scenarios.sweeps.axes import Draft, sojourn_section


def longest_delay(draft: Mapping[str, Any]) -> float:
    """The longest delay of a problem file, seconds; NaN where one of them is, 0 of none.

    Examples
    --------
    >>> longest_delay({"plant": {"delay": [[1.2, 0.7], [0.9, 0.7]]}})
    1.2
    """
    return float(np.max(_values(draft["plant"]["delay"]), initial=0.0))


def shortest_delay(draft: Mapping[str, Any]) -> float:
    """The shortest delay of a problem file, seconds; NaN where one of them is."""
    return float(np.min(_values(draft["plant"]["delay"]), initial=longest_delay(draft)))


def _values(given: Any) -> list[float]:
    """Every number of nested lists, whatever their shapes: the file may not hold together."""
    if isinstance(given, list):
        return [value for one in given for value in _values(one)]
    return [float(given)]


def moved_delays(draft: Mapping[str, Any]) -> Iterator[tuple[str, str, float]]:
    """Delays that can be moved: name, label and value of each.

    One that all inputs have in all modes; else one per input where modes share them, and one per
    mode and input where they do not.

    Examples
    --------
    >>> plant = {"B": [[[0.0, 1.0]], [[1.0, 1.0]]], "inputs": ["throttle", "brake"]}
    >>> [*moved_delays({"plant": {**plant, "delay": [0.3, 0.1]}})]
    [('delay.0', 'Delay of throttle (s)', 0.3), ('delay.1', 'Delay of brake (s)', 0.1)]
    >>> [label for _, label, _ in moved_delays({"plant": {**plant, "delay": [[0.3], [0.1]]}})]
    ['Delay in mode 0 (s)', 'Delay in mode 1 (s)']
    """
    plant = draft["plant"]
    table = np.atleast_2d(np.asarray(plant["delay"], dtype=float))
    inputs = plant.get("inputs") or input_names(len(plant["B"][0][0]))
    modes = plant.get("modes") or [f"mode {i}" for i in range(len(table))]
    shared, single = bool((table == table[0]).all()), table.shape[1] == 1
    if shared and single:
        yield "delay", "Delay D (s)", float(table[0, 0])
    elif shared:
        for j, value in enumerate(table[0].tolist()):
            yield f"delay.{j}", f"Delay of {inputs[j]} (s)", value
    else:
        for (i, j), value in np.ndenumerate(table):
            whose = f"in {modes[i]}" if single else f"of {inputs[j]}, {modes[i]}"
            yield f"plant.delay.{i}.{j}", f"Delay {whose} (s)", float(value)


def delay_error(draft: Mapping[str, Any]) -> float:
    """Mean relative error of the delays: true over model, less 1.

    Examples
    --------
    >>> round(delay_error({"plant": {"delay": [0.5, 0.2]}, "truth": {"delay": 0.5}}), 12)
    0.75
    """
    believed = np.asarray(draft["plant"]["delay"], dtype=float)
    true = draft.get("truth", {}).get("delay")
    return 0.0 if true is None else float(np.mean(np.asarray(true, dtype=float) / believed)) - 1.0


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
