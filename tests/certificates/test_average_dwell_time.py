"""Average dwell times: V may rise at a switch; held against LMIs and attacked along bursts."""

import itertools
import json
import math

import cvxpy as cp
import numpy as np
import pytest

import certificate_reference as reference
import deadtime as dt
from certificate_corpus import aged_pair, free
from certificate_forgeries import forged, put
from certified_loops import PAPER, designed, proved
from deadtime.cli.application import main
from deadtime.problems.switching_assumptions import signals_of

STEP = 0.1
PAIR = np.array([[[0.0, 1.0], [-10.0, -1.0]], [[0.0, 1.0], [-0.1, -0.5]]])  # they turn
SHEAR = np.array([[[-0.2, 3.0], [-0.3, -0.2]], [[-0.3, 0.5], [-2.0, -0.3]]])
THREE = np.array([
    [[-0.4, 2.0], [-0.5, -0.4]], [[-0.6, 0.4], [-1.5, -0.6]], [[-0.5, 1.0], [-1.0, -0.5]]
])  # fmt: skip


def by_matrix_inequalities(A) -> float:
    """The least ln μ/λ with A_iᵀP_i + P_iA_i ≺ −λP_i, P_i ≺ μP_j [Hespanha and Morse 1999].

    Over λ up to that of the slowest mode, μ by bisection, in continuous time and another program.
    """
    n, modes = A.shape[1], range(len(A))
    fastest = -2.0 * max(np.linalg.eigvals(M).real.max() for M in A)
    P = [cp.Variable((n, n), symmetric=True) for _ in modes]
    rate, rise = cp.Parameter(nonneg=True), cp.Parameter(nonneg=True)
    limits = [X >> 1e-3 * np.eye(n) for X in P] + [X << 1e3 * np.eye(n) for X in P]
    limits += [M.T @ X + X @ M << -rate * X for M, X in zip(A, P, strict=True)]
    limits += [P[i] << rise * P[j] for i, j in itertools.permutations(modes, 2)]
    program, found = cp.Problem(cp.Minimize(0), limits), []

    def holds(mu):
        rise.value = mu
        program.solve("CLARABEL")
        return program.status == "optimal"

    for part in (0.3, 0.5, 0.7, 0.8, 0.9, 0.96, 0.999):
        rate.value, low, high = part * fastest, 0.0, math.log(100.0)
        if not holds(math.exp(high)):
            continue
        for _ in range(10):
            middle = 0.5 * (low + high)
            low, high = (low, middle) if holds(math.exp(middle)) else (middle, high)
        found.append(high / rate.value)
    return min(found)


@pytest.mark.parametrize("A", [PAIR, SHEAR, THREE], ids=["turning", "shear", "three"])
def test_what_linear_matrix_inequalities_give_is_proved_within_two_percent_and_no_less(A):
    least = by_matrix_inequalities(A)
    if A is PAIR:
        assert least == pytest.approx(5.42, abs=0.01)
    proved(*free(A), 1.02 * least, STEP, chatter=2, decay_rate=0.0)
    below = dt.certify(*free(A), 0.97 * least, STEP, chatter=2, search_signals=False)
    assert below.stable is None


@pytest.mark.parametrize("chatter", [1, 2, 5])
def test_the_turning_pair_is_proved_at_a_hundred_seconds_and_close_to_its_slowest_mode(chatter):
    found = proved(*free(PAIR), 100.0, STEP, chatter=chatter)
    assert found.decay_rate > 0.2  # held it decays at 0.25


def turned(rng):
    """Modes that decay and turn in planes of their own, without input."""
    A = rng.normal(size=(3, 3, 3))
    A -= (np.linalg.eigvals(A).real.max(axis=1) + 0.4)[:, None, None] * np.eye(3)
    return free(A)


LOOPS = {
    "turning": (lambda: free(PAIR), 5.5, 2),
    "shear": (lambda: free(SHEAR), 8.0, 4),
    "three": (lambda: free(THREE), 6.0, 3),
    "three states": (lambda: turned(np.random.default_rng(4)), 12.0, 2),
    "aged": (aged_pair, 9.0, 3),
}


