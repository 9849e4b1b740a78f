"""The second verifier: it proves the corpus, no forgery, and shares no code with the package."""

import ast
import itertools
import json
import subprocess
import sys
from fractions import Fraction
from types import SimpleNamespace

import mpmath
import numpy as np
import pytest

import certificate_corpus as corpus
import certificate_forgeries as forgeries
import certificate_reference as reference
import deadtime as dt
import delayed_loops
from deadtime.base.errors import CertificateFileError
from second_verifier import VERIFY, second_verifier
from shares import mostly_long

FILES = sorted(corpus.CORPUS.glob("*.json"))


def run(*arguments):
    """Exit code and lines of the verifier, isolated from this repository."""
    command = [sys.executable, "-I", str(VERIFY), *map(str, arguments)]
    found = subprocess.run(command, capture_output=True, text=True, timeout=500)
    assert "Traceback" not in found.stderr
    return found.returncode, found.stdout.splitlines()


def by_the_package(path):
    try:
        return dt.verify(path).proven
    except CertificateFileError:
        return False


def test_the_verifier_is_one_short_file_that_imports_python_and_flint_alone():
    text = VERIFY.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 1030
    found = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            found |= {name.name.split(".")[0] for name in node.names}
        elif isinstance(node, ast.ImportFrom):
            found.add(str(node.module).split(".")[0])
    assert found - {"flint"} <= set(sys.stdlib_module_names)


# Each delay in a range of its own is proved on boxes, with corners besides in minutes: for long.
BOXES = [f for f in FILES if f.stem in ("ranges-inputs", "ranges-one", "ranges-polytope")]
# One of every kind of plant, law, signals and period.
KINDS = (
    *("alike", "average", "averaged-dwell", "delayed", "delays-both", "ellipsoid", "every-age"),
    *("average-turning", "expected"),
    *("free-rate-0", "generic-averaged", "late-delays", "late-mode", "maximum", "mean", "one-mode"),
    *("lost-observed", "lost-tracking", "polytope", "range", "ranges-modes", "rate", "short-delay"),
    *("stretches-generic", "stretches-late", "stretches-ways", "tolerant", "ways", "ways-late"),
)
FEW = [f for f in FILES if f.stem in KINDS]
OTHERS = [f for f in FILES if f not in (*BOXES, *FEW)]


def test_the_corpus_has_a_file_for_every_case():
    assert {path.stem for path in FILES} == {*corpus.CASES, *corpus.STRETCHES}
    assert len(FILES) >= 30
    assert len(FEW) == len(KINDS)


@pytest.mark.parametrize(
    "files", mostly_long([FEW, OTHERS, BOXES], FEW), ids=["few", "others", "boxes"]
)
def test_both_verifiers_prove_all_of_the_corpus(files):
    code, lines = run(*files)
    assert [line for line in lines if ": PROVED: " not in line] == []
    assert (code, len(lines)) == (0, len(files))
    assert [path.stem for path in files if not by_the_package(path)] == []


def test_neither_verifier_proves_a_forgery_and_the_exit_code_tells_false_from_malformed(tmp_path):
    assert len(forgeries.FALSE) + len(forgeries.MALFORMED) >= 60
    for forged, code, verdict in (
        (forgeries.FALSE, 1, "NOT PROVED"),
        (forgeries.MALFORMED, 2, "UNREADABLE"),
    ):
        paths = [tmp_path / f"{code}-{k}-{forged[k][0]}.json" for k in range(len(forged))]
        for path, forgery in zip(paths, forged, strict=True):
            path.write_text(forgeries.forged(forgery))
        found, lines = run(*paths)
        assert [line for line in lines if f": {verdict}: " not in line] == []
        assert (found, len(lines)) == (code, len(paths))
        assert [path.name for path in paths if by_the_package(path)] == []


TEXT = (corpus.CORPUS / "rate.json").read_text(encoding="utf-8")
BROKEN = {
    "empty": "",
    "no object": "[1]",
    "cut short": TEXT[:1000],
    "changed": TEXT.replace('"rho": 0.9', '"rho": 0.8'),
    "a key twice": TEXT.replace('"rho"', '"rho": 0.5, "rho"', 1),
    "deep": "[" * 10**6,
    "no text": "\udcff\udc80",
    "digits": '{"rho": ' + "1" * 10**5 + "}",
    "not a number": TEXT.replace('"rho"', '"rho": NaN, "a"', 1),
}


def test_whatever_is_no_certificate_gets_a_line_and_no_traceback(tmp_path):
    paths = [tmp_path / name for name in BROKEN]
    for path, text in zip(paths, BROKEN.values(), strict=True):
        path.write_bytes(text.encode("utf-8", "surrogateescape"))
    code, lines = run(*paths, tmp_path, tmp_path / "nothing", "/dev/zero")
    assert (code, len(lines)) == (2, len(paths) + 3)
    assert all(": UNREADABLE: " in line for line in lines)
    assert sum("no such file" in line for line in lines) == 3
    assert run(FILES[0], paths[0])[0] == 2


