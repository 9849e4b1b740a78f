"""JAX in double precision, where it is installed; the session's own default stays as it is."""

from __future__ import annotations

from contextlib import AbstractContextManager
from importlib import import_module

from deadtime.base.errors import ArgumentError


def need_jax() -> None:
    """Refuse a backend that is not installed.

    Raises
    ------
    ArgumentError
        If JAX cannot be imported.

    Examples
    --------
    >>> need_jax()
    """
    try:
        import_module("jax")
    except ImportError:
        raise ArgumentError('backend "jax" needs JAX: pip install "deadtime[jax]".') from None


need_jax()


def in_double() -> AbstractContextManager[object]:
    """A context in which JAX computes in float64; outside of it nothing changes.

    Examples
    --------
    >>> import jax.numpy as jnp
    >>> with in_double():
    ...     inside = jnp.ones(1).dtype
    >>> inside, jnp.ones(1).dtype
    (dtype('float64'), dtype('float32'))
    """
    import jax

    if hasattr(jax, "enable_x64"):
        return jax.enable_x64(True)
    # Versions before 0.8 have it there only, later ones no longer.
    return import_module("jax.experimental").enable_x64()


def on_cpu() -> bool:
    """Whether JAX found nothing faster to compute on."""
    import jax

    return jax.default_backend() == "cpu"
