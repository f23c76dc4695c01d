"""Seeds of a trial, from what the trial is and not from when or where it runs."""

import hashlib


def simulator_seed(run_seed: int, world_number: int, repetition: int) -> int:
    """Return the seed of a trial's simulator, equal for all planners and machines.

    Args:
        run_seed: Seed of the run.
        world_number: Number of the world in its data set.
        repetition: Number of the trial among those in its world, from 0.

    Returns:
        A number from 0 to 2**32 - 1.
    """
    return _derive_seed("simulator", run_seed, world_number, repetition)


def planner_seed(
    run_seed: int, world_number: int, repetition: int, planner: str
) -> int:
    """Return the seed of a trial's planner, which also depends on the planner's name.

    Args:
        run_seed: Seed of the run.
        world_number: Number of the world in its data set.
        repetition: Number of the trial among those in its world, from 0.
        planner: Name of the planner.

    Returns:
        A number from 0 to 2**32 - 1.
    """
    return _derive_seed("planner", run_seed, world_number, repetition, planner)


def _derive_seed(*parts: object) -> int:
    """Return the first 32 bits of the SHA-256 of `parts`, joined by slashes."""
    # Python's own hash of a text differs from process to process.
    digest = hashlib.sha256("/".join(map(str, parts)).encode()).digest()
    return int.from_bytes(digest[:4], "little")
