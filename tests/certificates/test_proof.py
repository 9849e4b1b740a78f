"""The check: it rejects whatever is no proof, its enclosures hold, and its files are safe."""

import math
import subprocess
import sys
from dataclasses import replace
from fractions import Fraction
from functools import cache
from operator import attrgetter

import mpmath
import numpy as np
import pytest
from flint import arb
from hypothesis import given, settings, strategies as st

import certificate_reference as reference
import deadtime as dt
from deadtime.base.errors import CertificateFileError
from deadtime.certificates.proof import balls, check, load_evidence
from deadtime.certificates.proof.covering import Covering
from deadtime.certificates.proof.definite import is_positive_definite
from deadtime.certificates.proof.enclosure import Enclosures, cells_of
from deadtime.certificates.proof.family import Family

PAPER = dt.problems.paper().plant
ALPHA = {"common": 0.63, "eigenvectors": 0.65, "extended rows": 0.3}


def designed(alpha, delay=1.0, dwell_time=None):
    near = PAPER.apart(alpha)
    plant = dt.SwitchedSystem(near.A, near.B, delay)
    return plant, dt.AveragedPredictor(plant, dt.place(plant, [-1.0, -2.0]), None, dwell_time)


@cache
def made(name):
    """A plant, a law and its certificate, and the loop of the second method."""
    aged = (0.234, 0.1634) if name == "extended rows" else ()
    plant, law = designed(ALPHA[name], *aged)
    certificate = dt.certify(plant, law, 0.2, 0.1)
    assert certificate.proven, certificate.message
    loop = reference.Loop(plant.A, plant.B, plant.delay, law.digital(0.1))
    return plant, law, certificate, loop


def evidence_of(name):
    return made(name)[2].evidence


def assert_rejected(evidence, reason=""):
    outcome = check(evidence)
    assert not outcome.proven
    assert outcome.reason
    assert reason in outcome.reason


def least(evidence, loop):
    """The least eigenvalue of all inequalities of the evidence, by the second method."""
    return reference.Inequalities(evidence, loop).least(np.linspace(0.0, 1.0, 21))


def with_part(evidence, part, value):
    """The evidence with a part of it, of its centre or of its setting replaced."""
    owner, _, name = part.rpartition(".")
    if owner:
        name, value = owner, replace(getattr(evidence, owner), **{name: value})
    return replace(evidence, **{name: value})


@pytest.mark.parametrize("name", ALPHA)
def test_the_evidence_itself_passes_both_methods(name):
    evidence, loop = evidence_of(name), made(name)[3]
    assert bool(evidence.S.size) == (name == "eigenvectors")
    assert evidence.setting.rows_differ == (name == "extended rows")
    outcome = check(evidence)
    assert (outcome.proven, outcome.reason) == (True, "")
    assert least(evidence, loop) > 0.0


@pytest.mark.parametrize("part", ["P", "Pi", "S"])
@pytest.mark.parametrize("name", ALPHA)
def test_perturbed_evidence_is_rejected_wherever_the_second_method_refutes_it(name, part):
    evidence, loop = evidence_of(name), made(name)[3]
    whole = getattr(evidence, part)
    large = 0.1 if (name, part) == ("extended rows", "Pi") else 1e-3  # it has room for 1e-3
    sizes = [large] * (6 if part == "P" else 20) + [1e-5, 1e-7, 1e-10]
    for seed, size in enumerate(sizes if whole.size else ()):
        rng = np.random.default_rng(seed)
        changed = whole.copy()
        for block in changed.reshape(-1, *changed.shape[-2:]):
            unit = np.sqrt(np.abs(np.diag(block)))
            noise = rng.choice([-size, 0.0, 0.0, size], size=block.shape)
            block += (np.triu(noise) + np.triu(noise, 1).T) * unit * unit[:, None]
        mutant = replace(evidence, **{part: changed})
        violated = least(mutant, loop) < 0.0
        assert violated or size < large
        if violated:
            assert_rejected(mutant)


def test_evidence_is_rejected_for_another_plant():
    evidence, table = evidence_of("common"), made("common")[3].table
    for alpha in (0.64, 0.66):
        other = PAPER.apart(alpha)
        mutant = with_part(evidence, "setting.A", other.A[None])
        mutant = with_part(mutant, "setting.B", other.B[None])
        assert least(mutant, reference.Loop(other.A, other.B, 1.0, table)) < 0.0
        assert_rejected(mutant, "the inequality of the step")


