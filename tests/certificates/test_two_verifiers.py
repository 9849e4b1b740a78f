"""Two verifiers that share no code answer alike: of mutants, and of files that ask for work."""

import dataclasses
import json
import math
import sys
from random import Random

import numpy as np
import pytest

import certificate_forgeries as forgeries
import deadtime as dt
from certificate_corpus import CASES, CORPUS
from deadtime.certificates.proof import (
    Evidence,
    StretchEvidence,
    load_evidence,
    save_evidence,
    work,
)
from deadtime.certificates.proof.delays import Delays
from deadtime.certificates.proof.evidence import Centre, Setting
from deadtime.certificates.proof.work import allowance, operations
from deadtime.numerics.precision import precision
from deadtime.plant.plant_set import Polytope
from fuzzing import mutators
from second_verifier import both, second_verifier

FILES = sorted(CORPUS.glob("*.json"))
VERIFY, CHECK = second_verifier(), sys.modules["deadtime.certificates.proof.check"]


# -- mutants ---------------------------------------------------------------------------

NAMES = (
    *("rate", "delayed", "maximum-free", "average-free", "lost-one-mode", "observed-late", "ways"),
    *("delays-short", "one-mode", "free-rate-0", "polytope-mode", "tracking", "late-mode"),
    *("ways-ring", "stretches-maximum-free", "stretches-late", "stretches-late-dwell"),
    *("samples", "samples-turning", "samples-ring", "samples-aged", "samples-late", "samples-lost"),
)
CHANGED = ("plant", "law", "signals", "rho", "decay_rate")
FACTORS = (0.5, 0.9, 0.99, 1.001, 1.01, 1.1, 2, 5, 100, -1)
OTHERS = (*(0, 1, 2, 3, 10, 1000, 10**5, 10**6, 0.1, 0.2, 0.25, 0.3), *(1e-9, 1e99, 1e101))


def mutant(rng):
    """A certificate with a change of any kind, or of its numbers; its hints are kept."""
    trees = [json.loads((CORPUS / f"{rng.choice(NAMES)}.json").read_text()) for _ in range(2)]
    tree, hints = trees[0], trees[0].pop("hints")
    if rng.random() < 0.5:
        tree = mutators.of_tree(rng, tree, trees[1])
    else:
        places = mutators.places({name: tree[name] for name in CHANGED})
        owner, key = rng.choice([(o, k) for o, k in places if type(o[k]) in (int, float)])
        owner = tree if key in ("rho", "decay_rate") else owner
        owner[key] = rng.choice((owner[key] * rng.choice(FACTORS), rng.choice(OTHERS)))
    return tree | {"hints": hints}


@pytest.mark.few(4)
@pytest.mark.parametrize("seed", range(40))
def test_both_verifiers_give_the_same_answer_to_mutants(seed, tmp_path):
    rng, path, proved = Random(seed), tmp_path / "mutant.json", 0
    for _ in range(25):
        tree = mutant(rng)
        path.write_text(forgeries.signed(tree))
        (first, message), (second, verdict) = both(VERIFY, path)
        proved += first
        if first != second:
            # The package splits the inequality, and takes the multiplier from the file's hints:
            # what holds by itself it may leave unproved, as it says. Nothing else may differ.
            assert (first, second) == (False, True), (message, verdict)
            assert tree["lyapunov"]["kind"] == "linear"
            assert message.startswith(("Rejected: the inequality ", "Rejected: the Lyapunov"))
    assert proved <= 20


# -- work ------------------------------------------------------------------------------


def counts(path):
    """Operations that a file asks for and that it may ask for, by both verifiers."""
    evidence = load_evidence(path).evidence
    along = isinstance(evidence, StretchEvidence)
    asked = operations(evidence.setting, len(evidence.knots), along)
    with precision(VERIFY.BITS):
        c = VERIFY.certificate(VERIFY.parsed(path)[0])
        loop = VERIFY.Loop(c, math.inf)
        second = loop.work(), VERIFY.FREE + VERIFY.PER_NUMBER * c.numbers
    return (asked, allowance(evidence.numbers)), second


