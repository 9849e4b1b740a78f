"""The check: it rejects whatever is no proof, its enclosures hold, and its files are safe."""

import hashlib
import json
import math
import subprocess
import sys
from dataclasses import replace
from fractions import Fraction
from functools import cache
from itertools import pairwise

import mpmath
import numpy as np
import pytest
from flint import arb, ctx
from hypothesis import given, settings
from hypothesis import strategies as st

import certificate_reference as reference
import deadtime as dt
from deadtime.certificates.proof import balls, check, load_evidence
from deadtime.certificates.proof.definite import is_positive_definite
from deadtime.certificates.proof.enclosure import Enclosures, cells_of
from deadtime.certificates.proof.family import Family
from deadtime.certificates.proof.transitions import Transitions, interpolation
from deadtime.errors import ArgumentError, CertificateFileError

PAPER = dt.problems.paper().plant
seeds = st.integers(0, 2**32 - 1)


def designed(alpha, delay=1.0, law=dt.AveragedPredictor, **options):
    near = PAPER.apart(alpha)
    plant = dt.SwitchedSystem(near.A, near.B, delay)
    return plant, law(plant, dt.place(plant, [-1.0, -2.0]), **options)


# name: (plant and law, dwell time, step)
CASES = {
    "common": (lambda: designed(0.63), 0.2, 0.1),
    "eigenvectors": (lambda: designed(0.65), 0.2, 0.1),
    "extended rows": (lambda: designed(0.3, 0.234, dwell_time=0.1634), 0.2, 0.1),
}


@cache
def made(name):
    loop, dwell_time, step = CASES[name]
    plant, law = loop()
    certificate = dt.certify(plant, law, dwell_time, step)
    assert certificate.proven, certificate.message
    return plant, law, certificate


def rejected(evidence, reason=""):
    outcome = check(evidence)
    assert not outcome.proven
    assert outcome.reason
    assert reason in outcome.reason
    return True


@cache
def loop_of(name):
    plant, law, certificate = made(name)
    table = law.digital(certificate.evidence.setting.step)
    return reference.Loop(plant.A, plant.B, plant.delay, table)


def least(evidence, loop):
    """The least eigenvalue of all inequalities of the evidence, by the second method."""
    return reference.Inequalities(evidence, loop).least(np.linspace(0.0, 1.0, 21))


def about(evidence, **changes):
    """The same numbers about another setting."""
    return replace(evidence, setting=replace(evidence.setting, **changes))


@pytest.mark.parametrize("name", CASES)
def test_the_evidence_itself_passes_both_methods(name):
    evidence = made(name)[2].evidence
    assert bool(evidence.S.size) == (name == "eigenvectors")
    assert evidence.setting.rows_differ == (name == "extended rows")
    outcome = check(evidence)
    assert outcome.proven
    assert outcome.reason == ""
    assert least(evidence, loop_of(name)) > 0.0
    assert reference.Inequalities(evidence, loop_of(name)).residual() < 1e-12


@pytest.mark.parametrize("part", ["P", "Pi", "S"])
@pytest.mark.parametrize("name", CASES)
def test_perturbed_evidence_is_rejected_wherever_the_second_method_refutes_it(name, part):
    evidence, whole = made(name)[2].evidence, getattr(made(name)[2].evidence, part)
    large = 0.1 if (name, part) == ("extended rows", "Pi") else 1e-3  # it has room for 1e-3
    sizes = [large] * (8 if part == "P" else 20) + [1e-5, 1e-7, 1e-9, 1e-12]
    for seed, size in enumerate(sizes if whole.size else ()):
        rng = np.random.default_rng(seed)
        changed = whole.copy()
        for block in changed.reshape(-1, *changed.shape[-2:]):
            unit = np.sqrt(np.abs(np.diag(block)))
            noise = rng.choice([-size, 0.0, 0.0, size], size=block.shape)
            block += (np.triu(noise) + np.triu(noise, 1).T) * unit * unit[:, None]
        mutant = replace(evidence, **{part: changed})
        violated = least(mutant, loop_of(name)) < 0.0
        assert violated or size < large
        assert rejected(mutant) if violated else least(mutant, loop_of(name)) > 0.0


