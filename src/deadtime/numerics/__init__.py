"""Matrices, random numbers and polynomials; nothing of control."""
