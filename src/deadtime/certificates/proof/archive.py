"""Certificates on disk: one JSON file, its matrices as base64 of little-endian binary64.

verifier/FORMAT.md defines every entry and its conditions. The SHA-256 of the content detects
accidents only. A certificate is true if the check passes on the numbers of the file, and the file
claims no more than they prove.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import json
import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from deadtime.base.errors import ArgumentError, CertificateFileError
from deadtime.base.files import read_text, replacing
from deadtime.base.version import __version__
from deadtime.certificates.proof.delays import Delays
from deadtime.certificates.proof.evidence import Centre, Evidence, Setting
from deadtime.certificates.proof.stretches import StretchEvidence, decay_rate
from deadtime.plant.uncertainties import KEYS as KEYS_OF_PLANTS, read_set
from deadtime.switching import SignalClass
from deadtime.switching.constraint import one_or_each

FORMAT = "deadtime certificate 2"
HINTS = ("E", "row", "R", "T", "F")  # of the centre
MOST_BYTES = 2**30  # the limit of the second verifier, too: both accept the same files
DEEPEST = 20  # brackets within brackets: json.loads would exhaust the stack on a hostile file
# Possessive (++), so that a string without an end costs linear and not quadratic time.
_BRACKET = re.compile(r'"(?:[^"\\]++|\\.)*"?|[\[{\]}]', re.DOTALL)
TOP = "format version decay_rate plant law signals rho lyapunov hints sha256"
KEYS = {
    "plant": " ".join(("A B delays", *KEYS_OF_PLANTS)),
    "law": "context ages step F G mode_lag memory lost_samples",
    "signals": "dwell_time maximum_dwell chatter clock_tolerance transitions at",
}
LYAPUNOV = {"linear": "kind knots P Psi S", "stretches": "kind knots P mu"}


@dataclass(frozen=True)
class Archived:
    """The content of a certificate's file (immutable): evidence, claimed decay rate and digest."""

    evidence: Evidence | StretchEvidence
    decay_rate: float | None
    digest: str


def save_evidence(evidence: Evidence | StretchEvidence, path: Path) -> Path:
    """Write the evidence to `path`, complete or not at all."""
    setting, signals, limits = evidence.setting, evidence.setting.signals, evidence.setting.limits
    longest = tuple(None if math.isinf(most) else most for most in limits.maximum_dwell)
    counts = {
        "mode_lag": signals.mode_lag,
        "memory": setting.memory,
        "lost_samples": signals.lost_samples,
    }
    content = {
        "format": FORMAT,
        "version": __version__,
        "decay_rate": decay_rate(evidence),
        "plant": {
            "A": setting.plants.A.tolist(),
            "B": setting.plants.B.tolist(),
            "delays": setting.delays.ends.tolist(),
            **{name: _pack(array) for name, array in setting.plants.arrays.items()},
        },
        "law": {
            "context": setting.context,
            "ages": setting.ages,
            "step": setting.step,
            "F": _pack(setting.F),
            "G": _pack(setting.G),
            **{name: n for name, n in counts.items() if n},
        },
        "signals": {
            "dwell_time": one_or_each(limits.dwell_time),
            "maximum_dwell": one_or_each(longest),
            "chatter": signals.chatter,
            "clock_tolerance": signals.clock_tolerance,
            **({} if signals.at == "anywhere" else {"at": signals.at}),
            **({} if limits.is_free else {"transitions": limits.transitions.astype(int).tolist()}),
        },
        "rho": evidence.rho,
        **_function(evidence),
    }
    # Of all the content but itself, as `_content` computes it again.
    content["sha256"] = digest(content)
    with replacing(path) as place:
        place.write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    return path


def _function(evidence: Evidence | StretchEvidence) -> dict[str, Any]:
    if isinstance(evidence, StretchEvidence):
        V = {"kind": "stretches", "knots": evidence.knots, "P": _pack(evidence.P)}
        averaged = evidence.setting.transitions.bucket is not None
        return {"lyapunov": V | ({"mu": evidence.mu} if averaged else {}), "hints": {}}
    centre = evidence.centre
    arrays = {"P": evidence.P, "Psi": centre.Psi, "S": evidence.S}
    hints = {name: _pack(getattr(centre, name)) for name in HINTS}
    V = {"kind": "linear", "knots": evidence.knots}
    V |= {name: _pack(array) for name, array in arrays.items()}
    return {"lyapunov": V, "hints": hints | {"Pi": _pack(evidence.Pi)}}