def test_evidence_is_rejected_for_another_plant_delay_dwell_time_rate_or_table():
    evidence, (_, law, _) = made("common")[2].evidence, made("common")
    table = law.digital(0.1)
    for alpha in (0.64, 0.66):
        other = PAPER.apart(alpha)
        mutant = about(evidence, A=other.A[None], B=other.B[None])
        assert least(mutant, reference.Loop(other.A, other.B, 1.0, table)) < 0.0
        assert rejected(mutant, "the inequality of the step")
    for delay, reason in ((0.9, "K ≻ 0 fails"), (0.98, "has the shape"), (1.1, "has the shape")):
        assert rejected(about(evidence, delays=(delay, delay)), reason)
    aged, plant, rows = made("extended rows")[2].evidence, *made("extended rows")[:2]
    for delay in (0.21, 0.27):
        loop = reference.Loop(plant.A, plant.B, delay, rows.digital(0.1))
        mutant = about(aged, delays=(delay, delay))
        assert least(mutant, loop) < 0.0
        assert rejected(mutant, "the inequality of the step")
    mutant = about(made("eigenvectors")[2].evidence, dwell_time=0.1)
    assert least(mutant, loop_of("eigenvectors")) < 0.0
    assert rejected(mutant, "the inequality of the step")
    assert check(about(evidence, dwell_time=0.1)).proven  # a common P allows any dwell time
    assert rejected(about(evidence, dwell_time=0.09), "the dwell time is below one period")
    for name in CASES:
        evidence, loop = made(name)[2].evidence, loop_of(name)
        modes = range(loop.plant.modes)
        rho = max(np.abs(np.linalg.eigvals(loop.step(i, 10**6))).max() for i in modes)
        assert rejected(replace(evidence, rho=float(rho) * (1.0 - 1e-9)))


def test_evidence_is_rejected_for_another_entry_of_the_table():
    for name in ("common", "extended rows"):
        evidence = made(name)[2].evidence
        for part, index in (("F", (-1, 0, 0)), ("F", (0, 0, 1)), ("G", (-1, 0, 0, 0))):
            changed = getattr(evidence.setting, part).copy()
            changed[index] *= 1.001
            reason = "row is not the table's row" if name == "common" else "K ≻ 0 fails"
            assert rejected(about(evidence, **{part: changed}), reason)
    # An attacker changes the centre, too.
    evidence = made("common")[2].evidence
    F, row = evidence.setting.F * 1.001, evidence.centre.row.copy()
    row[:, :2] = F[0]
    mutant = about(replace(evidence, centre=replace(evidence.centre, row=row)), F=F)
    assert least(mutant, loop_of("common")) < 0.0
    assert rejected(mutant, "K ≻ 0 fails")
    # Rows that no step would read, if the table's layout were believed.
    assert rejected(about(made("extended rows")[2].evidence, ages=1), "rows")
    assert rejected(about(made("extended rows")[2].evidence, context="mode"))
    assert rejected(about(made("extended rows")[2].evidence, context="none"))


def spoiled(array, value):
    result = array.copy()
    result.flat[-1] = value
    return result


@pytest.mark.parametrize("value", [math.nan, math.inf, 1e300])
@pytest.mark.parametrize("name", ["eigenvectors", "extended rows"])
def test_numbers_that_are_none_are_rejected_wherever_they_stand(name, value):
    evidence = made(name)[2].evidence
    setting, centre = evidence.setting, evidence.centre
    for part in ("P", "Pi", "S"):
        if getattr(evidence, part).size:
            assert rejected(replace(evidence, **{part: spoiled(getattr(evidence, part), value)}))
    for part in ("E", "row", "R", "T", "Psi", "F"):
        if getattr(centre, part).size:
            changed = replace(centre, **{part: spoiled(getattr(centre, part), value)})
            assert rejected(replace(evidence, centre=changed))
    for part in ("A", "B", "F", "G"):
        assert rejected(about(evidence, **{part: spoiled(getattr(setting, part), value)}))
    for part in ("step", "dwell_time", "maximum_dwell"):
        assert rejected(about(evidence, **{part: value}))
    assert rejected(about(evidence, delays=(setting.delays[0], value)))
    for rho in (value, 0.0, -0.5, 1.0 + 1e-9):
        assert rejected(replace(evidence, rho=rho), "rho is not in")


