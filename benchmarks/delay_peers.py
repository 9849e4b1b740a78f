"""Delays by other packages, of the last state of a log, for `delay_estimators.py`.

None of them has a delay with a fraction of the period. What they have is a model, and it is read in
two ways:

- whole: the delay in periods that the package says, or else the first gain of the impulse response
  in a period that exceeds a quarter of the largest; the middle of that period.
- share: of two neighbouring gains those with the largest sum, g_N−1 and g_N; with a held input they
  share the effect as the period is cut by the arrival, D = h (N − g_N−1 / (g_N−1 + g_N)), if A
  does little in a period. No package does this: it is what somebody can do by hand.

python-control is required by the package itself. SIPPY (`pip install sippy_unipi`; `sippy` is
another package) and nfoursid (`pip install nfoursid`) are optional.

- `control.markov`: 16 parameters of what the state gains in a period, by least squares.
- `control.eigensys_realization`: a model of n + 12 states from 4 (n + 12) + 1 such parameters.
- SIPPY, ARX and ARMAX: orders and delay by Akaike's criterion, the delay from 0 to 11 (SIPPY counts
  from the sample before); of ARX na 0–5 and nb 1–5, its defaults, of ARMAX 1–3 each.
- SIPPY, N4SID: all states as outputs, horizons as by default, the order from 1 to n + 12 by
  Akaike's criterion, and n + 12, what a delay of 12 periods takes. PARSIM-K, its method for closed
  loops: the same with n + 12.
- nfoursid: all states as outputs, 20 block rows, rank n + 12. It leaves the rank to the eye; the
  widest gap between singular values is that of the plant without its delay.
"""

from __future__ import annotations

import contextlib
import importlib
import io
import warnings

import control
import numpy as np

from identification import H

MOST, LAGS = 12, 16  # periods


def middle(period):
    return H * (period + 0.5)


def first(gains):
    """The middle of the first period in which the response stands out."""
    size = np.abs(gains)
    return middle(int(np.argmax(size > 0.25 * size.max())))


def share(gains):
    """The arrival within the period, from how two neighbouring gains share the effect."""
    along = np.maximum(gains * np.sign(gains[np.abs(gains).argmax()]), 0.0)
    pair = along[:-1] + along[1:]
    k = int(pair.argmax())
    return H * (k + 1.0 - along[k] / pair[k])


def read(gains):
    return {"whole": first(gains), "share": share(gains)}


def response(A, B, C, D):
    """What a unit input does to the last output, over periods."""
    found, state = [D[-1, 0]], B[:, 0]
    for _ in range(LAGS):
        found.append(C[-1] @ state)
        state = A @ state
    return np.array(found)


def markov(x, u, count):
    return np.ravel(control.markov(np.diff(x[:, -1]), u[:-1], count))


def by_markov(log, x, u):
    return read(markov(x, u, LAGS))


def by_realization(log, x, u):
    order = x.shape[1] + MOST
    model, _ = control.eigensys_realization(markov(x, u, 4 * order + 1), order)
    return read(response(model.A, model.B, model.C, model.D))


def sippy(y, u, method, **asked):
    """A model by SIPPY, without what it prints."""
    package = importlib.import_module("sippy_unipi")
    with contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return package.system_identification(y.copy(), u.copy(), method, tsample=H, **asked)


def of_fraction(model, periods):
    time = H * np.arange(LAGS + 1)
    outputs = np.ravel(control.impulse_response(model.G, time).outputs)
    return {"whole": middle(periods), "share": share(np.diff(outputs))}


def by_sippy_arx(log, x, u):
    model = sippy(x[:, -1], u, "ARX", IC="AIC", delays=[0, MOST - 1])
    return of_fraction(model, model.theta)


def by_sippy_armax(log, x, u):
    orders = {key: [1, 3] for key in ("na_ord", "nb_ord", "nc_ord")}
    model = sippy(x[:, -1], u, "ARMAX", IC="AIC", delays=[0, MOST - 1], **orders)
    return of_fraction(model, model.delay)


def by_sippy_states(method, chosen=True):
    def found(log, x, u):
        order = x.shape[1] + MOST
        asked = {"IC": "AIC", "SS_orders": [1, order]} if chosen else {"SS_fixed_order": order}
        model = sippy(x.T, u, method, **asked)
        return read(np.diff(response(model.A, model.B, model.C, model.D)))

    return found


def by_nfoursid(log, x, u):
    package = importlib.import_module("nfoursid.nfoursid")
    states = list(log.filter(regex="^x"))
    fit = package.NFourSID(log, output_columns=states, input_columns=["u0"], num_block_rows=20)
    fit.subspace_identification()
    model, _ = fit.system_identification(rank=len(states) + MOST)
    return read(np.diff(response(model.a, model.b, model.c, model.d)))


PEERS = {
    "`control.markov`": (by_markov, "control"),
    "`control.eigensys_realization`": (by_realization, "control"),
    "SIPPY ARX, AIC": (by_sippy_arx, "sippy_unipi"),
    "SIPPY ARMAX, AIC": (by_sippy_armax, "sippy_unipi"),
    "SIPPY N4SID, AIC": (by_sippy_states("N4SID"), "sippy_unipi"),
    "SIPPY N4SID, order n + 12": (by_sippy_states("N4SID", chosen=False), "sippy_unipi"),
    "SIPPY PARSIM-K, order n + 12": (by_sippy_states("PARSIM-K", chosen=False), "sippy_unipi"),
    "nfoursid": (by_nfoursid, "nfoursid"),
}


def present():
    """Methods of the packages that import, and the names of those that do not."""
    missing = set()
    for package in {package for _, package in PEERS.values()}:
        try:
            importlib.import_module(package)
        except ImportError:
            missing.add(package)
    here = {name: one for name, (one, package) in PEERS.items() if package not in missing}
    return here, sorted(missing)
