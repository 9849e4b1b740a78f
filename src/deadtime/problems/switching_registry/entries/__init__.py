"""The switching models of problem files: every module here is loaded."""
