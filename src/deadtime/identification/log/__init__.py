"""Logs as arrays: columns, modes, states and units."""
