"""The imperfections of problem files: every module here is loaded, in the order of its name."""
