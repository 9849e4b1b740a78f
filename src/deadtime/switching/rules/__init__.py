"""Switching rules, by which the state determines the mode, and crossings of their boundaries."""
