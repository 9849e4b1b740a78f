"""Random switching: Markov and semi-Markov models, their sojourns, and how signals are drawn."""
