"""python verifier/verify.py certificate.json ...: needs python-flint, and nothing of deadtime's.

FORMAT.md, beside this file, says what a certificate holds, and that it has to prove
    V − Mᵀ V₊ M/g ≻ 0,    g = ρ^(2L),                                                       (1)
for every link, a stretch of L periods from a node of the graph to the next.

**Only n rows move.** In one period of a link the instant s of a switch may vary. Its matrix is
[E Y₀; U₀]: E (n rows) propagates (x, the inputs read) = Y₀ ξ, U₀ has the rows of u_k, ….
With the products Q and S of the periods before and after it M = S [E Y; U], Y = Y₀ Q, U = U₀ Q.
Let Sᵀ V₊ S = [a, bᵀ; b, c], a ≻ 0 (checked), and complete the square:
    V − Mᵀ V₊ M/g = H − Kᵀ (a/g) K,  H = V − (Uᵀ c U − Zᵀ a⁻¹ Z)/g,  K = E Y + a⁻¹ Z,  Z = bᵀ U.
It is ≻ 0 only if H is, and then, by the two Schur complements of [H, Kᵀ; K, g a⁻¹], exactly if
    F(E) = g a⁻¹ − [E I] G [E I]ᵀ ≻ 0,    G = W H⁻¹ Wᵀ,    W = [Y; a⁻¹ Z].                   (2)
Only (2), of order n, depends on s. If T H Tᵀ is within ε < 1 of I in the norm ∞, its eigenvalues
are ≥ 1 − ε, so H ≻ 0 and H⁻¹ ⪯ TᵀT/(1 − ε); with this for H⁻¹, (2) says more. T may be anything.

**All instants.** The instant, and where they vary the delay in its range and the weights of the
vertices, are parameters p. On a cell of p with centre q, by the mean value theorem for each entry,
    E(p) ∈ E(q) + Σ (p_k − q_k) D_k + R,  ∂E/∂p_k ∈ D_k ± r_k on the cell,  |R| ≤ Σ |p_k − q_k| r_k,
and p is in the hull of the cell's corners: E is in the hull of sets E_c + R, one per corner. F is
concave, for G ⪰ 0: (2) holds on the cell if it does for all E_c + R. In balls,
    F(E_c + R) = F(E_c) − R Nᵀ − N Rᵀ − R G₁₁ Rᵀ,    N = the first columns of [E_c I] G,
is ≻ 0 if T F Tᵀ is within ε < 1 of I, T from its centre: R counts in units in which F is I. A cell
that fails is halved (R falls with the square of its size), unless its centre fails too.

**An ellipsoid** of plants adds δ = Σ z_i M_i + R' to E, |z| ≤ 1, by the mean value theorem over the
cell and all of the ellipsoid, |R'| ≤ r entry by entry. By Cauchy and Schwarz (ηᵀ δ y)² is at most
(η ⊗ y)ᵀ C (η ⊗ y), C = (1 + ε) Σ vec M_i vec M_iᵀ + (1 + 1/ε) n k diag r², so at most ηᵀWη yᵀXy if
W ⊗ X ⪰ C (checked). Then p = δᵀη has pᵀX⁻¹p ≤ ηᵀWη, and (2) holds for all of it if, for some μ,
    [F(E) − μ W, −N; −Nᵀ, μ X⁻¹ − G₁₁] ≻ 0.

**A period** is cut at t_1 ≤ t_2 … into pieces, E = … e^{X_2 (t_2 − t_1)} e^{X_1 t_1},
X = [A, B; 0, 0] with each column of B at the input read. As X commutes with its exponential,
    ∂E/∂p = Σ_k ∂t_k/∂p (the pieces after t_k) (X_k − X_{k+1}) (the pieces before it).
The t_k are marks, every φ, and s, a part u of the way from one mark, or 0, to the next, or h: E
has a kink where s is at a mark. With vertices, X = X⁰ + Σ λ_v (Xᵛ − X⁰), and
∂e^{Xτ}/∂λ_v is the upper right block of exp τ[X, Xᵛ − X⁰; 0, X]. e^X = (e^{X/2^k})^(2^k), where
|X/2^k| = θ ≤ 1/8 in the norm ∞: 24 terms of its series leave < θ²⁵/25!/(1 − θ/26) in every entry.

**Ages.** For "linear", V_{i,a} and V at the next node are affine in the age a between breakpoints
(knots, `last`, q₀, q₀ + 1, with a bucket q₀ + knots, all ages where rows go by age, the mode is
told late or samples are lost), and M is the same: so (1) at the first and the last age there
implies the others, as it does for V ≻ 0.

**Rounding.** P, Ψ, S, F, G, ρ are exact; V and up to order 16 its leading minors are rational.
A, B, delays, the period are balls of half a unit in the last place; ages come from quotients of
decimals. All else is in Arb's balls at 160 bits: a comparison is true only if it is for all of one.

**An average dwell time**, "stretches": over a period V falls by ρ² μ^(−1/r), times μ where it
switches. Of k periods at most N₀ + k/r do: together V falls by ρ^(2k) μ^N₀.
"""

import argparse
import base64
import hashlib
import itertools
import json
import math
import struct
import sys
import time
from fractions import Fraction
from functools import lru_cache
from pathlib import Path
from types import SimpleNamespace

from flint import arb, arb_mat, ctx, fmpq, fmpq_mat

BITS, TERMS, EXACT_ORDER, CELLS, DEEPEST = 160, 24, 16, 20000, 60  # cells kept; their bisections
NEAR = Fraction(1, 10**9)  # of a period: a time so near a multiple of it is that multiple
LARGEST_FILE, LARGEST_NORM, PERIODS = 1 << 30, 1 << 20, 10**5  # bytes; of A h and B h; of times
FREE, PER_NUMBER, HALVINGS, STRETCHES = 3 * 10**7, 10**5, 100, 5000  # of work: FORMAT.md


def need(condition, message):
    if not condition:
        raise ValueError(message)


def take(value, name, keys):
    odd = sorted(set(value) ^ set(keys.split()))
    need(not odd, f"{name} lacks, or has too many: {ascii(odd)[:80]}")
    return [value[k] for k in keys.split()]


def real(value, name):
    need(type(value) in (int, float), f"{name} is not a number")
    need(abs(value) <= sys.float_info.max and float(value) == value, f"{name} is not binary64")
    need(value == 0 or 1e-100 <= abs(value) <= 1e100, f"{name} is beyond 1e±100")
    return float(value)


def whole(value, name, least):
    need(type(value) is int and value >= least, f"{name} is not an integer, {least} or more")
    return value


def nested(value, name, *shape):
    """Lists of lists of numbers of a shape; None stands for any length above 0."""
    if not shape:
        return real(value, name)
    need(value and shape[0] in (None, len(value)), f"{name} has not the shape that it should have")
    return [nested(entry, name, *shape[1:]) for entry in value]


def array(value, name, *shape):
    """Nested lists of a stored array, whose numbers are base64."""
    sizes, data = take(value, name, "shape data")
    fits = all(k in (None, whole(s, name, 0)) for s, k in zip(sizes, shape, strict=True))
    raw = base64.b64decode(data, validate=True)
    need(fits and len(raw) == 8 * math.prod(sizes), f"{name} has not the shape {shape}")
    flat = [real(x, name) for x in struct.unpack(f"<{len(raw) // 8}d", raw)]
    for k in range(len(sizes) - 1, 0, -1):
        r, count = sizes[k], math.prod(sizes[:k])
        flat = [flat[i * r : i * r + r] for i in range(count)]
    return flat


