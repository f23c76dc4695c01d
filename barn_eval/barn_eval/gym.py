"""The benchmark as a learning environment: importing this module registers `barn/Jackal-v0` with Gymnasium.

    import gymnasium
    import barn_eval.gym

    env = gymnasium.make("barn/Jackal-v0", worlds="0:100")

or, without the import, `gymnasium.make("barn_eval.gym:barn/Jackal-v0")`. See docs/learning.md.
"""

from barn_worlds.base.errors import ConfigError

try:
    import gymnasium
except ImportError:
    raise ConfigError(
        "the learning environment needs Gymnasium, which is missing: make extras, or pip install gymnasium"
    ) from None

ENVIRONMENT_ID = "barn/Jackal-v0"

if ENVIRONMENT_ID not in gymnasium.registry:
    gymnasium.register(
        ENVIRONMENT_ID,
        entry_point="barn_eval.learning.environment:JackalEnv",
        vector_entry_point="barn_eval.learning.vector:JackalVectorEnv",
    )
