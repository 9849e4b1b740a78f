"""Modes that nobody logged: a hidden Markov chain, by expectation–maximisation."""
