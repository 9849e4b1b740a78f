"""`deadtime certify` and `verify`, on answers that are made up and on real ones."""

import json
import re
from dataclasses import replace
from importlib import import_module
from importlib.resources import files
from types import SimpleNamespace

import numpy as np
import pytest

import deadtime as dt
from certificate_reference import rewritten
from certified_loops import MILD_FILE
from deadtime.certificates import Verification
from deadtime.certificates.proof.archive import digest
from deadtime.cli.application import main
from deadtime.imperfections import Dropout, ModeDelay, Noise
from deadtime.reports.certificate_tables import certificate_sentences, judge

WITNESS = SimpleNamespace(
    growth_rate=0.282, message="grows.", modes=(1,), sojourns=(np.inf,), phase=0.0, signal=None,
    proven=True,
)  # fmt: skip
CALM = SimpleNamespace(
    growth_rate=-0.4, message="decays.", modes=(0, 1), sojourns=(0.2, 0.3), phase=0.01,
    proven=False,
)  # fmt: skip
ANSWERS = {
    "averaged": (False, None, "Not stable for every signal: mode 1 for ever grows.", WITNESS),
    "mean": (True, 0.25, "Proved.", None),
    "oracle": (None, None, "The oracle knows the future: no certificate.", None),
}


def run(capsys, *arguments):
    with pytest.raises(SystemExit) as stopped:
        main(arguments)
    captured = capsys.readouterr()
    return stopped.value.code, captured.out, captured.err


@pytest.fixture
def made_up(monkeypatch, tmp_path):
    """Answers by the law's label; a law that is not in the list is refused."""
    monkeypatch.chdir(tmp_path)
    asked = []

    def certify(plant, law, dwell_time, step, decay_rate, delays=None, mode_lag=0, progress=None):
        asked.append((law.label, dwell_time, step, decay_rate))
        if law.label not in ANSWERS:
            raise dt.ArgumentError("this law cannot be asked about.")
        stable, rate, message, witness = ANSWERS[law.label]
        return SimpleNamespace(
            stable=stable,
            decay_rate=rate,
            proven=stable is True,
            message=message,
            statement=("The loop is the sampled one.",),
            witness=witness,
            save=lambda path: path.write_text(law.label) and path,
            limit=1,
        )

    text = "between 0.99 s and 1.012 s"
    margin = SimpleNamespace(lower=0.99, upper=1.012, differ=False, message=text)
    for place, function in {
        "certificates.certify": certify,
        "certificates.falsify": lambda plant, law, dwell_time, step, mode_lag=0: CALM,
        "margins.delay.constant_delay_margin": lambda plant, law, step: margin,
    }.items():
        module, _, name = f"deadtime.{place}".rpartition(".")
        monkeypatch.setattr(import_module(module), name, function)
    return asked


def test_decay_at_no_rate_in_particular_is_not_tabulated_as_none(capsys, made_up, monkeypatch):
    monkeypatch.setitem(ANSWERS, "mean", (True, 0.0, "Proved.", None))
    _, out, _ = run(capsys, "certify", "paper", "--law", "mean", "--decay-rate", "0")
    assert "mean yes > 0 yes" in " ".join(out.split())


def test_certify_tabulates_every_law_and_says_why_one_has_no_answer(capsys, made_up):
    code, out, err = run(capsys, "certify", "paper")
    assert (code, err) == (0, "")
    text = " ".join(out.split())
    assert "averaged no – witness −0.282 0.99 to 1.012" in text
    assert "mean yes 0.25 yes +0.400 0.99 to 1.012" in text
    assert "oracle no answer – – –" in text
    assert text.startswith("Stable for every such signal: mean. Not stable: averaged. No answer: m")
    assert "mode 0 only no answer – – – –" in text
    assert "• mode 0 only: this law cannot be asked about." in text
    assert "at least 0.2 s" in text
    assert {asked[1:3] for asked in made_up} == {(dt.SignalClass(0.2), 0.01)}


