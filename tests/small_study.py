"""A small study, as text and from its file."""

from deadtime.scenarios.sweeps import load_study

PLAIN = """\
title = "A small study"
problem = "paper"
poles = [-1.0, -2.0]
horizon = 6.0
step = 0.05
scenarios = 8
laws = ["averaged", "mean", "mean, dwell-aware", "expected", "delay ignored"]

[grid]
dwell_time = [0.2, 0.8]
distance = [0.5, 1.0]
delay = [0.5]
sojourn = ["exponential", "fixed"]
"""


def load(tmp_path, text=PLAIN):
    path = tmp_path / "mine.toml"
    path.write_text(text, encoding="utf-8")
    return load_study(path)
