"""What an attacker writes into certificates of the corpus, and makes the digest fit again."""

from __future__ import annotations

import base64
import hashlib
import json
import math

import numpy as np

from certificate_corpus import CORPUS, PAPER
from certificate_reference import packed

HUGE = 10**400


def unpacked(array) -> np.ndarray:
    return np.frombuffer(base64.b64decode(array["data"]), "<f8").reshape(array["shape"]).copy()


def put(path, value):
    """Put a value at a path of keys, or what a function makes of the one there."""

    def edit(content):
        *owners, last = path.split(".")
        for key in owners:
            content = content[key]
        content[last] = value(content[last]) if callable(value) else value

    return edit


def entries(path, change):
    """Change the numbers of an array."""
    return put(path, lambda array: packed(change(unpacked(array))))


def scaled(index, factor):
    def change(X):
        X[index] *= factor
        return X

    return change


def turned(X):
    return X[::-1]


def other_half(X):
    return np.roll(X, len(X) // 2, axis=0)


def cleared(X):
    return 0.0 * X


def nested(path, change):
    return put(path, lambda rows: change(np.array(rows)).tolist())


def other_modes(X):
    return X[:, ::-1]


def without(key):
    return lambda content: content.pop(key)


def without_inside(path):
    owner, key = path.rsplit(".", 1)
    return put(owner, lambda content: {k: v for k, v in content.items() if k != key})


AGED, AVERAGE, LONGEST = "every-age", "average-free", "maximum-free"
JUMPS = "average-turning"
FAR, PAIR, PIECES = "paper-far", "rate", "stretches-every-age"
FREER = [[0, 1, 1], [1, 0, 0], [1, 1, 0]]  # all but one
DWELL, UNTIL = "stretches-dwell", "stretches-maximum-free"

# (name of the certificate, change of its content): false claims, which no check may prove
FALSE = [
    (AGED, put("signals.dwell_time", 0.41)),
    (FAR, put("signals.dwell_time", 0.11)),
    ("paper-dwell", put("signals.dwell_time", 0.21)),
    (PIECES, put("signals.dwell_time", 0.61)),
    (DWELL, put("signals.dwell_time", 0.21)),
    (PAIR, put("signals.dwell_time", 0.09)),
    (PAIR, put("signals.dwell_time", 1e-99)),
    (LONGEST, put("signals.maximum_dwell", 6.0)),
    (LONGEST, put("signals.maximum_dwell", None)),
    (LONGEST, put("signals.maximum_dwell", 900.0)),
    (UNTIL, put("signals.maximum_dwell", 6.0)),
    (UNTIL, put("signals.maximum_dwell", None)),
    ("maximum", put("signals.maximum_dwell", None)),
    (AVERAGE, put("signals.chatter", 6)),
    *((JUMPS, put("lyapunov.mu", lambda mu, part=part: part * mu)) for part in (0.9, 1.5)),
    (JUMPS, put("lyapunov.mu", 1.0)),
    (JUMPS, put("lyapunov.knots", [1])),
    *((JUMPS, put("signals.dwell_time", average)) for average in (5.0, 1.0)),
    *((JUMPS, put("rho", 0.99)), (JUMPS, put("decay_rate", 1.0))),
    (JUMPS, entries("lyapunov.P", lambda P: P[::-1])),
    (AVERAGE, put("signals.dwell_time", 2.0)),
    (AVERAGE, put("signals.dwell_time", 0.5)),
    *((name, put("rho", lambda rho: 0.97 * rho)) for name in (PAIR, AGED, LONGEST, PIECES, UNTIL)),
    *((name, put("decay_rate", 1.0)) for name in (PAIR, AVERAGE, "range", PIECES)),
    (PAIR, put("decay_rate", lambda rate: rate * (1 + 1e-10))),
    ("free-rate-0", put("decay_rate", 1e-300)),
    (FAR, put("plant.A", [PAPER.apart(0.66).A.tolist()])),
    (FAR, nested("plant.A", scaled((0, 1, 0, 0), 1.02))),
    (PAIR, nested("plant.A", lambda A: -A)),
    (PAIR, nested("plant.B", scaled((0, 0), 1.2))),
    (FAR, nested("plant.B", scaled((0, 1), 0.97))),
    ("expected", nested("plant.A", scaled((0, 1), 1.3))),
    ("delayed", nested("plant.B", other_modes), entries("law.F", lambda F: -F)),
    (PAIR, nested("plant.A", lambda A: 1e6 * A)),
    (PAIR, nested("plant.A", lambda A: 1e99 * A)),
    (PAIR, nested("plant.B", lambda B: 1e99 * B)),
    (FAR, entries("law.F", scaled((0, 0, 0), 1.02))),
    (PAIR, entries("law.F", cleared)),
    (PAIR, entries("law.G", cleared)),
    (PIECES, entries("law.F", turned)),
    ("single", entries("law.G", scaled((0, 0), 1.1))),
    ("generic-averaged", entries("law.F", lambda F: F[:, ::-1])),
    ("paper-dwell", entries("law.F", turned)),
    (PAIR, put("plant.delays", [0.2, 0.2])),
    (PAIR, put("plant.delays", [0.295, 0.295])),
    ("delays-both", put("plant.delays", [[0.17, 0.34], [0.26, 0.22]])),
    ("delays-both", put("plant.delays", [[0.04, 0.04], [0.34, 0.26]])),
    ("delays-both", put("plant.delays", [[0.31, 0.11], [0.21, 0.21]])),
    ("delays-inputs", put("plant.delays", [0.34, 0.34])),
    ("delays-inputs", put("plant.delays", [[0.17, 0.34], [0.17, 0.34]])),
    ("delays-modes", put("plant.delays", [[0.2], [0.3]])),
    ("delays-alike", put("plant.delays", [[0.27, 0.37], [0.27, 0.37]])),
    ("delays-short", put("plant.delays", [[0.07, 0.04], [0.04, 0.07]])),
    ("stretches-delays", put("plant.delays", [[0.17, 0.34], [0.26, 0.22]])),
    ("range", put("plant.delays", [0.2, 0.31])),
    ("range-narrow", put("plant.delays", [0.201, 0.299])),
    ("stretches-range", put("plant.delays", [0.1, 0.3])),
    *(("ellipsoid", entries("plant.axes", lambda L, s=s: s * L)) for s in (8.0, 30.0, 1e6)),
    ("ellipsoid", entries("plant.axes", lambda L: L + 0.3)),  # another covariance
    ("ellipsoid", nested("plant.A", lambda A: -A)),
    ("ellipsoid-range", entries("plant.axes", lambda L: 30.0 * L)),
    ("ellipsoid-ranges", entries("plant.axes", lambda L: 30.0 * L)),
    ("stretches-ellipsoid", entries("plant.axes", lambda L: 8.0 * L)),
    ("stretches-ellipsoid", put("lyapunov.knots", [0, 2])),
    ("polytope-mode", put("plant.A", lambda A: [A[0], (4.0 * np.array(A[1])).tolist()])),
    (PAIR, entries("lyapunov.P", lambda P: -P)),
    (PAIR, entries("lyapunov.P", scaled((0, 0), 0.9))),
    (PAIR, entries("lyapunov.P", scaled((0, 0), -1.0))),
    (PAIR, entries("lyapunov.P", lambda P: np.eye(len(P)))),
    (FAR, entries("lyapunov.P", scaled((3, 4), 1.05))),
    (PAIR, entries("lyapunov.P", cleared)),
    (PAIR, entries("lyapunov.P", lambda P: np.triu(P))),
    (AGED, entries("lyapunov.S", np.tril)),
    (PIECES, entries("lyapunov.P", turned)),
    (PIECES, entries("lyapunov.P", lambda P: P[:, ::-1])),
    (FAR, entries("lyapunov.S", turned)),
    (FAR, entries("lyapunov.S", lambda S: S[:, ::-1])),
    (AGED, entries("lyapunov.S", lambda S: -S)),
    (AVERAGE, entries("lyapunov.S", lambda S: S[:, ::-1])),
    (AVERAGE, entries("lyapunov.Psi", lambda Psi: 1.1 * Psi)),
    (AVERAGE, put("lyapunov.knots", [0, 3])),
    (LONGEST, put("lyapunov.knots", [0, 2])),
    (PIECES, put("lyapunov.knots", [3, 4])),
    (PIECES, put("lyapunov.knots", [2, 5])),
    (UNTIL, put("lyapunov.knots", [30])),
    ("stretches-range", put("lyapunov.knots", [0, 1, 3])),
    ("mean", put("law.step", 0.05)),
    (PAIR, entries("lyapunov.P", lambda P: P[:4, :4])),
    (AGED, put("law.step", 0.4)),
    *(("late-far", put("law.mode_lag", lag)) for lag in (1, 3, 6)),
    ("stretches-late-three", put("law.mode_lag", 5)),
    *((name, put("signals.transitions", FREER)) for name in ("ways", "ways-ring", "ways-late")),
    ("ways", put("signals.transitions", [[0, 1, 1], [1, 0, 1], [0, 1, 0]])),
    ("ways", put("signals.transitions", [[0, 0, 1], [1, 0, 0], [1, 0, 0]])),
    ("ways", put("signals.dwell_time", [0.3, 0.31, 0.3])),
    ("ways-ring", put("signals.maximum_dwell", [None, None, 1.2])),
    ("ways-ring", put("signals.maximum_dwell", [9.0, None, 1.2])),
    ("ways-late", put("law.mode_lag", 9)),
    ("stretches-ways", put("signals.transitions", FREER)),
    ("stretches-ways", put("signals.maximum_dwell", [9.0, None, 1.2])),
    ("observed", entries("law.F", scaled((0, 0), 5.0))),  # the observer's gain
    ("observed", entries("law.G", scaled(np.s_[:, 0, :2, :2], 1.5))),
    ("observed-average", entries("law.G", scaled(np.s_[:, 0, :2, :2], 1.5))),
    ("tracking", entries("law.G", scaled(np.s_[:, 0, 1, 1], 1.2))),  # a sum that grows
    ("tracking-disturbance", entries("law.F", cleared)),
    ("observed-late", put("law.mode_lag", 5)),
    *((name, entries("law.F", other_half)) for name in ("lost-observed", "lost-state", "lost-far")),
    *(("lost-observed", entries("lyapunov.P", change)) for change in (other_half, turned)),
    *(("lost-average", entries("lyapunov.S", change)) for change in (other_half, turned)),
    ("lost-unseen", entries("lyapunov.P", turned)),
    ("lost-modes", entries("law.G", scaled(np.s_[-1, 0, :2, :2], 2.0))),  # a prediction that grows
    ("lost-tracking", put("signals.dwell_time", 0.2)),
    *(("samples", without_inside("signals.at"), put("signals.dwell_time", T)) for T in (0.1, 0.05)),
    ("samples-turning", without_inside("signals.at"), put("signals.dwell_time", 0.4)),
    ("samples-turning", put("law.step", 0.05)),
    ("samples-late", entries("law.F", scaled((0, 0, 0), 4.0))),
    ("samples-ring", put("signals.transitions", FREER)),
    ("samples-ring", put("signals.maximum_dwell", [9.0, None, 1.2])),
    ("samples-ring", put("signals.maximum_dwell", [0.9, None, 0.29])),  # no whole period
    ("samples-average", put("signals.dwell_time", 0.5)),
    *(
        (f"samples-{name}", put("rho", lambda rho: 0.97 * rho))
        for name in ("ways", "lost", "range")
    ),
]

# malformed: no certificates at all
MALFORMED = [
    *(("late-far", put("law.mode_lag", lag)) for lag in (0, -1, True, 2.0, 10**7)),
    *((name, put("law.mode_lag", 1)) for name in ("one-mode", "mean")),
    *(("lost-observed", put("law.lost_samples", n)) for n in (0, -1, True, 2.0, 1, 3, 10**7)),
    *(
        (name, put("law.lost_samples", 1))
        for name in ("rate", "late-mode", "observed", "free-rate-0")
    ),
    ("lost-state", put("law.mode_lag", 1)),
    *(
        ("samples", put("signals.at", at))
        for at in ("anywhere", "Samples", True, None, ["samples"])
    ),
    ("lost-state", entries("law.F", lambda F: F[:2])),
    *(("observed", put("law.memory", q)) for q in (0, -1, True, 2.0, 1, 3, 10**7)),
    ("observed", entries("law.G", lambda G: G + 1e-3)),  # reads what was remembered long ago
    ("paper", put("law.memory", 1)),
    *((PAIR, put("rho", rho)) for rho in (1.01, 0.0, -0.9, HUGE, None, "1", True)),
    *((PAIR, put("law.step", step)) for step in (0, -0.1, HUGE, None, [0.1])),
    *((PAIR, put("plant.delays", D)) for D in ([0.3, 0.2], [0.2], 0.2, [HUGE, HUGE], [0, 0])),
    *(
        ("delays-both", put("plant.delays", D))
        for D in (
            [[0.34, 0.17]],
            [[0.34], [0.22]],
            [0.34, [0.22, 0.26]],
            [[0.34, 0.17], 0.2],
            [[0.34, 0.17], [0.22, 0]],
            [[0.34, "0.17"], [0.22, 0.26]],
            [[0.34, HUGE], [0.22, 0.26]],
            [[[0.34, 0.17]], [[0.22, 0.26]]],
            [],
        )
    ),
    (PAIR, put("plant.A", [1.0, 2.0])),
    *(("ellipsoid", put("plant.axes", axes)) for axes in (None, [], [[1.0]], HUGE, {})),
    ("ellipsoid", entries("plant.axes", lambda L: L[:, :1])),
    ("ellipsoid", entries("plant.axes", lambda L: L[:0])),
    ("ellipsoid", entries("plant.axes", lambda L: math.nan * L)),
    ("ellipsoid", put("plant.A", lambda A: A * 2), put("plant.B", lambda B: B * 2)),
    (PAIR, put("plant.A", lambda A: A[0])),
    (PAIR, put("plant.A", [[[[HUGE, 0], [0, 1]]] * 2])),
    (PAIR, put("plant.A", [[[[math.inf, 0], [0, 1]]] * 2])),
    (PAIR, put("plant.B", lambda B: [B[0][:1]])),
    (PAIR, put("law.context", ["mode"])),
    (PAIR, put("law.context", "mode")),
    (PAIR, put("law.context", "\ud800")),
    ("expected", put("law.context", "none")),
    *((PAIR, put("law.ages", ages)) for ages in (0, 1.5, HUGE, True, math.inf)),
    (AGED, put("law.ages", 4)),
    *((PAIR, put("law.F.shape", shape)) for shape in ([10**9] * 2, [math.inf], [-1, 1, 2], "1")),
    *((PAIR, put("lyapunov.P.data", data)) for data in (3, "\ud800", "AAAA", "?", None)),
    (PAIR, entries("lyapunov.P", lambda P: math.nan * P)),
    (PAIR, entries("law.F", lambda F: math.inf * F)),
    (PAIR, put("lyapunov.kind", ["linear"])),
    (PAIR, put("lyapunov.kind", "stretches")),
    (PIECES, put("lyapunov.kind", "linear")),
    *((FAR, put("lyapunov.knots", knots)) for knots in ([1, 0], [0, 0], [0], [0, 1.5], [1, 2], 0)),
    (PIECES, put("lyapunov.knots", [-1, 2])),
    *((PAIR, put("signals.chatter", chatter)) for chatter in (0, True, 1.5, -1)),
    *((JUMPS, put("lyapunov.mu", mu)) for mu in (0.99, None, True, "2", 1e101, HUGE)),
    *((JUMPS, put("signals.chatter", 1)), (PIECES, put("lyapunov.mu", 1.0))),
    (LONGEST, put("signals.chatter", 2)),
    (LONGEST, put("signals.maximum_dwell", 0.5)),
    *((LONGEST, put("signals.maximum_dwell", T)) for T in (math.inf, math.nan, HUGE, "9")),
    *(
        ("ways", put("signals.transitions", ways))
        for ways in (
            [[0, 1, 1], [1, 0, 1], [1, 1, 0]],  # all of them: then the file leaves it out
            [[1, 1, 0], [1, 0, 1], [0, 1, 0]],
            [[0, 1, 0], [1, 0, 1], [0, 0.5, 0]],
            [[0, 1], [1, 0]],
            [0, 1, 0],
            [],
            True,
        )
    ),
    ("ways-ring", put("signals.transitions", [[0, 0, 0], [1, 0, 1], [1, 0, 0]])),
    *(
        ("ways-ring", put("signals.maximum_dwell", most))
        for most in ([math.inf, None, 1.2], [0.9, None], [0.2, None, 1.2], [0.9, "1", 1.2], [])
    ),
    *((PAIR, put("signals.clock_tolerance", d)) for d in (0.0, -0.1, 1.0, None, 1e-9, 0.11)),
    (AGED, put("signals.clock_tolerance", 0.5)),
    (FAR, put("signals.clock_tolerance", 0.4)),
    (PAIR, put("signals.clock_tolerance", 0.8)),
    *((AVERAGE, put("signals.chatter", count)) for count in (HUGE, 10**9, 10**5 + 1)),
    (AVERAGE, put("signals.dwell_time", 6e3)),  # twice as long a bucket: over 10⁵ periods
    *((PAIR, put(f"signals.{name}", 1.01e4)) for name in ("dwell_time", "maximum_dwell")),
    (PAIR, put("plant.delays", [1.01e4, 1.01e4])),
    (PAIR, put("signals.dwell_time", 1e-300)),
    *((PAIR, nested(f"plant.{M}", lambda X: 1e300 * X)) for M in "AB"),
    (PAIR, put("rho", 0.009)),
    *((PAIR, put("decay_rate", rate)) for rate in (-1.0, -1e-300, math.inf, "0.1", True, HUGE)),
    *((name, put("version", v)) for name in (PAIR, PIECES) for v in (1, None, {}, ["0.1"], True)),
    (PAIR, put("version", "\ud800")),
    (PAIR, put("plant.A", lambda A: [[[[2**53 + 1, 0], [0, 1]], A[0][1]]])),  # no binary64
    *(
        (name, put(f"{array}.{key}", "all"))  # what nobody checks, in any array
        for name, array in (
            *((PAIR, array) for array in ("law.F", "law.G", "lyapunov.P", "lyapunov.Psi")),
            *(("ellipsoid", "plant.axes"), (AGED, "lyapunov.S"), (PIECES, "lyapunov.P")),
        )
        for key in ("claim", "Data")
    ),
    *((PAIR, without_inside(f"law.F.{key}")) for key in ("shape", "data")),
    *((name, without("hints")) for name in (PAIR, PIECES, UNTIL)),
    *((name, put("hints", hints)) for name in (PAIR, PIECES) for hints in (None, [], "none")),
    (PIECES, put("hints.deep", [[[[[[[[[[[[[[[[[[[[0]]]]]]]]]]]]]]]]]]]])),
    *((PAIR, put(part, None)) for part in ("law", "plant", "signals", "lyapunov")),
    *((PAIR, without(key)) for key in ("rho", "lyapunov", "plant")),
    (PAIR, lambda c: c.update(claim="all")),
    (PAIR, lambda c: c["signals"].update(note="all of them")),
    (PAIR, put("format", "deadtime certificate 1")),
]


def signed(content) -> str:
    """The text of a certificate with a digest that fits."""
    content = {key: value for key, value in content.items() if key != "sha256"}
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    content["sha256"] = hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()
    return json.dumps(content)


def forged(forgery) -> str:
    name, *edits = forgery
    content = json.loads((CORPUS / f"{name}.json").read_text(encoding="utf-8"))
    for edit in edits:
        edit(content)
    return signed(content)