def parsed(path):
    """The file's object and its digest, which has to fit."""
    path, twice = Path(path), "a key occurs twice"
    need(path.is_file() and path.stat().st_size <= LARGEST_FILE, "no such file, or too large a one")
    hook = lambda pairs: need(len(dict(pairs)) == len(pairs), twice) or dict(pairs)  # noqa: E731
    content = json.loads(path.read_bytes().decode("utf-8-sig"), object_pairs_hook=hook)
    need(depth(content) <= 20, "it is nested too deeply")
    stated = content.pop("sha256", None)
    line = json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    digest = hashlib.sha256(line.encode()).hexdigest()
    need(stated == digest, "its digest does not fit: cut short, or changed since it was written")
    return content, digest


def depth(value):
    if not isinstance(value, (dict, list)):
        return 0
    return 1 + max(map(depth, value.values() if isinstance(value, dict) else value), default=0)


def certificate(content):
    """The content of a file, checked for shapes and ranges."""
    keys = "format version decay_rate plant law signals rho lyapunov hints"
    form, by, rate, plant, law, signals, rho, lyapunov, hints = take(content, "the file", keys)
    need(form == "deadtime certificate 2", "the format is not 'deadtime certificate 2'")
    need(type(by) is str and type(hints) is dict, "version is no text, or hints are no object")
    need(rate is None or type(rate) in (int, float), "decay_rate is not a number")
    c = SimpleNamespace(rho=real(rho, "rho"), rate=0 if rate is None else rate)
    need(0 <= c.rate <= sys.float_info.max, "decay_rate is negative, or not finite")
    A, B, c.delays, *axes = take(plant, "plant", "A B delays" + " axes" * ("axes" in plant))
    c.vertices, c.modes, c.n, c.m = len(A), len(A[0]), len(A[0][0]), len(B[0][0][0])
    c.A = nested(A, "A", c.vertices, c.modes, c.n, c.n)
    c.B = nested(B, "B", c.vertices, c.modes, c.n, c.m)
    c.axes = array(axes[0], "axes", None, c.modes, c.n, c.n + c.m) if axes else []
    need(not axes or (c.axes and c.vertices == 1), "axes are none, or those of several vertices")
    c.off = lambda i, a, b: sum((arb(axis[i][a][b]) ** 2 for axis in c.axes), arb(0)).sqrt().upper()
    c.set = f" in an ellipsoid of {len(c.axes)} axes" * (len(c.axes) > 0)
    each = type(c.delays[0]) is list  # delays of every mode and input; else low and high of one
    c.box = each and type(c.delays[0][0]) is list  # low and high of every mode and input
    D = nested(c.delays, "delays", *(2,) * (c.box or not each), *(c.modes, c.m) * each)
    low, high = D if c.box or not each else (D, D)
    every = [(i, j) for i in range(c.modes) for j in range(c.m)]
    pairs = [(low[i][j], high[i][j]) if each else (low, high) for i, j in every]
    c.D = [pairs[i * c.m : i * c.m + c.m] for i in range(c.modes)]
    more = [k for k in ("mode_lag", "memory", "lost_samples") if k in law]
    c.context, ages, step, F, G, *n = take(law, "law", " ".join(["context ages step F G", *more]))
    found = {k: whole(x, k, 1) for k, x in zip(more, n, strict=True)}
    c.lag, c.q, c.lost = (found.get(k, 0) for k in ("mode_lag", "memory", "lost_samples"))
    c.ages, c.step = whole(ages, "ages", 1), real(step, "step")
    rows = {"none": 1, "mode": c.modes, "mode_age": c.modes * c.ages}.get(str(c.context))
    need(rows and (c.context == "mode_age" or c.ages == 1), "context is unknown, or ages not 1")
    fits = not c.lag or (c.context != "none" and c.modes > 1 and c.lag * rows <= 10**6)
    need(fits, "mode_lag where no row reads the mode, or too long a one")
    need(not c.lost or (not c.lag and 2 * c.lost * rows <= 10**6), "lost_samples does not fit")
    c.measured, rows = rows, rows * (1 + (c.lost > 0))  # then as many of lost samples
    out = c.q + c.m  # of the table: what is remembered, then the inputs
    c.F, c.G = array(F, "F", rows, out, c.n), array(G, "G", rows, None, out, out)
    need(c.G[0], "G has no taps")
    need(not any(x for r in c.G for g in r[1:] for y in g for x in y[: c.q]), "G reads an old w")
    ways, c.samples = "transitions" in signals, "at" in signals
    keys = "dwell_time maximum_dwell chatter clock_tolerance"
    keys += " transitions" * ways + " at" * c.samples
    dwell, maximum, chatter, tolerance, *matrix = take(signals, "signals", keys)
    need(signals.get("at", "samples") == "samples", "at is not 'samples', nor left out")
    c.dwell, c.maximum = per_mode(dwell, "dwell_time", c), per_mode(maximum, "maximum_dwell", c)
    c.chatter, c.tolerance = whole(chatter, "chatter", 1), real(tolerance, "clock_tolerance")
    others = [{*range(c.modes)} - {i} for i in range(c.modes)]
    c.follow = following(matrix[0], c) if ways else others
    fits = c.step > 0 and all(x and x > 0 for x in c.dwell) and 1e-8 <= c.tolerance <= 0.1
    fits = fits and all(0 < low <= high for row in c.D for low, high in row)
    need(fits and 0.01 <= c.rho <= 1, "delays, step, dwell_time, clock_tolerance or rho are off")
    times = [*c.dwell, *(x for x in c.maximum if x), *(x for row in c.D for _, x in row)]
    fits = c.chatter <= PERIODS and c.chatter * max(c.dwell) <= PERIODS * c.step
    need(fits and max(times) / c.step <= PERIODS, f"a time is above {PERIODS} periods")
    pairs = [*zip(c.dwell, c.maximum, strict=True)]
    fits = all(x is None or low <= x for low, x in pairs)
    fits = fits and (c.chatter == 1 or (maximum is None and type(dwell) is not list))
    need(fits, "maximum_dwell is below dwell_time, or chatter is not 1")
    entered = set().union(*c.follow)
    fits = [c.follow[i] or (c.maximum[i] is None and i in entered) for i in range(c.modes)]
    need(all(fits) or c.modes == 1, "transitions lead nowhere from a mode, or neither in nor out")
    c.linear = lyapunov["kind"] == "linear"
    c.averaged = not c.linear and c.chatter > 1 and c.modes > 1
    keys = "kind knots P" + " Psi S" * c.linear + " mu" * c.averaged
    kind, knots, P, *rest = take(lyapunov, "lyapunov", keys)
    need(c.linear or kind == "stretches", "lyapunov.kind is neither 'linear' nor 'stretches'")
    c.mu = real(rest[0], "mu") if c.averaged else 1.0
    need(1 <= c.mu <= 1e100, "mu is not in 1 to 1e100")
    c.knots = [whole(k, "knots", 0) for k in knots]
    fits = c.knots and c.knots == sorted(set(c.knots)) and c.knots[0] * c.linear == 0
    need(fits, "knots do not ascend, or not from 0 where they have to")
    places = c.modes * (c.lost + 1)  # the modes, then the modes after one lost sample, …
    c.P = array(P, "P", *() if c.linear else (places, len(knots)), None, None)
    c.Psi = array(rest[0], "Psi", None, None) if c.linear else []
    c.width = rest[0]["shape"][1] if c.linear else 0
    c.S = array(rest[1], "S", places, len(knots), len(c.Psi), len(c.Psi)) if c.linear else []
    arrays = [law["F"], law["G"], lyapunov["P"], *(rest if c.linear else []), *axes]
    c.numbers = sum(math.prod(x["shape"]) for x in arrays)
    return c