def test_shapes_knots_and_symmetry_are_checked():
    evidence = made("eigenvectors")[2].evidence
    skew = evidence.P.copy()
    skew[0, 1] *= 1.0 + 1e-15
    assert rejected(replace(evidence, P=skew), "P is not symmetric")
    for part in ("P", "Pi"):
        less = getattr(evidence, part)[:-1, :-1]
        assert rejected(replace(evidence, **{part: less}), f"{part} has the shape")
    for cut in (evidence.S[:1], evidence.S[:, :1], evidence.S[:, :, 1:, 1:]):
        assert rejected(replace(evidence, S=cut), "S has the shape")
    for part in ("E", "T", "F"):
        less = getattr(evidence.centre, part)[..., 1:]
        centre = replace(evidence.centre, **{part: less})
        assert rejected(replace(evidence, centre=centre), "has the shape")
    for knots in ((1, 0), (0, 0), (1, 2), (-1, 1)):
        assert rejected(replace(evidence, knots=knots), "knots do not ascend from 0")
    for change in ({"step": 0.0}, {"step": -0.1}, {"delays": (-1.0, -1.0)}, {"ages": 0}):
        assert rejected(about(evidence, **change))
    for change in ({"chatter": 0}, {"delays": (0.5, 1.0)}, {"delays": (1.0, 0.95)}):
        assert rejected(about(evidence, **change))


# -- files ---------------------------------------------------------------------------------


def rewritten(path, change=None, data=None):
    """Change a certificate's files as an attacker who makes the digests fit again."""
    content = json.loads(path.read_text())
    if change:
        change(content)
    if data is not None:
        path.with_suffix(".bin").write_bytes(data)
        content["sidecar"]["sha256"] = hashlib.sha256(data).hexdigest()
    content.pop("sha256")
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    content["sha256"] = hashlib.sha256(text.encode()).hexdigest()
    path.write_text(json.dumps(content))
    return path


@pytest.fixture
def saved(tmp_path):
    path = made("extended rows")[2].save(tmp_path / "certificate")
    assert path == tmp_path / "certificate.json"
    return path


@pytest.mark.parametrize("name", CASES)
def test_files_hold_the_evidence_bit_by_bit_and_prove_it_again(name, tmp_path):
    plant, law, certificate = made(name)
    evidence = certificate.evidence
    path = certificate.save(tmp_path / "a.json")
    loaded, words = load_evidence(path)
    assert words["claim"] == certificate.message
    assert (loaded.knots, loaded.rho) == (evidence.knots, evidence.rho)
    for part in ("setting", "centre", None):
        one, two = (getattr(e, part) if part else e for e in (evidence, loaded))
        for key, value in vars(one).items():
            if isinstance(value, np.ndarray) and key in type(one).__dataclass_fields__:
                assert value.tobytes() == getattr(two, key).tobytes()
            elif isinstance(value, float | int | str | tuple | None):
                assert value == getattr(two, key)
    verified = dt.verify(path, plant, law)
    assert verified.proven, verified.message
    assert verified.statement == certificate.statement
    assert verified.decay_rate == certificate.decay_rate
    again = replace(certificate, evidence=loaded).save(tmp_path / "again.json")
    assert again.with_suffix(".bin").read_bytes() == path.with_suffix(".bin").read_bytes()


@pytest.mark.parametrize(
    ("old", "new"),
    [('"rho": 0.9', '"rho": 0.8'), ('"dwell_time": 0.2', '"dwell_time": 0.1'), ("2.0", "2.001"),
     ('"knots": [', '"knots": [0,'), ("Stable", "stable"), ("dwell", "well")],
)  # fmt: skip
def test_an_altered_entry_is_noticed(saved, old, new):
    text = saved.read_text()
    assert old in text
    saved.write_text(text.replace(old, new, 1))
    with pytest.raises(CertificateFileError, match=r"was altered after it was written|lacks"):
        dt.verify(saved)


