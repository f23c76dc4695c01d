"""PyBullet, imported without the line that it prints on standard error."""

import importlib
import os
import sys
from typing import Any

# PyBullet's number of the plug-in that draws.
_RENDERER = 2


def _import_silently() -> Any:
    """Return the module pybullet, imported while standard error goes to /dev/null."""
    # None where it was closed before Python started, as cron may do.
    if sys.stderr is not None:
        sys.stderr.flush()
    try:
        # The line comes from C, which writes to the descriptor and not to sys.stderr.
        stderr = os.dup(2)
    except OSError:
        # Standard error is closed.
        return importlib.import_module("pybullet")
    devnull = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(devnull, 2)
        return importlib.import_module("pybullet")
    finally:
        os.dup2(stderr, 2)
        os.close(stderr)
        os.close(devnull)


bullet = _import_silently()


def connect(*, renders: bool = False) -> int:
    """Start a physics client, return its number; RuntimeError without room.

    Args:
        renders: Whether it can draw. Without, a body is ready in a tenth of the time,
            since no mesh is made of it.

    Raises:
        RuntimeError: If the process has too many clients.
    """
    client: int = bullet.connect(bullet.DIRECT)
    if client < 0:
        raise RuntimeError("PyBullet cannot create another physics client")
    if not renders:
        bullet.unloadPlugin(_RENDERER, physicsClientId=client)
    return client


def disconnect(client: int) -> None:
    """End a physics client by its number; do nothing if it has already ended."""
    if bullet.isConnected(client):
        bullet.disconnect(physicsClientId=client)