def per_mode(value, name, c):
    """A number, or None, for each mode; a list only where they are not all one."""
    several = type(value) is list
    fits = not several or (len(value) == c.modes and len({*value}) > 1)
    need(fits, f"{name} is no time per mode")
    each = value if several else [value] * c.modes
    need(name != "dwell_time" or None not in each, "dwell_time is missing")
    return [None if x is None else real(x, name) for x in each]


def following(matrix, c):
    """The modes that each may switch to; not all of them, for then the file says nothing."""
    rows = nested(matrix, "transitions", c.modes, c.modes)
    fits = all(type(x) is int and x in (0, 1) for row in matrix for x in row)
    need(fits and not any(row[i] for i, row in enumerate(rows)), "transitions is no matrix of 0, 1")
    need(sum(map(sum, rows)) < c.modes * (c.modes - 1), "transitions allows all: to be left out")
    return [{j for j, x in enumerate(row) if x} for row in rows]


def ball(x):
    """All reals within half a unit in the last place."""
    return arb(x) + arb(0, math.ulp(x)) * arb(0.5)


def eye(n):
    return arb_mat(n, n, [int(i == j) for i in range(n) for j in range(n)])


def block(rows):
    lines = [zip(*(X.tolist() for X in row), strict=True) for row in rows]
    return arb_mat([[x for entries in parts for x in entries] for line in lines for parts in line])


def part(X, top, bottom, left, right):
    entries = [x for row in X.tolist()[top:bottom] for x in row[left:right]]
    return arb_mat(bottom - top, right - left, entries)


def norm(X):
    """An upper bound of the norm ∞."""
    sums = [sum((x.abs_upper() for x in row), arb(0)).upper() for row in X.tolist()]
    return max(sums) if all(s.is_finite() for s in sums) else arb.pos_inf()


def exponential(X):
    size, n, halvings = norm(X), X.nrows(), 0
    need(size < LARGEST_NORM, f"the norm of A h or B h is above {LARGEST_NORM}")
    while not size <= 0.125:
        size, halvings = size / 2, halvings + 1
    X, one, total = X * (arb(1) / 2**halvings), eye(n), eye(n)
    for k in range(TERMS, 0, -1):
        total = one + X * total * (arb(1) / k)
    rest = size ** (TERMS + 1) / arb(math.factorial(TERMS + 1)) / (1 - size / (TERMS + 2))
    total += arb_mat(n, n, [arb(0, 1) * rest] * (n * n))
    for _ in range(halvings):
        total = total * total
    return total


def inverse_factor(H):
    """About L⁻¹ for the centre of H = L Lᵀ, not finite if there is no L; nothing is claimed."""
    H, n = H.mid(), H.nrows()
    if n == 1:
        return arb_mat([[H[0, 0].rsqrt()]]).mid()
    k = n // 2
    T = inverse_factor(part(H, 0, k, 0, k))
    L = part(H, k, n, 0, k) * T.transpose()
    rest = inverse_factor(part(H, k, n, k, n) - L * L.transpose())
    return block([[T, arb_mat(k, n - k)], [rest * L * T * arb(-1), rest]]).mid()


def positive(H):
    """T and a bound ε of |T H Tᵀ − I|; H ≻ 0 if ε < 1."""
    T = inverse_factor(H)
    return T, norm(T * H * T.transpose() - eye(H.nrows()))


def size_of(M):
    """About the largest eigenvalue of a product of two matrices ⪰ 0, not below it."""
    for _ in range(9):
        M = (M * M).mid()
    return sum((M[i, i] for i in range(M.nrows())), arb(0)).root(512).mid()


def root_of(S):
    """About the square root of S ≻ 0, by Denman and Beavers."""
    Y, Z = S, eye(S.nrows())
    for _ in range(12):
        Y, Z = ((Y + Z.inv()) * arb(0.5)).mid(), ((Z + Y.inv()) * arb(0.5)).mid()
    return Y


def kronecker(A, B):
    return arb_mat([[x * y for x in a for y in b] for a in A.tolist() for b in B.tolist()])


def in_units(Q, units):
    """Q with the entry (a, b) times both their units."""
    lines = zip(Q.tolist(), units, strict=True)
    return arb_mat([[x * a * b for x, b in zip(row, units, strict=True)] for row, a in lines])


def traced(C, inverse, n, k, left):
    """Σ of the blocks of C (n k square) by the entries of an inverse, of its left or right part."""
    if left:
        blocks = [[part(C, a * k, a * k + k, b * k, b * k + k) for b in range(n)] for a in range(n)]
        return sum(
            (blocks[a][b] * inverse[a, b] for a in range(n) for b in range(n)), arb_mat(k, k)
        )
    total = lambda a, b: sum(  # noqa: E731
        (C[a * k + p, b * k + q] * inverse[p, q] for p in range(k) for q in range(k)), arb(0)
    )
    return arb_mat([[total(a, b) for b in range(n)] for a in range(n)])


def covered(C, n, k, S, rounds):
    """W, X with W ⊗ X ⪰ C ⪰ 0 about as small as can be (proved), and S to go on from."""
    units = [C[i, i].sqrt() for i in range(n * k)]
    rows = [sum((x * x for x in units[a * k : a * k + k]), arb(0)).sqrt().mid() for a in range(n)]
    rows = [max(x, max(rows) * arb(2) ** -30) for x in rows]
    columns = [
        sum(((units[a * k + p] / rows[a]) ** 2 for a in range(n)), arb(0)).sqrt().mid()
        for p in range(k)
    ]
    columns = [max(x, max(columns) * arb(2) ** -30) for x in columns]
    little, one = arb(2) ** -30, eye(n * k)
    scaled = in_units(C, [1 / (a * p) for a in rows for p in columns])
    F = inverse_factor(scaled.mid() + one * little).inv().mid()  # F Fᵀ is about that
    S, W = one if S is None else S + one * arb(2) ** -4, eye(n)
    for _ in range(rounds):
        G = (F * S * F.transpose()).mid()
        X = (traced(G, W.inv(), n, k, True) + eye(k) * little).mid()
        W = (traced(G, X.inv(), n, k, False) + eye(n) * little).mid()
        W = W * (n / sum((W[a, a] for a in range(n)), arb(0))).mid()
        M = (F.transpose() * kronecker(W.inv(), X.inv()) * F).mid()
        root = root_of((S + one * arb(2) ** -10).mid())
        S = (root * M * root).mid()
        S = (S * (n * k / sum((S[i, i] for i in range(n * k)), arb(0)))).mid()
        S = ((S + S.transpose()) * arb(0.5)).mid()
    W = W * size_of(M) * (1 + arb(2) ** -20)
    W, X = in_units(W, rows).mid(), in_units(X, columns).mid()
    W, X = ((Q + Q.transpose()) * arb(0.5) for Q in (W, X))
    need(positive(kronecker(W, X) - C)[1] < 1, "the ellipsoid was not enclosed")
    return W, X, S


def weight(F, N, G, W, X):
    """About the μ by which F − μ W − N (μ X⁻¹ − G)⁻¹ Nᵀ is most positive; anything will do."""
    inverse, Xi, least = F.inv().mid(), X.inv().mid(), size_of((X * G).mid())

    def lack(log):
        mu = least * (1 + log.exp())
        return size_of((inverse * (W * mu + N * (Xi * mu - G).inv() * N.transpose())).mid())

    low, high, ratio = arb(-25), arb(25), arb(0.618)
    for _ in range(30):
        a, b = (high - ratio * (high - low)).mid(), (low + ratio * (high - low)).mid()
        low, high = (low, b) if lack(a) < lack(b) else (a, high)
    return (least * (1 + low.exp())).mid()


