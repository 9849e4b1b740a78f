"""Preview: the rows of a law for a known switching signal, without a table.

Such a law has a row for every sample, which holds the pieces of the plant over a whole delay. All
of them are one product: the model predicts x(t_k + D) from the state and the inputs in flight, and

    u_k = K_i x(t_k + D) + L u_{k−1},    i = σ(t_k + D).

An engine that already moves the model along the signal needs the gains alone; the table serves
for inspection.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from deadtime.plant import SampledPlant
from deadtime.switching import SwitchingSignal
from deadtime.switching.grid import cuts_of, modes_at


class Preview(NamedTuple):
    """The preview of a law for a known signal: model, gains and signal.

    sampled : the law's model at its period
    gains : (modes, m, n), K_i
    latest : (m, m), L, the direct gain of the latest input
    signal : the signal that the law assumes, known up to the last sample plus the delay
    """

    sampled: SampledPlant
    gains: Float[np.ndarray, "mode m n"]
    latest: Float[np.ndarray, "m m"]
    signal: SwitchingSignal

    def modes_ahead(self, steps: int) -> np.ndarray:
        """σ(t_k + D) for k = 0, …, steps − 1; a switch at that instant counts."""
        window = self.sampled.window
        return modes_at(self.signal, np.arange(steps) * window.step + window.delay, window.step)

    def rows(
        self, steps: int
    ) -> tuple[Float[np.ndarray, "step m n"], Float[np.ndarray, "step N m m"]]:
        """F and G of the samples 0, …, steps − 1.

        The functional R = K_σ(t_k+D) is carried backwards from t_k + D to t_k over the pieces, all
        samples at once: a piece adds R Γ to the tap of its input, and turns R into R Φ. What
        remains of R is F.
        """
        count, R = self.sampled.longest_lag, self.gains[self.modes_ahead(steps)]
        table = self.sampled.along(cuts_of(self.signal, self.sampled), steps + count - 1)
        # With one delay all periods have equally many pieces.
        entry = table.entry.reshape(table.first.size - 1, -1)
        G = np.zeros((steps, count, *self.latest.shape))
        G[:, 0] = self.latest
        with np.errstate(all="ignore"):  # a table refuses what overflows
            for j in range(1, count + 1):
                # u_{k−j} acts in the first piece of period k − j + N and in the later pieces of the
                # period before; for j = N those are past.
                for piece in range(entry.shape[1] if j < count else 1):
                    begin = count - j - piece
                    of = entry[begin : begin + steps, piece]
                    G[:, j - 1] += R @ table.Gamma[of]
                    R = R @ table.Phi[of]
        return R, G