@pytest.mark.few(5)
@pytest.mark.parametrize(
    ("forgery", "reason"),
    [
        (("rate", forgeries.put("signals.dwell_time", 0.09)), "dwell time is below one period"),
        (("rate", forgeries.put("decay_rate", 1.0)), "decay_rate is above −ln ρ/h"),
        (("range", forgeries.put("plant.delays", [0.2, 0.31])), "not within one period"),
        (
            ("ranges-modes", forgeries.put("plant.delays", [[[0.299], [0.268]], [[0.3], [0.301]]])),
            "not within one period",
        ),
        (
            ("ranges-modes", forgeries.put("plant.delays", [[[0.299], [0.21]], [[0.3], [0.3]]])),
            "V does not decrease",
        ),
        (("rate", forgeries.put("plant.delays", [200.0, 200.0])), "P has not the order 2002"),
        (("rate", forgeries.put("plant.delays", [0.35, 0.35])), "P has not the order 6"),
        (("rate", forgeries.put("plant.delays", [1e-12, 1e-12])), "not within one period"),
        (("rate", forgeries.entries("lyapunov.P", np.triu)), "P or S is not symmetric"),
        (("rate", forgeries.entries("lyapunov.P", lambda P: -P)), "V is not positive definite"),
        (("rate", forgeries.put("plant.A", [[[[1e9, 0], [0, 1]]] * 2])), "norm of A h or B h"),
        (("rate", forgeries.put("rho", 0.2)), "mode 0 at age 0: V does not decrease"),
        (
            ("stretches-maximum-free", forgeries.put("lyapunov.knots", [30])),
            "the last knot is past the last age, 18",
        ),
        (
            ("stretches-range", forgeries.put("lyapunov.knots", [0, 1, 3])),
            "the last knot is past the last age, 2",
        ),
        (("paper-far", forgeries.put("signals.dwell_time", 0.11)), "the switch"),
    ],
)
def test_the_reason_names_what_fails(forgery, reason, tmp_path):
    path = tmp_path / "a.json"
    path.write_text(forgeries.forged(forgery))
    code, (line,) = run(path)
    assert code == 1
    assert reason in line


def test_an_age_that_is_never_told_apart_costs_nothing(tmp_path):
    path = tmp_path / "a.json"
    far = forgeries.put("signals.dwell_time", 9e3)  # a common function needs no dwell time
    path.write_text(forgeries.forged(("paper", far)))
    assert run(path)[0] == 0


def test_the_line_tells_the_loop_and_the_signals():
    (line,) = run(corpus.CORPUS / "maximum.json")[1]
    for words in ("n = 2, m = 1, 2 modes", "h = 0.1 s", "D = 1.0 s", "sojourns of 0.2 s to 0.7 s"):
        assert words in line
    lines = run(*(corpus.CORPUS / f"{name}.json" for name in ("range", "polytope", "average")))[1]
    assert "every constant D of 0.2 to 0.29 s" in lines[0]
    assert "3 vertices" in lines[1]
    assert "3 + T/(0.2 s) switches or fewer in any T" in lines[2]
    (line,) = run(corpus.CORPUS / "delays-both.json")[1]
    assert "D = [[0.34, 0.17], [0.22, 0.26]] s" in line
    (line,) = run(corpus.CORPUS / "ranges-modes.json")[1]
    assert "every constant D of [[0.299], [0.268]] to [[0.3], [0.272]] s" in line


# -- its enclosures, against fifty digits --------------------------------------------------


def contains(ball, x):
    """Whether a ball holds an mpmath number, up to 40 digits."""
    text = mpmath.nstr(x, 45, strip_zeros=False)
    return ball.contains(type(ball)(text)) or abs(ball - type(ball)(text)) < 1e-35


def test_exponentials_and_periods_are_enclosed():
    verify, rng = second_verifier(), np.random.default_rng(3)
    verify.ctx.prec = verify.BITS
    with mpmath.workdps(reference.DIGITS):
        for size in (1e-3, 1.0, 30.0):
            X = size * rng.normal(size=(4, 4))
            found = verify.exponential(verify.arb_mat(X.tolist())).tolist()
            exact = reference.exponential(reference.many_digits(X))
            assert all(contains(found[i][j], exact[i, j]) for i, j in np.ndindex(4, 4))
        content, _ = verify.parsed(str(corpus.CORPUS / "polytope-mode.json"))
        loop = verify.Loop(verify.certificate(content))
        A, B = (np.array(content["plant"][name]) for name in "AB")
        for late, share in itertools.product((0, 1), rng.uniform(0, 1, (3, 2)).round(3)):
            u, weight = (verify.fmpq(*x.as_integer_ratio()) for x in share.tolist())
            cell = (((u * 0,), (u,)), ((u * 0,),), ((u * 0,), (weight,)))
            enclosed = loop.enclosure(0, 1, late, cell)[0][-1]
            mixed = [(1 - share[1]) * X[0] + share[1] * X[1] for X in (A, B)]
            plant = reference.Plant(*mixed, loop.c.D[0][0][0], loop.c.step, digits=True)
            at = plant.phase * reference.decimal(share[0])
            if late:
                at = plant.phase + (plant.h - plant.phase) * reference.decimal(share[0])
            columns = [plant.n + plant.m * (plant.count - lag) + j for lag, j in loop.reads]
            E = plant.rows(0, 1, at / plant.h)[:, [*range(plant.n), *columns]]
            ball = (enclosed[0] + enclosed[1]).tolist()
            assert all(
                ball[i][j].contains(float(E[i, j])) or abs(ball[i][j] - float(E[i, j])) < 1e-12
                for i, j in np.ndindex(*E.shape)
            )