class Loop:
    """The loop of a certificate: its ages, rows, Lyapunov function and periods."""

    def __init__(self, c, limit=1.0):
        self.c, self.n, self.modes = c, c.n, range(c.modes)
        gains = itertools.chain(*c.F, *itertools.chain(*c.G))
        self.acts, self.h = any(map(any, gains)), ball(c.step)  # else no input travels
        need(self.acts or not (c.lost or c.q), "lost_samples or memory, though F and G are zero")
        self.boxed = c.box and self.acts
        if self.boxed:
            self.places, self.reads = self.box_clock()
        else:
            self.marks, self.lags = self.clock(c.D if self.acts else [[]] * c.modes)
            self.reads = sorted({(N, j) for i in self.lags for q in i for j, N in enumerate(q)})
        self.q0, self.q1, self.last = self.ages()
        self.ranged = self.acts and any(low < high for row in c.D for low, high in row)
        N = max([0, *dict(self.reads)])
        self.held, self.k = max(N, len(c.G[0])) * self.acts, c.n + len(self.reads)
        self.d = c.n + c.q + c.m * self.held
        every = [c.P] if c.linear else [*itertools.chain(*c.P)]
        for X in every:
            need(len(X) == self.d == len(X[0]), f"P has not the order {self.d} of the loop")
        for X in itertools.chain(every, *c.S):
            need([*map(list, zip(*X, strict=True))] == X, "P or S is not symmetric")
        need(not c.linear or c.width == self.d, f"Psi has not the order {self.d} of the loop")
        allowed, asked = limit * (FREE + PER_NUMBER * c.numbers), self.work()
        more = f"operations; --limit {limit:g} allows"
        need(asked <= allowed, f"it takes {min(asked, 10**30):.2g} {more} {allowed:.2g}")
        self.left, self.spent = HALVINGS * allowed, f"it takes more {more} {HALVINGS * allowed:.2g}"
        room = 2 + 10**6 // self.d**2
        self.table, self.V = lru_cache(room)(self.new_table), lru_cache(room)(self.new_V)
        self.full, self.after = lru_cache(room)(self.new_full), lru_cache(room)(self.new_after)
        self.enclosure, self.X = lru_cache(CELLS)(self.new_enclosure), lru_cache(self.generator)
        self.X_of, self.known = lru_cache(self.generator_of), {}

    def work(self):
        """Operations that the inequalities take if no cell is halved, by the count of FORMAT.md."""
        c, ends = self.c, {x for row in self.c.D for pair in row for x in pair}
        moving = sorted(sum(low < high for low, high in row) for row in c.D)[-2:]
        moving = sum(moving) if c.box else max(moving) > 0
        cells, corners = (1 + len(ends), 1 + moving) if self.acts else (1, 1)
        total, lost, rows = 0, c.lost, c.measured
        own = c.ages if self.bucket or lost > min(self.q0) else min(c.ages, lost + 1)
        own = own if self.bucket or lost else 1
        most = 4 + 2 * len(c.knots) + c.ages + lost + min(c.lag, c.modes * (c.ages + 1))
        for last, after in zip(self.last, c.follow, strict=True):
            ages = 1 if c.averaged else min(last + 1, 2 * most) if c.linear else last + 1
            if c.lag:
                told = ages * rows if self.bucket else ages + min(ages, c.lag) * (rows - 1)
            elif self.bucket:
                told = ages * ((lost + 1) * own + lost * rows)
            else:
                told = ages * (2 * lost + 1) * own + lost * lost * rows
            total += told * (1 + len(after))
        self.corner = cost(self.k if c.linear else self.d)
        self.cell = 30 * cost(self.n * self.k) * (len(c.axes) > 0)
        cell = self.cell + (self.corner * c.vertices << corners)
        return total * (cost(self.d) + cells * cell)

    def spend(self, operations):
        self.left -= operations
        need(self.left >= 0, self.spent)

    def clock(self, each):
        """0, each φ below h, and h, and how the range moves them; lags by mode, part and input."""
        h, at, marks, here = self.h, {}, [(arb(0), arb(0))], -1
        for D in {D for row in each for D in row}:
            late, first, last, low, high = self.phases(D)
            at[D] = last, first == 1, late, (low, high - low)
        for D, (last, whole, late, mark) in sorted(at.items(), key=lambda item: item[1][0]):
            if not whole and last - here > NEAR:
                here, marks = last, [*marks, mark]
            at[D] = [late + 1] * (len(marks) - 1 + whole) + [late] * (1 + len(at))  # by part
        lags = [[[at[D][q] for D in row] for q in range(len(marks))] for row in each]
        return [*marks, (h, arb(0))], lags

    def phases(self, D):
        """N − 1, both ends of φ/h, and of φ in balls, of a range of delays."""
        h, ratios = self.h, [Fraction(repr(x)) / Fraction(repr(self.c.step)) for x in D]
        ratios = [round(r) if abs(r - round(r)) <= NEAR else r for r in ratios]
        late = math.ceil(ratios[1]) - 1
        first, last = (r - late for r in ratios)
        need(late >= 0 and first >= 0, "the delays are not within one period")
        low = h if first == 1 else ball(D[0]) - late * h if first else arb(0)
        return late, first, last, low, ball(D[1]) - late * h if last < 1 else h

    def box_clock(self):
        """The phases of every mode and input, and what is read: each at N, and N − 1 if φ < h."""
        places = [[self.phases(D) for D in row] for row in self.c.D]
        every = [(j, at) for row in places for j, at in enumerate(row)]
        reads = {(late + 1, j) for j, (late, *_) in every}
        return places, sorted(reads | {(at[0], j) for j, at in every if at[1] < 1})

    def ages(self):
        """q₀, q₁ (None: no bound) and `last` of every mode."""
        c, tolerance, room = self.c, Fraction(repr(self.c.tolerance)), Fraction(1, 2**50)
        h, number = Fraction(repr(c.step)), lambda x: Fraction(repr(float(x or 1)))
        self.shortest = [(1 - tolerance) * (1 - room) * number(x) / h for x in c.dwell]
        self.longest = [(1 + tolerance) * (1 + room) * number(x) / h for x in c.maximum]
        self.bucket = c.chatter > 1 and c.modes > 1
        if c.modes == 1:
            return [0], [None], [c.ages - 1 + c.lost]
        # A sojourn from sample to sample has a full period less than it is long.
        whole = math.ceil if c.samples and not self.bucket else math.floor
        first = [max(whole(x) - 1, -1 + c.samples) for x in self.shortest]
        need(min(first) >= 0, "the dwell time is below one period")
        ends = [(math.floor if c.samples else math.ceil)(x) - 1 for x in self.longest]
        ends = [None if x is None else q for x, q in zip(c.maximum, ends, strict=True)]
        # Without a bucket the last age stands for all later ones.
        lasts = [max(q + (not c.samples), c.ages - 1 + c.lag + c.lost) for q in first]
        if self.bucket:
            lasts = [max(q, math.ceil(c.chatter * number(c.dwell[0]) / h)) for q in first]
        lasts = [q if end is None else end for q, end in zip(lasts, ends, strict=True)]
        need(all(map(int.__le__, first, lasts)), "maximum_dwell leaves no sojourn of whole periods")
        return first, ends, lasts

    def rows(self, mode, age):
        """The rows that may act: of what the law may have been told."""
        if self.c.context == "none" or self.c.lost:
            return self.counted(mode, age, 0)
        late, ages, told = self.c.lag - age, self.c.ages, set()
        if self.bucket:
            first, last = (0, self.c.modes) if self.c.lag else (mode, mode + 1)
            return range(first * ages, last * ages)
        if late <= 0:
            return [mode * ages + min(-late, ages - 1)]
        for here, seen in self.before(mode, late):
            least = min(max(0, seen - late), ages - 1)
            told |= {i * ages + a for i in here for a in range(least, ages)}
        return sorted(told)

    def before(self, mode, late):
        """Modes of the sojourns before, as far back as `late` samples, the last first; how many
        samples they have shown together, each sojourn q₀ + 1 or more."""
        here, seen, known = {mode}, 0, set()
        while seen < late:
            here = {j for j in self.modes for i in here if i in self.c.follow[j]}
            if here <= known:  # then so are all before, and each has been seen at every age
                return
            known, seen = known | here, seen + min(self.q0) + 1
            yield here, seen

    def counted(self, mode, age, since):
        """The rows of a mode that was told `since` samples ago, by the ages that may be counted."""
        c, top = self.c, self.c.ages - 1
        if c.context == "none":
            return [0]
        low, high = max(since, age - c.lost), age
        if c.lost > min(self.q0):  # a sojourn may pass unseen
            high = max(low, top)
        low, high = (0, top) if self.bucket else (low, high)
        return sorted({mode * c.ages + min(a, top) for a in range(low, high + 1)})

    def told(self, mode, age):
        """Every (row, lost samples before, lost samples before the next) that a step may have."""
        c = self.c
        for lost in range(c.lost + 1):
            yield from ((row, lost, 0) for row in self.rows(mode, age))
            if lost < c.lost:
                rows = self.unseen(mode, age, lost + 1)
                yield from ((c.measured + row, lost, lost + 1) for row in rows)

    def unseen(self, mode, age, lost):
        """Rows at the last of so many lost samples in a row, before `measured` is added."""
        c = self.c
        if c.context == "none" or (age >= lost and not self.bucket) or c.modes == 1:
            return self.counted(mode, age, lost)
        if self.bucket:
            return range(c.measured)
        here = {i for modes, _ in self.before(mode, lost - age) for i in modes}
        return sorted(i * c.ages + a for i in here for a in range(c.ages))

    def new_after(self, i, first, j, follows):
        """The product of the periods of mode j after a switch; i is told at first, by its ages."""
        late, ages, M = min(self.c.lag, follows), self.c.ages, eye(self.d)
        for age in range(first, first + late):
            self.spend(cost(self.d))
            M = self.alone(j, i * ages + min(age, ages - 1)) * M
        return self.full(j, late, follows) * M if late else self.full(j, 0, follows)

    def new_table(self, row):
        """Y₀ and U₀ of a row."""
        n, m, q, d = self.n, self.c.m, self.c.q, self.d
        if not self.acts:
            return eye(d), arb_mat(0, n)
        F, G, one = self.c.F[row], self.c.G[row], eye(d).tolist()
        G, out = G + [[[0.0] * (q + m)] * (q + m)] * (self.held - len(G)), range(q + m)
        now = [[*F[i], *G[0][i][:q], *(x for g in G for x in g[i][q:])] for i in out]  # w⁺, u_k
        u = now[q:] + one[n + q :]  # u_k, u_{k−1}, …, u_{k−W}
        Y = arb_mat(one[:n] + [u[N * m + j] for N, j in self.reads])
        return Y, arb_mat(now[:q] + u[: d - n - q])

    def new_V(self, mode, age, lost=0):
        """V at a node, if it is ≻ 0."""
        c, d, place = self.c, self.d, lost * self.c.modes + mode
        rational = lambda X: fmpq_mat([[fmpq(*x.as_integer_ratio()) for x in r] for r in X])  # noqa: E731
        V = rational(c.P if c.linear else c.P[place][c.knots.index(age)])
        if c.Psi:
            Psi, S, knots = rational(c.Psi), c.S[place], [*c.knots, max(age, c.knots[-1]) + 1]
            k = next(k for k in range(len(S)) if age < knots[k + 1])
            share = fmpq(age - knots[k], knots[k + 1] - knots[k])
            after = rational(S[min(k + 1, len(S) - 1)])
            V += Psi.transpose() * (rational(S[k]) * (1 - share) + after * share) * Psi
        balls = arb_mat(d, d, [arb(x) for x in V.entries()])
        minors = (fmpq_mat([row[:k] for row in V.tolist()[:k]]).det() for k in range(1, d + 1))
        fits = all(x > 0 for x in minors) if d <= EXACT_ORDER else positive(balls)[1] < 1
        need(fits, f"V is not positive definite in mode {mode} at age {age}")
        return balls

    def generator(self, vertex, mode, q):
        """X of a piece in a part of the period."""
        c, lags, rows = self.c, self.lags[mode][q], []
        for a, b in zip(c.A[vertex][mode], c.B[vertex][mode], strict=True):
            rows.append([*map(ball, a), *(ball(b[j]) * (lags[j] == N) for N, j in self.reads)])
        return arb_mat(rows + [[0] * self.k] * (self.k - self.n))

    def pieces(self, i, j, q, p):
        """The pieces' modes, parts and durations, and how u and f move the instant before each."""
        u, f = p[:2]
        marks, rise = [low + f * r for low, r in self.marks], [r for _, r in self.marks]
        long = [b - a for a, b in itertools.pairwise(marks)]
        modes, parts = [i] * (q + 1) + [j] * (len(long) - q), sorted([*range(len(long)), q])
        durations = [*long[:q], u * long[q], (1 - u) * long[q], *long[q + 1 :]]
        moved = [(0, r) for r in rise[:-1]]
        moved.insert(q + 1, (long[q], rise[q] + u * (rise[q + 1] - rise[q])))
        return [*zip(modes, parts, durations, strict=True)], moved

    def period(self, i, j, q, p, slopes):
        """E, and if asked for its derivatives by u, by the place f in the range, by λ_1, …."""
        (_, _, *weights), k, zero = p, self.k, arb_mat(self.k, self.k)
        E, D, before = eye(k), [zero] * (2 + len(weights)), zero
        for (mode, at, duration), by in zip(*self.pieces(i, j, q, p), strict=True):
            first, *others = [self.X(v, mode, at) for v in range(self.c.vertices)]
            steps = [X - first for X in others]
            X = sum((w * dX for w, dX in zip(weights, steps, strict=True)), first)
            P = exponential(X * duration)
            if slopes:
                D[:2] = [D[r] + (before - X) * E * by[r] for r in (0, 1)]
                D = [P * slope for slope in D]
                for v, dX in enumerate(steps, 2):
                    doubled = exponential(block([[X, dX], [zero, X]]) * duration)
                    D[v] += part(doubled, 0, k, k, 2 * k) * E
            E, before = P * E, X
        return [part(Q, 0, self.n, 0, k) for Q in (E, *D)]

    def generator_of(self, vertex, mode, read):
        """X of a piece in which one input alone acts, the others' columns zero."""
        c, rows = self.c, []
        for a, b in zip(c.A[vertex][mode], c.B[vertex][mode], strict=True):
            rows.append([*map(ball, a), *(ball(b[read[1]]) * (read == r) for r in self.reads)])
        return arb_mat(rows + [[0] * self.k] * (self.k - self.n))

    def swayed(self, chain):
        """(n k, axes): by how much each axis of the ellipsoid moves E, of a chain of pieces (mode,
        duration, and where each input is read), at all of its points."""
        c, n, k, E, moved = self.c, self.n, self.k, eye(self.k), {}
        for mode, duration, at in chain:
            places = {**{b: b for b in range(n)}, **{n + j: col for j, col in at.items()}}
            X = arb_mat(k, k)
            for a, (b, col) in itertools.product(range(n), places.items()):
                value = c.A[0][mode][a][b] if b < n else c.B[0][mode][a][b - n]
                X[a, col] = ball(value) + arb(0, 1) * c.off(mode, a, b)
            P = exponential(X * duration)
            moved = {place: P * D for place, D in moved.items()}
            for a, (b, col) in itertools.product(range(n), places.items()):
                if any(axis[mode][a][b] for axis in c.axes):
                    Y = arb_mat(k, k)
                    Y[a, col] = arb(1)
                    doubled = exponential(block([[X, Y], [arb_mat(k, k), X]]) * duration)
                    D = part(doubled, 0, k, k, 2 * k) * E
                    place = mode, a, b
                    moved[place] = moved[place] + D if place in moved else D
            E = P * E
        return {place: part(D, 0, n, 0, k) for place, D in moved.items()}

    def sway(self, i, j, q, p):
        """W, X with (ηᵀ δE y)² ≤ (ηᵀ W η) (yᵀ X y) for all of the ellipsoid."""
        c, n, k, m = self.c, self.n, self.k, self.c.m
        if self.boxed:
            u, f, g, moved = p[0], p[1 : m + 1], p[m + 1 : 2 * m + 1], {}
            for at in range(m):
                chain, now = [], arb(0)
                for mode, lag, end, _ in self.arrivals(i, j, q, at, u, f[at], g[at]):
                    column = n + self.reads.index((lag, at))
                    chain, now = [*chain, (mode, end - now, {at: column})], end
                for place, D in self.swayed(chain).items():
                    if at:  # the columns of x are the same for all inputs
                        D = block([[arb_mat(n, n), part(D, 0, n, n, k)]])
                    moved[place] = moved[place] + D if place in moved else D
        else:
            chain = []
            for mode, at, duration in self.pieces(i, j, q, p)[0]:
                places = enumerate(self.lags[mode][at])
                column = {b: n + self.reads.index((N, b)) for b, N in places} if self.acts else {}
                chain.append((mode, duration, column))
            moved = self.swayed(chain)
        if not moved:
            return None, None
        J = arb_mat([*zip(*(D.entries() for D in moved.values()), strict=True)])
        axes = [[arb(axis[mode][a][b]) for axis in c.axes] for mode, a, b in moved]
        L = J * arb_mat(axes)
        C = L.mid() * L.mid().transpose()
        rest = [sum((x.rad() ** 2 for x in r), arb(0)) for r in L.tolist()]
        sizes = sum((C[a, a] for a in range(n * k)), arb(0)), sum(rest, arb(0)) * n * k
        share = (sizes[1] / sizes[0]).sqrt().mid() + arb(2) ** -30
        C = C * (1 + share)
        for a, x in enumerate(rest):
            C[a, a] += x * n * k * (1 + 1 / share)
        before = self.known.get((i, j))
        W, X, self.known[i, j] = covered(C, n, k, before, 50 if before is None else 20)
        return W, X

    def arrivals(self, i, j, q, at, u, f, g):
        """The pieces of input `at`: (mode, lag), its end, how u, f and g move that, f and g the
        places of its delays in modes i and j. The last piece ends with the period."""
        (late, first, last, low, high), to = self.places[i][at], self.places[j][at]
        phase, zero = low + f * (high - low), arb(0)
        if i == j:
            found = [(i, late + 1, phase, (zero, high - low, zero)), (i, late, self.h, ())]
            return found if first < 1 else [(i, late + 1, self.h, ())]
        (a, b), room = q, lambda x: arb(0).union(x.upper()) if x.upper() > 0 else arb(0)
        start, width = self.h * fraction(a), self.h * fraction(b - a)
        s, by_s = start + u * width, (width, zero, zero)
        # τ = min(s, φ): s where φ is later, φ where it is earlier, else anywhere between
        if b <= first + NEAR:
            tau, by = s - room(start + width - low), by_s
        elif a >= last - NEAR:
            tau, by = phase - room(high - start), (zero, high - low, zero)
        else:
            tau, by = low + f * (s - low), (f * width, s - low, zero)
        found = [(i, late + 1, s, by_s)]
        if first < 1:
            found = [(i, late + 1, tau, by), (i, late, s, by_s)]
        late, first, last, low, high = to
        # τ = max(s, φ)
        if a >= last - NEAR:
            tau, by = s + room(high - start), by_s
        elif b <= first + NEAR:
            tau, by = low + g * (high - low) + room(start + width - low), (zero, zero, high - low)
        else:
            tau, by = s + g * (high - s), ((1 - g) * width, zero, high - s)
        if first < 1:
            return [*found, (j, late + 1, tau, by), (j, late, self.h, ())]
        return [*found, (j, late + 1, self.h, ())]

    def box_period(self, i, j, q, p, slopes):
        """As `period`, for delays that each have a range, by u, by the place in each."""
        c, k, n, m = self.c, self.k, self.n, self.c.m
        u, f, g, weights = p[0], p[1 : m + 1], p[m + 1 : 2 * m + 1], p[2 * m + 1 :]
        zero, totals = arb_mat(k, k), None
        for at in range(m):
            E, D, before, now = eye(k), [zero] * len(p), zero, arb(0)
            moved, places = (arb(0),) * 3, (0, 1 + at, 1 + m + at)
            for mode, lag, end, by in self.arrivals(i, j, q, at, u, f[at], g[at]):
                first, *others = [self.X_of(v, mode, (lag, at)) for v in range(c.vertices)]
                steps = [X - first for X in others]
                X = sum((w * dX for w, dX in zip(weights, steps, strict=True)), first)
                P = exponential(X * (end - now))
                if slopes:
                    for place, rate in zip(places, moved, strict=True):
                        D[place] += (before - X) * E * rate
                    D = [P * slope for slope in D]
                    for v, dX in enumerate(steps, 2 * m + 1):
                        doubled = exponential(block([[X, dX], [zero, X]]) * (end - now))
                        D[v] += part(doubled, 0, k, k, 2 * k) * E
                E, before, now, moved = P * E, X, end, by
            # The columns of x are the same for all inputs, those of the others' reads are zero.
            found = [part(Q, 0, n, 0, k) for Q in (E, *D)]
            if totals is not None:
                found = [block([[arb_mat(n, n), part(Q, 0, n, n, k)]]) for Q in found]
            totals = [a + b for a, b in zip(totals, found, strict=True)] if totals else found
        return totals

    def new_enclosure(self, i, j, q, simplices):
        """(E, R) at the centre and at the corners of a cell; how much each simplex moves E."""
        corners = [[x for v in vs for x in v] for vs in itertools.product(*simplices)]
        places = [*zip(*corners, strict=True)]
        middle = [sum(x, fmpq(0)) / len(x) for x in places]
        widths = [max(abs(x - y) for x in xs) for xs, y in zip(places, middle, strict=True)]
        box = [y + arb(0, 1) * arb(w) for y, w in zip(middle, widths, strict=True)]
        period = self.box_period if self.boxed else self.period
        E = period(i, j, q, [arb(y) for y in middle], False)[0]
        D = period(i, j, q, box, True)[1:] if any(widths) else []
        spread = ((S - S.mid()) * arb(w) for S, w in zip(D, widths, strict=False))
        spread = sum(spread, arb_mat(self.n, self.k))
        sway = self.sway(i, j, q, box) if self.c.axes else (None, None)
        found = [(E.mid(), E - E.mid())]
        for corner in corners:
            moves = (S.mid() * arb(x - y) for S, x, y in zip(D, corner, middle, strict=False))
            X = sum(moves, E)
            found.append((X.mid(), X - X.mid() + spread))
        moves = iter([float(norm(S) * w) for S, w in zip(D, widths, strict=False)])
        return found, [sum(next(moves, 0.0) for _ in vs[0]) for vs in simplices], sway

    def new_full(self, mode, start, end):
        """The product of the periods without a switch; by halves, so that the balls grow less."""
        self.spend(cost(self.d))
        if end - start != 1:
            half = (start + end) // 2
            late = self.full(mode, half, end) if end > start else eye(self.d)
            return late * self.full(mode, start, half) if end > start else late
        return self.alone(mode, self.rows(mode, start)[0])

    def alone(self, mode, row):
        """M of a period without a switch under a row."""
        (Y, U), cell = self.table(row), self.roots(mode, mode)[0]
        E, R = self.enclosure(mode, mode, *cell)[0][0]
        return block([[(E + R) * Y], [U]]) if self.acts else (E + R) * Y

    def roots(self, i, j, age=0):
        """Cells that cover the parameters: part of the period, simplices of u, of f and of λ."""
        count, found = range(self.c.vertices), []
        f = ((fmpq(0),), (fmpq(1),)) if self.ranged else ((fmpq(0),),)
        low = 0 if self.bucket or i == j else max(0, self.shortest[i] - age - 1)
        high = 0 if i == j else min(1, self.longest[i] - age) if self.c.maximum[i] else 1
        low, high = (self.h * x.numerator / x.denominator for x in (low, high))  # s of a switch
        weights = tuple(tuple(fmpq(p == q) for p in count[1:]) for q in count)
        if self.boxed:
            return self.box_roots(i, j, low, high, weights)
        for q, ((a, ra), (b, rb)) in enumerate(itertools.pairwise(self.marks)):
            first, last = (low - a - ra) / (b + rb - a - ra), (high - a) / (b - a)  # u, for all φ
            u0 = float(first.lower()) - 2**-50 if first.is_finite() and i != j else 0.0
            u1 = float(last.upper()) + 2**-50 if last.is_finite() and i != j else float(i != j)
            ends = sorted({fmpq(*min(1.0, max(0.0, u)).as_integer_ratio()) for u in (u0, u1)})
            if u0 <= 1 and u1 >= 0 and (i != j or q == 0):
                found.append((q, (tuple((x,) for x in ends), f, weights)))
        return found

    def box_roots(self, i, j, low, high, weights):
        """As `roots`, where each delay has its range: s is cut at both ends of all of them."""
        marks, found, switches = [Fraction(0)], [], i != j
        ends = {x for mode in (i, j) for at in self.places[mode] for x in at[1:3] if switches}
        for x in sorted(ends):
            marks += [x] * (x - marks[-1] > NEAR and 1 - x > NEAR)
        for a, b in itertools.pairwise([*marks, Fraction(1)]):
            start, width = self.h * fraction(a), self.h * fraction(b - a)
            u0 = float(((low - start) / width).lower()) - 2**-50
            u1 = float(((high - start) / width).upper()) + 2**-50
            u = sorted({fmpq(*min(1.0, max(0.0, x)).as_integer_ratio()) for x in (u0, u1)})
            # A delay in mode i plays no part if s is before all of its φ, one in j if after them.
            heard = [not switches or b > at[1] + NEAR for at in self.places[i]]
            heard += [switches and a < at[2] - NEAR for at in self.places[j]]
            spans = [
                ((fmpq(0),), (fmpq(1),))[: 1 + (counts and at[1] < at[2])]
                for counts, at in zip(heard, self.places[i] + self.places[j], strict=True)
            ]
            if not switches or (u0 <= 1 and u1 >= 0):
                us = tuple((x,) for x in (u if switches else [fmpq(0)]))
                found.append(((a, b), (us, *spans, weights)))
        return found