def bound_along(certificate, loop, chatter, average, choose):
    """max over k of ln V_k/(μ^N₀ ρ^{2k} V_0) along the switches that `choose` picks from a bucket.

    `choose` gets (mode, ξ, level, what may come: (mode after, ξ after)) and returns an index.
    """
    evidence, mode, level, worst, age = certificate.evidence, 0, float(chatter), -math.inf, 0
    P = evidence.P[:, 0]
    xi = np.linalg.eigh(P[0])[1][:, -1]
    start = math.log(xi @ P[0] @ xi) + chatter * math.log(evidence.mu)
    travels = evidence.setting.inputs > 0
    for k in range(1, 400):
        own = loop.step(mode, age)
        options = [(mode, own if travels else own[: len(xi), : len(xi)])]
        if level >= 1.0:  # the bucket is fuller at any instant of the period than at its start
            for j, s in itertools.product(range(loop.plant.modes), (0.01, 0.5, 1.0)):
                if j != mode:
                    M = loop.step(mode, age, j, s)
                    options.append((j, M if travels else M[: len(xi), : len(xi)]))
        options = [(j, M @ xi) for j, M in options]
        after, xi = options[choose(mode, level, options, P)]
        level = min(float(chatter), level - (after != mode) + STEP / average)
        mode, age = after, 0 if after != mode else age + 1
        value = math.log(xi @ P[mode] @ xi)
        worst = max(worst, value - start - 2.0 * k * math.log(evidence.rho))
        scale = np.linalg.norm(xi)
        xi, start = xi / scale, start - 2.0 * math.log(scale)
    return worst


def greedy(mu):
    """The switch after which V μ^level is largest: the worst that the proof leaves room for."""

    def choose(mode, level, options, P):
        left = [math.log(x @ P[j] @ x) - (j != mode) * math.log(mu) for j, x in options]
        return int(np.argmax(left))

    return choose


def hasty(mode, level, options, P):
    """Switch whenever the bucket allows it, to what is largest then."""
    left = [math.log(x @ P[j] @ x) + 99.0 * (j != mode) for j, x in options]
    return int(np.argmax(left))


@pytest.mark.parametrize("name", LOOPS)
def test_v_stays_below_its_transient_factor_along_signals_chosen_against_it(name):
    make, average, chatter = LOOPS[name]
    plant, law = make()
    certificate = proved(plant, law, average, STEP, chatter=chatter)
    assert certificate.evidence.mu > 1.0
    loop = reference.Loop(plant.A, plant.B, plant.delay, law.digital(STEP))
    rng = np.random.default_rng(0)

    def random(mode, level, options, P):
        return int(rng.integers(len(options))) * int(rng.random() < 0.2)

    tried = [greedy(certificate.evidence.mu), greedy(1.0), hasty, random, random]
    worst = [bound_along(certificate, loop, chatter, average, one) for one in tried]
    assert max(worst) < 0.0


def test_without_the_factor_the_bound_is_false():
    plant, law = free(PAIR)
    certificate = proved(plant, law, 5.5, STEP, chatter=4)
    loop = reference.Loop(plant.A, plant.B, plant.delay, law.digital(STEP))
    worst = bound_along(certificate, loop, 4, 5.5, hasty)
    assert worst + 4 * math.log(certificate.evidence.mu) > math.log(1.0)


def test_neither_file_nor_arguments_may_ask_for_more(tmp_path):
    plant, law = free(PAIR)
    path = proved(plant, law, 6.0, STEP, chatter=2).save(tmp_path / "c.json")
    content = json.loads(path.read_text(encoding="utf-8"))
    assert content["lyapunov"]["kind"] == "stretches"
    assert content["lyapunov"]["mu"] > 10.0
    assert dt.verify(path, plant, law, dwell_time=6.0, chatter=2).proven
    assert "but for one factor of at most" in dt.verify(path).statement[-1]
    for asked in ({"chatter": 3}, {"dwell_time": 5.9}):
        assert not dt.verify(path, **asked).proven


