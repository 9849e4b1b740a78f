"""Files that are right, small, and between them use every section and key."""

from __future__ import annotations

from importlib.resources import files

PLAIN = """\
[plant]
delay = 0.35
A = [[[0.5, 1.0], [0.0, -0.2]], [[0.4, 1.0], [0.1, -0.3]]]
B = [[[0.0], [1.0]], [[0.0], [1.1]]]
states = ["x", "v"]
modes = ["slow", "fast"]

[gains]
poles = [-1.0, -2.0]

[signal]
kind = "switches"
times = [0.0, 0.7, 1.55]
modes = [0, 1, 0]
dwell_time = 0.5

[run]
x0 = [1.0, 0.0]
horizon = 4.0
step = 0.1
u0 = [0.5]
"""

AT_REST = PLAIN.replace("u0 = [0.5]\n", "")  # as studies want it


def _with(*changes: tuple[str, str], end: str = "") -> str:
    """The plain file, with parts of it replaced."""
    text = PLAIN
    for old, new in changes:
        head, _, rest = text.partition(old)
        text = head + new + rest
    return text + end


_SIGNAL = PLAIN[PLAIN.index('kind = "switches"') : PLAIN.index("\n[run]")]
_POLES = "poles = [-1.0, -2.0]"
_EXPON = """\
[switching]
kind = "semi-markov"
sojourn = { distribution = "expon", loc = 0.3, scale = 1.0 }
"""

PROBLEMS = (
    *(files("deadtime.problems").joinpath("files", f"{name}.toml").read_text(encoding="utf-8")
      for name in ("paper", "three-mode", "follower")),
    PLAIN,
    _with((_POLES, 'lqr = { Q = [[1.0, 0.0], [0.0, 1.0]], R = [[2.0]] }'), end="""
[[law]]
kind = "averaged"
name = "wrong"
weights = [0.25, 0.75]
dwell_time = 0.2
model = { delay = 0.4 }
[[law]]
kind = "mean"
gain = [[-5.0, -3.0]]
low_pass = 0.1
[[law]]
kind = "single"
mode = 1
[truth]
delay = 0.36
"""),
    _with((_POLES, "K = [[[-3.0, -4.0]], [[-3.0, -4.0]]]\nallow_unstable = true"),
          (_SIGNAL, 'kind = "periodic"\nsojourns = [1.0, 2.0]\nmodes = [0, 1]\n'), end="""
[[imperfection]]
kind = "noise"
std = [0.1, 0.2]
[[imperfection]]
kind = "saturation"
low = -1.0
high = 2.0
[[imperfection]]
kind = "coloured-disturbance"
std = 0.1
time_constant = 0.5
force = [0.0, 1.0]
[[imperfection]]
kind = "step-disturbance"
force = [0.0, 1.0]
start = 1.0
"""),
    _with((_SIGNAL, 'kind = "random"\ndwell_time = 0.3\nseed = 4\n'), end="""
[switching]
kind = "markov"
rates = [[0.0, 0.5], [0.7, 0.0]]
[observer]
kind = "kalman"
C = [[1.0, 0.0]]
process = [[1.0, 0.0], [0.0, 1.0]]
measurement = [[0.01]]
"""),
    _with((_SIGNAL, 'kind = "model"\nseed = 2\n'), end=_EXPON + """
[observer]
kind = "luenberger"
C = [[1.0, 0.0]]
poles = ["-4+1j", "-4-1j"]
estimate = [0.0, 0.0]
"""),
    _with((_SIGNAL, 'kind = "half-space"\nnormal = [1.0, 0.0]\noffset = 0.1\n'),
          ("step = 0.1", 'step = "ideal"')),
    _with((_SIGNAL, """kind = "polyhedra"
regions = [
  { H = [[1.0, 0.0]], h = [0.0], mode = 0 },
  { H = [[-1.0, 0.0]], h = [0.0], mode = 1 },
]
"""), end='[[law]]\nkind = "state-dependent"\n'),
    _with((_SIGNAL, 'kind = "quadratic"\nS = [[[1.0, 0.0], [0.0, 1.0]], [[0.0, 1.0], [1.0, 0]]]')),
    _with((_POLES, "poles = [-1.0, -2.0, -3.0]"), ("u0 = [0.5]\n", ""), end="""
[servo]
tracked = ["x"]
reference = { times = [0.0, 2.0], values = [0.0, 1.0] }
integral = true
[observer]
kind = "luenberger"
C = [[1.0, 0.0]]
outputs = ["x"]
poles = [-4.0, -5.0]
"""),
    _with(("poles", "allow_unstable = false\npoles"), end="""
[[law]]
kind = "averaged"
[[offset]]
mode = 1
force = [0.0, 0.5]
[servo]
tracked = [[0.0, 1.0]]
reference = [0.5]
integral = false
disturbance = [[0.0], [1.0]]
[observer]
kind = "luenberger"
C = [[1.0, 0.0], [0.0, 1.0]]
poles = [-4.0, -5.0, -6.0]
"""),
    _with((_SIGNAL, 'kind = "log"\nfile = "log.csv"\nlabels = { idle = 0, busy = 1 }\n')),
)  # fmt: skip

LOGS = (
    "time,mode\n0.0,0\n0.5,1\n2.0,0\n9.0,0\n",
    "time,mode,initial_age\n1732300000.1,1,0.25\n1732300000.2,0,\n1732300000.4,1,\n",
    'mode,"speed",time\r\n1,9,100\r\n0,"9,5",100.5\r\n',
    "time,mode\n3.0,idle\n3.5,busy\n5.0,idle\n9.0,idle\n",
)

STUDIES = (
    """\
title = "A study"
problem = "plain.toml"
poles = [-1.0, "-2"]
horizon = 4.0
scenarios = 5
laws = ["averaged", "mean"]
metrics = ["ise", "peak"]
[grid]
dwell_time = [0.2, 0.8]
delay = [0.3, 0.5]
sojourn = ["exponential", "uniform"]
""",
    """\
problem = "plain.toml"
step = 0.1
[grid]
"plant.delay" = [0.3, 0.35]
dwell_time = 0.4
distance = [0.5, 1.0]
noise = [0.0, 0.1]
seed = [0, 1]
[[imperfection]]
kind = "dropout"
probability = 0.1
""",
    """\
problem = "paper"
[grid]
run.step = [0.05, 0.1]
dwell_time = 0.4
saturation = 5.0
mode_delay = 1
delay_error = [0.0, 0.1]
gain_error = 0.1
speed = 1.5
start = 2.0
""",
)
