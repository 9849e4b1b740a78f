"""Files that nobody would write on purpose, by the thousand, and what reads them.

`python -m fuzzing --kind problem --count 1000` from `tests`, or `make fuzz`.
"""
