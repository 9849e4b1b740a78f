"""`python -m fuzzing`: read mutants of files, and say which reader did not refuse them well."""

from __future__ import annotations

import argparse
import sys

from fuzzing.runner import fuzz
from fuzzing.targets import TARGETS


def main() -> int:
    parser = argparse.ArgumentParser(prog="fuzzing", description=__doc__)
    parser.add_argument("--kind", choices=TARGETS, action="append", help="all by default")
    parser.add_argument("--count", type=int, default=2000, help="mutants of each kind")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0, help="number of the first mutant")
    parser.add_argument("--seconds", type=float, default=120.0, help="at most, for each kind")
    asked = parser.parse_args()
    faulty = False
    for kind in asked.kind or TARGETS:
        found = fuzz(kind, asked.count, asked.seed, asked.seconds, asked.first)
        print(f"{kind}: {found.count} mutants, {found.read} read, {found.refused} refused,"
              f" {found.faults.total()} faults", flush=True)  # fmt: skip
        for fault, times in found.faults.most_common():
            print(f"  {times} × {fault} (--seed {asked.seed} --first {found.first[fault]})")
        faulty |= bool(found.faults)
    return int(faulty)


if __name__ == "__main__":
    sys.exit(main())
