"""The benchmark as a learning environment for Gymnasium.

Importing this module registers `barn/Jackal-v0`::

    import gymnasium
    import barn_eval.gym

    env = gymnasium.make("barn/Jackal-v0", worlds="0:100")

`gymnasium.make("barn_eval.gym:barn/Jackal-v0")` does both. See docs/learning.md.
"""

from barn_worlds.base.errors import ConfigError

try:
    import gymnasium
except ImportError:
    raise ConfigError(
        "the learning environment needs Gymnasium, which is missing: "
        "make extras, or pip install gymnasium"
    ) from None

ENVIRONMENT_ID = "barn/Jackal-v0"

# Reloading the module must not register the environment twice: Gymnasium warns of that.
if ENVIRONMENT_ID not in gymnasium.registry:
    gymnasium.register(
        ENVIRONMENT_ID,
        entry_point="barn_eval.learning.environment:JackalEnv",
        vector_entry_point="barn_eval.learning.environment:JackalVectorEnv",
    )