def test_a_law_of_one_mode_has_one_name_that_of_the_mode(capsys, made_up, monkeypatch):
    monkeypatch.setitem(ANSWERS, "mode 1 only", (False, None, "Held in mode 1 it grows.", WITNESS))
    _, out, _ = run(capsys, "certify", "follower", "--law", "brake only")
    text = " ".join(out.split())
    assert "brake only no – witness" in text
    assert text.startswith("brake only: Held in brake it grows.")
    assert list(dt.problems.follower().laws)[1:3] == ["throttle only", "brake only"]


def test_certify_of_one_law_tells_what_is_proved_and_saves_it(capsys, made_up, tmp_path):
    numbers = ("--dwell-time", "0.5", "--step", "0.05", "--decay-rate", "0.1")
    arguments = ("--law", "mean", *numbers, "--out", "cert.json")
    code, out, err = run(capsys, "certify", "paper", *arguments)
    assert (code, err) == (0, "")
    assert made_up == [("mean", dt.SignalClass(0.5), 0.05, 0.1)]
    assert out.startswith("mean: Proved.")
    assert "The loop is the sampled one." not in out
    assert "• Delay: between 0.99 s and 1.012 s." in out
    assert out.rstrip().endswith("Certificates: cert.json")
    assert (tmp_path / "cert.json").read_text() == "mean"
    _, out, _ = run(capsys, "certify", "paper", *arguments, "--explain")
    assert "mean, formally:\n• The loop is the sampled one." in out


def test_certify_of_all_laws_saves_each_into_a_file_of_its_own(capsys, made_up, tmp_path):
    code, out, _ = run(capsys, "certify", "paper", "--out", "cert.json")
    assert code == 0
    assert [path.name for path in tmp_path.iterdir()] == ["cert-mean.json"]
    assert "Certificates: cert-mean.json" in out
    code, out, _ = run(capsys, "certify", "paper", "--law", "averaged", "--out", "cert.json")
    assert "Certificates: none to save" in out


def test_certify_says_that_it_leaves_imperfections_out(capsys, made_up, monkeypatch):
    imperfect = replace(dt.problems.paper(), imperfections=(Dropout(0.5),))
    monkeypatch.setattr(import_module("deadtime.cli.options"), "problem_of", lambda _: imperfect)
    said = "Not covered: dropout (probability 0.5). Certificates are about the loop without it."
    assert said in " ".join(run(capsys, "certify", "paper", "--law", "mean")[1].split())
    record = json.loads(run(capsys, "certify", "paper", "--json")[1])
    assert record["imperfections_left_out"] == ["dropout (probability 0.5)"]


def test_certify_does_not_list_as_left_out_what_it_covers(capsys, made_up, monkeypatch):
    parts = (ModeDelay(2), Dropout(0.5), Noise(0.1))
    imperfect = replace(dt.problems.paper(), imperfections=parts)
    monkeypatch.setattr(import_module("deadtime.cli.options"), "problem_of", lambda _: imperfect)

    def left_out(*options):
        text = " ".join(run(capsys, "certify", "paper", "--law", "mean", *options)[1].split())
        record = json.loads(run(capsys, "certify", "paper", "--json", *options)[1])
        return text, record["imperfections_left_out"]

    text, names = left_out("--mode-lag", "2")
    assert "Not covered: dropout (probability 0.5), noise (std 0.1)." in text
    assert names == ["dropout (probability 0.5)", "noise (std 0.1)"]
    assert left_out("--mode-lag", "1")[1] == [
        "mode detection delay (periods 2)",
        "dropout (probability 0.5)",
        "noise (std 0.1)",
    ]
    text, names = left_out("--lost-samples", "3")
    assert "Not covered: mode detection delay (periods 2), noise (std 0.1)." in text
    assert "Covered while at most 3 samples in a row are lost: dropout (probability 0.5)." in text
    assert names == ["mode detection delay (periods 2)", "noise (std 0.1)"]