def cost(order):
    return (order + 12) ** 3


def fraction(x):
    return arb(fmpq(x.numerator, x.denominator))


def linear(loop):
    for i in loop.modes:
        linear_in(loop, i, loop.q0[i], loop.last[i])


def linear_in(loop, i, q0, last):
    """The steps from the ages of one mode between which all others lie."""
    c = loop.c
    found = {0, last, q0, q0 + 1, *c.knots, *range(min(c.ages, last + 1))}
    found |= {k + q0 for k in c.knots if loop.bucket}
    found |= set(range(min(c.lost + c.ages, last + 1) * (c.lost > 0)))
    if c.lag:  # the ages at which other rows may act than before
        rows = [loop.rows(i, a) for a in range(c.lag + 1)]
        found |= {a for a, (x, y) in enumerate(itertools.pairwise(rows), 1) if x != y}
        found |= set(range(c.lag, c.lag + c.ages + 1))
    starts = {a for a in found if a <= last}
    steps_from(loop, i, sorted(starts | {a - 1 for a in starts if a > 0}))


def steps_from(loop, i, ages):
    """All single periods from some ages of a mode."""
    V, c, last, q0 = loop.V, loop.c, loop.last[i], loop.q0[i]
    for a in ages:
        for row, lost, then in loop.told(i, a):
            here, at = V(i, a, lost), f" at age {a}" + f" after {lost} lost samples" * (lost > 0)
            if loop.q1[i] is None or a < last:
                there = V(i, min(a + 1, last), then)
                prove(loop, f"mode {i}{at}", here, there, row, (i, i))
            for j in (j for j in sorted(c.follow[i]) if a >= q0):
                there = V(j, a - q0 if loop.bucket else 0, then)
                prove(loop, f"the switch {i} to {j}{at}", here, there, row, (i, j), a)