def load_evidence(path: Path) -> Archived:
    """The evidence of a file.

    Raises `CertificateFileError` for files that are missing, cut short, altered or foreign.
    """
    content = _content(path)
    try:
        rate = content["decay_rate"]
        evidence = _evidence(content)
        return Archived(evidence, None if rate is None else _float(rate), content["sha256"])
    # Any entry may be of any type: these are the errors that reading a foreign file can raise.
    except (
        KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError, binascii.Error
    ) as error:  # fmt: skip
        fault = f"{error!r:.200}"
        if isinstance(error, KeyError):
            fault = f"it lacks the entry {error.args[0]!r}"
        elif type(error) in (ValueError, ArgumentError):
            fault = f"{error!s:.200}".removesuffix(".")
        raise CertificateFileError(
            f"path {str(path)!r} is not a whole certificate: {fault}."
        ) from None


def _content(path: Path) -> dict[str, Any]:
    """The JSON of a file whose digest fits."""
    no_json = f"path {str(path)!r} must be a certificate's JSON file: it"
    text = read_text(path, MOST_BYTES, CertificateFileError, called=no_json)
    depth = 0
    for bracket in _BRACKET.finditer(text):
        depth += (bracket[0] in ("[", "{")) - (bracket[0] in ("]", "}"))
        if depth > DEEPEST:
            raise CertificateFileError(f"{no_json} is nested too deeply.")
    try:
        content = json.loads(text, object_pairs_hook=_without_repeats)
    except ValueError as error:
        raise CertificateFileError(f"{no_json} cannot be read: {error}.") from None
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise CertificateFileError(
            f"path {str(path)!r} is no {FORMAT}: give the JSON file that `save` wrote."
        )
    stored = content.get("sha256")
    # A half of a surrogate pair is valid JSON, but has no UTF-8 to be hashed.
    try:
        found = digest({key: value for key, value in content.items() if key != "sha256"})
    except UnicodeEncodeError:
        raise CertificateFileError(f"{no_json} holds half a surrogate pair, no text.") from None
    if stored != found:
        raise CertificateFileError(
            f"path {str(path)!r} was altered after it was written: its digest does not match."
        )
    return content