def test_evidence_is_rejected_for_another_delay_dwell_time_or_rate():
    evidence, (plant, _, _, loop) = evidence_of("extended rows"), made("extended rows")
    for delay in (0.21, 0.27):
        mutant = with_part(evidence, "setting.delays", (delay, delay))
        assert least(mutant, reference.Loop(plant.A, plant.B, delay, loop.table)) < 0.0
        assert_rejected(mutant, "the inequality of the step")
    evidence = evidence_of("common")
    for delay, reason in ((0.9, "K ≻ 0 fails"), (0.98, "has the shape"), (1.1, "has the shape")):
        assert_rejected(with_part(evidence, "setting.delays", (delay, delay)), reason)
    assert check(with_part(evidence, "setting.dwell_time", 0.11)).proven  # P is for any dwell time
    assert_rejected(with_part(evidence, "setting.dwell_time", 0.1), "below one period")
    mutant = with_part(evidence_of("eigenvectors"), "setting.dwell_time", 0.11)
    assert least(mutant, made("eigenvectors")[3]) < 0.0
    assert_rejected(mutant, "the inequality of the step")
    for name in ALPHA:
        loop = made(name)[3]
        radii = [np.abs(np.linalg.eigvals(loop.step(mode, 10**6))).max() for mode in range(2)]
        assert_rejected(replace(evidence_of(name), rho=float(max(radii)) * (1.0 - 1e-9)))


def test_evidence_is_rejected_for_another_entry_of_the_table():
    for name, reason in (("common", "row is not the table's"), ("extended rows", "K ≻ 0 fails")):
        evidence = evidence_of(name)
        for part, index in (("F", (-1, 0, 0)), ("F", (0, 0, 1)), ("G", (-1, 0, 0, 0))):
            changed = getattr(evidence.setting, part).copy()
            changed[index] *= 1.001
            assert_rejected(with_part(evidence, f"setting.{part}", changed), reason)
    # An attacker changes the centre, too.
    evidence = evidence_of("common")
    F, row = evidence.setting.F * 1.001, evidence.centre.row.copy()
    row[:, :2] = F[0]
    mutant = with_part(with_part(evidence, "centre.row", row), "setting.F", F)
    assert least(mutant, made("common")[3]) < 0.0
    assert_rejected(mutant, "K ≻ 0 fails")


TIMES = ("step", "dwell_time", "maximum_dwell", "clock_tolerance")
ARRAYS = (
    *("P", "Pi", "S", "setting.A", "setting.B", "setting.F", "setting.G"),
    *("centre.E", "centre.row", "centre.R", "centre.T", "centre.Psi", "centre.F"),
)


@pytest.mark.parametrize("value", [math.nan, math.inf, 1e300])
@pytest.mark.parametrize("name", ["eigenvectors", "extended rows"])
def test_numbers_that_are_none_are_rejected_wherever_they_stand(name, value):
    evidence = evidence_of(name)
    for part in ARRAYS:
        spoiled = attrgetter(part)(evidence).copy()
        if spoiled.size:
            spoiled.flat[-1] = value
            assert_rejected(with_part(evidence, part, spoiled))
    for part in ("rho", *(f"setting.{name}" for name in TIMES)):
        assert_rejected(with_part(evidence, part, value))
    assert_rejected(with_part(evidence, "setting.delays", (1.0, value)))


def test_shapes_layout_knots_and_symmetry_are_checked():
    evidence, aged = evidence_of("eigenvectors"), evidence_of("extended rows")
    skew = evidence.P.copy()
    skew[0, 1] *= 1.0 + 1e-15
    assert_rejected(replace(evidence, P=skew), "P is not symmetric")
    for part in ("P", "Pi"):
        assert_rejected(with_part(evidence, part, getattr(evidence, part)[1:, 1:]), "has the shape")
    for cut in (evidence.S[:1], evidence.S[:, :1], evidence.S[:, :, 1:, 1:]):
        assert_rejected(replace(evidence, S=cut), "S has the shape")
    for part in ("centre.E", "centre.T", "centre.F"):
        less = attrgetter(part)(evidence)[..., 1:]
        assert_rejected(with_part(evidence, part, less), "has the shape")
    for knots in ((1, 0), (0, 0), (1, 2), (-1, 1)):
        assert_rejected(replace(evidence, knots=knots), "knots do not ascend")
    for rho in (0.0, -0.5, 1.0 + 1e-9):
        assert_rejected(replace(evidence, rho=rho), "rho is not in")
    for delays in ((-1.0, -1.0), (0.5, 1.0), (1.0, 0.95)):
        assert_rejected(with_part(evidence, "setting.delays", delays))
    for part, value in (("step", 0.0), ("step", -0.1), ("ages", 0), ("chatter", 0)):
        assert_rejected(with_part(evidence, f"setting.{part}", value))
    # Rows that no step would read, if what is said of the table's layout were believed.
    for part, value in (("ages", 1), ("context", "mode"), ("context", "none")):
        assert_rejected(with_part(aged, f"setting.{part}", value))


