"""Random generators of the children of a seed, as `np.random.SeedSequence(seed).spawn` has them, but made sooner.

The hash is that of numpy's SeedSequence, which numpy keeps as it is (NEP 19): O'Neill's `seed_seq_fe`, with a pool of
four words.
"""

from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

_WORD = np.uint64(0xFFFFFFFF)
_HALF = np.uint64(16)
_POOL = 4
_INIT_A, _MULT_A = np.uint64(0x43B0D7E5), np.uint64(0x931E8875)
_INIT_B, _MULT_B = np.uint64(0x8B51F9DD), np.uint64(0x58F38DED)
_MIX_LEFT, _MIX_RIGHT = np.uint64(0xCA01F9DD), np.uint64(0x4973F715)


class _Words(np.random.bit_generator.ISeedSequence):
    """The state that a generator begins with, eight words of 32 bits."""

    def __init__(self, words: npt.NDArray[np.uint32]) -> None:
        self._words = words

    def generate_state(self, n_words: int, dtype: Any = np.uint32) -> npt.NDArray[Any]:
        """Return the first words of a width."""
        return self._words.view(dtype)[:n_words]


def generator_of(seed: int, child: int) -> np.random.Generator:
    """Return a generator of a child of a seed, `default_rng(SeedSequence(seed).spawn(n)[child])` of numpy."""
    if not 0 <= seed <= _WORD:  # more than a word, or refused by numpy
        return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(child,)))
    return np.random.Generator(np.random.PCG64(_Words(first_words(seed, child))))


@njit(cache=True)
def first_words(seed: int, child: int) -> npt.NDArray[np.uint32]:
    """Return the first eight words of the state of a child of a seed, both of one word."""
    pool, factor = np.zeros(_POOL, np.uint64), _INIT_A
    for k in range(_POOL):
        pool[k], factor = _hashed(np.uint64(seed if k == 0 else 0), factor, _MULT_A)
    for source in range(_POOL + 1):
        for k in range(_POOL):
            if k != source:
                word = pool[source] if source < _POOL else np.uint64(child)
                word, factor = _hashed(word, factor, _MULT_A)
                mixed = (_MIX_LEFT * pool[k] - _MIX_RIGHT * word) & _WORD
                pool[k] = mixed ^ (mixed >> _HALF)
    words, factor = np.empty(2 * _POOL, np.uint32), _INIT_B
    for k in range(2 * _POOL):
        words[k], factor = _hashed(pool[k % _POOL], factor, _MULT_B)
    return words


@njit(cache=True)
def _hashed(word: Any, factor: Any, multiplier: Any) -> tuple[Any, Any]:
    """Return the hash of a word, and the factor for the next one."""
    word ^= factor
    factor = (factor * multiplier) & _WORD
    word = (word * factor) & _WORD
    return word ^ (word >> _HALF), factor
