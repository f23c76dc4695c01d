"""PyTorch, which only training needs and which is slow to load."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from barn_metrics.model.errors import ModelError


@contextmanager
def torch_on_one_thread() -> Iterator[Any]:
    """Give torch; ModelError where it is missing.

    On one thread small products are quickest, and the order of their sums does not depend on the machine.
    """
    try:
        import torch  # noqa: PLC0415 (optional and slow to load)
    except ImportError:
        raise ModelError("training of networks needs PyTorch: pip install torch") from None
    threads = torch.get_num_threads()
    try:
        torch.set_num_threads(1)
        yield torch
    finally:
        torch.set_num_threads(threads)