# -- files ---------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ALPHA)
def test_files_hold_the_evidence_bit_by_bit_and_prove_it_again(name, tmp_path):
    plant, law, certificate, _ = made(name)
    path = certificate.save(tmp_path / "a")
    assert path == tmp_path / "a.json"
    archived = load_evidence(path)
    loaded = archived.evidence
    for part in ARRAYS:
        one, two = (attrgetter(part)(e) for e in (loaded, certificate.evidence))
        assert (one.shape, one.tobytes()) == (two.shape, two.tobytes())
    setting = (f"setting.{key}" for key in ("delays", "chatter", "context", "ages", *TIMES))
    for part in ("rho", "knots", *setting):
        assert attrgetter(part)(loaded) == attrgetter(part)(certificate.evidence)
    verified = dt.verify(path, plant, law)
    assert verified.proven, verified.message
    assert verified.statement == certificate.statement
    assert verified.decay_rate == certificate.decay_rate == archived.decay_rate
    again = replace(certificate, evidence=loaded).save(tmp_path / "again.json")
    assert again.read_bytes() == path.read_bytes()


@pytest.fixture
def saved(tmp_path):
    return made("extended rows")[2].save(tmp_path / "certificate.json")


def assert_refused(path, message):
    with pytest.raises(CertificateFileError, match=message):
        dt.verify(path)


def test_ages_with_the_same_row_are_checked_once(monkeypatch):
    plant = dt.problems.paper().plant.apart(0.5)
    law = dt.AveragedPredictor(plant, dt.place(plant, [-1.0, -2.0]), dwell_time=20.0)
    asked, holds = [], Covering.holds
    monkeypatch.setattr(
        Covering, "holds", lambda self, *step: asked.append(step) or holds(self, *step)
    )
    certificate = dt.certify(plant, law, 20.0, step=0.1)
    assert certificate.proven
    assert certificate.evidence.setting.transitions.ages > 150
    assert len(asked) < 150


