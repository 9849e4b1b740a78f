"""Imperfections that problem files know: every file is found, in the order of its name."""
