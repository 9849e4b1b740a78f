"""One file for each place of a loop; every file is found and taken in the order of its name."""