def averaged(loop):
    need(loop.c.knots == [0], "knots are not 0 alone, as an average dwell time has them")
    many = len(loop.c.F) * loop.c.modes * len(loop.c.P)
    need(many <= STRETCHES, "there are too many rows")
    mu, r = arb(loop.c.mu), fraction(loop.shortest[0])
    for i in loop.modes:
        for (row, lost, then), j in itertools.product(loop.told(i, 0), {i} | loop.c.follow[i]):
            V, scale = (loop.V(i, 0, lost), loop.V(j, 0, then)), mu ** ((j != i) - 1 / r)
            prove(loop, f"mode {i}, then {j}", *V, row, (i, j), scale=scale)


def stretches(loop):
    knots, c, highest = loop.c.knots, loop.c, max(loop.last)
    need(knots[-1] <= highest, f"the last knot is past the last age, {highest}")
    need(knots[0] <= min(loop.q0), "the first knot is past a switch")
    switching = zip(loop.last, loop.q0, c.follow, strict=True)
    most = max(sum(len(j) * (a - q + 1) for a, q, j in switching), len(c.P) * len(knots))
    need(most <= STRETCHES, "there are too many stretches")
    fixed = not loop.ranged and c.vertices == 1 and not c.lost and not c.axes
    need(fixed or len(knots) > highest, "not every age is a knot, though something varies")
    need(c.lag <= knots[0], "the first knot is before the lag of the mode")
    for i in loop.modes:
        own = [age for age in knots if age <= loop.last[i]]
        fits = loop.q1[i] is not None or own[-1:] == [loop.last[i]]
        need(own and fits, f"the last age of mode {i}, {loop.last[i]}, is no knot")
        if c.lost:
            steps_from(loop, i, own)
            continue
        for start, end in itertools.pairwise([*own, loop.last[i] + 1]):
            stretches_from(loop, i, start, end)


