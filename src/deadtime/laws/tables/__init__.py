"""Rows of digital laws, one file for each kind of forecast."""