def _without_repeats(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """An object whose keys are all different: a repeated key would be ambiguous."""
    content = dict(pairs)
    if len(content) < len(pairs):
        raise ValueError("a key occurs twice")
    return content


def _evidence(content: dict[str, Any]) -> Evidence | StretchEvidence:
    plant, law, signals, V = (content[key] for key in ("plant", "law", "signals", "lyapunov"))
    _require_keys("", content, TOP)
    _text(content["version"])
    if not isinstance(content["hints"], dict):
        raise TypeError(f"hints are {content['hints']!r:.40}, no object")
    for name, keys in KEYS.items():
        _require_keys(name, content[name], keys)
    if V["kind"] not in list(LYAPUNOV):
        raise ValueError(f"lyapunov.kind {V['kind']!r:.40} is neither 'linear' nor 'stretches'")
    _require_keys("lyapunov", V, LYAPUNOV[V["kind"]])
    if signals.get("at", "samples") != "samples":
        raise ValueError("signals.at must be 'samples', or left out")
    setting = Setting(
        read_set(
            _array_of(plant["A"]),
            _array_of(plant["B"]),
            {name: _array(plant[name]) for name in KEYS_OF_PLANTS if name in plant},
        ),
        _delays(plant["delays"]),
        _array(law["F"]),
        _array(law["G"]),
        _text(law["context"]),
        law["ages"],
        _float(law["step"]),
        SignalClass(
            _each(signals["dwell_time"], _float),
            _each(signals["maximum_dwell"], lambda x: math.inf if x is None else _float(x)),
            _transitions(signals),
            "samples" if "at" in signals else "anywhere",
            _float(signals["clock_tolerance"]),
            _count(law, "mode_lag"),
            _count(law, "lost_samples"),
            signals["chatter"],
        ),
        _count(law, "memory"),
    )
    knots, rho = tuple(V["knots"]), _float(content["rho"])
    if V["kind"] == "stretches":
        if ("mu" in V) != (setting.signals.chatter > 1 and setting.modes > 1):
            raise ValueError("lyapunov.mu goes with an average dwell time, and only with it")
        return StretchEvidence(setting, _array(V["P"]), knots, rho, _float(V.get("mu", 1.0)))
    hints = {name: _array(content["hints"][name]) for name in HINTS}
    centre = Centre(Psi=_array(V["Psi"]), **hints)
    Pi = _array(content["hints"]["Pi"])
    return Evidence(setting, centre, _array(V["P"]), Pi, _array(V["S"]), knots, rho)


def _require_keys(name: str, content: dict[str, Any], keys: str) -> None:
    """Refuse unknown entries: the check would not read them, and a reader might believe them."""
    extra = sorted(set(content) - set(keys.split()))
    if extra:
        raise ValueError(f"{extra[0]!r:.40} is no entry of {name or 'a certificate'}")


def claims_too_much(archived: Archived) -> str:
    """The claim of a file that exceeds the proof; empty if there is none."""
    proved, claimed = decay_rate(archived.evidence), archived.decay_rate
    if claimed is not None and not 0.0 <= claimed <= proved:
        return f"it claims a decay rate of {claimed!r} 1/s, its numbers prove {proved!r} at most"
    return ""


def _count(law: dict[str, Any], name: str) -> int:
    """A number of the law; absent where it is 0, so that one loop has one file."""
    count = law.get(name, 0)
    if name in law and count == 0:
        raise ValueError(f"law.{name} 0 must be left out")
    return count


def _each(value: Any, read: Callable[[Any], float]) -> float | tuple[float, ...]:
    """One value, or one per mode; equal values must be stored as one."""
    if not isinstance(value, list):
        return read(value)
    if len({*value}) < 2:
        raise ValueError("a time is neither one number nor several, one for each mode")
    return tuple(read(one) for one in value)


def _transitions(signals: dict[str, Any]) -> list[list[int]] | None:
    """The matrix of 0 and 1 of the allowed switches; None if all are."""
    if "transitions" not in signals:
        return None
    matrix = signals["transitions"]
    for i, row in enumerate(matrix):
        if len(row) != len(matrix) or any(type(x) is not int or x not in (0, 1) for x in row):
            raise ValueError("signals.transitions is no square matrix of 0 and 1")
        if row[i]:
            raise ValueError("signals.transitions holds a 1 on its diagonal")
    if sum(map(sum, matrix)) == len(matrix) * (len(matrix) - 1):
        raise ValueError("signals.transitions allows all: it must be left out")
    return matrix


def _text(value: Any) -> Any:
    if not isinstance(value, str):
        raise TypeError(f"{value!r:.40} is no text")
    return value


def _float(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise TypeError(f"{value!r:.40} is no number")
    # JSON integers have any length; a rounded one would not be the number of the file.
    if isinstance(value, int) and float(value) != value:
        raise ValueError(f"{value!r:.40} is no binary64 number")
    if not math.isfinite(value):
        raise ValueError(f"{value!r} is not finite")
    return float(value)


def _delays(value: Any) -> Delays:
    ends = _array_of(value)
    if ends.ndim < 2 and ends.shape != (2,):
        raise ValueError("plant.delays is neither low and high nor a list per mode")
    return Delays(ends)


def _array_of(value: Any) -> np.ndarray:
    flat = np.array(value, dtype=object)
    return np.array([_float(entry) for entry in flat.ravel()]).reshape(flat.shape)


def _pack(array: np.ndarray) -> dict[str, Any]:
    data = np.ascontiguousarray(array, "<f8").tobytes()
    return {"shape": array.shape, "data": base64.b64encode(data).decode("ascii")}


def _array(packed: dict[str, Any]) -> np.ndarray:
    _require_keys("an array", packed, "shape data")
    shape = packed["shape"]
    if not all(isinstance(n, int) and not isinstance(n, bool) and n >= 0 for n in shape):
        raise ValueError(f"{shape!r:.40} is no shape")
    data = base64.b64decode(packed["data"], validate=True)
    if math.prod(shape) * 8 != len(data):
        raise ValueError(f"{len(data)} bytes do not have the shape {shape!r:.40}")
    return np.frombuffer(data, "<f8").astype(np.float64).reshape(shape)


def digest(content: dict[str, Any]) -> str:
    """SHA-256 of the content in a canonical form, independent of white space and key order."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    return hashlib.sha256(text.encode()).hexdigest()
