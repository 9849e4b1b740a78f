"""What to do to a plant so that its log tells it: input sequences of the most information."""