def test_an_altered_file_is_refused(saved, tmp_path):
    text = saved.read_text()
    for old, new in (
        *(('"rho": 0.9', '"rho": 0.8'), ('"dwell_time": 0.2', '"dwell_time": 0.1'), ("2.0", "2.1")),
        *(('"knots": [', '"knots": [0,'), ("linear", "Linear"), ('"dwell', '"well')),
    ):
        assert old in text
        saved.write_text(text.replace(old, new, 1))
        assert_refused(saved, "was altered after it was written")
    for size in (0, 1, len(text) // 2, len(text) - 3):
        saved.write_text(text[:size])
        assert_refused(saved, "must be a certificate's JSON file")
    for foreign in ("{}", "[]", "null", '{"format": "deadtime certificate 1"}', "7"):
        saved.write_text(foreign)
        assert_refused(saved, "is no deadtime certificate 2")
    for broken in ("[" * 10**5, '{"format": ' + "1" * 5000 + "}", '{"format": 1, "format": 2}'):
        saved.write_text(broken)
        assert_refused(saved, "must be a certificate's JSON file")
    saved.write_bytes(b'{"format": "\xff"}')
    for path in (tmp_path, tmp_path / "nowhere.json", saved):
        assert_refused(path, "must be a certificate's JSON file")
    with pytest.raises(CertificateFileError, match="cannot be written"):
        made("common")[2].save(tmp_path / "no" / "such" / "folder.json")


def test_a_file_about_another_plant_or_law_is_no_answer(saved):
    plant, law, _, _ = made("extended rows")
    assert dt.verify(saved, plant, law).proven
    for other, message in (
        ({"plant": designed(0.31, 0.234)[0]}, "a plant with other matrices"),
        ({"plant": designed(0.3, 0.235)[0]}, "a plant with a delay of"),
        ({"law": designed(0.3, 0.234, 0.1635)[1]}, "another table than that of the given law"),
        ({"law": designed(0.3, 0.234)[1]}, "another table than that of the given law"),
    ):
        found = dt.verify(saved, **other)
        assert (found.proven, found.statement, found.decay_rate) == (False, (), None)
        assert message in found.message


def test_a_file_is_an_answer_to_what_lies_within_its_class_of_signals_alone(tmp_path):
    plant, law, certificate, _ = made("common")
    path = certificate.save(tmp_path / "a.json")
    longest = dt.certify(plant, law, 0.2, 0.1, maximum_dwell=0.7).save(tmp_path / "b.json")
    average = dt.certify(plant, law, 0.2, 0.1, chatter=2).save(tmp_path / "c.json")
    for file, asked in (
        *((path, {"dwell_time": 0.2, "step": 0.1}), (path, {"dwell_time": 3.0, "chatter": 1})),
        *((path, {"maximum_dwell": 9.0}), (path, {"clock_tolerance": 1e-5})),
        *((longest, {"maximum_dwell": 0.7}), (longest, {"dwell_time": 0.3, "maximum_dwell": 0.4})),
        *((average, {"chatter": 2}), (average, {"dwell_time": 0.2})),
    ):
        assert dt.verify(file, plant, law, **asked).proven, asked
    for file, asked, message in (
        (path, {"dwell_time": 0.19}, "with a dwell time of 0.2 s, not 0.19 s"),
        (path, {"step": 0.05}, "is about a period of 0.1 s, not 0.05 s"),
        (path, {"chatter": 2}, "with a dwell time of 0.2 s, not for a chatter of 2"),
        (path, {"clock_tolerance": 1e-4}, "a clock that is off by 1e-05, not by 0.0001"),
        (longest, {"dwell_time": 0.2}, "between 0.2 s and 0.7 s, not for sojourns of any length"),
        (longest, {"maximum_dwell": 0.8}, "between 0.2 s and 0.7 s, not 0.8 s"),
        (average, {"chatter": 3}, "not for a chatter of 3"),
    ):
        found = dt.verify(file, **asked)
        assert not found.proven
        assert message in found.message
    assert [line.split()[0] for line in found.about] == ["Plant", "Table", "Signals:", "File"]


FAR = PAPER.apart(0.66)
FORGED = [  # what an attacker writes, who makes the digest fit again
    *(("plant", {"A": [FAR.A.tolist()], "B": [FAR.B.tolist()]}), ("", {"rho": 0.5})),
    *(("signals", {"dwell_time": 0.11}), ("lyapunov", {"knots": [0, 2]})),
    *(("plant", {"delays": [0.95, 1.0]}), ("", {"decay_rate": 1.0})),
    *(("signals", {"clock_tolerance": 0.5}), ("signals", {"chatter": 2})),
    *(("", {"claim": "Stable for every delay."}), ("signals", {"note": "all of them"})),
    *(("plant", {"A": [1.0, 2.0]}), ("plant", {"A": FAR.A.tolist()}), ("law", {"step": 0})),
    *(("plant", {"delays": [math.nan] * 2}), ("signals", {"dwell_time": 1e308})),
    *(("signals", {"maximum_dwell": math.inf}), ("law", {"ages": math.inf})),
    *(("lyapunov", {"knots": [math.inf]}), ("law.F", {"shape": [-1, 1, 2]})),
    *(("law.F", {"shape": [10**9, 10**9]}), ("law.F", {"shape": [math.inf]}), ("", {"hints": [1]})),
    *(("lyapunov.P", {"data": 3}), ("lyapunov.P", {"data": "\ud800"}), ("", {"law": None})),
    *(("law", {"context": ["mode"]}), ("law", {"context": "\ud800"}), ("", {"rho": 10**400})),
    *(("plant", {"A": [[[[10**400, 0.0], [0.0, 1.0]]] * 2]}), ("signals", {"chatter": True})),
    *(("lyapunov", {"kind": ["linear"]}), ("lyapunov", {"kind": "stretches"})),
    *(("", {"version": {"claims": "all"}}), ("plant", {"A": [[[["2.0", 1.0], [0.0, 1.0]]] * 2]})),
    ("", {"decay_rate": -1.0}),
]
SCRIPT = """
import sys
sys.modules["clarabel"] = sys.modules["cvxpy"] = None
import deadtime
for path in sys.argv[1:]:
    try:
        print(deadtime.verify(path).proven)
    except deadtime.CertificateFileError:
        print("refused")
"""


def test_whoever_makes_the_digest_fit_gains_nothing_and_no_solver_is_needed(tmp_path):
    certificate = made("eigenvectors")[2]
    paths = [certificate.save(tmp_path / f"{k}.json") for k in range(len(FORGED) + 2)]
    for path, (part, values) in zip(paths[2:], FORGED, strict=True):
        reference.rewritten(path, part, values)
    P = 1.001 * certificate.evidence.P
    reference.rewritten(paths[1], "lyapunov", {"P": reference.packed(P)})
    command = [sys.executable, "-W", "error", "-c", SCRIPT, *map(str, paths)]
    run = subprocess.run(command, capture_output=True, text=True)
    assert run.stderr == ""
    answers = run.stdout.split()
    assert answers[:10] == ["True"] + ["False"] * 9
    assert len(answers) == len(paths)
    assert set(answers[10:]) == {"False", "refused"}


# -- enclosures and definiteness -----------------------------------------------------------


@pytest.mark.parametrize("corners", [1, 3])
@pytest.mark.parametrize("delays", [(0.3, 0.3), (0.234, 0.234), (0.034, 0.034), (0.2, 0.29)])
def test_enclosures_hold_the_plant_and_its_derivatives(delays, corners):
    rng = np.random.default_rng(3)
    A = rng.normal(size=(2, 3, 3)) + 0.1 * rng.normal(size=(corners, 2, 3, 3))
    B = rng.normal(size=(2, 3, 2)) + 0.1 * rng.normal(size=(corners, 2, 3, 2))
    family = Family.of(A, B, delays, 0.1)

    def value(cell, point, reading="decimal"):
        E = reference.at_point(A, B, delays, 0.1, cell.order, *point, reading)
        return E[:, : family.generators(True).shape[-1]]

    def holds(matrix, values):
        exact = [arb(mpmath.nstr(y, 60, strip_zeros=False)) for y in values.flat]
        return all(x.contains(y) for x, y in zip(matrix.entries(), exact, strict=True))

    for cell in [*cells_of(family, 0, 0), *cells_of(family, 0, 1)]:
        for _ in range(3):
            cell = cell.halves(int(rng.integers(3 if corners > 1 else 2)))[int(rng.integers(2))]
        with balls.precision():
            found = Enclosures(family).of(cell)
        mean, weights = cell.corners.mean(axis=0), rng.dirichlet(np.ones(corners))
        point = [rng.uniform(*cell.u), rng.uniform(*cell.f), 0.9 * weights @ cell.corners]
        point[2] = point[2] + 0.1 * mean
        with mpmath.workdps(60), balls.precision(256):
            for reading in ("decimal", "binary"):
                middle = [np.mean(cell.u), np.mean(cell.f), mean]
                assert holds(found.centre, value(cell, middle, reading))
            ways = iter(cell.corners)
            for direction, slope in found.slopes:
                # By the mean value theorem a difference, as long as half of the cell.
                ahead = point.copy()
                if direction == 2:
                    ahead[2], scale = point[2] + 2.0**-5 * (next(ways) - mean), Fraction(32)
                else:
                    low, high = (cell.u, cell.f)[direction]
                    ahead[direction] = rng.uniform(low, high)
                    scale = Fraction(high - low) / 2
                    scale /= Fraction(ahead[direction]) - Fraction(point[direction])
                change = value(cell, ahead) - value(cell, point)
                assert holds(slope, change * reference.precise(scale))


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_definite_is_said_of_no_matrix_that_is_not(seed):
    rng = np.random.default_rng(seed)
    d = int(rng.integers(1, 9))
    C = rng.integers(-3, 4, (d, max(d - 1, 1))).astype(float)
    X, none = C @ C.T * (d > 1), np.zeros(d)  # singular, and exact
    nudge = 2.0 ** -int(rng.integers(1, 40))
    assert not is_positive_definite(X, none)
    assert not is_positive_definite(X + nudge * np.eye(d), nudge + none)
    assert not is_positive_definite(X - nudge * np.eye(d), none)
    some = X + nudge * np.diag(rng.integers(-1, 4, d))
    exact = np.vectorize(Fraction, otypes=[object])(some)
    assert reference.is_positive(exact) or not is_positive_definite(some, none)
    assert not is_positive_definite(some * np.nan, none)
    assert not is_positive_definite(some, none + np.nan)


@pytest.mark.parametrize("d", [1, 2, 10, 100])
def test_definite_is_said_of_matrices_that_clearly_are(d):
    Q = np.linalg.qr(np.random.default_rng(5).normal(size=(d, d)))[0]
    X = Q * np.geomspace(1.0, 1e-9 * d, d) @ Q.T
    unit = 1.0 / np.sqrt(np.diag(X))
    X = 0.5 * (X + X.T) * unit * unit[:, None]
    least = float(np.linalg.eigvalsh(X)[0])
    assert is_positive_definite(X, np.full(d, 0.5 * least))
    assert not is_positive_definite(X, np.full(d, 1.01 * least))