def test_what_is_proved_for_one_chatter_holds_for_any(tmp_path):
    path = tmp_path / "more.json"
    path.write_text(forged(("average-turning", put("signals.chatter", 7))))
    assert dt.verify(path, chatter=7, dwell_time=6.0).proven


# -- what a file promises -------------------------------------------------------------------

FILE = """
[plant]
delay = 0.3
A = [[[0.0, 1.0], [-10.0, -1.0]], [[0.0, 1.0], [-0.1, -0.5]]]
B = [[[0.0], [1.0]], [[0.0], [1.0]]]
[gains]
K = [[[0.0, 0.0]], [[0.0, 0.0]]]
[signal]
kind = "random"
average_dwell_time = {average}
chatter = {chatter}
seed = 1
[run]
x0 = [1.0, 0.0]
horizon = 60.0
step = 0.1
[[law]]
kind = "averaged"
"""


@pytest.mark.parametrize(("average", "chatter"), [(10.0, 2), (6.0, 3), (7.5, 1), (0.4, 5)])
def test_a_file_is_asked_about_by_its_class_and_not_by_the_signal_drawn(tmp_path, average, chatter):
    path = tmp_path / "adt.toml"
    path.write_text(FILE.format(average=average, chatter=chatter))
    problem = dt.problems.load_problem(path)
    asked = signals_of(problem, problem.signal).signals
    assert asked == dt.SignalClass(average, chatter=chatter)
    assert signals_of(problem, problem.signal, chatter=1).signals == dt.SignalClass(average)
    assert signals_of(problem, problem.signal, [3.0]).signals.chatter == chatter


def of_command(capsys, *arguments):
    with pytest.raises(SystemExit) as stopped:
        main(arguments)
    return stopped.value.code, capsys.readouterr().out


def test_certify_and_verify_take_the_class_of_the_file_and_chatter(tmp_path, capsys):
    path, out = str(tmp_path / "adt.toml"), str(tmp_path / "c.json")
    (tmp_path / "adt.toml").write_text(FILE.format(average=10.0, chatter=2))
    code, text = of_command(capsys, "certify", path, "--law", "averaged", "--out", out)
    said = "switches at most 2 + T/(10 s) times in any T seconds (the problem's average dwell time)"
    assert (code, said in " ".join(text.split())) == (0, True)
    assert of_command(capsys, "verify", out, "--problem", path)[0] == 0
    assert of_command(capsys, "verify", out, "--problem", path, "--chatter", "3")[0] == 1
    assert of_command(capsys, "verify", out, "--dwell-time", "9", "--chatter", "2")[0] == 1
    code, text = of_command(
        capsys,
        "certify",
        path,
        "--law",
        "averaged",
        "--json",
        "--dwell-time",
        "5",
        "--chatter",
        "4",
    )
    record = json.loads(text)
    assert (record["dwell_time"], record["chatter"], code) == (5.0, 4, 1)
    assert record["laws"]["averaged"]["stable"] is None


def test_the_least_average_dwell_time_is_bracketed():
    plant, law = free(PAIR)
    found = dt.margins.least_dwell_time(plant, law, STEP, 1.1, chatter=2)
    assert 5.41 < found.certified < 5.42 * 1.1
    assert 2.6 < found.refuted < 2.8
    assert "with an average dwell time of" in found.message
    with pytest.raises(dt.ArgumentError, match="chatter > 1 and maximum_dwell exclude each other"):
        dt.margins.least_dwell_time(plant, law, STEP, chatter=2, maximum_dwell=3.0)
    with pytest.raises(dt.ArgumentError, match="chatter above 1 asks about one average"):
        dt.margins.least_dwell_time(plant, law, STEP, chatter=2, dwell_time=3.0, mode=0)


def test_feedback_over_a_delay_line_is_certified_for_an_average_dwell_time():
    certificate = proved(*designed(PAPER.apart(0.3)), 1.0, STEP, chatter=3)
    assert certificate.decay_rate > 0.1
