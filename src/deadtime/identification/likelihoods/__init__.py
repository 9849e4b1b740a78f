"""Likelihoods of logs: of exact states, of noisy sensors, and of hidden modes with either."""
