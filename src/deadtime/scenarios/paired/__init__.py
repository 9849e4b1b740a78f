"""Laws compared in pairs, on the same signals: statistics of quotients, and the best law."""
