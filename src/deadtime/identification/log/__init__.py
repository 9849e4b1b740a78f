"""Logs as they come: columns, modes, states and units, as arrays."""
