"""Kernels of a hidden Markov chain: posterior probabilities of modes, and the likeliest path.

The first is the forward–backward recursion, the second Viterbi's (Rabiner, Proc. IEEE 77(2), 1989).
Sample k has the mode σ_k, and the period from it to the next one the density

    b_k(i, j) = exp stay[k, i] if i = j else exp move[k, i, j],
    p(σ) = first(σ_0) Π P_k(σ_k, σ_{k+1}),

P_k the row kind[k] of `chain`; with uneven samples every period has its own. Probabilities are
logarithms, because densities of exact states may differ by e^{1e12}.
"""

from __future__ import annotations

import math

import numpy as np

from deadtime.numerics.kernels import kernel


def smooth(stay, move, chain, kind, first, same, node, pairs):
    """The log likelihood; and posterior probabilities of modes, in place.

    stay : (periods, modes), move : (periods, modes, modes), or (periods, modes, 1) if it does not
    depend on the mode in which a period ends, log densities; chain : (kinds, modes, modes), first :
    (modes,), logs of probabilities; kind : (periods,). same : (periods, modes), probability that a
    period begins and ends in a mode; node : (periods + 1, modes), of each sample; pairs : (kinds,
    modes, modes), expected numbers of jumps in periods of each kind.
    """
    ahead = np.empty(node.shape)
    value = forward(stay, move, chain, kind, first, ahead)
    backward(stay, move, chain, kind, ahead, same, node, pairs)
    return value


@kernel
def forward(stay, move, chain, kind, first, ahead):
    """The log likelihood; ahead (periods + 1, modes), in place, of each mode and all before it.

    In each sample the largest one is subtracted, so that long logs lose no digits.
    """
    periods, modes = stay.shape
    last = move.shape[2] - 1
    term = np.empty(modes)
    value, minus_infinity = 0.0, -np.inf
    for i in range(modes):
        ahead[0, i] = first[i]
    for k in range(periods):
        largest = minus_infinity
        for j in range(modes):
            top = minus_infinity
            for i in range(modes):
                term[i] = ahead[k, i] + chain[kind[k], i, j]
                term[i] += stay[k, i] if i == j else move[k, i, min(j, last)]
                top = max(top, term[i])
            total = 0.0
            for i in range(modes):
                total += math.exp(term[i] - top)
            ahead[k + 1, j] = top + math.log(total)
            largest = max(largest, ahead[k + 1, j])
        value += largest
        for j in range(modes):
            ahead[k + 1, j] -= largest
    total = 0.0
    for i in range(modes):
        total += math.exp(ahead[periods, i])
    return value + math.log(total)


@kernel
def backward(stay, move, chain, kind, ahead, same, node, pairs):
    """The probabilities of `smooth`, in place, from those `ahead`."""
    periods, modes = stay.shape
    last = move.shape[2] - 1
    back, older, own = np.zeros(modes), np.zeros(modes), np.empty((modes, modes))
    minus_infinity = -np.inf
    total = 0.0
    for i in range(modes):
        node[periods, i] = math.exp(ahead[periods, i])
        total += node[periods, i]
    for k in range(pairs.shape[0]):
        for i in range(modes):
            for j in range(modes):
                pairs[k, i, j] = 0.0
    for i in range(modes):
        node[periods, i] /= total
    for k in range(periods - 1, -1, -1):
        top, largest = minus_infinity, minus_infinity
        for i in range(modes):
            most, after = minus_infinity, 0.0
            for j in range(modes):
                own[i, j] = (
                    chain[kind[k], i, j]
                    + (stay[k, i] if i == j else move[k, i, min(j, last)])
                    + back[j]
                )
                most = max(most, own[i, j])
            for j in range(modes):
                after += math.exp(own[i, j] - most)
            older[i] = most + math.log(after)
            largest = max(largest, older[i])
            top = max(top, ahead[k, i] + most)
        total = 0.0
        for i in range(modes):
            node[k, i] = 0.0
            for j in range(modes):
                own[i, j] = math.exp(ahead[k, i] + own[i, j] - top)
                total += own[i, j]
        for i in range(modes):
            for j in range(modes):
                share = own[i, j] / total
                node[k, i] += share
                pairs[kind[k], i, j] += share
            same[k, i] = own[i, i] / total
            back[i] = older[i] - largest


@kernel
def likeliest(stay, move, chain, kind, first, path):
    """Viterbi: the likeliest path (periods + 1,), in place, and its log probability.

    Of equally likely paths the one that stays.
    """
    periods, modes = stay.shape
    last = move.shape[2] - 1
    best, after = np.empty(modes), np.empty(modes)
    came = np.zeros((periods, modes), np.int64)
    for i in range(modes):
        best[i] = first[i]
    for k in range(periods):
        for j in range(modes):
            after[j] = best[j] + chain[kind[k], j, j] + stay[k, j]
            came[k, j] = j
            for i in range(modes):
                if i != j:
                    value = best[i] + chain[kind[k], i, j] + move[k, i, min(j, last)]
                    if value > after[j]:
                        after[j] = value
                        came[k, j] = i
        for j in range(modes):
            best[j] = after[j]
    end = 0
    for i in range(modes):
        if best[i] > best[end]:
            end = i
    path[periods] = end
    for k in range(periods - 1, -1, -1):
        path[k] = came[k, path[k + 1]]
    return best[end]
