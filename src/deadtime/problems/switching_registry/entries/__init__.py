"""The switching models that problem files know: every file here is found."""
