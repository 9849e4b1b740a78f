"""Proofs by machine: the evidence for a certificate, and the check that it is one."""

from deadtime.certificates.proof.archive import load_evidence, save_evidence
from deadtime.certificates.proof.check import Check, check
from deadtime.certificates.proof.evidence import Evidence
from deadtime.certificates.proof.stretches import StretchEvidence

__all__ = ["Check", "Evidence", "StretchEvidence", "check", "load_evidence", "save_evidence"]