def test_a_refusal_calls_an_input_by_its_name():
    problem = replace(dt.problems.paper(), inputs=("brake",))
    delays = [[1.0], [1.0]], [[1.0], [0.9]]
    judged = judge(problem, dt.SignalClass(0.2), 0.1, ["mean"], delays=delays)
    assert certificate_sentences(judged, problem) == [
        f"mean: delays of brake in {problem.modes[1]} must ascend, got (1, 0.9)."
    ]


def test_certify_json_holds_everything_and_no_infinity(capsys, made_up):
    code, out, _ = run(capsys, "certify", "paper", "--json")
    record = json.loads(out)
    assert code == 0
    assert record["step"] == 0.01
    assert record["laws"]["averaged"]["worst_signal"] == {
        "proven": True,
        "growth_rate": 0.282,
        "modes": [1],
        "sojourns": [None],
        "phase": 0.0,
        "message": "grows.",
    }
    assert record["laws"]["mean"]["delay_margin"]["upper"] == 1.012
    assert record["laws"]["mean"]["statement"] == ["The loop is the sampled one."]
    assert record["laws"]["delay ignored"]["message"] == "this law cannot be asked about."


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["certify", "none.toml"], "none.toml cannot be read"),
        (["certify", "paper", "--law", "avg"], "law must be one of averaged, mode 0 only"),
        (["certify", "paper", "--dwell-time", "0"], "dwell_time must be positive"),
        (["certify", "paper", "--step", "-1"], "step must be positive"),
        (["certify", "paper", "--out", "c.npz"], "JSON files, such as 'c.json'"),
        (["certify"], "requires an argument"),
        (["verify"], "requires an argument"),
    ],
)
def test_bad_requests_get_one_line_and_code_2(capsys, made_up, arguments, message):
    code, _, err = run(capsys, *arguments)
    assert code == 2
    assert err.startswith("deadtime: error: ")
    assert err.count("\n") == 1
    assert message in err


@pytest.mark.parametrize(("proven", "word"), [(True, "proven"), (False, "not proven")])
def test_verify_tells_by_its_exit_code(capsys, monkeypatch, proven, word):
    def verify(path, **asked):
        statement = ("About this loop.", "And its numbers.")
        about = ("Plant 12ab.",)
        plainly = ("Valid: it decays.",)
        return Verification(proven, "Proved: …", statement, 0.5, 0.25, about, plainly)

    monkeypatch.setattr(import_module("deadtime.certificates"), "verify", verify)
    code, out, err = run(capsys, "verify", "cert.json")
    assert (code, err) == (0 if proven else 1, "")
    assert out == "Valid: it decays.\n"
    _, out, _ = run(capsys, "verify", "cert.json", "--explain")
    formal = "• About this loop.\n• And its numbers.\n• Plant 12ab.\n"
    assert out == f"Valid: it decays.\n{formal}({word} in 0.25 s)\n"
    code, out, _ = run(capsys, "verify", "cert.json", "--json")
    assert code == (0 if proven else 1)
    record = json.loads(out)
    assert (record["proven"], "summary" in record) == (proven, False)


# -- the real answers ----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """A certificate of the follower's averaged law, sampled slowly."""
    path = tmp_path_factory.mktemp("certificates") / "cert.json"
    arguments = ["certify", "follower", "--law", "averaged", "--step", "0.1", "--out", str(path)]
    with pytest.raises(SystemExit) as stopped:
        main(arguments)
    assert stopped.value.code == 0
    return path


def test_what_certify_saves_verify_proves(capsys, saved):
    code, out, err = run(capsys, "verify", str(saved))
    assert (code, err) == (0, "")
    valid, loop, left_out = out.splitlines()
    assert valid.startswith("Valid: the loop decays at least like exp(−")
    assert valid.endswith(
        ", for every switching signal with a dwell time of 1.0 s, switching at any instant."
    )
    assert loop.startswith(
        "Loop: the plant of 2 modes, 3 states, 1 input, input delay 0.2 s, under a"
    )
    assert left_out.startswith("Not covered: ")


