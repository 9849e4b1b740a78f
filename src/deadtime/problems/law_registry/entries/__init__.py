"""Laws that problem files know: every file here is found and taken in the order of its name."""