def test_both_count_alike_and_every_file_of_the_corpus_asks_for_a_third_of_the_limit_or_less():
    for path in FILES:
        first, second = counts(path)
        assert first == second, path.stem
        assert 3 * first[0] <= first[1], path.stem


@pytest.mark.parametrize("halvings", [100, 1], ids=["asked for", "halving"])
def test_certify_says_the_least_limit_with_which_verify_proves(halvings, monkeypatch, tmp_path):
    """As of a file that asks for more than is usual: the allowance is made small instead."""
    for name, value in (("FREE", 10**4), ("PER_NUMBER", 10**2), ("HALVINGS", halvings)):
        monkeypatch.setattr(work, name, value)
    monkeypatch.setattr(CHECK, "HALVINGS", halvings)
    loop, dwell_time, step, options = CASES["range"]
    found = dt.certify(*loop(), dwell_time, step, **options)
    path, limit = found.save(tmp_path / "c.json"), found.limit
    assert limit > 2
    assert dt.verify(path, limit=limit).proven
    refused = dt.verify(path, limit=limit - 1).message
    assert (f"allow {limit:,} times the usual" if halvings > 1 else "operations") in refused


ONE = {"A": -np.ones((1, 1, 1, 1)), "B": np.full((1, 1, 1, 1), 1e-3), "delays": (0.05, 0.05)}
TWO = {"A": -np.ones((1, 2, 1, 1)), "B": np.full((1, 2, 1, 1), 1e-3), "delays": (0.05, 0.05)}


def setting(plant, rows=1, context="none", **options):
    m = plant["B"].shape[3]
    F, G = np.full((rows, m, 1), 1e-3), np.zeros((rows, 1, m, m))
    ages = options.pop("ages", 1)
    signals = dt.SignalClass(0.3, **options)
    about = Polytope(plant["A"], plant["B"]), Delays(np.array(plant["delays"]))
    return Setting(*about, F=F, G=G, context=context, ages=ages, step=0.1, signals=signals)


def ranges(modes, m):
    ends = np.stack([np.full((modes, m), x) for x in (0.02, 0.08)])
    return {"A": -np.ones((1, modes, 1, 1)), "B": np.full((1, modes, 1, m), 1e-3), "delays": ends}


def evidence_of(about):
    """A certificate with a common function, whose numbers prove nothing."""
    d, n, o, rows = about.order, about.states, about.outputs, len(about.F)
    y, w = n + len(about.family.reads), n + o * about.rows_differ
    centre = Centre(np.zeros((n, y)), about.rows[0], np.zeros((0, d)), np.zeros((rows, o, y)),
                    np.zeros((0, d)), np.zeros((0, y + w)))  # fmt: skip
    S = np.zeros((about.transitions.places, 1, 0, 0))
    return Evidence(about, centre, np.eye(d), np.eye(y + w), S, (0,), 1.0)


def several(count, plant):
    return plant | {name: np.repeat(plant[name], count, axis=0) for name in "AB"}


MUCH = {
    **{f"{m} delays in ranges": setting(ranges(1, m)) for m in (11, 14, 17)},
    "six delays in each of two modes": setting(ranges(2, 6)),
    "five delays in three modes": setting(ranges(3, 5)),
    **{f"{k} lost samples": setting(ONE, 2, lost_samples=k) for k in (60, 300, 3000)},
    "40 lost samples of two modes": setting(TWO, 4, "mode", lost_samples=40),
    "20 lost samples and 20 ages": setting(TWO, 80, "mode_age", ages=20, lost_samples=20),
    **{
        f"{k} ages at every level of a bucket": setting(TWO, 2 * k, "mode_age", ages=k, chatter=9)
        for k in (80, 400)
    },
    **{
        f"{k} ages told {k} periods late": setting(TWO, 2 * k, "mode_age", ages=k, mode_lag=k)
        for k in (90, 300)
    },
    "6,000 plants": setting(several(6000, ONE)),
    "900 plants in two modes, and a delay in a range": setting(
        several(900, TWO | {"delays": (0.02, 0.08)})
    ),
}