def test_a_certificate_is_one_file_that_proves_itself_anywhere(capsys, saved, tmp_path):
    """What is mailed is the file alone."""
    assert list(saved.parent.iterdir()) == [saved]
    assert json.loads(saved.read_text(encoding="utf-8"))
    mailed = tmp_path / "of_a_colleague.json"
    mailed.write_bytes(saved.read_bytes())
    assert run(capsys, "verify", str(mailed))[::2] == (0, "")


def test_verify_compares_plant_period_dwell_time_and_table_with_a_problem(capsys, saved, tmp_path):
    slow = ("--step", "0.1")
    for asked in (
        *(("--law", "averaged", "--dwell-time", "1.5"), ("--law", "averaged"), ()),
        ("--dwell-time", "7"),
    ):
        code, out, _ = run(capsys, "verify", str(saved), "--problem", "follower", *slow, *asked)
        assert (code, out[:6]) == (0, "Valid:"), asked
        matches = "\nMatches follower: its plant and its law averaged. Every signal that stays in "
        assert matches in out
        assert out.endswith(", switches at any time; sampling period 0.1 s.\n")
    for asked, message in (
        (("follower", *slow, "--law", "mean"), "another table than that of the given law"),
        (("follower", *slow, "--dwell-time", "0.9"), ", not 0.9 s"),
        (("follower",), "is about a period of 0.1 s, not "),
        (("follower",), "give a step of 0.1 (--step)"),
        (("paper", *slow), "a plant with other matrices"),
    ):
        code, out, err = run(capsys, "verify", str(saved), "--problem", *asked)
        assert (code, err) == (1, "")
        assert out.startswith("Rejected: ")
        assert message in out
        assert out.count("\n") == 1
    code, _, err = run(capsys, "verify", str(saved), "--law", "averaged")
    assert code == 2
    assert "--law needs --problem" in err
    for part, value in (("law", {"context": ["mode"]}), ("", {"rho": 10**400})):
        code, out, err = run(capsys, "verify", str(rewritten(copied(saved, tmp_path), part, value)))
        assert (code, out, err.count("\n")) == (2, "", 1)


def test_the_match_with_a_problem_is_data_too(capsys, saved):
    code, out, _ = run(
        capsys, "verify", str(saved), "--problem", "follower", "--step", "0.1", "--json"
    )
    assert code == 0
    matches = json.loads(out)["matches"]
    assert matches.pop("dwell_time") >= 1.0
    assert matches == {"problem": "follower", "laws": ["averaged"], "step": 0.1}
    _, out, _ = run(capsys, "verify", str(saved), "--json")
    assert json.loads(out)["matches"] is None


def test_a_certificate_of_a_law_that_the_problem_lacks_is_rejected(capsys, saved, tmp_path):
    text = files("deadtime.problems").joinpath("files/follower.toml").read_text()
    other = tmp_path / "other.toml"
    other.write_text(f'{text}\n[[law]]\nkind = "mean"\n')
    code, out, _ = run(capsys, "verify", str(saved), "--problem", str(other), "--step", "0.1")
    assert code == 1
    assert out.startswith("Rejected: its table belongs to none of")
    assert "Matches" not in out


@pytest.mark.parametrize(
    ("section", "entry"), [("", "rho"), ("plant", "A"), ("law", "G"), ("signals", "chatter")]
)
def test_a_certificate_without_an_entry_names_it(capsys, saved, tmp_path, section, entry):
    content = json.loads(saved.read_text())
    del (content[section] if section else content)[entry]
    del content["sha256"]
    content["sha256"] = digest(content)
    path = tmp_path / "cut.json"
    path.write_text(json.dumps(content))
    code, _, err = run(capsys, "verify", str(path))
    assert (code, err.count("\n")) == (2, 1)
    assert repr(entry) in err


def test_certify_asks_for_the_dwell_time_of_a_rule(capsys, tmp_path):
    paper = files("deadtime.problems").joinpath("files/paper.toml").read_text()
    rule = '[signal]\nkind = "half-space"\nnormal = [1.0, 0.0]\n\n'
    (tmp_path / "own.toml").write_text(re.sub(r"(?ms)^\[signal\].*?(?=^\[run\])", rule, paper))
    code, _, err = run(capsys, "certify", str(tmp_path / "own.toml"))
    assert (code, err.count("\n")) == (2, 1)
    assert "give --dwell-time" in err


