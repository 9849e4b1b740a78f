"""Random switching: Markov and semi-Markov models, their sojourns, and sampling of signals."""