@pytest.mark.parametrize("name", MUCH)
def test_short_files_that_ask_for_long_work_are_refused_before_any_is_done(
    name, tmp_path, monkeypatch
):
    path = save_evidence(evidence_of(MUCH[name]), tmp_path / "a.json")
    first, second = counts(path)
    assert first == second
    assert first[0] > first[1]
    monkeypatch.setattr(CHECK, "_check_split", None)  # cannot be called
    monkeypatch.setattr(VERIFY, "linear", None)
    (proved, message), (also, verdict) = both(VERIFY, path)
    assert (proved, also) == (False, False)
    assert f"take {first[0]:.2g} operations" in message
    assert f"allow {math.ceil(first[0] / first[1]):,} times the usual (limit=, --limit)" in message
    assert f"it takes {first[0]:.2g} operations; --limit 1 allows {first[1]:.2g}" in verdict


@pytest.mark.parametrize("lag", [50, 2000, 9000])
def test_rows_told_ever_so_late_are_looked_at_where_they_change(lag, tmp_path):
    path = tmp_path / "a.json"
    path.write_text(forgeries.forged(("late-mode", forgeries.put("law.mode_lag", lag))))
    (proved, message), (also, verdict) = both(VERIFY, path)
    assert (proved, also) == (True, True), (message, verdict)


def test_the_limit_may_be_raised_and_lowered():
    path = CORPUS / "rate.json"
    ((asked, allowed), _) = counts(path)
    for limit, answer in ((0.9 * asked / allowed, False), (1.1 * asked / allowed, True)):
        assert [proved for proved, _ in both(VERIFY, path, limit)] == [answer, answer]
    for limit in (0.0, -1.0, math.nan):
        with pytest.raises(dt.ArgumentError, match="limit must be"):
            dt.verify(path, limit=limit)


def test_work_is_bounded_while_cells_are_halved(monkeypatch):
    monkeypatch.setattr(CHECK, "HALVINGS", 1)
    monkeypatch.setattr(VERIFY, "HALVINGS", 1)
    for name in ("average-dwell", "stretches-range", "range"):
        path = CORPUS / f"{name}.json"
        ((asked, allowed), _) = counts(path)
        (proved, message), (also, verdict) = both(VERIFY, path, 1.001 * asked / allowed)
        assert (proved, also) == (False, False)
        assert "it is not proved within" in message
        assert "it takes more operations; --limit" in verdict


def test_V_at_ages_to_which_a_mode_does_not_come_is_not_used(tmp_path):
    evidence = load_evidence(CORPUS / "maximum-free.json").evidence
    signals = dataclasses.replace(evidence.setting.signals, maximum_dwell=(1.8, 1.2))
    about = dataclasses.replace(evidence.setting, signals=signals)
    assert [own.last for own in about.transitions.clocks] == [18, 12]
    P = np.array([[evidence.lyapunov(mode, age) for age in (5, 15)] for mode in range(2)])
    P = 0.5 * (P + P.swapaxes(-1, -2))
    for unused in (P[1, 1], -P[1, 1], 0.0 * P[1, 1]):
        P[1, 1] = unused
        path = save_evidence(StretchEvidence(about, P, (5, 15), 1.0), tmp_path / "a.json")
        assert [proved for proved, _ in both(VERIFY, path)] == [True, True]
    P[0, 1] *= -1.0
    path = save_evidence(StretchEvidence(about, P, (5, 15), 1.0), tmp_path / "a.json")
    assert [proved for proved, _ in both(VERIFY, path)] == [False, False]