def test_files_cut_short_altered_swapped_or_missing_are_refused(saved, tmp_path):
    text, data, sidecar = saved.read_text(), saved.with_suffix(".bin").read_bytes(), "bin"
    sidecar = saved.with_suffix(".bin")
    for size in (0, 1, len(data) // 2, len(data) - 8, len(data) - 1):
        sidecar.write_bytes(data[:size])
        with pytest.raises(CertificateFileError, match="cut short or replaced"):
            dt.verify(saved)
    for at in (0, 7, len(data) // 2, len(data) - 1):
        sidecar.write_bytes(data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :])
        with pytest.raises(CertificateFileError, match="digest does not match"):
            dt.verify(saved)
    other = made("common")[2].save(tmp_path / "other.json").with_suffix(".bin")
    sidecar.write_bytes(other.read_bytes())
    with pytest.raises(CertificateFileError, match="cut short or replaced"):
        dt.verify(saved)
    sidecar.unlink()
    with pytest.raises(CertificateFileError, match="the binary file belongs beside"):
        dt.verify(saved)
    sidecar.write_bytes(data)
    for size in (0, 1, len(text) // 2, len(text) - 3):
        saved.write_text(text[:size])
        with pytest.raises(CertificateFileError, match="must be a certificate's JSON file"):
            dt.verify(saved)
    for foreign in ("{}", "[]", "null", '{"format": "deadtime certificate 0"}', "7"):
        saved.write_text(foreign)
        with pytest.raises(CertificateFileError, match="is no deadtime certificate 1"):
            dt.verify(saved)
    for path in (tmp_path, tmp_path / "nowhere.json"):
        with pytest.raises(ArgumentError, match="must be a certificate's JSON file"):
            dt.verify(path)
    with pytest.raises(ArgumentError, match="cannot be written"):
        made("common")[2].save(tmp_path / "no" / "such" / "folder.json")


def test_a_file_about_another_plant_or_law_is_no_answer(saved):
    plant, law, _ = made("extended rows")
    assert dt.verify(saved, plant, law).proven
    for other, message in (
        (designed(0.31, 0.234)[0], "a plant with other matrices"),
        (designed(0.3, 0.235)[0], "a plant with a delay in"),
    ):
        found = dt.verify(saved, plant=other)
        assert not found.proven
        assert message in found.message
        assert found.statement == ()
    for dwell_time in (0.1635, None):
        found = dt.verify(saved, law=designed(0.3, 0.234, dwell_time=dwell_time)[1])
        assert not found.proven
        assert "another table than that of the given law" in found.message


def test_whoever_makes_the_digests_fit_gains_nothing_and_no_solver_is_needed(tmp_path):
    infinite, deep = float("inf"), tmp_path / "deep.json"
    far = PAPER.apart(0.66)
    claims = {
        "plant": lambda c: c["plant"].update(A=[far.A.tolist()], B=[far.B.tolist()]),
        "rho": lambda c: c.update(rho=0.5),
        "dwell": lambda c: c["signals"].update(dwell_time=0.1),
        "knots": lambda c: c.update(knots=[0, 2]),
        "delays": lambda c: c["plant"].update(delays=[0.95, 1.0]),
        "one axis": lambda c: c["plant"].update(A=[1.0, 2.0]),
        "plant's modes": lambda c: c["plant"].update(A=c["plant"]["A"][0]),
        "no step": lambda c: c["law"].update(step=0),
        "no number": lambda c: c["plant"].update(delays=[math.nan, math.nan]),
        "endless": lambda c: c["signals"].update(dwell_time=1e308),
        "infinite dwell": lambda c: c["signals"].update(maximum_dwell=infinite),
        "infinite ages": lambda c: c["law"].update(ages=infinite),
        "infinite knots": lambda c: c.update(knots=[infinite]),
        "negative shape": lambda c: c["sidecar"]["arrays"][0].__setitem__(1, [-1, 1, 2]),
        "huge shape": lambda c: c["sidecar"]["arrays"][0].__setitem__(1, [10**9, 10**9]),
        "a list": lambda c: c.update(sidecar=[1]),
        "a number": lambda c: c["sidecar"].update(file=3),
        "no law": lambda c: c.pop("law"),
    }
    paths = []
    for name, change in claims.items():
        path = made("eigenvectors")[2].save(tmp_path / f"{name}.json")
        paths.append(rewritten(path, change))
    path = made("eigenvectors")[2].save(tmp_path / "P.json")
    data = bytearray(path.with_suffix(".bin").read_bytes())
    P = made("eigenvectors")[2].evidence.P
    at = bytes(data).index(P.tobytes())
    data[at : at + 8] = np.float64(0.99 * P[0, 0]).tobytes()
    deep.write_text("[" * 10**5)
    honest = made("eigenvectors")[2].save(tmp_path / "honest.json")
    script = """if True:
        import sys
        for solver in ("clarabel", "cvxpy"):
            sys.modules[solver] = None
        import deadtime
        for path in sys.argv[1:]:
            try:
                print(deadtime.verify(path).proven)
            except deadtime.CertificateFileError:
                print("refused")
    """
    paths = [*paths, rewritten(path, data=bytes(data)), deep, honest]
    run = subprocess.run(
        [sys.executable, "-W", "error", "-c", script, *map(str, paths)],
        capture_output=True,
        text=True,
    )
    assert run.stderr == ""
    *answers, last = run.stdout.split()
    assert last == "True"
    assert len(answers) == len(claims) + 2
    assert answers[:5] == ["False"] * 5
    assert answers[-2] == "False"
    assert set(answers) == {"False", "refused"}


# -- the graph of steps --------------------------------------------------------------------


def covered(graph, knots, i, a, row, j, b):
    """Whether a step is in the graph, or between two that imply it where all is linear in the age."""
    found = {t.age: t.next_age for t in graph.all(knots) if (t.mode, t.row, t.after) == (i, row, j)}
    if a in found:
        return found[a] == b
    below, above = (max(x for x in found if x < a), min(x for x in found if x > a))
    part = Fraction(above - a, above - below)

    def weights(age):
        pairs = interpolation(knots, age)
        return np.array([sum(w for k, w in pairs if k == n) for n in range(len(knots))], object)

    ends = ((below, above, a), (found[below], found[above], b))
    return all(
        (weights(x) * part + weights(y) * (1 - part) == weights(z)).all() for x, y, z in ends
    )


@pytest.mark.parametrize(("context", "table_ages"), [("none", 1), ("mode", 1), ("mode_age", 7)])
@pytest.mark.parametrize("longest", [None, 0.93])
@pytest.mark.parametrize("dwell_time", [0.1, 0.17, 0.3, 0.449])
def test_every_step_of_signals_in_real_time_is_covered(context, table_ages, longest, dwell_time):
    rng, modes = np.random.default_rng(0), 3
    graph = Transitions.of(modes, (dwell_time, longest), 1, 0.1, context, table_ages)
    knots = tuple(sorted({0, graph.last // 3, graph.last}))
    most = longest if longest else dwell_time + 0.9
    times, sequence = reference.random_signal(rng, modes, dwell_time, 40.0, most)
    sampled = dt.SwitchingSignal(times, sequence)(np.arange(401) * 0.1 + 1e-12)
    seen = reference.ages(sampled)
    for k in range(400):
        i, j = int(sampled[k]), int(sampled[k + 1])
        a, b = min(seen[k], graph.last), min(seen[k + 1], graph.last)
        row = {"none": 0, "mode": i, "mode_age": i * table_ages + min(seen[k], table_ages - 1)}
        assert covered(graph, knots, i, a, row[context], j, b), (i, a, j, b)
    assert graph.last < 12
    assert any(seen[k] == graph.first and sampled[k] != sampled[k + 1] for k in range(400))


@pytest.mark.parametrize("chatter", [2, 3])
@pytest.mark.parametrize("average", [0.1, 0.17, 0.3, 0.75])
def test_every_step_of_bursts_within_an_average_dwell_time_is_covered(average, chatter):
    rng, modes = np.random.default_rng(1), 3
    graph = Transitions.of(modes, (average, None), chatter, 0.1, "mode", 1)
    knots = tuple(sorted({0, graph.last // 2, graph.last}))
    times, sequence = reference.bursts(rng, modes, average, chatter, 60.0, 0.1)
    switches = np.array(times[1:])
    gaps = switches[None] - switches[:, None]  # the signal is admissible, and uses its room
    room = chatter + gaps / average - (np.arange(len(switches)) - np.arange(len(switches))[:, None])
    assert room[np.triu_indices(len(switches))].min() >= 1.0 - 1e-9
    assert room[np.triu_indices(len(switches), 1)].min() < 1.1
    sampled = dt.SwitchingSignal(times, sequence)(np.arange(600) * 0.1 + 1e-12)
    level = graph.last
    for i, j in pairwise(sampled.tolist()):
        after = min(level + 1, graph.last) if i == j else level - graph.bucket
        assert covered(graph, knots, i, level, i, j, after), (i, level, j, after)
        level = after


# -- enclosures and definiteness -----------------------------------------------------------

FAMILIES = {
    "whole delay": (1, (0.3, 0.3)),
    "fraction": (1, (0.234, 0.234)),
    "within a period": (1, (0.034, 0.034)),
    "range": (1, (0.22, 0.29)),
    "range from a multiple": (1, (0.2, 0.3)),
    "polytope": (3, (0.234, 0.234)),
    "polytope and range": (2, (0.21, 0.25)),
}


def ball(value):
    return arb(mpmath.nstr(value, 60, strip_zeros=False))


@pytest.mark.parametrize("reading", ["binary", "decimal"])
@pytest.mark.parametrize("name", FAMILIES)
def test_enclosures_hold_the_plant_and_its_derivatives(name, reading):
    corners, delays = FAMILIES[name]
    rng = np.random.default_rng(3)
    A = rng.normal(size=(2, 3, 3)) + 0.1 * rng.normal(size=(corners, 2, 3, 3))
    B = rng.normal(size=(2, 3, 2)) + 0.1 * rng.normal(size=(corners, 2, 3, 2))
    family, h = Family.of(A, B, delays, 0.1), Fraction(1, 10)
    low, high = (reference.decimal(d) for d in delays)
    if reading == "decimal":
        A, B = (np.vectorize(reference.decimal, otypes=[object])(X) for X in (A, B))
    A, B = reference.many_digits(A), reference.many_digits(B)

    def value(cell, u, f, weights):
        """E at a point of the parameters."""
        mixed = (np.tensordot(reference.many_digits(weights), X, 1) for X in (A, B))
        plant = reference.Plant(*mixed, low + (high - low) * Fraction(f), h, digits=True)
        early = cell.order[0].share != "all"
        s = Fraction(u) if not family.split else Fraction(u) * plant.phase / h
        if family.split and not early:
            s = (plant.phase + Fraction(u) * (h - plant.phase)) / h
        modes = cell.order[0].mode, cell.order[-1].mode
        return plant.rows(*modes, s)[:, : family.generators(True).shape[-1]]

    def holds(matrix, values):
        return all(x.contains(ball(y)) for x, y in zip(matrix.entries(), values.flat, strict=True))

    precision = ctx.prec
    with mpmath.workdps(60), balls.precision(256):
        for after in (0, 1):
            for cell in cells_of(family, 0, after):
                for _ in range(3):
                    direction = int(rng.choice([0, 1, 2] if corners > 1 else [0, 1]))
                    cell = cell.halves(direction)[int(rng.integers(2))]
                with balls.precision():
                    found = Enclosures(family).of(cell)
                mean = cell.corners.mean(axis=0)
                middle = (0.5 * sum(cell.u), 0.5 * sum(cell.f), mean)
                assert holds(found.centre, value(cell, *middle))
                point = [float(rng.uniform(*cell.u)), float(rng.uniform(*cell.f))]
                point.append(rng.dirichlet(np.ones(corners)) @ cell.corners)
                ways = iter(cell.corners)
                for direction, slope in found.slopes:
                    ahead = list(point)
                    if direction == 2:  # towards a corner, as far as the centre is from it
                        ahead[2] = point[2] + 2.0**-10 * (next(ways) - mean)
                        scale = 2**10
                    else:
                        ends = (cell.u, cell.f)[direction]
                        ahead[direction] = float(rng.uniform(*ends))
                        half = Fraction(ends[1] - ends[0]) / 2
                        scale = half / (Fraction(ahead[direction]) - Fraction(point[direction]))
                    difference = value(cell, *ahead) - value(cell, *point)
                    if direction == 2:
                        # the point ahead may leave the simplex by 2⁻¹⁰ of its size
                        slope = slope * arb(1, 0.01)
                    assert holds(slope, difference * reference.precise(Fraction(scale)))
    assert ctx.prec == precision


@given(seeds)
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


def test_definite_is_said_of_matrices_that_clearly_are():
    rng = np.random.default_rng(5)
    for d in (1, 2, 10, 100):
        Q = np.linalg.qr(rng.normal(size=(d, d)))[0]
        X = Q * np.geomspace(1.0, 1e-9 * d, d) @ Q.T
        X = 0.5 * (X + X.T)
        unit = 1.0 / np.sqrt(np.diag(X))
        X = X * unit * unit[:, None]
        least = float(np.linalg.eigvalsh(X)[0])
        assert is_positive_definite(X, np.full(d, 0.5 * least))
        assert not is_positive_definite(X, np.full(d, 1.01 * least))
