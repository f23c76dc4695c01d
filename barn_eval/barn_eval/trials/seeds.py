"""Seeds of a trial, made from what the trial is and not from when or where it runs."""

import hashlib


def simulator_seed(campaign_seed: int, world: int, repetition: int) -> int:
    """Return the seed of a trial's simulator, the same for every planner; from 0 to 2**32 - 1."""
    return _seed("simulator", campaign_seed, world, repetition)


def planner_seed(campaign_seed: int, world: int, repetition: int, planner: str) -> int:
    """Return the seed of a trial's planner; from 0 to 2**32 - 1."""
    return _seed("planner", campaign_seed, world, repetition, planner)


def _seed(*parts: object) -> int:
    digest = hashlib.sha256("/".join(map(str, parts)).encode()).digest()
    return int.from_bytes(digest[:4], "little")
