"""Switching signals: what they are, how they are drawn at random, how logs are read."""

from deadtime.switching.signal import SwitchingSignal

__all__ = ["SwitchingSignal"]