@pytest.mark.parametrize("seed", range(12))
def test_periods_at_delays_in_their_ranges_are_those_of_the_definition(seed):
    verify, rng = second_verifier(), np.random.default_rng(seed)
    verify.ctx.prec = verify.BITS
    content, _ = verify.parsed(str(corpus.CORPUS / "ranges-inputs.json"))
    low, high = np.array([[0.32, 0.11], [0.34, 0.2]]), np.array([[0.37, 0.19], [0.34, 0.3]])
    loop = object.__new__(verify.Loop)
    loop.c = c = SimpleNamespace(
        **{name: np.array(content["plant"][name]).tolist() for name in "AB"},
        **{"vertices": 1, "modes": 2, "n": 2, "m": 2, "step": 0.1, "maximum": [None] * 2},
        D=np.stack([low, high], axis=2).tolist(),
    )
    loop.n, loop.h, loop.bucket, loop.shortest = 2, verify.ball(0.1), False, [Fraction(1)] * 2
    loop.places, loop.reads = loop.box_clock()
    loop.k, loop.X_of, loop.ranged, loop.boxed = 2 + len(loop.reads), loop.generator_of, True, True
    delays = low + rng.choice([0.0, 1.0, rng.uniform()], size=low.shape) * (high - low)
    plant = delayed_loops.Plant(np.array(c.A)[0], np.array(c.B)[0], delays, 0.1)
    s = float(rng.uniform())  # of a period
    phases = delays / 0.1 - np.ceil(low / 0.1 + 1e-6) + 1
    for i, j in ((0, 0), (0, 1), (1, 0)):
        cells = loop.roots(i, j, 9)
        (a, b), _ = next(cell for cell in cells if cell[0][0] <= s <= cell[0][1])
        places = [(s - float(a)) / float(b - a)]
        for mode in (i, j):
            for (_, first, last, *_), phase in zip(loop.places[mode], phases[mode], strict=True):
                first, last = float(first), float(last)
                f = (phase - first) / (last - first or 1.0)
                around = first + 1e-9 < b and a < last - 1e-9
                if i != j and mode == i and around:
                    inside = first - 1e-9 <= float(a) and float(b) <= last + 1e-9
                    f = (min(s, phase) - first) / (s - first) if inside else f
                if i != j and mode == j and around:
                    inside = first - 1e-9 <= float(a) and float(b) <= last + 1e-9
                    f = (max(s, phase) - s) / (last - s) if inside else f
                places.append(f)
        E = loop.box_period(i, j, (a, b), [verify.arb(x) for x in places], False)[0]
        columns = [*range(2), *(2 + 2 * lag + at for lag, at in loop.reads)]
        exact = plant.rows(i, None if i == j else j, Fraction(s))[:, columns]
        found = np.array([float(x.mid()) for x in E.entries()]).reshape(2, -1)
        assert found == pytest.approx(exact, rel=1e-9, abs=1e-12)


@pytest.mark.long
@pytest.mark.parametrize("step", [0.02, 0.01])
def test_certificates_of_long_delays_are_proved_in_a_minute(step, tmp_path):
    plant, law = corpus.designed(corpus.PAPER.apart(0.62))
    path = dt.certify(plant, law, 0.2, step).save(tmp_path / "a.json")
    assert run(path)[0] == 0


@pytest.mark.long
@pytest.mark.parametrize("name", sorted({*corpus.CASES, *corpus.STRETCHES} - {"ranges-polytope"}))
def test_the_corpus_made_anew_is_proved(name, tmp_path):
    path = corpus.save(name, tmp_path / f"{name}.json")
    assert run(path)[0] == 0
    old = json.loads((corpus.CORPUS / f"{name}.json").read_text(encoding="utf-8"))
    new = json.loads(path.read_text(encoding="utf-8"))
    axes = [one["plant"].pop("axes") for one in (old, new) if "axes" in one["plant"]]
    if axes:  # from eigenvectors: their signs and last bits are the machine's, the ellipsoid is not
        flat = [forgeries.unpacked(one).reshape(one["shape"][0], -1) for one in axes]
        was, now = (one.T @ one for one in flat)
        np.testing.assert_allclose(now, was, rtol=0.0, atol=1e-12 * np.abs(was).max())
    assert {key: old[key] for key in ("plant", "signals")} == {
        key: new[key] for key in ("plant", "signals")
    }