def stretches_from(loop, i, start, end):
    """The stretches from the node at one age; the mode's next one is at `end`, or past its last."""
    V, last, first_node, lag = loop.V, loop.last[i], loop.c.knots[0], loop.c.lag
    for a in range(start, end):
        (row,), name, L = loop.rows(i, a), f"mode {i} from age {start} to {a}", a - start + 1
        before = loop.full(i, start, a)
        for j in (j for j in sorted(loop.c.follow[i]) if a >= loop.q0[i]):
            to = f"{name}, then {j}", V(i, start), V(j, first_node), row, (i, j), a
            first = min(a + 1 - lag, loop.c.ages) * (lag > 0)
            after = loop.after(i * (lag > 0), first, j, first_node)
            prove(loop, *to, L + first_node, before, after)
        if a + 1 == end and (end <= last or loop.q1[i] is None):
            prove(loop, name, V(i, start), V(i, min(end, last)), row, (i, i), a, L, before)


def prove(loop, name, V, W, row, modes, age=0, periods=1, before=None, after=None, scale=1):
    """Inequality (1) of a link from V to W, for all parameters; None stands for I."""
    n, d, k, (Y, U) = loop.n, loop.d, loop.k, loop.table(row)
    g = arb(loop.c.rho) ** (2 * periods) * scale
    Y, U = (Y * before, U * before) if before is not None else (Y, U)
    W = after.transpose() * W * after if after is not None else W
    a, b, c = part(W, 0, n, 0, n), part(W, n, d, 0, n), part(W, n, d, n, d)
    need(positive(a)[1] < 1, f"{name}: V after it is too close to singular")
    inverse, Z = a.inv(), b.transpose() * U
    H = V + (Z.transpose() * inverse * Z - U.transpose() * (c * U)) * (1 / g)
    loop.spend(cost(d))
    T, error = positive(H)
    need(error < 1, f"{name}: V does not decrease, whatever the state")
    TW = T * block([[Y], [inverse * Z]]).transpose()
    G, target = TW.transpose() * TW * (1 / (1 - error)), inverse * g

    def holds(E, R, W, X):
        EI, G1 = block([[E, eye(n)]]), part(G, 0, k, 0, k)
        N = part(EI * G, 0, n, 0, k)
        change = R * N.transpose()
        F = target - EI * G * EI.transpose() - change - change.transpose() - R * G1 * R.transpose()
        if W is None or positive(F)[1] >= 1:
            return positive(F)[1] < 1
        mu, N = weight(F.mid(), N.mid(), G1.mid(), W.mid(), X.mid()), (N + R * G1) * arb(-1)
        H = block([[F - W * mu, N], [N.transpose(), X.inv() * mu - G1]])
        return positive(H)[1] < 1

    modes = (modes[0], modes[0]) if loop.c.samples else modes  # a switch is at the end, s = h
    cells = [(cell, 0) for cell in loop.roots(*modes, age)]
    while cells:
        cell, deep = cells.pop()
        loop.spend(loop.cell + loop.corner * math.prod(map(len, cell[1])))
        (centre, *corners), moves, sway = loop.enclosure(*modes, *cell)
        if not all(holds(*at, *sway) for at in corners):
            end = deep == (DEEPEST if sway[0] is None else 20)  # small cells have a smaller W ⊗ X
            lost = end or not any(moves) or (sway[0] is None and not holds(*centre, *sway))
            need(not lost, f"{name}: V does not decrease")
            cells += [(half, deep + 1) for half in halves(*cell, moves.index(max(moves)))]


