from .held import held_spread as held_spread
