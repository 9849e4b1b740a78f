"""Certificates on disk: a JSON file that can be read, and a binary file beside it.

The JSON holds the problem and the claim in words and numbers, the layout of the binary file and
its SHA-256, and a SHA-256 of its own content. The binary file holds the matrices, little-endian
binary64, in C order, one after the other. The digests find accidents; what makes a certificate
true is that the check passes on the numbers read.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np

from deadtime.certificates.proof.evidence import Centre, Evidence, Setting
from deadtime.errors import CertificateFileError
from deadtime.version import __version__

FORMAT = "deadtime certificate 1"
CENTRE = ("E", "row", "R", "T", "Psi", "F")
ARRAYS = ("P", "Pi", "S")


def save_evidence(evidence: Evidence, path: Path, words: dict[str, Any]) -> tuple[Path, Path]:
    """Write the evidence to `path` (JSON) and beside it (.bin); `words` are shown to readers."""
    setting = evidence.setting
    arrays = {f"law.{name}": getattr(setting, name) for name in ("F", "G")}
    arrays |= {f"centre.{name}": getattr(evidence.centre, name) for name in CENTRE}
    arrays |= {name: getattr(evidence, name) for name in ARRAYS}
    data = b"".join(np.ascontiguousarray(array, "<f8").tobytes() for array in arrays.values())
    sidecar = path.with_suffix(".bin")
    content = {
        "format": FORMAT,
        "version": __version__,
        **words,
        "plant": {"A": setting.A.tolist(), "B": setting.B.tolist(), "delays": setting.delays},
        "law": {"context": setting.context, "ages": setting.ages, "step": setting.step},
        "signals": {
            "dwell_time": setting.dwell_time,
            "maximum_dwell": setting.maximum_dwell,
            "chatter": setting.chatter,
        },
        "rho": evidence.rho,
        "knots": evidence.knots,
        "sidecar": {
            "file": sidecar.name,
            "bytes": len(data),
            "sha256": hashlib.sha256(data).hexdigest(),
            "arrays": [[name, array.shape] for name, array in arrays.items()],
        },
    }
    content["sha256"] = _digest(content)
    try:
        sidecar.write_bytes(data)
        path.write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    except OSError as error:
        raise CertificateFileError(
            f"path {str(path)!r} cannot be written ({error.strerror}): choose another one."
        ) from None
    return path, sidecar


def load_evidence(path: Path) -> tuple[Evidence, dict[str, Any]]:
    """The evidence of a file and its JSON.

    Raises `CertificateFileError` for files that are missing, cut short, altered or foreign.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, json.JSONDecodeError, RecursionError) as error:
        raise CertificateFileError(
            f"path {str(path)!r} must be a certificate's JSON file: {error}."
        ) from None
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise CertificateFileError(
            f"path {str(path)!r} is no {FORMAT}: give the JSON file that `save` wrote."
        )
    if content.pop("sha256", None) != _digest(content):
        raise CertificateFileError(
            f"path {str(path)!r} was altered after it was written: its digest does not match."
        )
    try:
        arrays = _arrays(content["sidecar"], path)
        return _evidence(content, arrays), content
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        if isinstance(error, CertificateFileError):
            raise
        raise CertificateFileError(
            f"path {str(path)!r} lacks parts of a certificate ({error})."
        ) from None


def _arrays(sidecar: dict[str, Any], path: Path) -> dict[str, np.ndarray]:
    """The matrices of the binary file."""
    beside = path.with_name(Path(sidecar["file"]).name)
    try:
        data = beside.read_bytes()
    except OSError as error:
        raise CertificateFileError(
            f"{str(beside)!r} cannot be read ({error.strerror}): the binary file belongs beside "
            "the JSON file."
        ) from None
    if len(data) != sidecar["bytes"]:
        raise CertificateFileError(
            f"{str(beside)!r} has {len(data):,} bytes, not {sidecar['bytes']:,}: it was cut short "
            "or replaced."
        )
    if hashlib.sha256(data).hexdigest() != sidecar["sha256"]:
        raise CertificateFileError(f"{str(beside)!r} was altered: its digest does not match.")
    arrays, at = {}, 0
    for name, shape in sidecar["arrays"]:
        size = int(np.prod(shape))
        array = np.frombuffer(data, "<f8", size, 8 * at).astype(np.float64)
        arrays[name] = array.reshape(shape)
        at += size
    return arrays


def _evidence(content: dict[str, Any], arrays: dict[str, np.ndarray]) -> Evidence:
    plant, law, signals = content["plant"], content["law"], content["signals"]
    low, high = plant["delays"]
    maximum = signals["maximum_dwell"]
    setting = Setting(
        np.array(plant["A"], dtype=float),
        np.array(plant["B"], dtype=float),
        (float(low), float(high)),
        arrays["law.F"],
        arrays["law.G"],
        law["context"],
        law["ages"],
        float(law["step"]),
        float(signals["dwell_time"]),
        None if maximum is None else float(maximum),
        signals["chatter"],
    )
    centre = Centre(**{name: arrays[f"centre.{name}"] for name in CENTRE})
    knots = tuple(content["knots"])
    return Evidence(
        setting, centre, arrays["P"], arrays["Pi"], arrays["S"], knots, float(content["rho"])
    )


def _digest(content: dict[str, Any]) -> str:
    """SHA-256 of the content, however it is laid out."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    return hashlib.sha256(text.encode("utf-8")).hexdigest()