def halves(q, simplices, index):
    """The cell with one of its simplices cut in two across its longest edge."""
    pairs = itertools.combinations(simplices[index], 2)
    ends = max(pairs, key=lambda p: max(abs(x - y) for x, y in zip(*p, strict=True)))
    middle = tuple((x + y) / 2 for x, y in zip(*ends, strict=True))
    for end in ends:
        cut = tuple(middle if v == end else v for v in simplices[index])
        yield q, (*simplices[:index], cut, *simplices[index + 1 :])


def summary(c):
    """The loop in its first numbers, and its signals in words."""
    each = [
        f"{x!r} s {'or more' if y is None else f'to {y!r} s'}"
        for x, y in zip(c.dwell, c.maximum, strict=True)
    ]
    signals = "sojourns of " + (", ".join(each) if len({*each}) > 1 else each[0])
    if c.chatter > 1:
        signals = f"{c.chatter} + T/({c.dwell[0]!r} s) switches or fewer in any T, one in a period"
    signals += " at samples" * c.samples
    if sum(map(len, c.follow)) < c.modes * (c.modes - 1):
        only = ", ".join(f"{i} to {sorted(x)}" for i, x in enumerate(c.follow))
        signals += f" that switch only {only}"
    (low, high), D = c.D[0][0], c.delays if type(c.delays[0]) is list else c.delays[0]
    low, high = c.delays if c.box else (low, high)
    D = f"D = {D} s" if low == high else f"every constant D of {low!r} to {high!r} s"
    first = f"A = {c.A[0][0][0][:3]}…, B = {c.B[0][0][0][:3]}…, F = {c.F[0][0][:3]}…"
    plant = f"{c.modes} modes" + (f", {c.vertices} vertices" if c.vertices > 1 else "") + c.set
    rate = f"decays at {c.rate!r} 1/s" if c.rate else "goes to zero"
    kept = f", {c.q} remembered" * (c.q > 0)
    rows = f"rows by {c.context}" + f" of {c.lag} periods ago" * (c.lag > 0)
    rows += f", {c.lost} samples in a row lost at most" * (c.lost > 0)
    loop = f"n = {c.n}, m = {c.m}{kept}, {plant}, h = {c.step!r} s, {D}, {first}, {rows}"
    return f"{rate}; {loop}; {signals} by a clock off by {c.tolerance!r} at most"


def judged(path, limit):
    """The exit code, the verdict, and what the file is about."""
    c, about = None, ""
    try:
        content, digest = parsed(path)
        c = certificate(content)
        about = f": {summary(c)}; sha256 {digest[:16]}"
        need(arb(c.rate) * ball(c.step) <= -arb(c.rho).log(), "decay_rate is above −ln ρ/h")
        kind = averaged if c.averaged else linear if c.linear else stretches
        kind(Loop(c, limit))
    except Exception as error:  # whatever a foreign file brings about
        code, verdict = (1, "NOT PROVED: ") if c else (2, "UNREADABLE: ")
        return code, verdict + (f"{error}" if type(error) is ValueError else repr(error)), about
    return 0, "PROVED", about


def main():
    codes = "Exit code: 0 all are proved, 1 one is not, 2 one cannot be read or has been changed."
    parser = argparse.ArgumentParser(description=f"Check certificates of stability. {codes}")
    parser.add_argument("files", nargs="+", metavar="certificate.json")
    times = "how many times the usual work may be done for a file of its size (1)"
    parser.add_argument("--limit", type=float, default=1.0, help=times)
    arguments, ctx.prec, worst = parser.parse_args(), BITS, 0
    sys.stdout.reconfigure(errors="backslashreplace")
    for path in arguments.files:
        start = time.monotonic()
        code, verdict, about = judged(path, arguments.limit)
        print(*f"{path}: {verdict}{about}; {time.monotonic() - start:.1f} s".split(), flush=True)
        worst = max(worst, code)
    sys.exit(worst)


if __name__ == "__main__":
    main()
