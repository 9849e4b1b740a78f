"""How late a law may be told the mode: what is proved, what is refuted, on the command line too."""

import json

import pytest

import deadtime as dt
import plants
from deadtime.cli import main
from deadtime.margins.mode_lag import _edge
from shares import mostly_long


def expecting(plant, poles):
    model = dt.Markov([[0.0, 1.0], [1.0, 0.0]])
    return plant, dt.ExpectedPredictor(plant, dt.place(plant, poles), model)


PAPER = dt.problems.paper().plant
LOOPS = {
    "paper": (*expecting(PAPER.apart(0.5), [-1.0, -2.0]), 0.5, 0.1),
    "coarse": (*expecting(PAPER.apart(0.5), [-1.0, -2.0]), 0.75, 0.25),
}


@pytest.mark.parametrize(
    ("name", "upto", "certified", "refuted"),
    mostly_long([("paper", None, 4, 11), ("coarse", 2, 1, 2)], ("coarse", 2, 1, 2)),
)
def test_what_is_proved_and_what_grows(name, upto, certified, refuted):
    plant, law, dwell_time, step = LOOPS[name]
    found = dt.longest_mode_lag(plant, law, dwell_time, step, upto=upto)
    assert (found.certified, found.refuted, found.reads_mode) == (certified, refuted, True)
    assert found.certificate.evidence.setting.signals.mode_lag == certified
    assert (found.witness.proven, found.witness.signals.mode_lag) == (True, refuted)
    assert found.certified_seconds == pytest.approx(certified * step)
    assert found.refuted_seconds == pytest.approx(refuted * step)
    answers = dict(found.evaluations)
    assert answers[certified] is True
    assert answers[certified + 1] is not True
    assert answers[refuted] is False
    assert f"{certified} period" in found.message
    assert f"{refuted} period" in found.message


def test_a_lag_asked_about_up_to_a_bound():
    plant, law, dwell_time, step = LOOPS["coarse"]
    found = dt.longest_mode_lag(plant, law, dwell_time, step, upto=1)
    assert (found.certified, found.refuted) == (1, None)
    assert found.message.endswith("the longest lag that was asked about.")


def test_a_law_that_does_not_read_the_mode_may_be_told_it_at_any_time():
    plant = PAPER.apart(0.5)
    law = dt.AveragedPredictor(plant, dt.place(plant, [-1.0, -2.0]))
    found = dt.longest_mode_lag(plant, law, 0.2, 0.1)
    assert not found.reads_mode
    assert found.certificate.proven
    assert found.message.startswith("The law does not read the mode")


def test_the_edge_is_found_by_doubling_and_halving():
    for last in range(40):
        asked = []
        found = _edge(lambda k, n=last, seen=asked: seen.append(k) or k <= n, 50)
        assert found == (last, last + 1)
        assert len(asked) <= 14


def test_bad_input_is_refused_by_name():
    plant = plants.paper()
    with pytest.raises(
        dt.ArgumentError, match=r"law must be a table .* got ExactPredictor: no lag"
    ):
        dt.longest_mode_lag(plant, plants.LAWS["exact"](plant), 0.3, 0.1)
    with pytest.raises(dt.ArgumentError, match="upto must be an integer"):
        dt.longest_mode_lag(*LOOPS["paper"], upto=-1)


def run(capsys, *arguments):
    with pytest.raises(SystemExit) as stopped:
        main(arguments)
    captured = capsys.readouterr()
    return stopped.value.code, captured.out, captured.err


@pytest.mark.long
def test_the_command_line_certifies_and_verifies_with_a_lag(capsys, tmp_path):
    about = ["paper", "--law", "delay ignored", "--dwell-time", "0.4", "--step", "0.1"]
    code, out, _ = run(capsys, "certify", *about, "--mode-lag", "3", "--json")
    record = json.loads(out)
    assert (code, record["mode_lag"]) == (1, 3)
    assert record["laws"]["delay ignored"]["stable"] is False
    with pytest.raises(SystemExit):
        main(["certify", *about, "--mode-lag", "3", "--longest-mode-lag"])
    assert "leave out --mode-lag" in "".join(capsys.readouterr())
    options = {"decay_rate": 0.0, "search_signals": False}
    path = dt.certify(*LOOPS["coarse"], mode_lag=1, **options).save(tmp_path / "late.json")
    assert run(capsys, "verify", str(path), "--mode-lag", "1")[0] == 0
    code, out, _ = run(capsys, "verify", str(path), "--mode-lag", "2")
    assert code == 1
    assert "late, not 2" in out


def test_the_command_line_looks_for_the_longest_lag(capsys):
    about = ["paper", "--law", "mean", "--dwell-time", "0.4", "--step", "0.1"]
    code, out, _ = run(capsys, "certify", *about, "--longest-mode-lag", "--json")
    found = json.loads(out)["longest_mode_lags"]["mean"]
    assert (code, found["certified"], found["refuted"]) == (1, None, None)
    assert found["message"].startswith("The law does not read the mode")
