"""A certificate's file holds its proof bit by bit, and no altered or foreign one is an answer."""

import math
import subprocess
import sys
from dataclasses import replace
from operator import attrgetter

import pytest

import certificate_reference as reference
import deadtime as dt
from deadtime.base.errors import CertificateFileError
from deadtime.certificates.proof import load_evidence
from deadtime.certificates.proof.covering import Covering
from evidence import ALPHA, ARRAYS, PAPER, TIMES, designed, made


@pytest.mark.few(1)
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
    setting = (f"setting.{key}" for key in ("signals", "context", "ages", *TIMES))
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


@pytest.mark.long
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
    with pytest.raises(dt.ArgumentError, match="cannot be written: No such file"):
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
    *(("signals", {"chatter": 2}), ("signals", {"clock_tolerance": 0.5})),
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
sys.modules["clarabel"] = None
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
    assert answers[:9] == ["True"] + ["False"] * 8
    assert len(answers) == len(paths)
    assert set(answers[9:]) == {"False", "refused"}
