"""What a log hardly tells of a plant from outputs alone: whether it has zeros, and its order."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from deadtime.identification.estimate import Estimate
from deadtime.identification.likelihoods.embedding import Embedding
from deadtime.identification.outputs.chosen import CHANCE, Chosen, OutputsRequest, chosen_of

_DOUBT = 0.05  # of a rise by chance: from there on zeros are plausible
_WIDE = 0.2  # of an input's weight: a standard error that comes with poles that are not there


def zeros_in_doubt(chosen: Chosen, inputs: tuple[str, ...]) -> list[str]:
    """What delays would be the other way round, where both ways are plausible.

    A zero looks like a delay, so that its likelihood may rise by chance at any of many delays: it
    is beyond doubt at Bonferroni's level of all cells that were looked at.
    """
    from scipy.stats import chi2

    if chosen.other is None:
        return []
    cells = chosen.scan.curves.size
    least, most = (float(chi2.isf(p, chosen.more)) for p in (_DOUBT, CHANCE / cells))
    if not least < chosen.rise < most:
        return []
    D = chosen.other.theta[chosen.log.layout.at_delays]
    one = "the delay" if D.size == 1 else "delays"
    were = f"{one} would be {', '.join(f'{d:.4g}' for d in D)} s"
    whether = "the last derivative alone" if chosen.shape.zeros else "all states"
    acting = "inputs act" if inputs[1:] else f"{inputs[0]} acts"
    return [
        f"The log hardly tells whether {acting} on all states or on the last derivative alone: if "
        f"on {whether}, {were}. Say which by zeros=True or zeros=False, --zeros or --no-zeros."
    ]


def hardly_tells(found: Estimate, shape: Embedding) -> bool:
    """Whether the order may be too high: of a chain no input's weight is well known.

    A pole that is not there may be anywhere far out, as a delay, or beside a zero: with it goes
    what inputs weigh.
    """
    layout, theta = found.log.layout, found.best.theta
    error = np.sqrt(np.diagonal(found.spread.covariance))
    for last, count in zip(shape.last, shape.order, strict=True):
        place = layout.of_B[:, last].reshape(-1)
        if count > 1 and (error[place] > _WIDE * np.abs(theta[place])).all():
            return True
    return False


def order_too_high(request: OutputsRequest, chosen: Chosen) -> list[str]:
    """Which smaller order explains the log better, by BIC of the same measurements."""
    order, fewer = request.order, []
    for j, count in enumerate(order):
        if count > 1:
            own = (*order[:j], count - 1, *order[j + 1 :])
            layout = replace(request.layout, n=sum(own))
            asked = request._replace(layout=layout, order=own)
            fewer.append((chosen_of(asked, lead=order).bic, own))
    if not fewer or min(fewer)[0] >= chosen.bic:
        return []
    bic, own = min(fewer)
    say = f"say order={_text(own)}, --order {' '.join(map(str, own))}"
    return [
        f"An order of {_text(own)} explains the log better (BIC {bic:.1f}, against "
        f"{chosen.bic:.1f} with {_text(order)}): {say}."
    ]


def _text(order: tuple[int, ...]) -> str:
    return str(order[0]) if len(order) == 1 else str(order)
