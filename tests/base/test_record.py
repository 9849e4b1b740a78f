"""Records: plain data that JSON knows, whatever a result holds."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from deadtime.base.json_records import json_text, plain, record


class Pair(NamedTuple):
    low: float
    high: float


@dataclass(frozen=True)
class Result:
    rates: np.ndarray
    pairs: tuple[Pair, ...]
    place: Path
    count: np.int64

    @property
    def worst(self):
        return self.rates.max()


RESULT = Result(
    np.array([[1.0, np.nan], [-np.inf, 2.5]]), (Pair(0.0, np.inf),), Path("a") / "b", np.int64(3)
)
RATES = [[1.0, None], [None, 2.5]]


def test_every_figure_that_is_not_finite_is_none_however_deep_it_lies():
    whole = {"rates": RATES, "pairs": [{"low": 0.0, "high": None}], "place": str(RESULT.place)}
    assert plain(RESULT) == whole | {"count": 3}


def test_a_record_has_the_attributes_that_are_asked_for_in_that_order():
    assert list(record(RESULT, "worst", "rates").items()) == [("worst", None), ("rates", RATES)]


def test_a_document_is_json_to_the_letter():
    def refuse(token):
        raise AssertionError(f"{token} is no JSON")

    text = json_text({"law": "geglättet", "result": RESULT}, ascii_only=True)
    assert text.isascii()
    assert json.loads(text, parse_constant=refuse)["result"]["count"] == 3
