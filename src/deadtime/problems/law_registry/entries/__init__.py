"""One file for each family of laws; every file here is found and taken in the order of its name."""