def copied(path, folder):
    copy = folder / "copy.json"
    copy.write_bytes(path.read_bytes())
    return copy


def test_a_file_that_cannot_be_read_is_a_bad_request(capsys, saved, tmp_path):
    code, _, err = run(capsys, "verify", str(tmp_path / "none.json"))
    assert code == 2
    assert err.count("\n") == 1
    altered = tmp_path / "cert.json"
    altered.write_text(saved.read_text().replace("0.2", "0.3", 1))
    code, _, err = run(capsys, "verify", str(altered))
    assert code == 2
    assert "altered" in err


def test_certify_shows_the_signal_that_the_paper_s_law_does_not_stabilise(capsys):
    code, out, err = run(capsys, "certify", "paper", "--law", "averaged", "--step", "0.1", "--json")
    record = json.loads(out)["laws"]["averaged"]
    assert (code, err) == (1, "")
    assert record["stable"] is False
    assert record["worst_signal"]["modes"] == [1]
    assert record["worst_signal"]["sojourns"] == [None]
    assert record["worst_signal"]["growth_rate"] > 0.2
    assert record["delay_margin"]["lower"] is None


@pytest.mark.parametrize("law", ["averaged", "delay ignored"])
def test_a_law_with_no_certificate_is_reported_not_raised(capsys, law):
    arguments = ("--law", law, "--dwell-time", "0.004")
    code, out, err = run(capsys, "certify", "paper", *arguments)
    assert (code, err) == (1, "")
    assert "no answer" in out
    assert "is not above one period" in " ".join(out.split())


def test_ranges_that_do_not_fit_the_plant_are_a_wrong_request(capsys):
    code, out, err = run(capsys, "certify", "paper", "--delays", "[0.9,0.9]", "[1,1]")
    assert code == 2
    assert not out
    assert "delays must be a number or have shape (m,) = (1,)" in err


def test_certify_takes_ranges_of_delays_as_a_problem_file_writes_them(capsys, monkeypatch):
    asked = []

    def judge(problem, signals, step, laws, *, delays, **others):
        asked.append(delays)
        return []

    monkeypatch.setattr(import_module("deadtime.reports.certificate_tables"), "judge", judge)
    ranges = ("--delays", "[0.25,0.12]", "[[0.28,0.15],[0.3,0.15]]")
    code, out, _ = run(capsys, "certify", "paper", *ranges, "--json")
    assert code == 0
    assert asked == [([0.25, 0.12], [[0.28, 0.15], [0.3, 0.15]])]
    assert json.loads(out)["delays"] == [[0.25, 0.12], [[0.28, 0.15], [0.3, 0.15]]]
    code, _, err = run(capsys, "certify", "paper", "--delays", "[0.3", "0.1]")
    assert code == 2
    assert "--delays must be two numbers, or two lists such as [0.3,0.1], got '[0.3'" in err
    run(capsys, "certify", "paper", "--delays", "0.9", "1")
    assert asked[-1] == (0.9, 1)


def test_a_proof_that_takes_more_work_than_is_usual_is_saved_with_the_command_that_verifies_it(
    capsys, tmp_path, monkeypatch
):
    for name, value in (("FREE", 10**4), ("PER_NUMBER", 10**2)):
        monkeypatch.setattr(f"deadtime.certificates.proof.work.{name}", value)
    path = tmp_path / "c.json"
    file = tmp_path / "p.toml"
    file.write_text(MILD_FILE, encoding="utf-8")
    code, out, _ = run(capsys, "certify", str(file), "--law", "averaged", "--out", str(path))
    assert code == 0
    command = re.search(r"It needs more work than usual: deadtime (verify .*)", out)[1].split()
    assert run(capsys, *command[:-2])[0] == 1
    code, out, _ = run(capsys, *command)
    assert code == 0
    assert out.startswith("Valid: ")
